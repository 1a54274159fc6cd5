"""Predictive distributions for many unknowns: covariance of a fit, and model error from its
residuals.

For dozens of unknowns and hundreds of short experiments, sampling is too expensive and not needed:
near the optimum of a least-squares fit, the posterior is normal and its covariance is the inverse
of the Gauss-Newton matrix. The model error of a new experiment is larger. Its size is estimated
from the residuals, each corrected for its influence on the fit.

The error of an outcome has the covariance

    S_i = J_i C J_i'  +  c^2 B_i B_i'  +  diag(a)^2

with C the covariance of the parameters, J_i and B_i the derivatives of the outcome with respect to
parameters and start errors, and c, a fitted to the residuals by the likelihood of Student's t,
whose freedom is fitted too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.uncertainty.run_to_run import log_student

# Alternating fits of model error and covariance; the third changes almost nothing.
ROUNDS: Final = 3
# Largest leverage of an outcome on its own prediction.
MAX_LEVERAGE: Final = 0.9
# Degrees of freedom of Student's t: from "a mean exists" to "normal".
FREEDOM: Final = (1.5, 50.0)


class Outcomes(NamedTuple):
    """Residuals and derivatives of k outcomes of c numbers, for n unknowns."""

    residual: FloatArray  # (k, c) measured minus predicted
    columns: FloatArray  # (k, c, n) change of the prediction with each unknown
    start: FloatArray  # (k, c, m) change with each error of the start, in standard deviations


class Spreads(NamedTuple):
    """Contributions (k, c, c) to the covariance of a prediction."""

    parameters: FloatArray
    start: FloatArray
    model: FloatArray

    @property
    def total(self) -> FloatArray:
        """Sum of the contributions."""
        return self.parameters + self.start + self.model


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPredictive:
    """Predictive distribution learned from training outcomes.

    Attributes
    ----------
    covariance : (n, n) float64
        Covariance of the unknowns.
    error : (c,) float64
        Standard deviations of model error: the scale of Student's t.
    start : float
        Factor on the effect of start errors.
    freedom : float
        Degrees of freedom of Student's t.
    left : (k, c) float64
        Training residuals, each as if its outcome had not been fitted.
    distance : tuple of arrays
        Lengths of these residuals for each block of numbers, in standard deviations.
    blocks : tuple of tuple of int
        Numbers of an outcome that are bounded together.
    """

    covariance: FloatArray
    error: FloatArray
    start: float
    freedom: float
    left: FloatArray
    distance: tuple[FloatArray, ...]
    blocks: tuple[tuple[int, ...], ...]

    def spreads(self, outcomes: Outcomes) -> Spreads:
        """Return the contributions to the covariance of other outcomes, without their residuals."""
        return _spreads(outcomes, self.covariance, self.error, self.start)

    def levels_of(self, outcomes: Outcomes) -> FloatArray:
        """Return levels (k, n_block) of the smallest bounds that contain each outcome.

        A level is the share of training outcomes closer to their prediction, in standard
        deviations: an empirical quantile, which assumes no shape of the tails.
        """
        total = self.spreads(outcomes).total
        found = []
        for block, known in zip(self.blocks, self.distance, strict=True):
            own = _distance(outcomes.residual, total, block)
            below = np.searchsorted(np.sort(known), own, side="left")
            found.append(below / (len(known) + 1.0))
        return np.column_stack(found)


def fit_predictive(
    training: Outcomes,
    prior_sd: FloatArray,
    blocks: tuple[tuple[int, ...], ...],
) -> LinearPredictive:
    """Estimate the covariance of unknowns and the size of model error from fitted outcomes.

    Parameters
    ----------
    training : Outcomes
    prior_sd : (n,) float64
        Standard deviations of the priors of the unknowns; inf without a prior.
    blocks : tuple of tuple of int
        Numbers of an outcome that are bounded together: `((0, 1), (2,))` for a position and an
        angle.
    """
    residual = training.residual
    k = len(residual)
    if k < 10:
        raise InvalidInput("outcomes", found=k, expected="ten or more to learn from")
    room = max(1.0 - effective_unknowns(training, prior_sd) / residual.size, 0.1)
    error = 1.4826 * np.median(np.abs(residual), axis=0) / np.sqrt(room) + 1e-12
    start, freedom = 0.1, 4.0
    for _ in range(ROUNDS):
        own = error_of(training, error, start)
        covariance = _covariance(training, own, prior_sd, residual, freedom)
        error, start, freedom = _fitted(
            training, _corrected(training, covariance, own, freedom, 0.5), error, start, freedom
        )
    left = _corrected(training, covariance, error_of(training, error, start), freedom, 1.0)
    total = _spreads(training, covariance, error, start).total
    distance = tuple(_distance(left, total, block) for block in blocks)
    return LinearPredictive(
        covariance=covariance,
        error=error,
        start=start,
        freedom=freedom,
        left=left,
        distance=distance,
        blocks=blocks,
    )


def error_of(outcomes: Outcomes, error: FloatArray, start: float) -> FloatArray:
    """Return the covariance (k, c, c) of outcomes for known parameters."""
    away = start * outcomes.start
    return np.asarray(np.matmul(away, away.transpose(0, 2, 1)) + np.diag(error**2))


def effective_unknowns(outcomes: Outcomes, prior_sd: FloatArray) -> float:
    """Return the effective number of fitted unknowns; those fixed by a prior count little.

    Errors of outcomes are assumed as large as the median residual.
    """
    scale = 1.4826 * np.median(np.abs(outcomes.residual), axis=0) + 1e-12
    table = (outcomes.columns / scale[:, None]).reshape(-1, outcomes.columns.shape[2])
    matrix = table.T @ table
    return float(np.trace(np.linalg.pinv(matrix + np.diag(prior_sd**-2.0)) @ matrix))


def _spreads(
    outcomes: Outcomes, covariance: FloatArray, error: FloatArray, start: float
) -> Spreads:
    columns, away = outcomes.columns, start * outcomes.start
    return Spreads(
        np.matmul(np.matmul(columns, covariance), columns.transpose(0, 2, 1)),
        np.matmul(away, away.transpose(0, 2, 1)),
        np.broadcast_to(np.diag(error**2), (len(columns), len(error), len(error))),
    )


def _weights(residual: FloatArray, own: FloatArray, freedom: float) -> FloatArray:
    """Return weights (k,) of outcomes under Student's t, small for outliers."""
    square = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(own), residual)
    return np.asarray((freedom + residual.shape[1]) / (freedom + square))


def _covariance(
    outcomes: Outcomes,
    own: FloatArray,
    prior_sd: FloatArray,
    residual: FloatArray,
    freedom: float,
) -> FloatArray:
    """Return the inverse (n, n) of the Gauss-Newton matrix; outliers count less, as under
    Student's t."""
    weight = _weights(residual, own, freedom)
    weighted = np.matmul(np.linalg.inv(own), outcomes.columns) * weight[:, None, None]
    matrix = np.einsum("kcn,kcm->nm", outcomes.columns, weighted) + np.diag(prior_sd**-2.0)
    return np.asarray(np.linalg.pinv(matrix, hermitian=True))


def _corrected(
    outcomes: Outcomes, covariance: FloatArray, own: FloatArray, freedom: float, power: float
) -> FloatArray:
    """Return residuals (k, c) corrected for the influence of their outcomes on the fit.

    A factor (1 - leverage)^-1 gives the residual as if the outcome had not been fitted; a power of
    -1/2 restores the variance that the fit removed from the errors. Outliers have little weight in
    the fit, and so little leverage.
    """
    columns = outcomes.columns
    pull = np.matmul(np.matmul(columns, covariance), columns.transpose(0, 2, 1))
    # In standard deviations of the errors leverage is symmetric.
    root = np.linalg.cholesky(own)
    white = np.linalg.inv(root)
    weight = _weights(outcomes.residual, own, freedom)[:, None, None]
    leverage = weight * np.matmul(np.matmul(white, pull), white.transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(leverage)
    # The residual of an outcome that determines an unknown alone is almost zero.
    keep = 1.0 - np.clip(values, 0.0, MAX_LEVERAGE)
    residual = np.matmul(white, outcomes.residual[:, :, None])
    turned = np.matmul(vectors.transpose(0, 2, 1), residual) / keep[:, :, None] ** power
    return np.asarray(np.matmul(root, np.matmul(vectors, turned))[:, :, 0])


def _fitted(
    outcomes: Outcomes,
    left: FloatArray,
    error: FloatArray,
    start: float,
    freedom: float,
) -> tuple[FloatArray, float, float]:
    """Return model error, start factor and freedom of the largest likelihood of the residuals."""
    from scipy.optimize import minimize

    unit = np.matmul(outcomes.start, outcomes.start.transpose(0, 2, 1))
    low, high = np.log(FREEDOM)

    def cost(z: FloatArray) -> float:
        total = np.exp(2.0 * z[-2]) * unit + np.diag(np.exp(2.0 * z[: len(error)]))
        own = float(np.exp(np.clip(z[-1], low, high)))
        return -log_student(left, total, own)

    begin = np.log(np.concatenate((error, (max(start, 1e-3), freedom))))
    found = minimize(cost, begin, method="Nelder-Mead", options={"maxiter": 800, "xatol": 1e-3})
    z = found.x
    return np.exp(z[: len(error)]), float(np.exp(z[-2])), float(np.exp(np.clip(z[-1], low, high)))


def _distance(residual: FloatArray, total: FloatArray, block: tuple[int, ...]) -> FloatArray:
    """Return lengths (k,) of the residuals of a block of numbers, in standard deviations."""
    own = list(block)
    spread = total[:, own][:, :, own]
    away = residual[:, own]
    return np.asarray(np.sqrt(np.einsum("ki,kij,kj->k", away, np.linalg.inv(spread), away)))
