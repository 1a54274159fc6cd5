"""Statistics of weighted particles: means, covariances, quantiles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fixel.model import wrapped
from fixel.typing import FloatArray


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
