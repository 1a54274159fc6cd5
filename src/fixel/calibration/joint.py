"""Joint distribution of calibrated parameters: intervals of each, with their correlations.

Intervals are how far each parameter may be off, not which combinations the experiments exclude.
The correlations are those of least squares at the best fit: of the inverse of the information that
the experiments give about all parameters together.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from fixel.calibration.objective import ANGLE_SCALE, Comparer
from fixel.typing import BoolArray, FloatArray

STEP: Final = 0.1  # of the differences [scales]
INSTANTS: Final = 27  # poses of an experiment that are compared
# Independent observations that an experiment counts for: errors of a motion are much alike.
OBSERVATIONS: Final = 3.0
MM: Final = np.array([1e3, 1e3, 1e3 * ANGLE_SCALE])


def correlation_at(comparer: Comparer, point: FloatArray) -> FloatArray:
    """Return the correlations (p, p) of the free parameters about the best fit (p,).

    Parameters
    ----------
    comparer : Comparer
    point : (p,) float64

    Notes
    -----
    Directions without information have the variance of their bounds.
    """
    space = comparer.space
    low, high = space.low, space.high
    step = STEP * space.scale
    up, down = np.minimum(point + step, high), np.maximum(point - step, low)
    probes = np.vstack((point[None], *(np.vstack(pair) for pair in _moved(point, up, down))))
    n = len(comparer.targets)
    which = np.repeat(np.arange(n), len(probes))
    found, converged, _ = comparer.differences(which, np.tile(probes, (n, 1)))
    rows = np.unique(np.linspace(0, found.shape[1] - 1, INSTANTS).astype(np.int64))
    off = (found[:, rows] * MM).reshape(n, len(probes), -1)
    good: BoolArray = np.all(converged.reshape(n, len(probes)), axis=1)
    if not good.any():
        return np.eye(len(point))
    span = high - low
    slope = (off[good, 1::2] - off[good, 2::2]) / ((up - down) / span)[None, :, None]
    error = max(float(np.mean(off[good, 0] ** 2)), 1e-12)
    information = np.einsum("npi,nqi->pq", slope, slope) / slope.shape[2] * OBSERVATIONS / error
    covariance = np.linalg.inv(information + 12.0 * np.eye(len(point)))
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(sd, sd))


def draw_joint(
    centre: FloatArray,
    low: FloatArray,
    high: FloatArray,
    sd: FloatArray,
    correlation: FloatArray,
    n: int,
    seed: int,
) -> FloatArray:
    """Draw n points (n, p) of correlated normal distributions within bounds.

    Parameters
    ----------
    centre, low, high : (p,) float64
        Best values and bounds.
    sd : (p,) float64
        Standard deviations; infinite for a parameter that is even within its bounds.
    correlation : (p, p) float64
    n, seed : int
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


def _moved(
    point: FloatArray, up: FloatArray, down: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the points on both sides of `point` for each parameter."""
    pairs = []
    for k in range(len(point)):
        plus, minus = point.copy(), point.copy()
        plus[k], minus[k] = up[k], down[k]
        pairs.append((plus, minus))
    return pairs
