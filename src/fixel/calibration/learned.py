"""Gaussian processes on the residuals of simulations, learned from examples.

This is not physics and is not valid outside the training pushes. Report it separately.
"""

from __future__ import annotations

import warnings
from typing import Any, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray

# Largest number of examples: the computing time grows with its cube.
MAX_EXAMPLES: Final = 4000
MIN_EXAMPLES: Final = 8


# Residuals are clipped at this distance from the median, in robust standard deviations: a push with
# an entirely different end says nothing about the others. Of 3, 4, 6 and no limit, 4 was
# best on inner folds of training pushes.
FARTHEST: Final = 4.0
# Folds, each predicted from the others, to measure the errors of predictions.
PARTS: Final = 3


@final
class ResidualProcess:
    """Gaussian process for each column of the residual, with a length for each feature.

    Parameters
    ----------
    features : (n, n_feature) array
        Features that are known before a push, in any units.
    residuals : (n, n_output) array
        Measured minus simulated values.
    rounds : int
        Maximum number of iterations of the search for lengths and noise.

    Notes
    -----
    The standard deviations are scaled so that the 90 % intervals contain 90 % of the examples when
    each third of them is predicted from the rest: tails of pushes are heavier than normal, and many
    lengths overfit few examples.

    Source
    ------
    Rasmussen & Williams (2006), algorithm 2.1; kernel Matern 3/2.
    """

    def __init__(self, features: FloatArray, residuals: FloatArray, rounds: int = 60) -> None:
        _refuse_examples(features, residuals)
        _refuse_missing()
        self._processes = _Processes(features, residuals, rounds)
        self._widening = _widening(features, residuals, rounds)

    def predict(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return expected residuals (n, n_output) and their standard deviations (n, n_output)."""
        mean, sd = self._processes.predict(features)
        return mean, sd * self._widening


class _Processes:
    """Gaussian processes on scaled columns, without correction of the standard deviations."""

    def __init__(self, features: FloatArray, residuals: FloatArray, rounds: int) -> None:
        self._centre = features.mean(axis=0)
        spread = features.std(axis=0)
        self._used = spread > 1e-12
        self._spread = np.where(self._used, spread, 1.0)
        near = _without_tails(residuals)
        self._scale = np.maximum(near.std(axis=0), 1e-12)
        table = self._scaled(features)
        self._one_each = [_process(table, column, rounds) for column in (near / self._scale).T]

    def predict(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        table = self._scaled(features)
        found = [process.predict(table, return_std=True) for process in self._one_each]
        mean = np.column_stack([m for m, _ in found]) * self._scale
        return mean, np.column_stack([s for _, s in found]) * self._scale

    def _scaled(self, features: FloatArray) -> FloatArray:
        return np.asarray(((features - self._centre) / self._spread)[:, self._used])


def _without_tails(residuals: FloatArray) -> FloatArray:
    middle = np.median(residuals, axis=0)
    spread = 1.4826 * np.median(np.abs(residuals - middle), axis=0)
    return np.clip(residuals, middle - FARTHEST * spread, middle + FARTHEST * spread)


def _widening(features: FloatArray, residuals: FloatArray, rounds: int) -> FloatArray:
    """Return factors (n_output,) of the standard deviations for a 90 % coverage."""
    part = np.random.default_rng(0).permutation(len(features)) % PARTS
    z = np.zeros_like(residuals)
    for k in range(PARTS):
        own = part == k
        mean, sd = _Processes(features[~own], residuals[~own], rounds).predict(features[own])
        z[own] = np.abs(residuals[own] - mean) / sd
    return np.maximum(np.quantile(z, 0.9, axis=0) / NINETY, 1e-6)


# Standard deviations that contain 90 % of a normal distribution.
NINETY: Final = 1.6449


def _process(table: FloatArray, column: FloatArray, rounds: int) -> Any:
    from scipy.optimize import minimize
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    def climb(objective: Any, start: FloatArray, bounds: FloatArray) -> tuple[FloatArray, float]:
        options = {"maxiter": rounds}
        end = minimize(
            objective, start, method="L-BFGS-B", jac=True, bounds=bounds, options=options
        )
        return end.x, float(end.fun)

    n = table.shape[1]
    lengths = Matern(np.full(n, 2.0), (0.2, 100.0), nu=1.5)
    kernel = ConstantKernel(0.5, (1e-3, 10.0)) * lengths + WhiteKernel(0.5, (1e-2, 4.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound: no influence
        process = GaussianProcessRegressor(kernel, optimizer=climb, alpha=1e-8)
        return process.fit(table, column)


def _refuse_examples(features: FloatArray, residuals: FloatArray) -> None:
    n = len(features)
    good = np.isfinite(features).all() and np.isfinite(residuals).all()
    if len(residuals) != n or not good or not MIN_EXAMPLES <= n <= MAX_EXAMPLES:
        raise InvalidInput(
            "learned residual",
            found=f"{n} rows of features, {len(residuals)} of residuals",
            expected=f"finite ones, {MIN_EXAMPLES} to {MAX_EXAMPLES} of each",
        )


def _refuse_missing() -> None:
    try:
        import sklearn  # noqa: F401
    except ImportError:
        raise InvalidInput(
            "learned residual",
            found="no package scikit-learn",
            expected="it to be installed",
            hint='pip install "fixel[learn]"',
        ) from None
