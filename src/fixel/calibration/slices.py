"""Conditional slices: the deviance along one unknown while the others are held."""

from __future__ import annotations

import itertools
import math
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.optimiser import Best, SearchBox
from fixel.calibration.side import crossing_share
from fixel.typing import FloatArray

# Distances of the first look, from the bound inwards, where no curvature predicts the crossing;
# each is this many times the one before.
RATIO: Final = 4.0
LOOKS: Final = 3
# Place of the first look, as a share of the way to the predicted crossing.
AIM: Final = 1.05
# A look this close to the threshold is the crossing, as is one in a bracket this narrow: share of
# the rise's root, and of the distance.
CLOSE_RISE: Final = 0.1
CONFIRMED: Final = 0.05
NARROW: Final = 0.2
# Rounds of points between the two that bracket the crossing, at most.
MAX_ROUNDS: Final = 2


class Slice(NamedTuple):
    """Deviance along one unknown, the others held at the best."""

    values: FloatArray  # (k,) ascending
    deviances: FloatArray  # (k,) inf where a point could not be evaluated
    low: float | None  # where the rise reaches the threshold; None where it does not
    high: float | None


@final
class Slicer:
    """Both directions of a slice, in a few rounds.

    Parameters
    ----------
    box : SearchBox
    index : int
        Of the unknown.
    best : Best
    threshold : float
        Rise of the deviance at the ends of the interval.
    reach : float
        Distance of the crossing that the curvature predicts; inf where it says nothing.
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
        """Whether both crossings are known well enough."""
        return self._round > MAX_ROUNDS or (self._round > 0 and not self._closer())

    def ask(self) -> FloatArray:
        """(k, n) points; none once done."""
        values = [] if self.done else self._closer() if self._round else self._first()
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
        """A value in each bracket that is still wide."""
        found: list[float] = []
        for sign in (-1, 1):
            pair = self._bracket(sign)
            if pair is None or self._crossing(sign) is None:
                continue
            a, b = map(self._length, pair)
            width, distance = abs(pair[1] - pair[0]), abs(pair[1] - self._centre)
            if a == 0.0:
                # A parabola and a line look alike from here, unless one value confirms the
                # curvature.
                placed = abs(distance - AIM * self._reach) <= 1e-6 * distance
                if not (placed and abs(b - AIM) <= CONFIRMED):
                    found.append(pair[0] + 0.5 / b * (pair[1] - pair[0]))
            elif width > NARROW * distance and min(1.0 - a, b - 1.0) > CLOSE_RISE:
                # Where the deviance bends, this comes slowly closer: half of the way in turn.
                share = 0.5 if self._round % 2 == 0 else self._share(*pair)
                found.append(pair[0] + share * (pair[1] - pair[0]))
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
        return pair[0] + (pair[1] - pair[0]) * self._share(*pair)

    def _share(self, inner: float, outer: float) -> float:
        pair = (inner, outer)
        distances = [abs(value - self._centre) for value in pair]
        return crossing_share(distances, [self._length(value) for value in pair])

    def _length(self, value: float) -> float:
        return math.sqrt(max(0.0, self._known[value] - self._best.error) / self._threshold)
