"""What physics leaves over, learned from examples: Gaussian processes on the residual.

Not physics: it knows nothing outside the pushes it has seen. Report it apart.
"""

from __future__ import annotations

import warnings
from typing import Any, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray

# Of interest to a process of a few hundred pushes; more cost time with the cube.
MAX_EXAMPLES: Final = 4000
MIN_EXAMPLES: Final = 8


# Residuals farther from the median, in robust standard deviations, are taken for so far: a push
# that went elsewhere altogether teaches nothing about the others. Of 3, 4, 6 and no bound, 4 was
# best on inner folds of training pushes.
FARTHEST: Final = 4.0
# Parts that are predicted from the rest, to see how far predictions are off.
PARTS: Final = 3


@final
class ResidualProcess:
    """One Gaussian process for each column of the residual, with a length for each feature.

    Parameters
    ----------
    features : (n, n_feature) array
        What is known of a push before it is made; any units.
    residuals : (n, n_output) array
        Measured less simulated.
    rounds : int
        Of the search for lengths and noise, at most.

    Notes
    -----
    The standard deviations are widened, or narrowed, until the 90 % intervals hold 90 % of the
    examples when a third of them is predicted from the rest: tails of pushes are heavier than
    normal, and many lengths fit few examples too well.

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
        """Residuals (n, n_output) to expect, and their standard deviations (n, n_output)."""
        mean, sd = self._processes.predict(features)
        return mean, sd * self._widening


class _Processes:
    """The processes as they come, on scaled columns."""

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
    """(n_output,) factors of the standard deviations that make 90 % intervals hold 90 %."""
    part = np.random.default_rng(0).permutation(len(features)) % PARTS
    z = np.zeros_like(residuals)
    for k in range(PARTS):
        own = part == k
        mean, sd = _Processes(features[~own], residuals[~own], rounds).predict(features[own])
        z[own] = np.abs(residuals[own] - mean) / sd
    return np.maximum(np.quantile(z, 0.9, axis=0) / NINETY, 1e-6)


# Of a normal distribution: 90 % lie within so many standard deviations.
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
