"""Weights of particles: selection of particles, and means, covariances and quantiles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.model import wrapped
from fixel.typing import FloatArray

# Power of the likelihood for parameters, where all is well: below 1, because all particles share
# errors that no one of them can explain, the pusher's smoothed path above all. Chosen on 17
# simulated pushes.
# Source: Miller & Dunson (2019), Robust Bayesian inference via coarsening.
COARSE = 0.6
# Tried from the largest on; each is a tenth less than the one before.
POWERS = tuple(COARSE * 0.9**k for k in range(60))

Indices = NDArray[np.int64]


def normalised(log_weight: FloatArray) -> FloatArray:
    """(n,) weights that sum to 1, from logarithms of which one at least is finite."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def effective_sample_size(weight: FloatArray) -> float:
    """Return the number of equal weights that would estimate as well, 1 to n [-].

    Source: Kong, Liu & Wong (1994), Sequential imputations and Bayesian missing data problems.
    """
    return float(1.0 / np.sum(weight * weight))


def power(log_weight: FloatArray, score: FloatArray, reached: FloatArray, least: float) -> float:
    """Return the largest power of the likelihood that leaves `least` particles alive.

    At most `COARSE`. Where that would leave fewer, for instance when a fixel is touched at last,
    the likelihood counts with a lower power until moves have spread the particles again.

    Parameters
    ----------
    log_weight : (n,) float64
        Of the particles before.
    score : (n,) float64
        Logarithm of the likelihood of all that was measured.
    reached : (n,) float64
        How much of it is in the weights already.
    least : float
        Effective number of particles [-].

    Source: the idea of Neal (2001), Annealed importance sampling.
    """
    best, most = COARSE, 0.0
    for trial in POWERS:
        alive = effective_sample_size(normalised(log_weight + trial * score - reached))
        if alive >= least:
            return trial
        if alive > most:
            best, most = trial, alive
    return best


def systematic(weight: FloatArray, random: np.random.Generator) -> Indices:
    """Numbers of the particles that go on, (n,) int64, increasing.

    One uniform number places n equal strides over the weights; a particle of weight w goes on
    n w times on average, and at most one time more or less than that.

    Source: Kitagawa (1996), Monte Carlo filter and smoother.
    """
    n = len(weight)
    edges = np.cumsum(weight)
    place = (np.arange(n) + random.random()) * (edges[-1] / n)
    # The last stride may round to the end of all weights; a weight of zero must not be met there.
    last = int(np.flatnonzero(weight)[-1])
    return np.asarray(np.minimum(np.searchsorted(edges, place, side="right"), last))


def mean_pose(pose: FloatArray, weight: FloatArray, near: float) -> FloatArray:
    """Mean of poses, the angle on the circle.

    Parameters
    ----------
    pose : (n, 3) float64
        [m, m, rad].
    weight : (n,) float64
        With sum 1.
    near : float
        Which of the angles that differ by whole turns to give: within half a turn of this one
        [rad].

    Returns
    -------
    (3,) float64
    """
    x, y = np.sum(weight[:, None] * pose[:, :2], axis=0)
    turn = pose[:, 2] - near
    angle = math.atan2(float(np.sum(weight * np.sin(turn))), float(np.sum(weight * np.cos(turn))))
    return np.array([x, y, near + angle])


def pose_covariance(pose: FloatArray, weight: FloatArray, mean: FloatArray) -> FloatArray:
    """(3, 3) covariance about a mean [m, m, rad], angles the short way."""
    away = pose - mean
    away[:, 2] = wrapped(away[:, 2])
    return np.asarray(np.einsum("i,ij,ik->jk", weight, away, away))


def quantiles(values: FloatArray, weight: FloatArray, levels: ArrayLike) -> FloatArray:
    """(n_name, n_level) quantiles of weighted values (n, n_name), linear between their middles."""
    wanted = np.asarray(levels, np.float64)
    alive = weight > 0.0
    values, weight = values[alive], weight[alive]
    found = np.empty((values.shape[1], len(wanted)))
    for k, column in enumerate(values.T):
        order = np.argsort(column, kind="stable")
        share = np.cumsum(weight[order]) - 0.5 * weight[order]
        found[k] = np.interp(wanted, share, column[order])
    return found
