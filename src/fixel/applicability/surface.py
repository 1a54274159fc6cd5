"""How logarithms of errors vary over the cells of several maps: a Gaussian process.

Theory: docs/theory/domain-of-applicability.md. Source: Rasmussen & Williams (2006), chapters 2, 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np

from fixel.kernels.arrays import FloatArray, IntArray

DRAWS: Final = 48  # of what is not known of the surface itself
WIDE_MEAN: Final = 3.0  # standard deviation of the overall mean, in logarithms: a factor of 20
JITTER: Final = 1e-8

# Logarithms of: reach (share of an axis), what all maps share, what each has of its own, offset of
# a map, what a cell has of its own, scatter of a new member. Middle and standard deviation of each,
# wide: a reach from a tenth of an axis to all of it, changes by a tenth to a factor of 3, scatter
# of 3 to 60 %.
_MIDDLE: Final = np.log([0.35, 0.35, 0.35, 0.35, 0.15, 0.15])
_WIDTH: Final = np.array([0.7, 0.9, 0.9, 0.9, 0.8, 0.8])
NAMES: Final = ("reach", "shared", "own", "offset", "cell", "scatter")


class Seen(NamedTuple):
    """What members say, cell by cell."""

    group: IntArray  # (m,) map of each cell that has members
    cell: IntArray  # (m,) its number
    count: IntArray  # (m,) members
    mean: FloatArray  # (m,) of their scores
    squares: FloatArray  # (m,) sum of squared distances from the mean


@final
@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Scores of every cell of every map as far as the members tell, in several versions.

    Attributes
    ----------
    mean, variance : (n_draw, n_group, n_cell) float64
        Of a cell's own typical score.
    covariance : (n_group, n_cell, n_cell) float64
        Between cells of a map, in the likeliest version.
    scatter : (n_draw,) float64
        Standard deviation of a new member about its cell's score.
    values : (6,) float64
        The likeliest of `NAMES`.
    """

    mean: FloatArray
    variance: FloatArray
    covariance: FloatArray
    scatter: FloatArray
    values: FloatArray

    def below(self, score: float, level: float) -> FloatArray:
        """(n_group, n_cell) probability that a share `level` of new members stays below."""
        from scipy.special import ndtr, ndtri

        z = float(ndtri(level))
        quantile = self.mean + z * self.scatter[:, None, None]
        return np.asarray(ndtr((score - quantile) / np.sqrt(self.variance)).mean(axis=0))

    @property
    def best(self) -> FloatArray:
        """(n_group, n_cell) mean over the versions."""
        return np.asarray(self.mean.mean(axis=0))


def fit_surface(places: FloatArray, n_group: int, seen: Seen, seed: int = 0) -> Surface:
    """Find the surface that members most likely lie on, and how far others are as likely.

    Parameters
    ----------
    places : (n_cell, d) float64
        Where the cells are, as shares of the axes.
    n_group : int
        Maps.
    seen : Seen
        One cell at least.
    seed : int
        Of the versions.
    """
    model = _Model(places, n_group, seen)
    best, spread = _likeliest(model)
    draws = _versions(best, spread, seed)
    mean, variance, scatter = [], [], []
    for values in draws:
        m, c = model.posterior(values)
        mean.append(m)
        variance.append(np.einsum("gcc->gc", c))
        scatter.append(math.exp(values[5]))
    _, covariance = model.posterior(best)
    return Surface(
        np.array(mean),
        np.maximum(np.array(variance), 1e-9),
        covariance,
        np.array(scatter),
        np.exp(best),
    )


class _Model:
    """Prior and data; parameters are logarithms, in the order of `NAMES`."""

    def __init__(self, places: FloatArray, n_group: int, seen: Seen) -> None:
        self.distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
        self.n_group = n_group
        self.seen = seen
        self.same = np.equal(seen.group[:, None], seen.group[None])
        self.centre = float(np.average(seen.mean, weights=seen.count))
        self.y = seen.mean - self.centre

    def kernels(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n_cell, n_cell) what all maps share, and what each has of its own."""
        reach, shared, own, offset, cell, _ = np.exp(values)
        if self.n_group == 1:  # one map cannot tell these apart
            offset = shared = 0.0
        r = math.sqrt(3.0) * self.distance / reach
        form = (1.0 + r) * np.exp(-r)  # Matern, 3/2
        common = WIDE_MEAN**2 + shared**2 * form
        return common, offset**2 + own**2 * form + cell**2 * np.eye(len(form))

    def _observed(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        common, single = self.kernels(values)
        at = np.ix_(self.seen.cell, self.seen.cell)
        covariance = common[at] + np.where(self.same, single[at], 0.0)
        noise = math.exp(2.0 * values[5]) / self.seen.count
        return common, single, covariance + np.diag(noise + JITTER)

    def loss(self, values: FloatArray) -> float:
        """Negative logarithm of the posterior of the parameters."""
        _, _, covariance = self._observed(values)
        try:
            factor = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            return 1e12
        z = np.linalg.solve(factor, self.y)
        likelihood = -0.5 * float(z @ z) - float(np.log(np.diag(factor)).sum())
        scatter = math.exp(2.0 * values[5])
        freedom = float((self.seen.count - 1).sum())
        likelihood -= freedom * values[5] + 0.5 * float(self.seen.squares.sum()) / scatter
        prior = 0.5 * float((((values - _MIDDLE) / _WIDTH) ** 2).sum())
        return prior - likelihood

    def posterior(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n_group, n_cell) means and (n_group, n_cell, n_cell) covariances."""
        common, single, covariance = self._observed(values)
        factor = np.linalg.cholesky(covariance)
        z = np.linalg.solve(factor, self.y)
        n = len(common)
        mean, spread = np.empty((self.n_group, n)), np.empty((self.n_group, n, n))
        for g in range(self.n_group):
            own = np.where(self.seen.group == g, 1.0, 0.0)
            cross = common[:, self.seen.cell] + single[:, self.seen.cell] * own
            back = np.linalg.solve(factor, cross.T)
            mean[g] = self.centre + back.T @ z
            spread[g] = common + single - back.T @ back
        return mean, spread


def _likeliest(model: _Model) -> tuple[FloatArray, FloatArray]:
    """The most probable parameters, and the covariance about them (Laplace)."""
    from scipy.optimize import minimize

    low, high = _MIDDLE - 3.0 * _WIDTH, _MIDDLE + 3.0 * _WIDTH
    found = minimize(
        model.loss,
        _MIDDLE,
        method="L-BFGS-B",
        bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 60},
    )
    best = np.asarray(found.x, np.float64)
    return best, _spread(model, best)


def _spread(model: _Model, best: FloatArray) -> FloatArray:
    """Inverse of the loss's curvature, at least that of the prior in no direction."""
    n, h = len(best), 0.1
    eye = h * np.eye(n)
    middle = model.loss(best)
    curvature = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            if i == j:
                bend = model.loss(best + eye[i]) - 2.0 * middle + model.loss(best - eye[i])
            else:
                bend = 0.25 * (
                    model.loss(best + eye[i] + eye[j])
                    - model.loss(best + eye[i] - eye[j])
                    - model.loss(best - eye[i] + eye[j])
                    + model.loss(best - eye[i] - eye[j])
                )
            curvature[i, j] = curvature[j, i] = bend / h**2
    size, directions = np.linalg.eigh(curvature)
    least = float((1.0 / _WIDTH**2).min())
    return np.asarray(directions @ np.diag(1.0 / np.maximum(size, least)) @ directions.T)


def _versions(best: FloatArray, spread: FloatArray, seed: int) -> FloatArray:
    """(n_draw, 6) parameters, the likeliest first."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    exponent = math.ceil(math.log2(DRAWS))
    dice = np.random.default_rng(seed)
    unit = qmc.Sobol(d=len(best), seed=dice).random_base2(exponent)[: DRAWS - 1]
    normal = ndtri(np.clip(unit, 1e-6, 1.0 - 1e-6))
    drawn = best + normal @ np.linalg.cholesky(spread + JITTER * np.eye(len(best))).T
    inside = np.clip(drawn, _MIDDLE - 3.5 * _WIDTH, _MIDDLE + 3.5 * _WIDTH)
    return np.concatenate((best[None], inside))
