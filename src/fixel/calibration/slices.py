"""Conditional slices: the deviance along one unknown while the others are held."""

from __future__ import annotations

import itertools
import math
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.optimiser import Best, Box
from fixel.kernels.arrays import FloatArray

# Distances of the first look, each so many times the one before, from the bound inwards.
RATIO: Final = 2.5
LOOKS: Final = 10
# Points between the two that bracket the crossing.
CLOSER: Final = 4


class Slice(NamedTuple):
    """Deviance along one unknown, the others held at the best."""

    values: FloatArray  # (k,) ascending
    deviances: FloatArray  # (k,) inf where a point could not be evaluated
    low: float | None  # where the rise reaches the threshold; None where it does not
    high: float | None


@final
class Slicer:
    """Both directions of a slice, in two rounds.

    Parameters
    ----------
    box : Box
    index : int
        Of the unknown.
    best : Best
    threshold : float
        Rise of the deviance at the ends of the interval.
    """

    def __init__(self, box: Box, index: int, best: Best, threshold: float) -> None:
        self._best, self._index, self._threshold = best, index, threshold
        self._bounds = float(box.low[index]), float(box.high[index])
        self._centre = float(best.point[index])
        self._known = {self._centre: best.error}
        self._round = 0

    @property
    def done(self) -> bool:
        """Whether both rounds were told."""
        return self._round == 2

    def ask(self) -> FloatArray:
        """(k, n) points; none once done."""
        values = [] if self.done else (self._first, self._second)[self._round]()
        points = np.repeat(self._best.point[None], len(values), axis=0)
        points[:, self._index] = values
        return points

    def tell(self, deviances: FloatArray) -> None:
        """Deviances (k,) of the points asked for."""
        values = self.ask()[:, self._index].tolist()
        self._known.update(zip(values, deviances.tolist(), strict=True))
        self._round += 1

    @property
    def slice(self) -> Slice:
        """What was found."""
        values = np.array(sorted(self._known))
        deviances = np.array([self._known[value] for value in values.tolist()])
        low, high = (self._crossing(sign) for sign in (-1, 1))
        return Slice(values, deviances, low, high)

    def _first(self) -> list[float]:
        shares = RATIO ** -np.arange(LOOKS, dtype=np.float64)
        return [
            bound if share == 1.0 else self._centre + share * (bound - self._centre)
            for bound in self._bounds
            for share in shares.tolist()
            if bound != self._centre
        ]

    def _second(self) -> list[float]:
        found: list[float] = []
        for sign in (-1, 1):
            pair = self._bracket(sign)
            if pair is not None:
                found += np.linspace(pair[0], pair[1], CLOSER + 2)[1:-1].tolist()
        return found

    def _bracket(self, sign: int) -> tuple[float, float] | None:
        """The values between which the rise first reaches the threshold."""
        side = sorted(
            (value for value in self._known if sign * (value - self._centre) >= 0.0),
            key=lambda value: abs(value - self._centre),
        )
        for inner, outer in itertools.pairwise(side):
            if self._length(outer) >= 1.0:
                return inner, outer
        return None

    def _crossing(self, sign: int) -> float | None:
        pair = self._bracket(sign)
        if pair is None or math.isinf(self._known[pair[1]]):
            return None
        a, b = self._length(pair[0]), self._length(pair[1])
        return pair[0] + (pair[1] - pair[0]) * (1.0 - a) / (b - a)

    def _length(self, value: float) -> float:
        return math.sqrt(max(0.0, self._known[value] - self._best.error) / self._threshold)
