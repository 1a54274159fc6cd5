"""Selection of experiments: the grammar of filters, and their evaluation in memory.

`fixel.database.query` evaluates the same selection in SQL.
"""

from __future__ import annotations

import json
import math
import operator
import re
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple, cast

from fixel.errors import InvalidInput, check_name, closest, number_of, unknown_name
from fixel.model.experiment import Experiment, Flag
from fixel.model.fields import instance
from fixel.model.trajectory import turned

Relation = Literal["=", "!=", "<", "<=", ">", ">="]

RELATIONS: Final[Mapping[str, Callable[[Any, Any], Any]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
MARKS: Final = ("clean", "faulty", "flagged", "noted", "real", "simulated", "deleted", "replaced")
MAX_FILTER: Final = 1000  # characters

# Columns by name: the field of `ExperimentRow` is also the column of the database.
TEXTS: Final = {
    **{name: name for name in ("dataset", "name")},
    "contacts": "contact_mode",
    "created": "created_at_utc",
}
NUMBERS: Final = {
    **{name: name for name in ("id", "duration_s", "start_x_m", "start_y_m", "end_x_m", "end_y_m")},
    "frames": "n_frame",
    "start_angle_rad": "start_theta_rad",
    "end_angle_rad": "end_theta_rad",
}
ERRORS: Final = ("before_mm", "after_mm", "error_mm")
# Values of columns are compared by their squares, errors and distances: the database has no roots.
SQUARES: Final = ("moved_m", *ERRORS)
COLUMNS: Final = (*TEXTS, *NUMBERS, "turned_rad", "flags", "notes", *SQUARES)
# Short names of columns, with their units in metres and radians.
DEGREE: Final = math.pi / 180.0
NAMES: Final[Mapping[str, tuple[str, float]]] = {
    "error": ("error_mm", 1.0),
    "before": ("before_mm", 1.0),
    "after": ("after_mm", 1.0),
    "moved": ("moved_m", 1e-3),
    "turned": ("turned_rad", DEGREE),
    "x": ("start_x_m", 1e-3),
    "y": ("start_y_m", 1e-3),
    "angle": ("start_angle_rad", DEGREE),
    "duration": ("duration_s", 1.0),
}
_RELATION: Final = r"(>=|<=|!=|=|<|>)"
_BOUND: Final = re.compile(rf"(\w[\w. -]*?){_RELATION}(.*)", re.DOTALL)


class Bound(NamedTuple):
    """Comparison of a column or a condition with a value."""

    name: str
    relation: Relation
    value: str | float
    text: str = ""  # value as typed, for conditions that are texts such as "007"

    @property
    def typed(self) -> str:
        """Value as typed, or written shortly."""
        return self.text or (self.value if isinstance(self.value, str) else f"{self.value!r}")

    @property
    def limit(self) -> float:
        """Number to compare with, squared for one of `SQUARES`; a text raises `InvalidInput`."""
        if isinstance(self.value, str):
            raise InvalidInput(f"filter: {self.name}", found=repr(self.value), expected="a number")
        # The sign is retained: every error exceeds a negative bound.
        return self.value * abs(self.value) if self.name in SQUARES else self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentQuery:
    """Criteria that select experiments, their order, and one page of them."""

    dataset: str | None = None
    name: str | None = None  # `*` matches any text
    words: tuple[str, ...] = ()  # must all occur in the name, a condition, a flag or a note
    bounds: tuple[Bound, ...] = ()  # of columns, or of conditions where there is no such column
    flags: tuple[str, ...] = ()  # that each experiment must have; faulty ones are then included
    # Out of `MARKS`; deleted experiments are listed only with `deleted` (then no others), those
    # replaced by a correction only with `replaced`.
    marks: tuple[str, ...] = ()
    include_faulty: bool = False  # whether to include experiments with a flag that marks a fault
    sort: str = "id"  # column or condition to sort by
    descending: bool = False
    limit: int | None = None
    offset: int = 0

    @property
    def omits_faulty(self) -> bool:
        """Whether experiments with a fault are left out of the page, and only counted."""
        with_faults = {"deleted", "faulty", "flagged"}.intersection(self.marks)
        return not (self.include_faulty or self.flags or with_faults)

    @property
    def filter(self) -> str:
        """Words, bounds, flags and marks as `parse_filter` reads them."""
        terms = [*self.words, *(f"{b.name}{b.relation}{b.typed}" for b in self.bounds)]
        terms += [*(f"flag:{name}" for name in self.flags), *(f"is:{mark}" for mark in self.marks)]
        return " ".join(f'"{term}"' if " " in term else term for term in terms)


# --- grammar --------------------------------------------------------------------------------------


def parse_filter(*filters: str, **options: Any) -> ExperimentQuery:
    """Parse filters as they are typed; all terms of all filters must hold.

    A quote that does not end, an unknown `is:`, or a text instead of a number raises
    `InvalidInput`.

    Parameters
    ----------
    *filters : str
        Terms separated by spaces: `shape=square`, `offset_x_m>0.01`, with `!=`, `<`, `<=`, `>=`
        alike, of a condition or a column; `error>5` [mm], `moved<80` [mm], `turned>10` [deg], `x`,
        `y` [mm], `angle` [deg], `duration` [s], `before` and `after` [mm]; `dataset:NAME`,
        `flag:NAME`; a mark such as `real`, `simulated`, `clean`, `faulty`, `flagged`, `noted`,
        `deleted`, or `is:real`. Other words must occur in the name, a condition, a flag or a note.
        Values with spaces are in double quotes.
    **options : object
        Further fields of `ExperimentQuery`; `sort` may be a short name.

    Examples
    --------
    >>> query = parse_filter('pentagon real error>5 flag:late')
    >>> query.words, query.marks, query.flags
    (('pentagon',), ('real',), ('late',))
    >>> query.bounds[0][:3]
    ('error_mm', '>', 5.0)
    """
    words: list[str] = []
    bounds: list[Bound] = []
    flags: list[str] = []
    marks: list[str] = []
    for token in (token for text in filters for token in _tokens(text)):
        head, colon, rest = token.partition(":")
        if token in MARKS or (colon and head == "is"):
            mark = rest if colon else token
            check_name("filter: is:", mark, MARKS)
            marks.append(mark)
        elif colon and head == "flag" and rest:
            flags.append(rest)
        elif colon and head == "dataset" and rest:
            bounds.append(Bound("dataset", "=", rest))
        elif (found := _BOUND.fullmatch(token)) is not None:
            bounds.append(_bound(*found.groups()))
        else:
            words.append(token)
    return ExperimentQuery(
        words=tuple(words),
        bounds=tuple(bounds),
        flags=(*flags, *options.pop("flags", ())),
        marks=(*marks, *options.pop("marks", ())),
        sort=NAMES.get(options.get("sort", "id"), (options.pop("sort", "id"), 1.0))[0],
        **options,
    )


def _tokens(text: str) -> list[str]:
    instance(text, str, "filter", "a text")
    if len(text) > MAX_FILTER:
        found, expected = f"{len(text)} characters", f"at most {MAX_FILTER}"
        raise InvalidInput("filter", found=found, expected=expected)
    # Spaces around a relation are allowed, where they are not in quotes.
    parts = text.split('"')
    parts[::2] = [re.sub(rf"\s*{_RELATION}\s*", r"\1", part) for part in parts[::2]]
    reader = shlex.shlex('"'.join(parts), posix=True)
    reader.whitespace_split = True
    reader.commenters = ""
    reader.quotes = '"'
    reader.escape = ""
    try:
        return list(reader)
    except ValueError:
        raise InvalidInput("filter", found="a quote that does not end", expected='"..."') from None


def _bound(name: str, relation: str, typed: str) -> Bound:
    known, unit = NAMES.get(name, (name, 1.0))
    value: float | str = typed
    try:
        value = number_of(typed, f"filter: {name}") * unit if known not in TEXTS else typed
    except InvalidInput:
        if known in COLUMNS or relation not in ("=", "!="):  # it compares no texts
            raise
    text = "" if unit != 1.0 or typed in (value, repr(value)) else typed
    return Bound(known, cast(Relation, relation), value, text)


# --- evaluation in memory -------------------------------------------------------------------------


class ExperimentRow(NamedTuple):
    """Row of the table of experiments: one experiment without its series."""

    id: int
    dataset: str
    name: str
    is_real: bool
    n_frame: int
    duration_s: float
    start_x_m: float
    start_y_m: float
    start_theta_rad: float
    end_x_m: float
    end_y_m: float
    end_theta_rad: float
    contact_mode: str
    conditions_json: str
    created_at_utc: str

    @property
    def conditions(self) -> dict[str, str | float]:
        """Further recorded conditions, by name."""
        found: dict[str, str | float] = json.loads(self.conditions_json)
        return found

    @property
    def key(self) -> str:
        """Dataset and name, joined by a slash."""
        return f"{self.dataset}/{self.name}"

    @property
    def moved_m(self) -> float:
        """Distance between the positions at the start and at the end [m]."""
        dx, dy = self.end_x_m - self.start_x_m, self.end_y_m - self.start_y_m
        return float((dx * dx + dy * dy) ** 0.5)

    @property
    def turned_rad(self) -> float:
        """Rotation from the start to the end [rad]."""
        return turned(self.start_theta_rad, self.end_theta_rad, self.n_frame)


class ExperimentDetails(NamedTuple):
    """Results and marks of an experiment."""

    content_sha256: str = ""
    deleted_at_utc: str | None = None
    before_mm2: float | None = None  # error of the newest simulation with nominal values
    after_mm2: float | None = None  # error of the newest calibration that it is a member of
    has_scene: bool = False
    flags: Sequence[Flag] = ()
    notes: Sequence[str] = ()

    @property
    def error_mm2(self) -> float | None:
        """Error after a calibration, else before [mm^2]."""
        return self.before_mm2 if self.after_mm2 is None else self.after_mm2


def described(experiment: Experiment, number: int) -> tuple[ExperimentRow, ExperimentDetails]:
    """Return row and details of an experiment that is not stored."""
    time, pose = experiment.trajectory.time, experiment.trajectory.pose
    named = (number, experiment.dataset, experiment.name, experiment.real)
    ends = (*pose[0].tolist(), *pose[-1].tolist())
    conditions = json.dumps(dict(experiment.conditions))
    marks = (experiment.contact_mode, conditions, experiment.provenance.created)
    row = ExperimentRow._make((*named, len(time), float(time[-1] - time[0]), *ends, *marks))
    return row, ExperimentDetails(has_scene=experiment.scene is not None, flags=experiment.flags)


@dataclass(frozen=True, slots=True)
class KnownNames:
    """Datasets, flags, and conditions with their texts, which filters may name."""

    datasets: Collection[str] = ()
    flags: Collection[str] = ()
    conditions: Mapping[str, Collection[str]] = field(default_factory=dict)
    texts: Collection[str] = ()  # conditions that are a number in no experiment

    @classmethod
    def of(cls, facts: Iterable[tuple[ExperimentRow, ExperimentDetails]]) -> KnownNames:
        """Collect the names of some experiments."""
        datasets, flags, numbers, conditions = set(), set(), set(), dict[str, set[str]]()
        for row, details in facts:
            datasets.add(row.dataset)
            flags |= {flag.name for flag in details.flags}
            for name, value in row.conditions.items():
                conditions.setdefault(name, set()).update([value] if isinstance(value, str) else [])
                numbers |= set() if isinstance(value, str) else {name}
        return cls(sorted(datasets), sorted(flags), conditions, {*conditions} - numbers)


def holds(query: ExperimentQuery, row: ExperimentRow, details: ExperimentDetails) -> bool:
    """Whether an experiment meets a query, apart from order and page.

    Replaced experiments are not known here. Deleted ones are left out when experiments are read
    from a project, so that they can be filtered further.
    """
    faulty = any(flag.fault for flag in details.flags)
    meaning = {
        "clean": not faulty,
        "faulty": faulty,
        "flagged": bool(details.flags),
        "noted": bool(details.notes),
        "real": row.is_real,
        "simulated": not row.is_real,
        "deleted": details.deleted_at_utc is not None,
        "replaced": True,
    }
    return (
        all(meaning[mark] for mark in query.marks)
        and not (faulty and query.omits_faulty)
        and query.dataset in (None, row.dataset)
        and (query.name is None or _like(query.name, row.name))
        and {*query.flags} <= {flag.name for flag in details.flags}
        and all(_bound_holds(bound, row, details) for bound in query.bounds)
        and all(_has_word(word.lower(), row, details) for word in query.words)
    )


def _like(pattern: str, text: str) -> bool:
    every = ".*".join(map(re.escape, pattern.split("*")))
    return re.fullmatch(every, text, re.IGNORECASE | re.DOTALL) is not None


def _has_word(word: str, row: ExperimentRow, details: ExperimentDetails) -> bool:
    flags = (text for flag in details.flags for text in (flag.name, flag.detail))
    texts = (row.key, row.conditions_json, *flags, *details.notes)
    return any(word in text.lower() for text in texts)


def _bound_holds(bound: Bound, row: ExperimentRow, details: ExperimentDetails) -> bool:
    relate, name = RELATIONS[bound.relation], bound.name
    if name in TEXTS:
        return bool(relate(getattr(row, TEXTS[name]), bound.typed))
    if name not in COLUMNS:
        return _condition_holds(bound, row.conditions)
    number, limit = _number_of(name, row, details), bound.limit
    return number is not None and bool(relate(number, limit))


def _number_of(name: str, row: ExperimentRow, details: ExperimentDetails) -> float | None:
    """Value of a column; its square for one of `SQUARES`."""
    if name in ERRORS:
        error: float | None = getattr(details, f"{name}2")
        return error
    if name == "moved_m":
        dx, dy = row.end_x_m - row.start_x_m, row.end_y_m - row.start_y_m
        return dx * dx + dy * dy
    if name in ("flags", "notes"):
        return len(getattr(details, name))
    return float(getattr(row, NUMBERS.get(name, name)))


def _condition_holds(bound: Bound, conditions: Mapping[str, str | float]) -> bool:
    """Compare a condition; a text equals a number that was typed like it, missing is unequal."""
    own = conditions.get(bound.name)
    if bound.relation in ("=", "!="):
        same = own == bound.value or (isinstance(own, str) and own == bound.typed)
        return same == (bound.relation == "=")
    limit = bound.limit
    return isinstance(own, int | float) and bool(RELATIONS[bound.relation](own, limit))


# --- unknown names --------------------------------------------------------------------------------


def unknown_names(
    query: ExperimentQuery, known: KnownNames
) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield the names, words and values in a query that no experiment has.

    Each comes with its place (`"filter: shape"`), as it was typed, and with the known names.
    """
    asked: list[tuple[str, str, Iterable[str]]] = [("flag", k, known.flags) for k in query.flags]
    datasets = [query.dataset] if query.dataset is not None else []
    datasets += [b.typed for b in query.bounds if b.name == "dataset" and b.relation == "="]
    asked += [("dataset", name, known.datasets) for name in datasets]
    texts = [text for values in known.conditions.values() for text in values]
    asked += [("filter", k, (*texts, *known.datasets, *known.flags)) for k in query.words]
    for own in (bound for bound in query.bounds if bound.name not in COLUMNS):
        if own.name not in known.conditions:
            asked.append(("filter", own.name, (*sorted(known.conditions), *NAMES)))
        elif isinstance(own.value, str) and own.relation == "=":
            asked.append((f"filter: {own.name}", own.value, sorted(known.conditions[own.name])))
    yield from ((what, one, (*names,)) for what, one, names in asked if one not in names)


def no_experiment_has(what: str, typed: str, known: Sequence[str]) -> InvalidInput:
    """Return the error for a name or value that no experiment has, with the known ones."""
    if not known:
        return InvalidInput(what, found=repr(typed), expected="omitted: no experiment has one")
    return unknown_name(what, typed, known)


def refuse_unknown(query: ExperimentQuery, known: KnownNames, *, found: bool) -> None:
    """Raise for a condition that no experiment has, or that is a text and compared with a number.

    If nothing was found, raise for other names too, with the known name that resembles one most.
    """
    for own in query.bounds:
        if own.name in known.texts and own.relation not in ("=", "!="):
            hint = "end the title of its column with its unit, as in speed_mm_s, or select with ="
            raise InvalidInput(f"filter: {own.name}", found="texts", expected="numbers", hint=hint)
    for what, typed, names in unknown_names(query, known):
        if not found or (what == "filter" and typed not in query.words):
            raise no_experiment_has(what, typed, names)


def meant_filter(filter: str, known: KnownNames) -> str | None:
    """Return a filter with unknown names and values replaced by what resembles them.

    It is None if nothing is unknown, or nothing resembles it.
    """
    changed = filter
    for _, typed, names in unknown_names(parse_filter(filter), known):
        meant = closest(typed, names)
        if meant is None:
            return None
        changed = changed.replace(typed, meant, 1)
    return changed if changed != filter else None
