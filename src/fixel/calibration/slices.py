"""Conditional slices: the deviance along one unknown with the others fixed."""

from __future__ import annotations

import itertools
import math
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.optimiser import Best, SearchBox
from fixel.calibration.side import crossing_share
from fixel.typing import FloatArray

# Ratio and number of the first distances, from the bound inwards, if no curvature predicts the
# crossing.
RATIO: Final = 4.0
LOOKS: Final = 3
# First distance, as a share of the way to the predicted crossing.
AIM: Final = 1.05
# Tolerances of the crossing: shares of the root of the rise, and for a bracket of the
# distance.
CLOSE_RISE: Final = 0.1
CONFIRMED: Final = 0.05
NARROW: Final = 0.2
# Maximum number of rounds of points inside a bracket.
MAX_ROUNDS: Final = 2


class Slice(NamedTuple):
    """Deviance along one unknown, with the others at the optimum."""

    values: FloatArray  # (k,) ascending
    deviances: FloatArray  # (k,) inf for failures
    low: float | None  # value at which the rise reaches the threshold; None without one
    high: float | None


@final
class Slicer:
    """Computation of a slice in both directions, in a few rounds.

    Parameters
    ----------
    box : SearchBox
    index : int
        Index of the unknown.
    best : Best
    threshold : float
        Rise of the deviance at the ends of the interval.
    reach : float
        Distance of the crossing predicted by the curvature; inf without a prediction.
    """

    def __init__(
        self, box: SearchBox, index: int, best: Best, threshold: float, reach: float
    ) -> None:
        self._best, self._index, self._threshold, self._reach = best, index, threshold, reach
        self._bounds = float(box.low[index]), float(box.high[index])
        self._centre = float(best.point[index])
        self._known = {self._centre: best.error}
        self._round = 0

    @property
    def done(self) -> bool:
        """Whether both crossings are known with sufficient accuracy."""
        return self._round > MAX_ROUNDS or (self._round > 0 and not self._closer())

    def ask(self) -> FloatArray:
        """Return points (k, n) to evaluate; none at the end."""
        values = [] if self.done else self._closer() if self._round else self._first()
        points = np.repeat(self._best.point[None], len(values), axis=0)
        points[:, self._index] = values
        return points

    def tell(self, deviances: FloatArray) -> None:
        """Take the deviances (k,) of the requested points."""
        values = self.ask()[:, self._index].tolist()
        self._known.update(zip(values, deviances.tolist(), strict=True))
        self._round += 1

    @property
    def slice(self) -> Slice:
        """Slice from all evaluated points."""
        values = np.array(sorted(self._known))
        deviances = np.array([self._known[value] for value in values.tolist()])
        low, high = (self._crossing(sign) for sign in (-1, 1))
        return Slice(values, deviances, low, high)

    def _first(self) -> list[float]:
        looks = (RATIO ** -np.arange(LOOKS, dtype=np.float64)).tolist()
        found: list[float] = []
        for bound in self._bounds:
            room = abs(bound - self._centre)
            if room > 0.0:
                predicted = AIM * self._reach / room
                shares = [1.0, predicted] if predicted < 1.0 else looks
                way = bound - self._centre
                found += [bound if share == 1.0 else self._centre + share * way for share in shares]
        return found

    def _closer(self) -> list[float]:
        """Return a value in each bracket that is still wide."""
        found: list[float] = []
        for sign in (-1, 1):
            pair = self._bracket(sign)
            if pair is None or self._crossing(sign) is None:
                continue
            a, b = map(self._length, pair)
            width, distance = abs(pair[1] - pair[0]), abs(pair[1] - self._centre)
            if a == 0.0:
                # A parabola and a line cannot be distinguished, unless one value confirms
                # the curvature.
                placed = abs(distance - AIM * self._reach) <= 1e-6 * distance
                if not (placed and abs(b - AIM) <= CONFIRMED):
                    found.append(pair[0] + 0.5 / b * (pair[1] - pair[0]))
            elif width > NARROW * distance and min(1.0 - a, b - 1.0) > CLOSE_RISE:
                # Interpolation converges slowly for curved deviances: alternate with bisection.
                share = 0.5 if self._round % 2 == 0 else self._share(*pair)
                found.append(pair[0] + share * (pair[1] - pair[0]))
        return found

    def _bracket(self, sign: int) -> tuple[float, float] | None:
        """Return the two values between which the rise first reaches the threshold."""
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
        return pair[0] + (pair[1] - pair[0]) * self._share(*pair)

    def _share(self, inner: float, outer: float) -> float:
        pair = (inner, outer)
        distances = [abs(value - self._centre) for value in pair]
        return crossing_share(distances, [self._length(value) for value in pair])

    def _length(self, value: float) -> float:
        return math.sqrt(max(0.0, self._known[value] - self._best.error) / self._threshold)
