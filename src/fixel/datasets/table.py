"""Importer of your own recordings: a CSV table whose header names columns and units."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from fixel.datasets.base import Importer, ImportPlan, origin_of, remark, trajectory_of
from fixel.datasets.files import CsvRows, Problems, increasing, rate_of, read_table
from fixel.datasets.own_scene import WORDS, refuse_implausible, with_scene
from fixel.errors import InvalidInput, check_name, unknown_name
from fixel.model import Channel, Experiment, Flag, Provenance, Trajectory
from fixel.model.fields import instance
from fixel.model.scene import SceneChoice
from fixel.progress import ProgressOption, show_progress
from fixel.typing import FloatArray

DATASET: Final = "csv"
ENDINGS = (".csv", ".csv.gz", ".parquet")
MAX_OTHERS: Final = 3  # sentences about some of the experiments of a table
_UNITS_IN_ROW: Final = "The first row has units, which count as those of the header."
_NUMBER: Final = re.compile(r"(?<![\w.'\"])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w)")  # none of a name


class ColumnUnit(NamedTuple):
    """Unit at the end of a column's name."""

    kind: str
    scale: float  # factor to SI
    si: str  # ending of the column's name in a channel


UNITS: Final[Mapping[str, ColumnUnit]] = {
    "s": ColumnUnit("time", 1.0, "s"),
    "ms": ColumnUnit("time", 1e-3, "s"),
    "us": ColumnUnit("time", 1e-6, "s"),
    "ns": ColumnUnit("time", 1e-9, "s"),
    "m": ColumnUnit("length", 1.0, "m"),
    "mm": ColumnUnit("length", 1e-3, "m"),
    "cm": ColumnUnit("length", 1e-2, "m"),
    "um": ColumnUnit("length", 1e-6, "m"),
    "inch": ColumnUnit("length", 0.0254, "m"),
    "rad": ColumnUnit("angle", 1.0, "rad"),
    "mrad": ColumnUnit("angle", 1e-3, "rad"),
    "deg": ColumnUnit("angle", math.pi / 180.0, "rad"),
    "n": ColumnUnit("force", 1.0, "n"),
    "nm": ColumnUnit("torque", 1.0, "nm"),
    "m_s": ColumnUnit("speed", 1.0, "m_s"),
    "mm_s": ColumnUnit("speed", 1e-3, "m_s"),
    "rad_s": ColumnUnit("turning", 1.0, "rad_s"),
    "deg_s": ColumnUnit("turning", math.pi / 180.0, "rad_s"),
    "bool": ColumnUnit("bool", 1.0, "bool"),
    "count": ColumnUnit("count", 1.0, "count"),
    "ratio": ColumnUnit("ratio", 1.0, "ratio"),
}

# Names of columns, their roles, and the kind of unit that each role requires.
_TIME = ("time", "t", "timestamp")
_ANGLE = ("theta", "angle", "yaw", "th", "heading", "phi")
_QUATERNION = ("q", "q_", "quat_", "quaternion_", "orientation_", "pose_orientation_")
_OBJECT = ("", "object_", "obj_", "slider_")
_PUSHER = ("pusher_", "tip_", "finger_", "actuator_")
_KINDS: Final = {"time": "time", "x": "length", "y": "length", "theta": "angle"} | dict.fromkeys(
    ("qx", "qy", "qz", "qw"), "ratio"
)


def _roles() -> dict[str, str]:
    roles = dict.fromkeys(_TIME, "time")
    for whose, prefixes in (("", _OBJECT), ("pusher_", _PUSHER)):
        for prefix in prefixes:
            roles |= {f"{prefix}{axis}": f"{whose}{axis}" for axis in ("x", "y")}
            roles |= {f"{prefix}{angle}": f"{whose}theta" for angle in _ANGLE}
            roles |= {
                f"{prefix}{q}{part}": f"{whose}q{part}" for q in _QUATERNION for part in "xyzw"
            }
    return roles


_ROLES: Final = _roles()

# Larger values decide the unit if the header has none: no plate is 5 m wide, and an angle seldom
# exceeds a turn.
_LIMITS: Final = {"length": ("m", "mm", 5.0), "angle": ("rad", "deg", 2.0 * math.pi + 0.1)}
# Readings come at more than one and less than a thousand per second: larger steps are milliseconds,
# microseconds, nanoseconds.
MAX_STEPS = (1.0, 1e3, 1e6)
MIN_PAUSE: Final = 10.0  # times the typical step: another experiment may begin
# A part that lies on the table is not tilted by more; the rest are coordinates of another frame.
MAX_TILT: Final = math.radians(25.0)

# Kinds of quantities that experiments differ by; others, such as forces, are readings.
_SETTABLE = ("length", "angle", "speed", "turning", "ratio", "count")
_GROUPS = {"force": "force", "torque": "force", "bool": "tactile"}


class CsvTable(Importer):
    """Importer of any table with time and pose of one object; one experiment per file."""

    name = DATASET
    title = "CSV or Parquet table of your own: time_s, x_mm, y_mm, theta_deg, pusher_x_mm, ..."
    licence = "yours"
    citation = ""
    options: ClassVar[Mapping[str, str]] = {
        "name": "name of the experiment; by default that of the file",
        "object_name": "name of the object",
        "simulated_by": "simulator that wrote the table, if it was not measured",
        "time_unit": "unit of times without a unit: s, ms, us or ns",
        "length_unit": "unit of positions without a unit: m, mm, cm, um or inch",
        "angle_unit": "unit of angles, which overrides the header: rad, mrad or deg",
        "scene": "scene file with object, pusher and fixels",
        "split_by": "column whose values separate the experiments of a table",
    }

    def recognised(self, source: Path) -> bool:
        """Whether the name of a file ends like that of a table."""
        return source.is_file() and source.name.lower().endswith(ENDINGS)

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        if not source.is_file():
            raise InvalidInput(source.name, found="a folder", expected="one table")
        texts: dict[str, Any] = dict(options)
        for name, value in texts.items():
            instance(value, str, f"option {name}", "a text")
        scene, split_by = texts.pop("scene", None), texts.pop("split_by", None)
        table = read_table(source, torn=split_by is not None)
        choice = None if scene is None else Path(scene)
        return plan_table(table, source, origin_of(source), texts, choice, split_by)


def plan_table(
    table: CsvRows,
    source: Path,
    provenance: Provenance,
    options: Mapping[str, str],
    scene: SceneChoice | None = None,
    split_by: str | None = None,
    columns: Mapping[str, str] | None = None,
    dataset: str = DATASET,
    progress: ProgressOption = False,
) -> ImportPlan:
    """Plan the import of a table.

    Raise `InvalidInput` if the table cannot be understood, or does not fit the scene.

    Parameters
    ----------
    source : Path
        File of the table; its name names the experiments.
    options : mapping of str to str
        Options of `CsvTable`, except for the next two.
    scene : Scene, Path or callable, optional
        Scene, file of a scene, or function that returns one for the conditions of an experiment.
    split_by : str, optional
        Column whose values separate experiments.
    columns : mapping of str to str, optional
        Titles of columns by role: `{"theta": "yaw"}`.
    dataset : str
        Name of the importer, and of the dataset of a single experiment.
    progress : bool or callable, optional
        Whether and how to show it, as for `show_progress`.
    """
    chosen = _chosen_columns(table, columns or {})
    table, titles = _with_units_of_first_row(table)
    chosen = {titles.get(title, title): role for title, role in chosen.items()}
    split_by = split_by and titles.get(split_by, split_by)
    stem = options.get("name", Path(source.name.removesuffix(".gz")).stem)
    experiments: list[Experiment] = []
    problems: Problems = {}
    sentences: list[tuple[str, ...]] = []
    parts = [*_parts(table, split_by)]
    with show_progress(progress, "reading the table") as report:
        for done, (value, part) in enumerate(parts):
            if split_by is not None:
                report(done, len(parts))
            key = (dataset, stem) if value is None else (stem, value)
            try:
                if value == "":
                    raise InvalidInput(f"rows without a value of {split_by!r}")
                if part.torn or (value is not None and len(part) < 2):
                    raise next(iter(part.torn.values()), InvalidInput("one row"))
                found, understood = _experiment(key, part, options, provenance, chosen, scene)
                experiments.append(found)
                sentences.append(understood)
            except InvalidInput as problem:
                if value is None:
                    raise
                if problem.where.startswith(table.source):
                    problem = problem.at(f"{problem.where} ({split_by} {value})")
                problems[f"{stem}/{value}"] = problem
    _refuse_common(problems, len(experiments), table.source)
    notes = sentences[0] if split_by is None else _common(sentences, split_by)
    notes += (_UNITS_IN_ROW,) if titles else ()
    names = [experiment.key for experiment in experiments]
    return ImportPlan(dataset, source, notes, names, experiments.__getitem__, problems)


def _refuse_common(problems: Problems, n_sound: int, source: str) -> None:
    """Raise for a defect of the table: a doubtful unit, or one that most experiments have."""
    damage = [p for p in problems.values() if str(p) != "one row"]
    doubts = [p for p in damage if isinstance(p, InvalidInput) and "angle_unit" in (p.hint or "")]
    if doubts or len(damage) > n_sound:
        raise (doubts or damage)[0]
    if not n_sound:
        raise InvalidInput(source, found="one row each", expected="poses of a motion")


def _chosen_columns(table: CsvRows, columns: Mapping[str, str]) -> dict[str, str]:
    """Return the role of each chosen title; raise for unknown roles and titles."""
    roles = sorted({*_ROLES.values()})
    for role, title in columns.items():
        check_name("columns", role, roles)
        check_name(f"columns[{role!r}]", title, table.columns)
    return {title: role for role, title in columns.items()}


def _with_units_of_first_row(table: CsvRows) -> tuple[CsvRows, dict[str, str]]:
    """Return a table without a first row of units, and its titles with them by the former ones."""
    cells = {title: _plain(column[0]) for title, column in table.columns.items() if len(column) > 1}
    units = {title: cell for title, cell in cells.items() if cell in UNITS}
    if not units or any(re.search("[0-9]", column[0]) for column in table.columns.values()):
        return table, {}
    for title, unit in units.items():
        stated = _parsed(title, None, ()).unit
        if stated not in (None, UNITS[unit]):
            found, where = f"the unit {unit}", f"{table.source}, row 1, column {title}"
            raise InvalidInput(where, found=found, expected="the unit of the header, or none")
    titles = {title: f"{title} [{unit}]" for title, unit in units.items()
              if _parsed(title, None, ()).unit is None}  # fmt: skip
    below = table.only(range(1, len(table)))
    columns = {titles.get(title, title): column for title, column in below.columns.items()}
    return replace(below, columns=columns), titles or {title: title for title in units}


def _plain(title: str) -> str:
    """Return a title in lower case, with an underscore for all between its words."""
    return re.sub(r"\W+", "_", title.strip().lower()).strip("_")


def _parts(table: CsvRows, split_by: str | None) -> Iterator[tuple[str | None, CsvRows]]:
    """Yield the rows of each experiment with the value that they have in common."""
    if split_by is None:
        yield None, table
        return
    check_name("split_by", split_by, table.columns)
    for value, own in _rows_by_cell(table, split_by).items():
        part = table.only(own)
        columns = {name: cells for name, cells in part.columns.items() if name != split_by}
        yield value, replace(part, columns=columns)


def _rows_by_cell(table: CsvRows, title: str) -> dict[str, list[int]]:
    """Return the rows of each value of a column."""
    rows: dict[str, list[int]] = {}
    for row, cell in enumerate(table.columns[title]):
        rows.setdefault(cell.strip(), []).append(row)
    return rows


def _common(sentences: Sequence[tuple[str, ...]], split_by: str) -> tuple[str, ...]:
    """Return the sentences about all experiments of a table, and a few about some of them.

    Sentences that differ in numbers alone are one, with the range of each number.
    """
    n = len(sentences)
    alike: dict[str, list[str]] = {}
    for sentence in (sentence for own in sentences for sentence in own[1:]):
        alike.setdefault(_NUMBER.sub("#", sentence), []).append(sentence)
    common = [_with_ranges(same) for same in alike.values() if len(same) >= n]
    others = [f"{_with_ranges(own)} ({len(own)} of {n})" for own in alike.values() if len(own) < n]
    return (f"{n} experiments, one for each value of {split_by!r}.", *common, *others[:MAX_OTHERS])


def _with_ranges(alike: Sequence[str]) -> str:
    """Return one sentence for several that differ in numbers alone."""
    columns = zip(*map(_NUMBER.findall, alike), strict=True)
    ends = ((min(own, key=float), max(own, key=float)) for own in columns)
    ranges = iter([low if low == high else f"{low} to {high}" for low, high in ends])
    return _NUMBER.sub(lambda _: next(ranges), alike[0])


@dataclass
class _TableColumn:
    """Column of the table: its title, role, and unit once that is known."""

    title: str
    stem: str
    role: str | None
    unit: ColumnUnit | None
    unknown: str = ""  # ending of the title that is no known unit


@dataclass
class _TableReading:
    """State of reading a table: columns by role, guesses and remarks."""

    table: CsvRows
    roles: dict[str, _TableColumn]
    others: list[_TableColumn]
    options: Mapping[str, str]
    sure_of_angles: bool = False  # whether the header and the user state the same unit
    guesses: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def numbers(self, column: _TableColumn, *, blank: bool = True) -> FloatArray:
        """Return a column as numbers (n,) in its own unit; blank cells become NaN."""
        return self.table.numbers(column.title, blank=blank)

    def si(self, role: str) -> FloatArray:
        """Return the column of a role in SI units, (n,)."""
        column = self.roles[role]
        assert column.unit is not None
        return self.numbers(column) * column.unit.scale


def _experiment(
    key: tuple[str, str],
    table: CsvRows,
    options: Mapping[str, str],
    provenance: Provenance,
    chosen: Mapping[str, str],
    scene: SceneChoice | None,
) -> tuple[Experiment, tuple[str, ...]]:
    """Return the experiment of a table, with a scene if there is one, and how it was understood."""
    reading = _columns(table, options, chosen)
    _refuse_incomplete(reading)
    _refuse_contradictions(reading)
    clock = _read_clock(reading)
    for role in ("time", "x", "y", "theta", "pusher_x", "pusher_y", "pusher_theta"):
        if role in reading.roles and not (clock and role == "time"):
            _settle_unit(reading, role)
    time = _time(reading)
    trajectory, flags = _poses(reading, time, "")
    pusher = None
    if "pusher_x" in reading.roles:
        pusher, more = _poses(reading, time, "pusher_")
        flags = (*flags, *more)
    try:
        _check_units(reading, trajectory, pusher)
    except InvalidInput as doubt:
        if not reading.sure_of_angles or "angle_unit" not in (doubt.hint or ""):
            raise
        flags = (*flags, remark("doubtful-angles", f"{doubt.found}, in the stated unit"))
    if reading.guesses:
        flags = (*flags, remark("guessed-units", " ".join(reading.guesses)))
    experiment = Experiment(
        dataset=key[0],
        name=key[1],
        real="simulated_by" not in options,
        simulated_by=options.get("simulated_by", ""),
        provenance=provenance,
        object_name=options.get("object_name", "object"),
        trajectory=trajectory,
        pusher=pusher,
        channels=_channels(reading, time),
        conditions=_conditions(reading),
        flags=flags,
    )
    understood = tuple(_understood(reading, experiment, time))
    if scene is None:
        return experiment, (*understood, "Without a scene, it can be shown but not simulated.")
    name, sure = options.get("object_name"), reading.sure_of_angles
    experiment, added = with_scene(experiment, scene, name, sure_of_angles=sure)
    return experiment, understood + added


# --- the header


def _columns(
    table: CsvRows, options: Mapping[str, str], chosen: Mapping[str, str]
) -> _TableReading:
    parsed = [_parsed(title, chosen.get(title), {*chosen.values()}) for title in table.columns]
    named = {column.role for column in parsed if column.role and not column.unknown}
    for column in parsed:
        # With x_mm in the table, x_raw is another quantity; alone it is x in an unknown unit.
        if column.unknown and column.role in named:
            column.role = None
    roles: dict[str, _TableColumn] = {}
    for column in parsed:
        if column.role in roles:
            found = f"{roles[column.role].title!r} and {column.title!r}"
            expected = f"one column of {column.role}"
            raise InvalidInput(f"{table.source}, header", found=found, expected=expected)
        if column.role:
            roles[column.role] = column
    for whose in ("", "pusher_"):  # a quaternion counts where there is no angle
        if f"{whose}theta" in roles or not {f"{whose}qz", f"{whose}qw"} <= roles.keys():
            for part in "xyzw":
                roles.pop(f"{whose}q{part}", None)
    others = [column for column in parsed if column not in roles.values()]
    return _TableReading(table, roles, others, options)


def _parsed(title: str, chosen: str | None, taken: Collection[str]) -> _TableColumn:
    """Parse the title of a column: `Tip x [mm]` is pusher_x in mm.

    A role that was chosen for it counts, and no other column gets a role that is `taken`.
    """

    def role_of(stem: str) -> str | None:
        own = _ROLES.get(stem)
        return chosen or (None if own in taken else own)

    plain = _plain(title)
    for ending in sorted(UNITS, key=len, reverse=True):
        if plain.endswith(f"_{ending}"):
            stem, unit = plain.removesuffix(f"_{ending}"), UNITS[ending]
            role = role_of(stem)
            if role and unit.kind != _kind(role):
                found, expected = f"a unit of {unit.kind}", f"a unit of {_kind(role)}"
                raise InvalidInput(f"column {title}", found=found, expected=expected)
            return _TableColumn(title, stem, role, unit)
    if chosen or plain in _ROLES:
        role = role_of(plain)
        ratio = role is not None and _kind(role) == "ratio"
        return _TableColumn(title, plain, role, UNITS["ratio"] if ratio else None)
    stem, _, ending = plain.rpartition("_")
    unknown = ending if role_of(stem) and re.fullmatch(r"[a-z]{1,4}", ending) else ""
    return _TableColumn(title, plain, role_of(stem) if unknown else None, None, unknown)


def _kind(role: str) -> str:
    return _KINDS[role.removeprefix("pusher_")]


def _refuse_incomplete(reading: _TableReading) -> None:
    wanted = ["time", "x", "y"]
    if any(role.startswith("pusher_") for role in reading.roles):
        wanted += ["pusher_x", "pusher_y"]
    if missing := [role for role in wanted if role not in reading.roles]:
        raise InvalidInput(
            reading.table.source,
            found="the columns " + ", ".join(reading.table.columns)[:200],
            expected="a column for " + " and ".join(missing),
            hint="name columns by quantity and unit: time_s, x_mm, y_mm, theta_deg, pusher_x_mm, "
            "pusher_y_mm; in Python, columns={'time': TITLE} chooses one",
        )


# --- units missing in the header


def _refuse_contradictions(reading: _TableReading) -> None:
    """Raise for a given unit that is unknown, or needed by no column and contradicted by one."""
    for kind in ("time", "length", "angle"):
        given = reading.options.get(f"{kind}_unit")
        if given is None:
            continue
        if given not in UNITS or UNITS[given].kind != kind:
            known = (name for name, unit in UNITS.items() if unit.kind == kind)
            raise unknown_name(f"option {kind}_unit", given, known)
        columns = [column for role, column in reading.roles.items() if _kind(role) == kind]
        others = [(own.title, own.unit) for own in columns if own.unit not in (None, UNITS[given])]
        if kind == "angle" or not others or any(own.unit is None for own in columns):
            continue
        raise InvalidInput(
            f"{reading.table.source}, column {others[0][0]}",
            found=f"the unit {_name(others[0][1])} in the header, but {given} was given",
            expected=f"the same unit of {kind} in both",
            hint="correct the header, or leave out the given unit",
        )


def _settle_unit(reading: _TableReading, role: str) -> None:
    column = reading.roles[role]
    kind = _kind(role)
    given = reading.options.get(f"{kind}_unit")
    # The header decides, except for angles: their unit is the one most often wrong in headers.
    if column.unit is not None and (given is None or kind != "angle"):
        return
    if given is not None and column.unit == UNITS[given]:
        reading.sure_of_angles = True
        return
    lack = f"the unknown unit {column.unknown!r}" if column.unknown else "no unit"
    if column.unit is not None:
        lack = f"the unit {_name(column.unit)}"
    if given is not None:
        column.unit = UNITS[given]
        reading.remarks.append(f"{column.title} has {lack}; the given unit {given} is used.")
        return
    name, why = _guess(reading, kind, column)
    column.unit = UNITS[name]
    reading.guesses.append(
        f"{column.title} has {lack} and {why}; {WORDS.get(name, name)} is assumed."
    )


def _name(wanted: ColumnUnit) -> str:
    return next(name for name, unit in UNITS.items() if unit == wanted)


def _guess(reading: _TableReading, kind: str, column: _TableColumn) -> tuple[str, str]:
    """Guess the unit of a column; also return the reason. Raise for pixels."""
    ending = re.split(r"[\W_]+", column.title.lower().rstrip("]) "))[-1]
    if ending == "in" and kind == "length":
        return "inch", "lengths in inches often end so"
    if ending in ("px", "pix"):
        where = f"{reading.table.source}, column {column.title}"
        raise InvalidInput(where, found="pixels", expected="lengths on the plane, or length_unit")
    siblings = {c.unit for r, c in reading.roles.items() if c.unit and _kind(r) == kind}
    if len(siblings) == 1:
        name = _name(siblings.pop())
        return name, f"others of its kind are in {name}"
    if kind == "time":
        numbers = reading.numbers(column)
        step = float(np.nanmedian(np.diff(numbers))) if len(numbers) > 1 else 0.0
        place = sum(step >= most for most in MAX_STEPS)
        return ("s", "ms", "us", "ns")[place], f"typical steps of {step:g}"
    # Positions without a unit share one, so the largest of them decides.
    alike = [c for r, c in reading.roles.items() if _kind(r) == kind and c.unit is None]
    values = np.abs(np.concatenate([reading.numbers(c) for c in alike]))
    largest = float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
    small, large, limit = _LIMITS[kind]
    return (large if largest > limit else small), f"values up to {largest:g}"


# --- the rows


def _read_clock(reading: _TableReading) -> bool:
    """Replace times such as 2026-11-30T09:00:00.25Z by seconds; return whether there were any."""
    column = reading.roles["time"]
    cells = reading.table.columns[column.title]
    if not re.match(r"\d{4}-\d\d-\d\d[T ]", cells[0]):
        return False
    try:
        clock = [datetime.fromisoformat(cell) for cell in cells]
        seconds = [repr((own - clock[0]).total_seconds()) for own in clock]
    except (ValueError, TypeError):
        return False  # the error of a cell that is no number names it
    reading.table = replace(reading.table, columns={**reading.table.columns, column.title: seconds})
    column.unit = UNITS["s"]
    return True


def _time(reading: _TableReading) -> FloatArray:
    """Times (n,), counted from the first row [s]."""
    column = reading.roles["time"]
    assert column.unit is not None
    numbers = reading.numbers(column, blank=False)
    # Subtract first: seconds since 1970 leave few digits after the decimal point.
    time = (numbers - numbers[0]) * column.unit.scale
    table = reading.table
    time = increasing(time, table.source, _how_to_split(reading, time), table.lines)
    _remark_pauses(reading, time)
    return time


def _remark_pauses(reading: _TableReading, time: FloatArray) -> None:
    """Name the column whose values change at every pause, and only there."""
    steps = np.diff(time)
    typical = float(np.median(steps)) if len(steps) else 0.0
    pauses = np.flatnonzero(steps > MIN_PAUSE * typical)
    for column in reading.others if len(pauses) else ():
        cells = np.array(reading.table.columns[column.title])
        if np.array_equal(np.flatnonzero(cells[1:] != cells[:-1]), pauses):
            reading.remarks.append(
                f"Guess: all rows are one experiment, although {column.title!r} changes where times"
                f" pause. With split_by={column.title!r}, each of its values is an experiment."
            )
            return


def _how_to_split(reading: _TableReading, time: FloatArray) -> str:
    """Return the hint for times that begin again: the column whose values separate experiments."""
    if not (time[1:] <= time[0]).any() or reading.table.lines:  # or it was split already
        return "sort the rows by time" if len(np.unique(time)) == len(time) else ""
    found: dict[str, int] = {}
    for column in reading.others:
        rows = _rows_by_cell(reading.table, column.title)
        if all(len(own) > 1 and (np.diff(time[own]) > 0.0).all() for own in rows.values()):
            found[column.title] = len(rows)
    likely = min(found, key=lambda title: found[title], default="COLUMN")
    return f'use split_by="{likely}" if the values of this column separate experiments'


def _poses(
    reading: _TableReading, time: FloatArray, whose: str
) -> tuple[Trajectory, tuple[Flag, ...]]:
    """Trajectory of the object (or, with `pusher_`, the pusher), without rows that lack a value."""
    columns = [reading.si(f"{whose}x"), reading.si(f"{whose}y")]
    what = whose.removesuffix("_") or "object"
    flags: tuple[Flag, ...] = ()
    if f"{whose}theta" in reading.roles:
        columns.append(reading.si(f"{whose}theta"))
    elif f"{whose}qw" in reading.roles:
        columns.append(_heading(reading, whose))
    else:
        columns.append(np.zeros(len(time)))
        stems = [stem for stem, role in _ROLES.items() if role == f"{whose}theta"]
        near = [own.title for own in reading.others if get_close_matches(own.stem, stems, 1, 0.8)]
        similar = f" Is it {near[0]!r}? Then correct the header." if near else ""
        reading.remarks.append(f"There is no angle of the {what}; 0 is used throughout.{similar}")
        flags = () if whose else (remark("no-angle", "the table has none; 0 is used throughout"),)
    pose = np.column_stack(columns)
    if not (there := np.asarray(~np.isnan(pose).any(axis=1))).any():
        found = f"no pose of the {what}"
        raise InvalidInput(reading.table.source, found=found, expected="at least one")
    if missing := int((~there).sum()):
        found = f"no pose of the {what} in {missing} of {len(time)} rows"
        reading.remarks.append(f"There is {found}; its trajectory has the others.")
        flags = (*flags, remark("missing-poses", found))
    return trajectory_of(time[there], pose[there]), flags


def _heading(reading: _TableReading, whose: str) -> FloatArray:
    """Angles (n,) of the x axis of a frame that a quaternion rotates [rad]."""
    roles = [f"{whose}q{part}" for part in "xyzw"]
    zero = np.zeros(len(reading.table))
    x, y, z, w = (reading.si(role) if role in reading.roles else zero for role in roles)
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    along, across = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    tilt = np.arccos(np.minimum(np.hypot(along, across), 1.0))
    used = [reading.roles[role].title for role in roles if role in reading.roles]
    for wrong, found, expected in (
        (np.abs(norm - 1.0) > 0.01, "a quaternion whose norm is not 1", "a norm of 1"),
        (tilt > MAX_TILT, "an x axis that points out of the plane", "a rotation about z"),
    ):
        if wrong.any():
            where = reading.table.place(" and ".join(used), int(np.argmax(wrong)))
            raise InvalidInput(where, found=found, expected=expected)
    whose = whose.removesuffix("_") or "object"
    reading.remarks.append(f"The angle of the {whose} is that of the quaternion {', '.join(used)}.")
    return np.arctan2(across, along)


def _check_units(reading: _TableReading, track: Trajectory, pusher: Trajectory | None) -> None:
    """Raise if the motion is impossible on a plate with these units; angles are not unwrapped."""
    column = reading.roles.get("theta")
    unit = None if column is None or column.unit is None else _name(column.unit)
    turned = track
    if unit is not None:  # angles as in the file, not unwrapped in a unit that may be wrong
        pose = np.column_stack([reading.si(role) for role in ("x", "y", "theta")])
        turned = Trajectory(time=track.time, pose=pose[~np.isnan(pose).any(axis=1)])
    where = f"{reading.table.source}, column {column.title if column else ''}"
    refuse_implausible(turned, pusher, reading.table.source, where, unit)


def _channels(reading: _TableReading, time: FloatArray) -> tuple[Channel, ...]:
    groups: dict[str, dict[str, FloatArray]] = {}
    for column in reading.others:
        if column.unit is None or not column.stem or _is_condition(reading, column):
            continue
        group = groups.setdefault(_GROUPS.get(column.unit.kind, "readings"), {})
        name = f"{column.stem}_{column.unit.si}"
        if name in group:
            where, found = f"{reading.table.source}, header", f"{name} twice"
            raise InvalidInput(where, found=found, expected="one column")
        group[name] = _values(reading, column, column.unit)
    return tuple(
        Channel(name=name, time=time, columns=(*own,), values=np.column_stack([*own.values()]))
        for name, own in sorted(groups.items())
    )


def _is_condition(reading: _TableReading, column: _TableColumn) -> bool:
    """Whether a column is a quantity that was set once: the same in all of several rows."""
    cells = reading.table.columns[column.title]
    settable = column.unit is not None and column.unit.kind in _SETTABLE
    return settable and len(cells) > 1 and bool(cells[0]) and len({*cells}) == 1


def _values(reading: _TableReading, column: _TableColumn, unit: ColumnUnit) -> FloatArray:
    if unit.kind != "bool":
        return reading.numbers(column) * unit.scale
    words = {"true": 1.0, "false": 0.0, "1": 1.0, "0": 0.0, "1.0": 1.0, "0.0": 0.0, "": math.nan}
    cells = [cell.strip().lower() for cell in reading.table.columns[column.title]]
    for row, cell in enumerate(cells):
        if cell not in words:
            where = reading.table.place(column.title, row)
            raise InvalidInput(where, found=repr(cell), expected="0 or 1, true or false")
    return np.array([words[cell] for cell in cells])


def _conditions(reading: _TableReading) -> dict[str, str | float]:
    """Conditions: columns that have the same value in every row, of quantities that are set."""
    conditions: dict[str, str | float] = {}
    for column in reading.others:
        if column.unit is not None:
            if column.stem and _is_condition(reading, column):
                value = float(reading.numbers(column)[0]) * column.unit.scale + 0.0
                conditions[f"{column.stem}_{column.unit.si}"] = value
            continue
        cells = set(reading.table.columns[column.title])
        if len(cells) == 1 and column.stem and (cell := cells.pop().strip()):
            conditions[column.stem] = cell
        else:
            reading.remarks.append(f"{column.title!r} has no unit and is skipped.")
    return conditions


def _understood(reading: _TableReading, experiment: Experiment, time: FloatArray) -> Iterator[str]:
    x, y, turn = experiment.trajectory.pose[-1] - experiment.trajectory.pose[0]
    yield (
        f"One experiment of {len(time)} rows at {rate_of(time):.4g} Hz over {time[-1]:.4g} s from"
        f" the first row on. The object moves {1e3 * math.hypot(x, y):.4g} mm and turns"
        f" {math.degrees(turn):.4g} degrees."
    )
    for role, column in reading.roles.items():
        if column.unit is None or column.unit.kind == "ratio":
            continue
        unit, si = _name(column.unit), column.unit.si
        into = f"{unit} to {si}" if unit != si else si
        unwrapped = ", unwrapped" if role.endswith("theta") else ""
        yield f"{column.title} is {role.replace('_', ' ')}, {into}{unwrapped}."
    for channel in experiment.channels:
        yield f"Channel {channel.name}: {', '.join(channel.columns)}."
    yield from (f"Guess: {guess}" for guess in reading.guesses)
    yield from reading.remarks
    yield "Positions are those of the frame of the object."
