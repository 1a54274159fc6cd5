"""One side of a profile: which value to fix next, and where the deviance crosses the threshold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.descent import LeastSquaresFit
from fixel.calibration.optimiser import SearchBox
from fixel.typing import BoolArray, FloatArray

# The rise is measured as a length: the root of the rise over the threshold, so that it grows in a
# straight line away from a smooth optimum and is 1 at the crossing.
# First fixed value, as a share of the way to the crossing that the curvature predicts: a little
# beyond, so that one value confirms the prediction.
FIRST_SHARE: Final = 1.05
HALF_WAY: Final = 0.5
# Distance from a bound, as a share of the range, that counts as on it.
ON_BOUND: Final = 1e-3
# The prediction is confirmed where the length there is above 1 by no more than this.
CONFIRMED: Final = 0.15
# Growth of the length from one value to the next: three values before the crossing.
STRIDE: Final = 0.4
# Where a value beyond the crossing is aimed at.
AIM: Final = 1.1
# Longest step, as a share of the way to the bound, and over the step before.
MAX_STEP: Final = 0.5
GROWTH: Final = 2.0
# Shortest step [scales].
MIN_STEP: Final = 1e-6
# A bracket is narrow enough when an end is this close to the threshold, or its width is this share
# of the distance: a 3 per cent error of an interval's half-width changes no conclusion.
CLOSE_RISE: Final = 0.06
NARROW: Final = 0.03
# Values fixed on a side, at most.
MAX_NODES: Final = 30


class Node(NamedTuple):
    """One fixed value of a profile."""

    value: float
    deviance: float  # least over the other parameters; inf where nothing could be evaluated
    point: FloatArray  # (n,) where it is least


@final
class Side:
    """The values of one unknown on one side of the best.

    Parameters
    ----------
    box : SearchBox
    index : int
        Of the unknown.
    sign : int
        +1 upwards, -1 downwards.
    best : Node
    reach : float
        Predicted distance of the crossing, inf where the curvature says nothing.
    slope : (n,) array
        Predicted change of the point per change of the unknown.
    """

    def __init__(
        self, box: SearchBox, index: int, sign: int, best: Node, reach: float, slope: FloatArray
    ) -> None:
        self.index, self.sign = index, sign
        self.bound = float(box.high[index] if sign > 0 else box.low[index])
        self.nodes = [best]
        self.beyond: list[Node] = []  # values past the crossing, for a look at the rest
        self._scale, self._scales = float(box.scale[index]), box.scale
        self._reach, self._slope = reach, slope
        self.columns: FloatArray | None = None  # (m, n) derivatives near the last node
        self._at, self._residual = best.point, np.zeros(0)
        self._centre = best.value
        self._room = abs(self.bound - best.value)
        # On a bound the deviance may rise in a line: a value half-way tells.
        bounds = np.array([box.low[index], box.high[index]])
        on_bound = np.abs(best.value - bounds).min() <= ON_BOUND * np.ptp(bounds)
        self._first = reach * (HALF_WAY if on_bound else FIRST_SHARE)

    def add(self, node: Node) -> None:
        """Take the deviance of a fixed value, or a lower one of a value known already."""
        for k, known in enumerate(self.nodes):
            if known.value == node.value:
                self.nodes[k] = node if node.deviance < known.deviance else known
                return
        self.nodes.append(node)
        self.nodes.sort(key=lambda known: self._distance(known.value))

    def begin(self, point: FloatArray, residual: FloatArray, columns: FloatArray) -> None:
        """Take residuals (m,) and derivatives (m, n) at a point, for the first fixed value."""
        if len(columns) == len(residual) > 0:
            self.columns, self._at, self._residual = columns.copy(), point, residual

    def learn(self, fit: LeastSquaresFit, free: BoolArray) -> None:
        """Correct the derivatives by what a fit at a fixed value has met.

        Fresh ones replace those of the parameters that were free; the change of the residuals from
        the last node to this one corrects the others (Broyden's update).
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
        """The next value to fix; None when the crossing is known, or there is none."""
        if self._room <= MIN_STEP * self._scale or len(self.nodes) > MAX_NODES:
            return None
        above = self.first_above(threshold)
        if above is None:
            return self._outward(threshold)
        return self._between(self.nodes[above - 1], self.nodes[above], threshold)

    def first_above(self, threshold: float) -> int | None:
        """Number of the first node above the threshold, counted from the best."""
        for k, length in enumerate(self.lengths(threshold)):
            if k and length >= 1.0:
                return k
        return None

    def lengths(self, threshold: float) -> list[float]:
        """Root of the rise over the threshold of each node."""
        return [self._length(node, threshold) for node in self.nodes]

    def crossing(self, threshold: float) -> float | None:
        """Where the deviance has risen by the threshold; None where it does not inside the bounds.

        A value that cannot be evaluated is a bound too.
        """
        above = self.first_above(threshold)
        if above is None or math.isinf(self.nodes[above].deviance):
            return None
        inner, outer = self.nodes[above - 1 : above + 1]
        return inner.value + (outer.value - inner.value) * self._share(inner, outer, threshold)

    def edge(self, threshold: float) -> Node:
        """The node nearest to the crossing, or the last where there is none."""
        above = self.first_above(threshold)
        if above is None:
            return self.nodes[-1]
        pair = self.nodes[above - 1 : above + 1]
        known = [node for node in pair if math.isfinite(node.deviance)]
        base = self.nodes[0].deviance
        return min(known, key=lambda node: abs(node.deviance - base - threshold))

    def guesses(self, value: float) -> FloatArray:
        """(k, n) points to start from with the unknown fixed at a value, the likeliest first."""
        known = [node for node in self.nodes if math.isfinite(node.deviance)]
        near = sorted(known, key=lambda node: abs(node.value - value))[:2]
        if len(near) == 1:
            guess = near[0].point + self._slope * (value - near[0].value)
        else:
            share = (value - near[0].value) / (near[1].value - near[0].value)
            guess = near[0].point + share * (near[1].point - near[0].point)
        points = np.array([guess, near[0].point])
        points[:, self.index] = value
        return points

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
        # From the best alone one cannot tell a parabola from a line: one more value in between.
        predicted = a == 0.0 and abs(to - FIRST_SHARE * self._reach) <= 1e-6 * to
        if narrow or (predicted and b - 1.0 <= CONFIRMED):
            return None
        if a > 0.0 and min(1.0 - a, b - 1.0) <= CLOSE_RISE:
            return None
        # Interpolation halves a bracket slowly where the deviance jumps, so every third is halved.
        share = (
            0.5
            if math.isinf(b) or len(self.nodes) % 3 == 0
            else self._share(inner, outer, threshold)
        )
        return self._placed(from_ + min(max(share, 0.1), 0.9) * (to - from_))

    def _share(self, inner: Node, outer: Node, threshold: float) -> float:
        """Share of the way from one node to the other at which the deviance crosses."""
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
    """Share of the way from one value to the next at which the length is 1.

    On the parabola through the best and both values: a minimum inside the bounds makes one without
    a linear term, a best on a bound one with; else on the straight line of lengths.

    Parameters
    ----------
    distances : two floats
        From the best.
    lengths : two floats
        Roots of the rise over the threshold, below and above 1.
    """
    (p, q), (a, b) = distances, lengths
    if a > 0.0:
        bend = (b * b / q - a * a / p) / (q - p)
        slope = a * a / p - bend * p
        root = slope * slope + 4.0 * bend
        if slope >= 0.0 and root > 0.0:
            return min(max((2.0 / (slope + math.sqrt(root)) - p) / (q - p), 0.0), 1.0)
    return (1.0 - a) / (b - a)
