"""Joint distribution of calibrated parameters: intervals of each, with their correlations.

Intervals are how far each parameter may be off, not which combinations the experiments exclude.
The correlations are those of least squares at the best fit: of the inverse of the information that
the experiments give about all parameters together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from fixel.calibration.honest import MM
from fixel.calibration.objective import Comparer
from fixel.errors import InvalidInput
from fixel.model.records import Estimate
from fixel.typing import BoolArray, FloatArray

STEP: Final = 0.1  # of the differences [scales]
INSTANTS: Final = 27  # poses of an experiment that are compared
# Independent observations that an experiment counts for: errors of a motion are much alike.
OBSERVATIONS: Final = 3.0


class LinearFit(NamedTuple):
    """Poses of experiments near the best fit, linear in the parameters, in parts of their ranges.

    Only experiments whose simulations near the fit all converged, n of them.
    """

    slope: FloatArray  # (n, p, i) of poses at some instants [mm]
    off: FloatArray  # (n, i) simulated less measured poses [mm]
    good: BoolArray  # (n_target,) which experiments these are
    span: FloatArray  # (p,) ranges of the parameters

    @property
    def information(self) -> FloatArray:
        """Information of all experiments and of the bounds about the parameters (p, p)."""
        slope = self.slope
        own = np.einsum("npi,nqi->pq", slope, slope) / slope.shape[2] * OBSERVATIONS / self._error
        return np.asarray(own + 12.0 * np.eye(len(self.span)))

    @property
    def correlation(self) -> FloatArray:
        """Correlations (p, p) of the parameters.

        Directions without information have the variance of their bounds.
        """
        if not self.good.any():
            return np.eye(len(self.span))
        covariance = np.linalg.inv(self.information)
        sd = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(sd, sd))

    @property
    def _error(self) -> float:
        return max(float(np.mean(self.off**2)), 1e-12)

    def left_out(self) -> FloatArray:
        """Return by how much the fit moves where one experiment is left out (n_target, p)."""
        found = np.zeros((len(self.good), len(self.span)))
        if not self.good.any():
            return found
        weight = OBSERVATIONS / self._error / self.slope.shape[2]
        each = np.einsum("npi,nqi->npq", self.slope, self.slope) * weight
        gradient = np.einsum("npi,ni->np", self.slope, self.off) * weight
        moved = np.linalg.solve(self.information - each, gradient[..., None])[..., 0]
        found[self.good] = moved * self.span
        return found


def quoted(
    estimates: Iterable[Estimate], labels: Sequence[str], level: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return values (p,) and standard deviations (p,) of estimates; infinite without an interval.

    An interval with one open end has the width of its other half.
    """
    known = {estimate.label: estimate for estimate in estimates}
    own = [known[label] for label in labels]
    value = np.array([e.value for e in own])
    ends = np.array([[np.nan if x is None else x for x in (e.low, e.high)] for e in own])
    half = np.abs(ends - value[:, None])
    closed = np.isfinite(half).any(axis=1)
    sd = np.full(len(own), math.inf)
    if closed.any():
        if level is None:
            found = "intervals stored without it"
            raise InvalidInput("level", found=found, expected="a level", hint="calibrate again")
        reach = NormalDist().inv_cdf(0.5 + 0.5 * level)
        sd[closed] = np.nanmean(half[closed], axis=1) / reach
    return value, sd


def linear_fit(comparer: Comparer, point: FloatArray) -> LinearFit:
    """Simulate the experiments near the best fit (p,), by central differences."""
    space = comparer.space
    low, high = space.low, space.high
    step = STEP * space.scale
    up, down = np.minimum(point + step, high), np.maximum(point - step, low)
    probes = np.tile(point, (1 + 2 * len(point), 1))
    np.fill_diagonal(probes[1::2], up)
    np.fill_diagonal(probes[2::2], down)
    n = len(comparer.targets)
    which = np.repeat(np.arange(n), len(probes))
    found, converged, _ = comparer.differences(which, np.tile(probes, (n, 1)))
    rows = np.unique(np.linspace(0, found.shape[1] - 1, INSTANTS).astype(np.int64))
    off = (found[:, rows] * MM).reshape(n, len(probes), -1)
    good: BoolArray = np.all(converged.reshape(n, len(probes)), axis=1)
    span = high - low
    slope = (off[good, 1::2] - off[good, 2::2]) / ((up - down) / span)[None, :, None]
    return LinearFit(slope, off[good, 0], good, span)


def draw_joint(
    centre: FloatArray,
    low: FloatArray,
    high: FloatArray,
    sd: FloatArray,
    correlation: FloatArray,
    n: int,
    seed: int,
) -> FloatArray:
    """Draw n points (n, p) of normal distributions with correlations (p, p), within bounds (p,).

    A parameter with an infinite standard deviation is even within its bounds.
    """
    size, axes = np.linalg.eigh(correlation)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    normal = np.random.default_rng(seed).standard_normal((n, len(centre))) @ root.T
    share = ndtr(normal)
    even = ~np.isfinite(sd)
    scale = np.where(even, 1.0, np.maximum(sd, 1e-300))
    left, right = ndtr((low - centre) / scale), ndtr((high - centre) / scale)
    inside = centre + scale * ndtri(left + (right - left) * share)
    found = np.where(even, low + (high - low) * share, inside)
    return np.asarray(np.clip(found, low, high))
