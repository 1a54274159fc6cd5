"""Gaussian process on what physics leaves over, among its examples; physics alone beyond them."""

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
# Standard deviations that contain 90 % of a normal distribution.
NINETY: Final = 1.6449
# Distance from the nearest example, in spacings, at which corrections shrink to 1 / e.
REACH: Final = 2.0
# Upper limit of that distance for contacts: with few examples, spacings are as large as the
# difference between sides. Normals that are 45 degrees apart differ by 0.77.
MAX_REACH: Final = 0.85
# Share of the examples that have another example within one spacing.
NEIGHBOURED: Final = 0.9


@final
class ResidualProcess:
    """Gaussian process for each column of the residual, which shrinks to zero away from examples.

    This is not physics and is not valid outside the training pushes. Report it separately.

    Parameters
    ----------
    features : (n, n_feature) array
        Features that are known before a push, in any units.
    residuals : (n, n_output) array
        Measured minus simulated values.
    places : (n, n_place) array
        Coordinates of the examples for their distances, all with the same weight: places in units
        of the size of the object, and directions as unit vectors.
    rounds : int
        Maximum number of iterations of the search for lengths and noise.

    Notes
    -----
    A prediction is the mean of the process times `exp(-(d / d0)^2)`, where `d` is the distance from
    the nearest example and `d0` is two spacings, at most 0.85. The spacing is the distance within
    which 90 % of the examples have another one. Neither the lengths of a process nor its own
    variance protect a side without examples, because nothing was observed between the sides.

    The standard deviation changes with the same weight from that of the process to that of the
    examples. The former is scaled so that the 90 % intervals contain 90 % of the examples when each
    third of them is predicted from the rest: tails of pushes are heavier than normal, and many
    lengths overfit few examples.

    Source
    ------
    Rasmussen & Williams (2006), algorithm 2.1; kernel Matern 3/2.
    """

    def __init__(
        self, features: FloatArray, residuals: FloatArray, places: FloatArray, rounds: int = 60
    ) -> None:
        _refuse_examples(features, residuals, places)
        _refuse_missing()
        self._places = places
        self._processes = _Processes(features, residuals, rounds)
        self._far = np.quantile(np.abs(residuals), 0.9, axis=0) / NINETY
        self._widening = _widening(features, residuals, places, self._far, rounds)

    def predict(self, features: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return expected residuals (n, n_output) and their standard deviations (n, n_output)."""
        mean, sd = self._processes.predict(features)
        weight = _weights(places, self._places)
        return weight * mean, weight * self._widening * sd + (1.0 - weight) * self._far


def _weights(places: FloatArray, known: FloatArray) -> FloatArray:
    """Weights (n, 1) of the process at places: 1 on an example, 0 far from all of them."""
    reach = min(REACH * _spacing(known), MAX_REACH)
    return np.asarray(np.exp(-np.square(_distances(places, known).min(axis=1) / reach))[:, None])


def _distances(places: FloatArray, known: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(places[:, None] - known[None], axis=2))


def _spacing(places: FloatArray) -> float:
    """Distance within which most examples have another one; never zero."""
    away = _distances(places, places)
    np.fill_diagonal(away, np.inf)
    return max(float(np.quantile(away.min(axis=1), NEIGHBOURED)), 1e-9)


class _Processes:
    """Gaussian processes on scaled columns."""

    def __init__(self, features: FloatArray, residuals: FloatArray, rounds: int) -> None:
        self._centre = features.mean(axis=0)
        spread = features.std(axis=0)
        self._used = spread > 1e-12
        self._spread = np.where(self._used, spread, 1.0)
        near = _clipped(residuals)
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


def _clipped(residuals: FloatArray) -> FloatArray:
    middle = np.median(residuals, axis=0)
    spread = 1.4826 * np.median(np.abs(residuals - middle), axis=0)
    return np.clip(residuals, middle - FARTHEST * spread, middle + FARTHEST * spread)


def _widening(
    features: FloatArray,
    residuals: FloatArray,
    places: FloatArray,
    far: FloatArray,
    rounds: int,
) -> FloatArray:
    """Return factors (n_output,) of the process's standard deviations for a 90 % coverage."""
    part = np.random.default_rng(0).permutation(len(features)) % PARTS
    factor = np.zeros_like(residuals)
    for k in range(PARTS):
        own = part == k
        mean, sd = _Processes(features[~own], residuals[~own], rounds).predict(features[own])
        weight = _weights(places[own], places[~own])
        needed = np.abs(residuals[own] - weight * mean) / NINETY - (1.0 - weight) * far
        factor[own] = needed / np.maximum(weight * sd, 1e-30)
    return np.maximum(np.quantile(factor, 0.9, axis=0), 1e-6)


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


def _refuse_examples(features: FloatArray, residuals: FloatArray, places: FloatArray) -> None:
    n = len(features)
    good = all(np.isfinite(table).all() for table in (features, residuals, places))
    even = len(residuals) == len(places) == n
    if not even or not good or not MIN_EXAMPLES <= n <= MAX_EXAMPLES:
        raise InvalidInput(
            "learned residual",
            found=f"{n} rows of features, {len(residuals)} of residuals, {len(places)} of places",
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
