"""Derivatives of rough residuals by finite differences, requested in batches."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from fixel.calibration.optimiser import SearchBox
from fixel.typing import FloatArray

# A response this many times the roughness gives a slope with an error of a few per cent.
CLEAR: Final = 30.0
# A response this many times the roughness is still clear after a step ten times smaller.
PLAIN: Final = 1000.0
# Maximum number of probes of one unknown at one point: enough to grow from 1e-3 to 1 scale.
TRIES: Final = 4
GROWTH: Final = 10.0
# Smallest step over the first one; if it still fails, the point is at an edge of feasibility.
MIN_STEP_SHARE: Final = 1e-3


@final
class Differences:
    """Finite-difference derivatives at one point after another.

    Each unknown has its own step, which is preserved between points. The step grows tenfold while
    no residual changes by more than `CLEAR` times the roughness, and shrinks again if one changes
    by more than `PLAIN` times. A failed probe is repeated on the other side and closer. If all
    probes of an unknown fail, its column is zero.

    The first and smallest step and the largest one are fractions of the scale. The roughness is an
    insignificant change of a residual [standard deviations].
    """

    def __init__(self, box: SearchBox, step: float, largest: float, roughness: float) -> None:
        self.box = box
        self.step = np.full(box.n, step)
        self._first = step
        self._limits = step, max(step, largest)
        self._roughness = roughness
        self._todo: list[int] = []

    @property
    def pending(self) -> bool:
        """Whether more probes are needed."""
        return bool(self._todo)

    def begin(self, point: FloatArray, which: FloatArray, central: bool) -> None:
        """Begin the columns of the unknowns `which` (n,) bool at a point (n,)."""
        self.point = point
        self.central = central
        self._columns: dict[int, FloatArray] = {}
        self._todo = [int(j) for j in np.flatnonzero(which)]
        self._tries = dict.fromkeys(self._todo, 0)
        self._side = dict.fromkeys(self._todo, 1.0)
        self._plan()

    def probes(self) -> FloatArray:
        """Return the points (k, n) to evaluate."""
        return self._probes

    def learn(self, residuals: FloatArray, base: FloatArray) -> None:
        """Take the residuals (k, m) of the probes; `base` (m,) are those of the point itself."""
        owner = np.array([j for j, _ in self._moves])
        moved = np.array([d for _, d in self._moves])
        todo = []
        for j in self._todo:
            rows = np.flatnonzero(owner == j)
            rows = rows[np.isfinite(residuals[rows]).all(axis=1)]
            if self._again(j, residuals[rows] - base, moved[rows]):
                todo.append(j)
        self._todo = todo
        self._plan()

    def columns(self, count: int) -> FloatArray:
        """Return derivatives (count, n) of each residual per scale of each unknown."""
        table = np.zeros((count, self.box.n))
        for j, column in self._columns.items():
            table[:, j] = column
        return table

    def widen(self) -> bool:
        """Increase the smallest step, for slopes across roughness; False if it is the largest."""
        least = max(self._limits[0], float(self.step.min()))
        self._limits = min(least * GROWTH, self._limits[1]), self._limits[1]
        self.step = np.maximum(self.step, self._limits[0])
        return self._limits[0] > least

    def _again(self, j: int, change: FloatArray, moved: FloatArray) -> bool:
        """Store the slope from changes (k, m) after moves (k,); True if j needs more probes."""
        self._tries[j] += 1
        last = self._tries[j] >= TRIES
        if not len(moved):
            self.step[j] = max(self.step[j] / GROWTH, MIN_STEP_SHARE * self._first)
            self._side[j] = -self._side[j]
            return j not in self._columns and not last
        self._columns[j] = _slope(change, moved)
        answer = float(np.abs(change).max(initial=0.0))
        if answer < CLEAR * self._roughness and self.step[j] < self._limits[1]:
            self.step[j] = min(self.step[j] * GROWTH, self._limits[1])
            return not last
        if answer > PLAIN * self._roughness and self.step[j] > self._limits[0]:
            self.step[j] = max(self.step[j] / GROWTH, self._limits[0])
        return False

    def _plan(self) -> None:
        moves = [(j, d) for j in self._todo for d in self._moves_of(j)]
        points = np.repeat(self.point[None], len(moves), axis=0)
        for row, (j, d) in zip(points, moves, strict=True):
            row[j] = np.clip(row[j] + d * self.box.scale[j], self.box.low[j], self.box.high[j])
        # Actual moves, after rounding and the bounds.
        self._moves = [
            (j, float((row[j] - self.point[j]) / self.box.scale[j]))
            for row, (j, _) in zip(points, moves, strict=True)
        ]
        self._probes = points

    def _moves_of(self, j: int) -> tuple[float, ...]:
        """Return the signed moves of unknown j within the bounds [scales]."""
        h, side = self.step[j], self._side[j]
        room = {
            1.0: (self.box.high[j] - self.point[j]) / self.box.scale[j],
            -1.0: (self.point[j] - self.box.low[j]) / self.box.scale[j],
        }
        if self.central and min(room.values()) >= h:
            return h, -h
        if room[side] < h and room[-side] > room[side]:
            side = -side
        reach = side * min(h, room[side])
        return (reach, 0.5 * reach) if self.central else (reach,)


def _slope(change: FloatArray, moved: FloatArray) -> FloatArray:
    """Return slopes (m,) at zero of the line or parabola through zero and changes (k, m)."""
    if len(moved) == 1:
        return np.asarray(change[0] / moved[0])
    a, b = moved
    return np.asarray((change[0] * b * b - change[1] * a * a) / (a * b * (b - a)))
