"""Predictive distributions of many unknowns: a fit's covariance, and model error learned from what
the fit leaves.

For dozens of unknowns and hundreds of short experiments sampling is out of reach and not needed:
near its best a fit by least squares is a normal distribution with the inverse of Gauss and Newton's
matrix as covariance. What a new experiment adds is larger: the model's own error, whose size the
residuals tell once each is corrected for the pull it had on the fit.

An outcome's error has the covariance

    S_i = J_i C J_i'  +  c^2 B_i B_i'  +  diag(a)^2

with C the covariance of the parameters, J_i what an outcome makes of them, B_i what it makes of an
error of the start (a push that tips over an edge makes much of it), and c, a fitted to the
residuals by the likelihood of Student's t, whose tails are as heavy as they need to be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray

# Steps of fitting model error and covariance to each other; the third changes nothing to speak of.
ROUNDS: Final = 3
# Leverage of an outcome on its own prediction, at most.
MAX_LEVERAGE: Final = 0.9
# Degrees of freedom of Student's t: from "a mean exists" to "normal".
FREEDOM: Final = (1.5, 50.0)


class Outcomes(NamedTuple):
    """Experiments and what their outcomes depend on; k outcomes of c numbers, n unknowns."""

    residual: FloatArray  # (k, c) measured less predicted
    columns: FloatArray  # (k, c, n) change of the prediction with each unknown
    start: FloatArray  # (k, c, m) change with each error of the start, in standard deviations


class Spreads(NamedTuple):
    """Covariances (k, c, c) that the parts of a prediction contribute."""

    parameters: FloatArray
    start: FloatArray
    model: FloatArray

    @property
    def total(self) -> FloatArray:
        """All together."""
        return self.parameters + self.start + self.model


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPredictive:
    """What the training outcomes say of others.

    Attributes
    ----------
    covariance : (n, n) float64
        Of the unknowns.
    error : (c,) float64
        Standard deviations of model error (of Student's t: its scale).
    start : float
        Factor on what an error of the start does.
    freedom : float
        Of Student's t.
    left : (k, c) float64
        Training residuals, each as if its outcome had not been fitted.
    distance : tuple of arrays
        Of these, for each block of numbers: in standard deviations.
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
        """Parts of the covariance of other outcomes; their residuals are not looked at."""
        return _spreads(outcomes, self.covariance, self.error, self.start)

    def levels_of(self, outcomes: Outcomes) -> FloatArray:
        """(k, n_block) levels of the smallest bounds that hold each outcome.

        The share of training outcomes that lay closer to their prediction, in standard deviations:
        empirical quantiles, so that tails need no shape.
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
    """Covariance of the unknowns and size of model error, from the outcomes a fit was made to.

    Parameters
    ----------
    training : Outcomes
    prior_sd : (n,) float64
        Standard deviations of what was known of the unknowns before; inf where nothing was.
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
    """(k, c, c) covariance of outcomes under known parameters."""
    away = start * outcomes.start
    return np.asarray(np.matmul(away, away.transpose(0, 2, 1)) + np.diag(error**2))


def effective_unknowns(outcomes: Outcomes, prior_sd: FloatArray) -> float:
    """How many unknowns a fit takes from the outcomes; those the prior holds count for little.

    With every outcome's error as large as its median residual.
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
    """(k,) how much outcomes count under Student's t: far ones little."""
    square = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(own), residual)
    return np.asarray((freedom + residual.shape[1]) / (freedom + square))


def _covariance(
    outcomes: Outcomes,
    own: FloatArray,
    prior_sd: FloatArray,
    residual: FloatArray,
    freedom: float,
) -> FloatArray:
    """(n, n) inverse of Gauss and Newton's matrix; far outcomes count less, as under Student's
    t."""
    weight = _weights(residual, own, freedom)
    weighted = np.matmul(np.linalg.inv(own), outcomes.columns) * weight[:, None, None]
    matrix = np.einsum("kcn,kcm->nm", outcomes.columns, weighted) + np.diag(prior_sd**-2.0)
    return np.asarray(np.linalg.pinv(matrix, hermitian=True))


def _corrected(
    outcomes: Outcomes, covariance: FloatArray, own: FloatArray, freedom: float, power: float
) -> FloatArray:
    """(k, c) residuals without the pull that their outcomes had on the fit.

    (1 - leverage) to the power of -1 gives what each would be, had it not been fitted; -1/2 gives
    the variance back that fitting took from the errors themselves. Far outcomes count little in
    the fit, and have little leverage.
    """
    columns = outcomes.columns
    pull = np.matmul(np.matmul(columns, covariance), columns.transpose(0, 2, 1))
    # In standard deviations of the errors leverage is symmetric.
    root = np.linalg.cholesky(own)
    white = np.linalg.inv(root)
    weight = _weights(outcomes.residual, own, freedom)[:, None, None]
    leverage = weight * np.matmul(np.matmul(white, pull), white.transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(leverage)
    # An outcome that decides an unknown alone has no residual to speak of.
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
    """Model error, factor on the start, and freedom that make the residuals likeliest."""
    from scipy.optimize import minimize

    unit = np.matmul(outcomes.start, outcomes.start.transpose(0, 2, 1))
    low, high = np.log(FREEDOM)

    def cost(z: FloatArray) -> float:
        total = np.exp(2.0 * z[-2]) * unit + np.diag(np.exp(2.0 * z[: len(error)]))
        own = float(np.exp(np.clip(z[-1], low, high)))
        return -_log_t(left, total, own)

    begin = np.log(np.concatenate((error, (max(start, 1e-3), freedom))))
    found = minimize(cost, begin, method="Nelder-Mead", options={"maxiter": 800, "xatol": 1e-3})
    z = found.x
    return np.exp(z[: len(error)]), float(np.exp(z[-2])), float(np.exp(np.clip(z[-1], low, high)))


def _log_t(residual: FloatArray, scale: FloatArray, freedom: float) -> float:
    """Log likelihood of residuals (k, c) under Student's t with scales (k, c, c)."""
    from scipy.special import gammaln

    k, c = residual.shape
    square = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(scale), residual)
    _, volume = np.linalg.slogdet(scale)
    constant = gammaln(0.5 * (freedom + c)) - gammaln(0.5 * freedom)
    constant -= 0.5 * c * np.log(freedom * np.pi)
    tails = 0.5 * (freedom + c) * np.log1p(square / freedom)
    return float(k * constant - 0.5 * volume.sum() - tails.sum())


def _distance(residual: FloatArray, total: FloatArray, block: tuple[int, ...]) -> FloatArray:
    """(k,) of some numbers of each outcome, in standard deviations."""
    own = list(block)
    spread = total[:, own][:, :, own]
    away = residual[:, own]
    return np.asarray(np.sqrt(np.einsum("ki,kij,kj->k", away, np.linalg.inv(spread), away)))
