"""Fit of the support parameters of a part to some of its pushes."""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.calibration.cost import NormalPrior
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.objective import ANGLE_SCALE
from fixel.calibration.optimiser import SearchBox
from fixel.model import wrapped
from fixel.parts.prior import NAMES, SupportPrior
from fixel.parts.pushes import PartPushes
from fixel.typing import BoolArray, FloatArray, IntArray

WIDTH: Final = 2e-3  # error at which the loss changes from square to linear [m]
LOST: Final = 10e-3  # of a push that cannot be simulated [m]
REACH: Final = 4.0  # of the search, in standard deviations of the prior
ITERATIONS: Final = 8


def fit_part(
    pushes: PartPushes, which: IntArray, prior: SupportPrior, noise: FloatArray
) -> SupportPrior:
    """Fit the parameters of a part to pushes, and return their distribution.

    Parameters
    ----------
    pushes : PartPushes
    which : (k,) int
        Pushes to fit.
    prior : SupportPrior
    noise : (k,) float64
        Size of the errors of each push [m].

    Returns
    -------
    SupportPrior
        Most probable values, and the covariance about them (Laplace's approximation, with the
        weights of the robust loss).
    """
    n = len(prior.mean)
    ones = np.ones(n)
    each = np.repeat(noise, 3)
    width = WIDTH / float(np.mean(noise))
    method = LeastSquares(
        loss="soft_l1",
        width=width,
        differences="one-sided",
        difference=0.15,
        largest_difference=0.6,
        trials=3,
        tolerance=1e-3,
        most_iterations=ITERATIONS,
    )

    def residuals(z: FloatArray) -> FloatArray:
        return _differences(pushes, which, prior.at(z)) / each

    box = SearchBox(-REACH * ones, REACH * ones, 0.0 * ones, ones)
    found = fit(method.start(box, prior=NormalPrior(mean=0.0 * ones, sd=ones)), residuals)
    values = prior.at(found.point[None])[0]
    columns = slopes(pushes, which, SupportPrior(values, prior.covariance)).reshape(-1, n)
    columns /= each[:, None]
    weight = 1.0 / np.sqrt(1.0 + (residuals(found.point[None])[0] / width) ** 2)
    precision = np.eye(n) + columns.T @ (columns * weight[:, None])
    factor = prior.factor
    return SupportPrior(values, factor @ np.linalg.inv(precision) @ factor.T)


def _differences(pushes: PartPushes, which: IntArray, values: FloatArray) -> FloatArray:
    """Return differences (m, 3 k) from the measured ends of pushes (k,) under values (m, n) [m]."""
    ends, good = simulated(pushes, which, values)
    away = ends - pushes.end[which]
    away[..., 2] = ANGLE_SCALE * wrapped(away[..., 2])
    away[~good] = LOST
    return np.asarray(away.reshape(len(values), -1))


def slopes(
    pushes: PartPushes, which: IntArray, prior: SupportPrior, step: float = 0.3
) -> FloatArray:
    """Return derivatives (k, 3, n) of the ends of pushes at the mean of a prior, along its standard
    normal coordinates [m]; angles times their length, zero where a simulation fails."""
    n, k = len(prior.mean), len(which)
    values = prior.at(np.concatenate((step * np.eye(n), -step * np.eye(n))))
    ends, good = simulated(pushes, which, values)
    away = ends[:n] - ends[n:]
    away[..., 2] = ANGLE_SCALE * wrapped(away[..., 2])
    away[~(good[:n] & good[n:])] = 0.0
    table = np.clip(away / (2.0 * step), -LOST, LOST)
    return np.asarray(np.moveaxis(table, 0, 2).reshape(k, 3, n))


def simulated(
    pushes: PartPushes, which: IntArray, values: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the ends (m, k, 3) of pushes `which` (k,) under values (m, n), and which converged."""
    m, k = len(values), len(which)
    given = {name: np.repeat(values[:, j], k) for j, name in enumerate(NAMES)}
    ends = pushes.simulate(np.tile(which, m), given)
    return ends.pose.reshape(m, k, 3), ends.good.reshape(m, k)
