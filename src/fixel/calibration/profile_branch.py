"""Deviance along one unknown: a branch of its profile, and its slice with the others fixed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import LeastSquaresFit
from fixel.calibration.optimiser import Best, SearchBox
from fixel.typing import BoolArray, FloatArray

# The rise is measured as a length: the root of the rise over the threshold. It grows linearly near
# a smooth optimum and is 1 at the crossing.
# First fixed value, as a share of the way to the crossing predicted by the curvature: slightly
# beyond it, so that one value can confirm the prediction.
FIRST_SHARE: Final = 1.05
HALF_WAY: Final = 0.5
# Distance from a bound that counts as on it, as a share of the range.
ON_BOUND: Final = 1e-3
# The prediction is confirmed if the length there exceeds 1 by no more than this.
CONFIRMED: Final = 0.15
# Growth of the length from one value to the next, for three values before the crossing.
STRIDE: Final = 0.4
# Intended length of a value beyond the crossing.
AIM: Final = 1.1
# Longest step, as a share of the way to the bound, and relative to the previous step.
MAX_STEP: Final = 0.5
GROWTH: Final = 2.0
# Shortest step [scales].
MIN_STEP: Final = 1e-6
# A bracket is narrow enough if an end is this close to the threshold, or its width is this share
# of the distance: 3 per cent of the half-width of an interval do not matter.
CLOSE_RISE: Final = 0.06
NARROW: Final = 0.03
# Maximum number of fixed values on a side.
MAX_NODES: Final = 30

# Of slices: ratio and number of the first distances, from the bound inwards, if no curvature
# predicts the crossing.
RATIO: Final = 4.0
LOOKS: Final = 3
# First distance, as a share of the way to the predicted crossing.
SLICE_AIM: Final = 1.05
# Tolerances of the crossing: shares of the root of the rise, and for a bracket of the
# distance.
SLICE_CLOSE_RISE: Final = 0.1
SLICE_CONFIRMED: Final = 0.05
SLICE_NARROW: Final = 0.2
# Maximum number of rounds of points inside a bracket.
MAX_ROUNDS: Final = 2


class Node(NamedTuple):
    """Fixed value of a profile, with the best values of the other parameters."""

    value: float
    deviance: float  # minimum over the other parameters; inf if nothing could be evaluated
    point: FloatArray  # (n,) point of the minimum


class ProfileBranch:
    """Fixed values of one unknown on one side of the optimum, upwards (sign +1) or downwards (-1).

    The curvature predicts the distance of the crossing as `reach`, inf where it is unusable, and
    the change of the point per change of the unknown as `slope` (n,).
    """

    def __init__(
        self, box: SearchBox, index: int, sign: int, best: Node, reach: float, slope: FloatArray
    ) -> None:
        self.index, self.sign = index, sign
        self.bound = float(box.high[index] if sign > 0 else box.low[index])
        self.nodes = [best]
        self.beyond: list[Node] = []  # values beyond the crossing, to check the rest of the range
        self._scale, self._scales = float(box.scale[index]), box.scale
        self._reach, self._slope = reach, slope
        self.columns: FloatArray | None = None  # (m, n) derivatives near the last node
        self._at, self._residual = best.point, np.zeros(0)
        self._centre = best.value
        self._room = abs(self.bound - best.value)
        # On a bound the deviance may rise linearly: test a value half-way.
        bounds = np.array([box.low[index], box.high[index]])
        on_bound = np.abs(best.value - bounds).min() <= ON_BOUND * np.ptp(bounds)
        self._first = reach * (HALF_WAY if on_bound else FIRST_SHARE)

    def add(self, node: Node) -> None:
        """Add the deviance of a fixed value, or a lower deviance of a known value."""
        for k, known in enumerate(self.nodes):
            if known.value == node.value:
                self.nodes[k] = node if node.deviance < known.deviance else known
                return
        self.nodes.append(node)
        self.nodes.sort(key=lambda known: self._distance(known.value))

    def begin(self, point: FloatArray, residual: FloatArray, columns: FloatArray) -> None:
        """Set the residuals (m,) and derivatives (m, n) at a point, for the first fixed value."""
        if len(columns) == len(residual) > 0:
            self.columns, self._at, self._residual = columns.copy(), point, residual

    def learn(self, fit: LeastSquaresFit, free: BoolArray) -> None:
        """Update the derivatives after a fit at a fixed value.

        Derivatives of the free parameters are replaced by those of the fit. The others are
        corrected by the change of the residuals since the last node (Broyden's update).
        """
        if not fit.residual.size:
            return
        if self.columns is None:
            self.columns, self._at, self._residual = fit.columns, fit.point, fit.residual
            return
        if fit.columns.size:
            self.columns[:, free] = fit.columns[:, free]
        move = (fit.point - self._at) / self._scales
        length = float(move @ move)
        if length > MIN_STEP**2:
            missed = fit.residual - self._residual - self.columns @ move
            self.columns += np.outer(missed, move / length)
            self._at, self._residual = fit.point, fit.residual

    def next_value(self, threshold: float) -> float | None:
        """Return the next value to fix; None if the crossing is known, or there is none."""
        if self._room <= MIN_STEP * self._scale or len(self.nodes) > MAX_NODES:
            return None
        above = self.first_above(threshold)
        if above is None:
            return self._outward(threshold)
        return self._between(self.nodes[above - 1], self.nodes[above], threshold)

    def first_above(self, threshold: float) -> int | None:
        """Return the index of the first node past all that are below the threshold."""
        above = 1 + max(k for k, n in enumerate(self.lengths(threshold)) if n < 1.0)
        return above if above < len(self.nodes) else None

    def lengths(self, threshold: float) -> list[float]:
        """Return the length of each node: the root of its rise over the threshold."""
        return [self._length(node, threshold) for node in self.nodes]

    def crossing(self, threshold: float) -> float | None:
        """Return the value at which the deviance has risen by the threshold; None if there is none.

        A value that cannot be evaluated counts as a bound.
        """
        above = self.first_above(threshold)
        if above is None or math.isinf(self.nodes[above].deviance):
            return None
        inner, outer = self.nodes[above - 1 : above + 1]
        return inner.value + (outer.value - inner.value) * self._share(inner, outer, threshold)

    def edge(self, threshold: float) -> Node:
        """Return the node nearest to the crossing, or the last one without a crossing."""
        above = self.first_above(threshold)
        if above is None:
            return self.nodes[-1]
        pair = self.nodes[above - 1 : above + 1]
        known = [node for node in pair if math.isfinite(node.deviance)]
        base = self.nodes[0].deviance
        return min(known, key=lambda node: abs(node.deviance - base - threshold))

    def guesses(self, value: float) -> list[FloatArray]:
        """Return start points (n,) for a fixed value of the unknown, the likeliest first."""
        known = [node for node in self.nodes if math.isfinite(node.deviance)]
        near = sorted(known, key=lambda node: abs(node.value - value))[:2]
        if len(near) == 1:
            guess = near[0].point + self._slope * (value - near[0].value)
        else:
            share = (value - near[0].value) / (near[1].value - near[0].value)
            guess = near[0].point + share * (near[1].point - near[0].point)
        return [guess, near[0].point]

    def _distance(self, value: float) -> float:
        return self.sign * (value - self._centre)

    def _outward(self, threshold: float) -> float | None:
        last = self._distance(self.nodes[-1].value)
        if last >= self._room:
            return None
        longest = MAX_STEP * self._room
        if len(self.nodes) == 1:
            step = self._first if self._first < self._room else longest
        else:
            a, b = self.lengths(threshold)[-2:]
            gap = last - self._distance(self.nodes[-2].value)
            wanted = min(max(AIM - b, 0.05), STRIDE)
            step = wanted * gap / (b - a) if b > a else math.inf
            step = min(max(step, gap / GROWTH), GROWTH * gap, longest)
        return self._placed(last + max(step, MIN_STEP * self._scale))

    def _between(self, inner: Node, outer: Node, threshold: float) -> float | None:
        a, b = (self._length(node, threshold) for node in (inner, outer))
        from_, to = self._distance(inner.value), self._distance(outer.value)
        narrow = to - from_ <= max(NARROW * to, MIN_STEP * self._scale)
        # The optimum and one value do not distinguish a parabola from a line: add one in between.
        predicted = a == 0.0 and abs(to - FIRST_SHARE * self._reach) <= 1e-6 * to
        if narrow or (predicted and b - 1.0 <= CONFIRMED):
            return None
        if a > 0.0 and min(1.0 - a, b - 1.0) <= CLOSE_RISE:
            return None
        # Interpolation is slow where the deviance jumps, so every third step is a bisection.
        share = (
            0.5
            if math.isinf(b) or len(self.nodes) % 3 == 0
            else self._share(inner, outer, threshold)
        )
        return self._placed(from_ + min(max(share, 0.1), 0.9) * (to - from_))

    def _share(self, inner: Node, outer: Node, threshold: float) -> float:
        """Return the share of the way between two nodes at which the deviance crosses."""
        pair = (inner, outer)
        distances = [self._distance(node.value) for node in pair]
        return crossing_share(distances, [self._length(node, threshold) for node in pair])

    def _length(self, node: Node, threshold: float) -> float:
        return math.sqrt(max(0.0, node.deviance - self.nodes[0].deviance) / threshold)

    def _placed(self, distance: float) -> float:
        if distance >= (1.0 - 1e-9) * self._room:
            return self.bound
        return self._centre + self.sign * distance


def crossing_share(distances: Sequence[float], lengths: Sequence[float]) -> float:
    """Return the share of the way from one value to the next at which the length is 1.

    It is that of the parabola through the optimum and both values, with a linear term if the
    optimum is on a bound; otherwise that of linearly interpolated lengths. Both values have a
    distance from the optimum, and a length: the root of the rise over the threshold, below and
    above 1.
    """
    (p, q), (a, b) = distances, lengths
    if a > 0.0:
        bend = (b * b / q - a * a / p) / (q - p)
        slope = a * a / p - bend * p
        root = slope * slope + 4.0 * bend
        if slope >= 0.0 and root > 0.0:
            return min(max((2.0 / (slope + math.sqrt(root)) - p) / (q - p), 0.0), 1.0)
    return (1.0 - a) / (b - a)


class Slice(NamedTuple):
    """Deviance along one unknown, with the others at the optimum."""

    values: FloatArray  # (k,) ascending
    deviances: FloatArray  # (k,) inf for failures
    low: float | None  # value at which the rise reaches the threshold; None without one
    high: float | None


class Slicer:
    """Computation of a slice in both directions, in a few rounds.

    The deviance rises by the threshold at the ends of the interval. The curvature predicts their
    distance as `reach`, inf without a prediction.
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
                predicted = SLICE_AIM * self._reach / room
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
                placed = abs(distance - SLICE_AIM * self._reach) <= 1e-6 * distance
                if not (placed and abs(b - SLICE_AIM) <= SLICE_CONFIRMED):
                    found.append(pair[0] + 0.5 / b * (pair[1] - pair[0]))
            elif width > SLICE_NARROW * distance and min(1.0 - a, b - 1.0) > SLICE_CLOSE_RISE:
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
