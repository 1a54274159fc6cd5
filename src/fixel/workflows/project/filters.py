"""Filters for experiments as typed, corrections of unknown names, and coverage."""

from __future__ import annotations

import contextlib
import difflib
import re
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, cast, final

import numpy as np

from fixel.database.query import COLUMNS, MARKS, TEXTS, Bound, ExperimentQuery, Relation
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.typing import FloatArray

MAX_FILTER: Final = 1000  # characters
MAX_VALUES: Final = 40  # values of a condition that are listed
MAX_PLACES: Final = 40  # places on an axis of the coverage; more are merged

# Short names of columns, with their units in metres and radians.
DEGREE: Final = float(np.pi / 180.0)
NAMES: Final[dict[str, tuple[str, float]]] = {
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
_CONDITION: Final = re.compile(r"([^=!<>]+)(>=|<=|!=|=|<|>)(.*)", re.DOTALL)
_BOUND: Final = re.compile(r"([\w.-]+)(>=|<=|!=|=|<|>)(.*)", re.DOTALL)
PLACES: Final = ("start_x_m", "start_y_m", "start_angle_rad")
OFFSETS: Final = ("offset_x_m", "offset_y_m", "offset_theta_rad")
_NUMBER: Final = (int, float)
MAX_NAMED = 12  # values listed in an error


def query_of(
    *,
    dataset: str | None = None,
    name: str | None = None,
    real: bool | None = None,
    where: Iterable[str] = (),
    flag: str | None = None,
    flagged: bool = False,
    deleted: bool = False,
    limit: int | None = None,
) -> ExperimentQuery:
    """Build a query from options; `where` are `CONDITION=VALUE`, or with another relation."""
    bounds = [_condition(text) for text in where]
    equal = {one.name: one for one in bounds if one.relation == "="}  # the last of a name counts
    marks = {"real": real is True, "simulated": real is False, "deleted": deleted}
    return ExperimentQuery(
        dataset=dataset,
        name=name,
        conditions=(*equal.values(), *(one for one in bounds if one.relation != "=")),
        flags=() if flag is None else (flag,),
        marks=tuple(mark for mark, chosen in marks.items() if chosen),
        include_faulty=flagged,
        limit=limit,
    )


def _condition(text: str) -> Bound:
    found = _CONDITION.fullmatch(text)
    if found is None:
        raise InvalidInput(
            "--where",
            found=repr(text),
            expected="CONDITION=VALUE, or !=, <, <=, >, >= in place of =",
            hint="put it in quotes: the shell takes < and > for itself",
        )
    name, relation, typed = found.groups()
    value: str | float = typed.strip()
    with contextlib.suppress(ValueError):
        value = float(value)
    if isinstance(value, str) and relation not in ("=", "!="):
        raise InvalidInput(f"--where {name}", found=repr(typed), expected="a number")
    return Bound(name.strip(), cast(Relation, relation), value)


def view_of(
    filter: str = "",
    *,
    sort: str = "id",
    descending: bool = False,
    limit: int | None = None,
    offset: int = 0,
) -> ExperimentQuery:
    """Parse a filter as it is typed.

    Parameters
    ----------
    filter : str
        Words that must occur somewhere, `"two words"` in quotes; `shape=square`, `offset_x_m>0.01`
        of a condition or a column; `error>5` [mm], `moved<80` [mm], `turned>10` [deg], `x`, `y`
        [mm], `angle` [deg], `duration` [s], `before` and `after` [mm]; `dataset:NAME`, `flag:NAME`,
        `is:clean`, `is:faulty`, `is:flagged`, `is:noted`, `is:real`, `is:simulated`, `is:deleted`.
    sort : str
        Name of a column, long or short, or a condition.
    descending : bool
    limit : int, optional
    offset : int

    Raises
    ------
    InvalidInput
        A quote that does not end, an unknown `is:`, or a text instead of a number.

    Examples
    --------
    >>> view = view_of('pentagon error>5 flag:late')
    >>> view.words, view.bounds, view.flags
    (('pentagon',), (Bound(name='error_mm', relation='>', value=5.0),), ('late',))
    """
    words: list[str] = []
    bounds: list[Bound] = []
    flags: list[str] = []
    marks: list[str] = []
    for token in _tokens(filter):
        head, colon, rest = token.partition(":")
        if colon and head == "is":
            marks.append(_mark(rest))
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
        flags=tuple(flags),
        marks=tuple(marks),
        include_faulty=True,
        sort=NAMES.get(sort, (sort, 1.0))[0],
        descending=descending,
        limit=limit,
        offset=offset,
    )


def _tokens(text: str) -> list[str]:
    if len(text) > MAX_FILTER:
        raise InvalidInput(
            "filter", found=f"{len(text)} characters", expected=f"at most {MAX_FILTER}"
        )
    reader = shlex.shlex(text, posix=True)
    reader.whitespace_split = True
    reader.commenters = ""
    reader.quotes = '"'
    reader.escape = ""
    try:
        return list(reader)
    except ValueError:
        raise InvalidInput("filter", found="a quote that does not end", expected='"..."') from None


def _mark(name: str) -> str:
    if name not in MARKS:
        raise InvalidInput("filter: is:", found=repr(name), expected="one of " + ", ".join(MARKS))
    return name


def _bound(name: str, relation: str, value: str) -> Bound:
    known, unit = NAMES.get(name, (name, 1.0))
    number = _number(value)
    if number is None and known in COLUMNS and known not in TEXTS:
        raise InvalidInput(f"filter: {name}", found=repr(value), expected="a number")
    if number is None or known in TEXTS:
        return Bound(known, cast(Relation, relation), value)
    return Bound(known, cast(Relation, relation), number * unit)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


# --- values to filter by ------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True)
class Values:
    """Values of a condition among all experiments."""

    texts: dict[str, int]  # values with their number of experiments; empty if too many
    low: float | None
    high: float | None
    total: int  # number of experiments with the condition


@final
@dataclass(frozen=True, slots=True)
class Vocabulary:
    """Names and values that a filter can use."""

    datasets: dict[str, int]
    flags: dict[str, int]
    conditions: dict[str, Values]


def vocabulary(store: Store) -> Vocabulary:
    """Return the datasets, flags and conditions by which experiments can be filtered."""
    found = {}
    for name, known in sorted(store.conditions().items()):
        few = dict(sorted(known.texts.items())) if len(known.texts) <= MAX_VALUES else {}
        found[name] = Values(few, known.low, known.high, sum(known.texts.values()) + known.numbers)
    return Vocabulary(store.datasets(), store.flags(), found)


# --- coverage -----------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True)
class CoverageAxis:
    """Axis of the coverage: places, each from one edge to the next."""

    name: str
    edges: list[float]  # n + 1
    centres: list[float]  # n


@final
@dataclass(frozen=True, slots=True)
class Coverage:
    """Number of experiments at each place of a plane of configurations.

    Attributes
    ----------
    x, y : CoverageAxis
    number : list of list of int
        One row per place along x.
    shapes, layouts : list of str
        Shapes and layouts; empty if not stored.
    table : list of list of int
        One row per shape, one column per layout.
    axes : list of str
        Names that an axis may have.
    without : int
        Number of experiments without these values.
    """

    x: CoverageAxis
    y: CoverageAxis
    number: list[list[int]]
    shapes: list[str]
    layouts: list[str]
    table: list[list[int]]
    axes: list[str]
    without: int


def coverage(
    store: Store, view: ExperimentQuery, x: str | None = None, y: str | None = None
) -> Coverage:
    """Count the experiments that were run in each configuration.

    Parameters
    ----------
    store : Store
    view : ExperimentQuery
    x, y : str, optional
        Columns or conditions with numbers; by default offsets along x and y, or else the start of
        the object.
    """
    noted = store.conditions()
    known = tuple(
        name
        for name, values in sorted(noted.items())
        if values.numbers and not name.startswith("truth_")
    )
    usual = OFFSETS if {*OFFSETS} <= {*known} else PLACES
    x, y = x or usual[0], y or usual[1]
    tally = store.tally(view, (x, y))
    placed = [row for row in tally if isinstance(row[0], _NUMBER) and isinstance(row[1], _NUMBER)]
    points = np.array(placed, dtype=np.float64).reshape(-1, 3)
    across, up = _axis(x, points[:, 0]), _axis(y, points[:, 1])
    count, _, _ = np.histogram2d(
        points[:, 0], points[:, 1], bins=(across.edges, up.edges), weights=points[:, 2]
    )
    kinds = ("shape", "layout")
    shapes, layouts, table = _table(store.tally(view, kinds) if {*kinds} <= {*noted} else [])
    without = sum(row[2] for row in tally) - sum(row[2] for row in placed)
    number = count.astype(int).tolist()
    return Coverage(across, up, number, shapes, layouts, table, [*PLACES, *known], without)


def _axis(name: str, values: FloatArray) -> CoverageAxis:
    """Return an axis with one place per value if these are few, else places of equal width."""
    distinct = np.unique(np.round(values, 9))
    if len(distinct) == 0:
        return CoverageAxis(name, [0.0, 1.0], [0.5])
    if len(distinct) <= MAX_PLACES:
        between = (distinct[1:] + distinct[:-1]) / 2.0
        margin = float(np.diff(distinct).min()) / 2.0 if len(distinct) > 1 else 0.5e-3
        edges = np.concatenate(([distinct[0] - margin], between, [distinct[-1] + margin]))
        return CoverageAxis(name, edges.tolist(), distinct.tolist())
    edges = np.linspace(distinct[0], distinct[-1], MAX_PLACES + 1)
    edges[-1] = np.nextafter(edges[-1], np.inf)
    return CoverageAxis(name, edges.tolist(), ((edges[1:] + edges[:-1]) / 2.0).tolist())


def _table(
    rows: Sequence[tuple[Any, Any, int]],
) -> tuple[list[str], list[str], list[list[int]]]:
    """Count the experiments of each shape in each layout."""
    counted: Counter[tuple[str, str]] = Counter()
    for shape, layout, n in rows:
        if shape is not None and layout is not None:
            counted[_word(shape), _word(layout)] += n
    shapes = sorted({shape for shape, _ in counted})
    layouts = sorted({layout for _, layout in counted})
    if len(shapes) > MAX_VALUES or len(layouts) > MAX_VALUES:
        return [], [], []
    return shapes, layouts, [[counted[shape, layout] for layout in layouts] for shape in shapes]


def _word(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"


class UnknownName(NamedTuple):
    """Name or value that no experiment has."""

    what: str  # as typed: "--where shape"
    typed: str
    known: tuple[str, ...]

    @property
    def meant(self) -> str | None:
        """Known name that resembles it most; None if none does."""
        close = difflib.get_close_matches(self.typed.lower(), [k.lower() for k in self.known], n=1)
        return next((k for k in self.known if k.lower() == close[0]), None) if close else None

    def error(self) -> InvalidInput:
        """Return the error to raise."""
        more = f", ... ({len(self.known)} in all)" if len(self.known) > MAX_NAMED else ""
        return InvalidInput(
            self.what,
            found=repr(self.typed),
            expected="one of " + ", ".join(self.known[:MAX_NAMED]) + more
            if self.known
            else "nothing: no experiment has one",
            hint=f"did you mean {self.meant!r}?" if self.meant else None,
        )


def check_known_names(store: Store, query: ExperimentQuery) -> None:
    """Raise if a query has a dataset, flag, condition or value that no experiment has.

    Raises
    ------
    InvalidInput
        Error for the first of them, with the known name that resembles it most.
    """
    for unknown in _unknown_in(store, query):
        raise unknown.error()


def meant_filter(store: Store, filter: str) -> str | None:
    """Return a filter with unknown names and values replaced by what resembles them.

    Returns
    -------
    str or None
        None if nothing is unknown, or nothing resembles it.
    """
    view = view_of(filter)
    changed = filter
    for unknown in _unknown_in_view(store, view):
        if unknown.meant is None:
            return None
        changed = changed.replace(unknown.typed, unknown.meant, 1)
    return changed if changed != filter else None


def _unknown_in(store: Store, query: ExperimentQuery) -> Iterator[UnknownName]:
    if query.dataset is not None:
        yield from _not_among("--dataset", query.dataset, store.datasets())
    for name in query.flags:
        yield from _not_among("--flag", name, store.flags())
    yield from _unknown_conditions(store, query.conditions, "--where ")


def _unknown_in_view(store: Store, view: ExperimentQuery) -> Iterator[UnknownName]:
    for name in view.flags:
        yield from _not_among("flag", name, store.flags())
    texts = [text for known in store.conditions().values() for text in known.texts]
    for word in view.words:
        yield from _not_among("filter", word, (*texts, *store.datasets(), *store.flags()))
    for bound in view.bounds:
        if bound.name == "dataset":
            yield from _not_among("dataset", str(bound.value), store.datasets())
    others = [bound for bound in view.bounds if bound.name not in COLUMNS]
    yield from _unknown_conditions(store, others, "", NAMES)


def _unknown_conditions(
    store: Store, bounds: Iterable[Bound], where: str, more: Iterable[str] = ()
) -> Iterator[UnknownName]:
    known = store.conditions()
    for bound in bounds:
        if bound.name not in known:
            yield UnknownName(where.strip() or "filter", bound.name, (*known, *more))
        elif isinstance(bound.value, str) and bound.relation == "=":
            yield from _not_among(f"{where}{bound.name}", bound.value, known[bound.name].texts)


def _not_among(what: str, typed: str, known: Iterable[str]) -> Iterator[UnknownName]:
    if typed not in (names := tuple(known)):
        yield UnknownName(what, typed, names)
