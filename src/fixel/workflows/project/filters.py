"""Names by which experiments can be selected, and coverage of configurations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fixel.database.store import Store
from fixel.model.selection import ExperimentQuery, parse_filter
from fixel.typing import FloatArray

MAX_VALUES: Final = 40  # values of a condition that are listed
MAX_PLACES: Final = 40  # places on an axis of the coverage; more are merged

PLACES: Final = ("start_x_m", "start_y_m", "start_angle_rad")
OFFSETS: Final = ("offset_x_m", "offset_y_m", "offset_theta_rad")
_NUMBER: Final = (int, float)


def view_of(filter: str = "", **options: Any) -> ExperimentQuery:
    """Parse the filter of a page, which lists experiments with faults, too."""
    return parse_filter(filter, include_faulty=True, **options)


# --- values to filter by ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Values:
    """Values of a condition among all experiments."""

    texts: dict[str, int]  # values with their number of experiments; empty if too many
    low: float | None
    high: float | None
    total: int  # number of experiments with the condition


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


@dataclass(frozen=True, slots=True)
class CoverageAxis:
    """Axis of the coverage: places, each from one edge to the next."""

    name: str
    edges: list[float]  # n + 1
    centres: list[float]  # n


@dataclass(frozen=True, slots=True)
class Coverage:
    """Number of experiments at each place of a plane of configurations."""

    x: CoverageAxis
    y: CoverageAxis
    number: list[list[int]]  # one row per place along x
    # Shapes and layouts; empty if not stored.
    shapes: list[str]
    layouts: list[str]
    table: list[list[int]]  # one row per shape, one column per layout
    axes: list[str]  # names that an axis may have
    without: int  # number of experiments without these values


def coverage(
    store: Store, view: ExperimentQuery, x: str | None = None, y: str | None = None
) -> Coverage:
    """Count the experiments that were run in each configuration.

    The axes are columns or conditions with numbers; by default offsets along x and y, or else the
    start of the object.
    """
    noted, known = store.conditions(), numeric_conditions(store)
    x, y = coverage_axes(store, x, y)
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


def numeric_conditions(store: Store) -> list[str]:
    """Return the conditions that have numbers, but for the truths of a simulated testbed."""
    found = sorted(store.conditions().items())
    return [name for name, one in found if one.numbers and not name.startswith("truth_")]


def coverage_axes(store: Store, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the axes of the coverage: those that are given, or else the usual ones."""
    usual = OFFSETS if {*OFFSETS} <= {*numeric_conditions(store)} else PLACES
    return x or usual[0], y or usual[1]


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


def _table(rows: Sequence[tuple[Any, Any, int]]) -> tuple[list[str], list[str], list[list[int]]]:
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
