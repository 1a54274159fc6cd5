"""Coordinates of pushes, and cells of a map: values or ranges of some of them, and neighbours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from fixel.calibration.known_pushes import CONTACT_ANGLE
from fixel.calibration.target import NUMBERING, TRUTH, Target
from fixel.domain.evidence import HeldOutErrors, Value
from fixel.errors import InvalidInput, check_name
from fixel.model import wrapped
from fixel.simulation.pack import pusher_path
from fixel.typing import FloatArray, IntArray
from fixel.units import displayed, split_unit

PUSH: Final = "push_angle_rad"
TRAVEL: Final = "travel_m"


def coordinates_of(target: Target) -> dict[str, Value]:
    """Return all coordinates that an axis can use.

    In addition to the conditions: the bearing of the pusher at the start from the centre of mass,
    in the body's frame [rad]; its direction of travel relative to the line to the centre of mass
    [rad]; its distance of travel [m]. Truths that no real laboratory could know are left out.
    """
    found: dict[str, Value] = {
        name: value
        for name, value in target.conditions.items()
        if name not in NUMBERING and not name.startswith(TRUTH)
    }
    for name, number in _geometry(target).items():
        found.setdefault(name, number)
    return found


def _geometry(target: Target) -> dict[str, float]:
    scene = target.case.scene
    if not scene.pushers:
        return {}
    path = pusher_path(scene.pushers[0], float(target.case.times[-1]))
    way = path[-1, 1:3] - path[0, 1:3]
    body = scene.bodies[0]
    c, s = math.cos(float(body.pose[2])), math.sin(float(body.pose[2]))
    turn = np.array([[c, -s], [s, c]])
    arm = path[0, 1:3] - (body.pose[:2] + turn @ body.com)
    found = {TRAVEL: float(np.hypot(*way))}
    if np.hypot(*arm) > 0.0:
        bearing = math.atan2(float(arm[1]), float(arm[0])) - float(body.pose[2])
        found[CONTACT_ANGLE] = float(wrapped(bearing))
        if found[TRAVEL] > 0.0:
            heading = math.atan2(float(way[1]), float(way[0]))
            back = math.atan2(-float(arm[1]), -float(arm[0]))
            found[PUSH] = float(wrapped(heading - back))
    return found


def refuse_missing(
    known: Mapping[str, Any], given: Mapping[str, Value], examples: Mapping[str, Value]
) -> None:
    """Raise if a push lacks a condition; the error shows the call with values for all of them.

    Coordinates of the push are `known`, and conditions of the call `given`; `examples` have every
    needed condition, with a value that occurs in the experiments.
    """
    missing = {name: value for name, value in examples.items() if name not in known}
    if missing:
        pairs = (
            f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value!r}"
            for name, value in ({**given, **missing}).items()
        )
        found = f"a push without {' and '.join(missing)}"
        expected = "every condition that the result distinguishes"
        hint = f"give its own value, as in .at(scene, {', '.join(pairs)})"
        raise InvalidInput("scene", found=found, expected=expected, hint=hint)


def label_of(conditions: Mapping[str, Any], names: Sequence[str]) -> str:
    """Label of the experiments that share the values of some conditions."""
    missing = [name for name in names if name not in conditions]
    if missing:
        found = f"{conditions.get('experiment', 'an experiment')} without {missing[0]}"
        expected = "a condition that all experiments have"
        hint = "see which there are: fixel show"
        raise InvalidInput("conditions", found=found, expected=expected, hint=hint)
    return " ".join(
        f"{conditions[n]:g}" if isinstance(conditions[n], float) else str(conditions[n])
        for n in names
    )


FEW_VALUES: Final = 25  # largest number of distinct values with a cell each
BINS: Final = 8  # ranges with equal numbers of values, for more distinct values
MAX_CELLS: Final = 2500
SAME_VALUE: Final = 1e-9  # difference of values that count as equal, over the extent


@dataclass(frozen=True, slots=True, kw_only=True)
class CellAxis:
    """Coordinate divided into cells."""

    name: str  # name of the condition
    labels: tuple[str, ...] = ()  # values of a text coordinate; empty for numbers
    centres: tuple[float, ...] = ()  # centres of cells of numbers, ascending [SI]
    # Ends of ranges, one more than centres; empty if cells are values.
    edges: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.labels) or len(self.centres)

    @property
    def is_text(self) -> bool:
        """Whether the coordinate is text, whose values have no order."""
        return bool(self.labels)

    @property
    def unit(self) -> str:
        """Displayed unit; empty for none."""
        return displayed(split_unit(self.name)[1])[0]

    @property
    def title(self) -> str:
        """Name without the suffix of its SI unit, for text with the displayed unit."""
        return split_unit(self.name)[0]

    @property
    def label(self) -> str:
        """Name for people, with the displayed unit."""
        return self.title.replace("_", " ") + (f" [{self.unit}]" if self.unit else "")

    @property
    def factor(self) -> float:
        """Factor from SI to the displayed unit."""
        return displayed(split_unit(self.name)[1])[1]

    def text(self, k: int) -> str:
        """Return a cell as text, without the unit."""
        if self.is_text:
            return self.labels[k]
        if self.edges:
            return f"{self.shown(self.edges[k])} to {self.shown(self.edges[k + 1])}"
        return self.shown(self.centres[k])

    def shown(self, value: float) -> str:
        """Return a number in the displayed unit, as text."""
        return f"{self.factor * value + 0.0:.4g}"

    def find(self, values: Sequence[Value]) -> IntArray:
        """Return the cell (n,) of each value; -1 for none."""
        return np.array([self._find(value) for value in values], np.int64)

    def _find(self, value: Value) -> int:
        if value is None:
            return -1
        if self.is_text:
            return self.labels.index(str(value)) if str(value) in self.labels else -1
        if isinstance(value, str):
            return -1
        if self.name == CONTACT_ANGLE:
            value = _after(value, (self.edges or self.centres)[0])
        if self.edges:
            inside = self.edges[0] <= value <= self.edges[-1]
            k = int(np.searchsorted(self.edges, value, side="right")) - 1
            return min(k, len(self) - 1) if inside else -1
        near = np.abs(np.array(self.centres) - value)
        k = int(near.argmin())
        extent = self.centres[-1] - self.centres[0]
        return k if near[k] <= max(SAME_VALUE * extent, 1e-12) * 10.0 else -1

    def nearest(self, value: Value) -> int:
        """Return the cell of a value, or of the nearest value within the tried ones; -1 if none."""
        own = self._find(value)
        if own >= 0 or self.is_text or isinstance(value, str | None) or len(self) < 2:
            return own
        centres = np.array(self.centres)
        value = _after(value, self.centres[0]) if self.name == CONTACT_ANGLE else value
        inside = centres[0] <= value <= centres[-1]
        return int(np.abs(centres - value).argmin()) if inside and not self.edges else -1

    @property
    def places(self) -> FloatArray:
        """Positions (n, d) of cells, for distances between them: numbers as shares of the extent,
        texts as the corners of a simplex."""
        if self.is_text:
            return np.eye(len(self)) / math.sqrt(2.0)
        centres = np.array(self.centres)
        extent = float(np.ptp(centres)) or 1.0
        return np.asarray(((centres - centres[0]) / extent)[:, None])


def axis_of(name: str, values: Sequence[Value], step: float | None = None) -> CellAxis:
    """Return an axis for values: one cell per value if these are few or text, else ranges.

    Ranges are `step` wide [SI], if that is given, and one of them is centred at zero.
    """
    known = [value for value in values if value is not None]
    if not known:
        raise InvalidInput(f"axis {name}", found="no values", expected="at least one")
    if any(isinstance(value, str) for value in known):
        return CellAxis(name=name, labels=tuple(sorted({str(value) for value in known})))
    if step is not None:
        return _regular(name, np.unique(np.array(known, np.float64)), step)
    values_along = np.array(known, np.float64)
    if name == CONTACT_ANGLE:
        values_along = _unwrapped(values_along)
    numbers = np.unique(values_along)
    gap = max(SAME_VALUE * float(np.ptp(numbers)), 1e-12)
    distinct = numbers[np.concatenate(([True], np.diff(numbers) > gap))]
    if len(distinct) <= FEW_VALUES:
        return CellAxis(name=name, centres=tuple(distinct.tolist()))
    shares = np.linspace(0.0, 1.0, BINS + 1)
    edges = np.unique(np.quantile(values_along, shares))
    return _ranges(name, np.asarray(edges, np.float64))


def _unwrapped(angles: FloatArray) -> FloatArray:
    """Return directions cut at the largest gap between them, so that neighbours stay neighbours."""
    ordered = np.unique(angles)
    gaps = np.diff(ordered)
    around = 2.0 * math.pi - float(ordered[-1] - ordered[0])
    if not len(gaps) or gaps.max() <= around * (1.0 + SAME_VALUE):
        return angles
    first = ordered[int(gaps.argmax()) + 1]
    return np.where(angles < first, angles + 2.0 * math.pi, angles)


def _after(angle: float, first: float) -> float:
    """Return a direction as the angle from `first` on, within one turn."""
    turns = math.floor((angle - first) / (2.0 * math.pi) + SAME_VALUE)
    return angle - 2.0 * math.pi * turns


def _regular(name: str, numbers: FloatArray, step: float) -> CellAxis:
    if not (math.isfinite(step) and step > 0.0):
        raise InvalidInput(f"axis {name}", found=f"a step of {step}", expected="a positive step")
    first = math.floor(float(numbers[0]) / step + 0.5)
    last = math.floor(float(numbers[-1]) / step + 0.5)
    if last - first >= MAX_CELLS:
        raise InvalidInput(
            f"axis {name}", found=f"{last - first + 1} cells", expected="fewer cells"
        )
    return _ranges(name, np.asarray((np.arange(first, last + 2) - 0.5) * step, np.float64))


def _ranges(name: str, edges: FloatArray) -> CellAxis:
    centres = 0.5 * (edges[1:] + edges[:-1])
    return CellAxis(name=name, centres=tuple(centres.tolist()), edges=tuple(edges.tolist()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Cells of a map."""

    axes: tuple[CellAxis, ...]
    index: tuple[tuple[int, ...], ...]  # position of each cell along every axis
    nominal: int  # index of the nominal cell
    arms: bool  # whether all cells differ from the nominal one along at most one axis

    def __len__(self) -> int:
        return len(self.index)

    def text(self, k: int) -> str:
        """Return a cell as text, with names and units."""
        parts = []
        for axis, place in zip(self.axes, self.index[k], strict=True):
            nominal = place == self.index[self.nominal][self.axes.index(axis)]
            if not (self.arms and nominal and k != self.nominal):
                parts.append(f"{axis.title} = {axis.text(place)} {axis.unit}".rstrip())
        return ", ".join(parts)

    def values(self, k: int) -> dict[str, str | float]:
        """Return the values of a cell along the axes, by name [SI]."""
        return {
            axis.name: axis.labels[place] if axis.is_text else axis.centres[place]
            for axis, place in zip(self.axes, self.index[k], strict=True)
        }

    @property
    def is_strips(self) -> bool:
        """Whether each axis is shown by itself, through the nominal cell."""
        return self.arms or len(self.axes) == 1

    @property
    def places(self) -> FloatArray:
        """Positions (n_cell, d) of the cells, for distances between them."""
        columns = [
            axis.places[[index[a] for index in self.index]] for a, axis in enumerate(self.axes)
        ]
        return np.concatenate(columns, axis=1)

    def find(self, evidence: HeldOutErrors) -> IntArray:
        """Return the cell (n,) of every experiment; -1 for none."""
        columns = [axis.find(evidence.column(axis.name)) for axis in self.axes]
        number = {index: k for k, index in enumerate(self.index)}
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return np.array([number.get(row, -1) for row in rows], np.int64)

    @property
    def edges(self) -> list[tuple[int, int]]:
        """Pairs of neighbours, which differ by one step along an axis, or in one text."""
        number = {index: k for k, index in enumerate(self.index)}
        found = []
        for index, k in number.items():
            for a, axis in enumerate(self.axes):
                ahead = range(index[a] + 1, len(axis) if axis.is_text else index[a] + 2)
                for place in ahead:
                    other = number.get((*index[:a], place, *index[a + 1 :]))
                    if other is not None:
                        found.append((k, other))
        return found

    def grid(self, across: int, up: int | None) -> IntArray:
        """Return cells (n_row, n_column) over one axis or two, in rows from below.

        On the other axes they are at the nominal.
        """
        number = {index: c for c, index in enumerate(self.index)}
        n_up = 1 if up is None else len(self.axes[up])
        found = np.zeros((n_up, len(self.axes[across])), np.int64)
        for row, column in np.ndindex(*found.shape):
            index = list(self.index[self.nominal])
            index[across] = column
            if up is not None:
                index[up] = row
            found[row, column] = number[tuple(index)]
        return found

    def component(self, inside: Sequence[bool]) -> list[int]:
        """Return the cells inside that are connected to the nominal; none if that is outside."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        if not inside[self.nominal]:
            return []
        both = np.array([(a, b) for a, b in self.edges if inside[a] and inside[b]], np.int64)
        links = coo_array((np.ones(len(both)), both.reshape(-1, 2).T), (len(self), len(self)))
        part = connected_components(links, directed=False)[1]
        return [int(k) for k in np.flatnonzero(part == part[self.nominal])]


def cells_of(
    evidence: HeldOutErrors,
    axes: Sequence[str],
    nominal: Mapping[str, str | float] | None = None,
    steps: Mapping[str, float] | None = None,
) -> Cells:
    """Divide coordinates of the evidence into cells.

    More than two axes are allowed only if every experiment differs from the nominal along at most
    one of them, as in a plan of offsets axis by axis. Nominal values are by default zero, or the
    median without it, and the most frequent text. Ranges are `steps` wide [SI].
    """
    if not axes or len(set(axes)) < len(axes):
        raise InvalidInput("axes", found=", ".join(axes) or "none", expected="each axis once")
    # A value for a misspelt axis would change nothing.
    for argument, given in {"nominal": nominal, "cells": steps}.items():
        for name in given or {}:
            check_name(argument, name, axes)
    made = tuple(axis_of(n, evidence.column(n), (steps or {}).get(n)) for n in axes)
    centre = tuple(_nominal(axis, evidence, (nominal or {}).get(axis.name)) for axis in made)
    columns = np.stack([axis.find(evidence.column(axis.name)) for axis in made], axis=1)
    known = columns[(columns >= 0).all(axis=1)]
    arms = len(made) > 1 and bool(((known != centre).sum(axis=1) <= 1).all()) and len(known) > 0
    if arms:
        index = _arms(made, centre)
    elif len(made) > 2:
        raise InvalidInput(
            "axes",
            found=f"{len(made)} axes",
            expected="one or two, where experiments differ along several axes at once",
        )
    else:
        index = list(product(*(range(len(axis)) for axis in made)))
    if len(index) > MAX_CELLS:
        found, hint = f"{len(index)} cells", "use wider cells"
        raise InvalidInput("cells", found=found, expected=f"at most {MAX_CELLS}", hint=hint)
    return Cells(axes=made, index=tuple(index), nominal=index.index(centre), arms=arms)


def _arms(axes: Sequence[CellAxis], centre: tuple[int, ...]) -> list[tuple[int, ...]]:
    found = {centre: None}
    for a, axis in enumerate(axes):
        for place in range(len(axis)):
            found[(*centre[:a], place, *centre[a + 1 :])] = None
    return sorted(found)


def _nominal(axis: CellAxis, evidence: HeldOutErrors, wanted: str | float | None) -> int:
    values = evidence.column(axis.name)
    if wanted is None:
        places = axis.find(values)
        if axis.is_text:
            return int(np.bincount(places[places >= 0]).argmax())
        zero = int(axis.find([0.0])[0])
        if zero >= 0:
            return zero
        numbers = np.array([v for v in values if v is not None], np.float64)
        if axis.name == CONTACT_ANGLE:
            numbers = _unwrapped(numbers)
        return int(np.abs(np.array(axis.centres) - float(np.median(numbers))).argmin())
    found = int(axis.find([wanted])[0])
    if found < 0:
        raise InvalidInput(
            f"nominal {axis.name}",
            found=wanted,
            expected="a value with experiments: " + ", ".join(map(axis.text, range(len(axis)))),
        )
    return found


def varying(evidence: HeldOutErrors, names: Sequence[str]) -> list[str]:
    """Return the coordinates that have more than one value."""
    return [
        name
        for name in names
        if len({v for v in evidence.coordinates.get(name, ()) if v is not None}) > 1
    ]
