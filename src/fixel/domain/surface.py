"""Gaussian process of the logarithms of errors over the cells of several maps.

Theory: docs/theory/domain.md. Source: Rasmussen & Williams (2006), chapters 2, 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from fixel.typing import FloatArray, IntArray

DRAWS: Final = 32  # draws of the parameters of the surface
WIDE_MEAN: Final = 3.0  # standard deviation of the overall mean, in logarithms: a factor of 20
JITTER: Final = 1e-8
MAX_LEARNT: Final = 300  # cells that the parameters are fitted to

# Priors (mean and standard deviation) of the logarithms of: reach (share of an axis), variation
# shared by all maps, variation of each map, offset of a map, variation of a cell, scatter of a new
# member. They are wide except for the last: without repetitions, scatter cannot be distinguished
# from the variation of a cell, and is then as on testbeds like the simulated one, about 15 %.
_MIDDLE: Final = np.log([0.35, 0.35, 0.35, 0.35, 0.40, 0.15])
_WIDTH: Final = np.array([0.7, 0.9, 0.9, 0.9, 0.7, 0.4])
# Standard deviation of the logarithm of the scatter over the cells: in cells where a push may go
# either way, it is many times the usual.
UNEVEN: Final = 0.8
NODES: Final = 7
NAMES: Final = ("reach", "shared", "own", "offset", "cell", "scatter")


class CellObservations(NamedTuple):
    """Scores of the members of each cell, summarised."""

    group: IntArray  # (m,) map of each cell that has members
    cell: IntArray  # (m,) number of the cell
    members: IntArray  # (m,) number of members
    mean: FloatArray  # (m,) mean of their scores
    squares: FloatArray  # (m,) sum of squared deviations from the mean


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Posterior of the scores of every cell of every map, in several versions."""

    # (n_draw, n_group, n_cell) Mean and variance of the typical score of a cell.
    mean: FloatArray
    variance: FloatArray
    # (n_group, n_cell, n_cell) Covariance between cells of a map, in the likeliest version.
    covariance: FloatArray
    # (n_draw,) Usual standard deviation of a new member about the score of its cell.
    scatter: FloatArray
    factors: FloatArray  # (n_node,) factors of the scatter in a cell
    # (n_draw, n_node, n_group, n_cell) Probabilities of the factors, given the repetitions in the
    # cell.
    weights: FloatArray
    values: FloatArray  # (6,) likeliest values of `NAMES`

    def below(self, score: float, level: float) -> FloatArray:
        """Return the probability (n_group, n_cell) that a share `level` of new members is below."""
        from scipy.special import ndtr, ndtri

        z = float(ndtri(level))
        spread = self.scatter[:, None] * self.factors
        quantile = self.mean[:, None] + z * spread[:, :, None, None]
        chance = ndtr((score - quantile) / np.sqrt(self.variance)[:, None])
        return np.asarray((self.weights * chance).sum(axis=1).mean(axis=0))

    def of_other(self, places: FloatArray, seen: CellObservations) -> Surface:
        """Return the surface of other scores in the same cells, with its likeliest values."""
        values, n_group = np.log(self.values), self.mean.shape[1]
        mean, variance = _SurfaceModel(places, n_group, seen).posterior(values)
        scatter = self.values[-1:]
        return Surface(
            mean[None],
            np.maximum(variance[None], 1e-9),
            self.covariance,
            scatter,
            *_uneven(scatter, seen, n_group, len(places)),
            self.values,
        )

    @property
    def best(self) -> FloatArray:
        """Mean (n_group, n_cell) over the versions."""
        return np.asarray(self.mean.mean(axis=0))


def fit_surface(places: FloatArray, n_group: int, seen: CellObservations, seed: int = 0) -> Surface:
    """Fit the likeliest surface to the scores of members, and draw other versions.

    Places (n_cell, d) of the cells are shares of the axes; at least one cell has scores.
    """
    best, spread = _likeliest(_SurfaceModel(places, n_group, _some(seen, seed)))
    model = _SurfaceModel(places, n_group, seen)
    draws = _versions(best, spread, seed)
    mean, variance, scatter = [], [], []
    for values in draws:
        m, v = model.posterior(values)
        mean.append(m)
        variance.append(v)
        scatter.append(math.exp(values[5]))
    _, covariance = model.posterior(best, whole=True)
    return Surface(
        np.array(mean),
        np.maximum(np.array(variance), 1e-9),
        covariance,
        np.array(scatter),
        *_uneven(np.array(scatter), seen, n_group, len(places)),
        np.exp(best),
    )


def _uneven(
    scatter: FloatArray, seen: CellObservations, n_group: int, n_cell: int
) -> tuple[FloatArray, FloatArray]:
    """Return the factors of the scatter, and their probabilities in every cell (Bayes's rule)."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    factors = np.exp(UNEVEN * nodes)
    found = np.zeros((len(scatter), NODES, n_group, n_cell))
    found += np.log(weights / weights.sum())[:, None, None]
    spread = scatter[:, None, None] * factors[:, None]
    said = -(seen.members - 1) * np.log(spread) - 0.5 * seen.squares / spread**2
    found[:, :, seen.group, seen.cell] += said
    found = np.exp(found - found.max(axis=1, keepdims=True))
    return factors, np.asarray(found / found.sum(axis=1, keepdims=True))


def _some(seen: CellObservations, seed: int) -> CellObservations:
    """Return a random selection of at most `MAX_LEARNT` cells."""
    n = len(seen.mean)
    if n <= MAX_LEARNT:
        return seen
    own = np.sort(np.random.default_rng(seed).choice(n, MAX_LEARNT, replace=False))
    return CellObservations._make(np.asarray(column)[own] for column in seen)


class _SurfaceModel:
    """Gaussian process with its data; parameters are logarithms, in the order of `NAMES`."""

    def __init__(self, places: FloatArray, n_group: int, seen: CellObservations) -> None:
        self.distance = np.linalg.norm(places[:, None] - places[None], axis=-1)
        self.n_group = n_group
        self.seen = seen
        self.same = np.equal(seen.group[:, None], seen.group[None])
        self.centre = float(np.average(seen.mean, weights=seen.members))
        self.y = seen.mean - self.centre

    def kernels(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the covariances (n_cell, n_cell) shared by all maps, and of each map alone."""
        reach, shared, own, offset, cell, _ = np.exp(values)
        if self.n_group == 1:  # cannot be distinguished in one map
            offset = shared = 0.0
        r = math.sqrt(3.0) * self.distance / reach
        form = (1.0 + r) * np.exp(-r)  # Matern, 3/2
        common = WIDE_MEAN**2 + shared**2 * form
        return common, offset**2 + own**2 * form + cell**2 * np.eye(len(form))

    def _observed(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        common, single = self.kernels(values)
        at = np.ix_(self.seen.cell, self.seen.cell)
        covariance = common[at] + np.where(self.same, single[at], 0.0)
        noise = math.exp(2.0 * values[5]) / self.seen.members
        return common, single, covariance + np.diag(noise + JITTER)

    def loss(self, values: FloatArray) -> float:
        """Return the negative logarithm of the posterior of the parameters."""
        from scipy.linalg import cholesky, solve_triangular

        _, _, covariance = self._observed(values)
        try:
            factor = cholesky(covariance, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return 1e12
        z = solve_triangular(factor, self.y, lower=True, check_finite=False)
        likelihood = -0.5 * float(z @ z) - float(np.log(np.diag(factor)).sum())
        scatter = math.exp(2.0 * values[5])
        freedom = float((self.seen.members - 1).sum())
        likelihood -= freedom * values[5] + 0.5 * float(self.seen.squares.sum()) / scatter
        prior = 0.5 * float((((values - _MIDDLE) / _WIDTH) ** 2).sum())
        return float(prior - likelihood)

    def posterior(self, values: FloatArray, whole: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return means (n_group, n_cell), and their variances, or covariances if `whole`."""
        from scipy.linalg import cholesky, solve_triangular

        common, single, covariance = self._observed(values)
        factor = cholesky(covariance, lower=True, check_finite=False)
        n, maps = len(common), np.arange(self.n_group)
        own = np.equal(self.seen.group[None, :], maps[:, None])[:, None, :]
        cross = common[None, :, self.seen.cell] + single[None, :, self.seen.cell] * own
        both = np.column_stack((self.y, cross.reshape(-1, len(self.y)).T))
        solved = solve_triangular(factor, both, lower=True, check_finite=False)
        z, back = solved[:, 0], solved[:, 1:]
        mean = self.centre + (back.T @ z).reshape(self.n_group, n)
        if whole:
            parts = back.reshape(-1, self.n_group, n)
            return mean, common + single - np.einsum("mgi,mgj->gij", parts, parts)
        left = np.diag(common + single) - (back**2).sum(axis=0).reshape(self.n_group, n)
        return mean, left


def _likeliest(model: _SurfaceModel) -> tuple[FloatArray, FloatArray]:
    """Return the most probable parameters, and the covariance about them (Laplace)."""
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


def _spread(model: _SurfaceModel, best: FloatArray) -> FloatArray:
    """Return the inverse curvature of the loss, at most the widest prior in any direction."""
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
    """Draw parameters (n_draw, 6), the likeliest first."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    exponent = math.ceil(math.log2(DRAWS))
    rng = np.random.default_rng(seed)
    unit = qmc.Sobol(d=len(best), seed=rng).random_base2(exponent)[: DRAWS - 1]
    normal = ndtri(np.clip(unit, 1e-6, 1.0 - 1e-6))
    drawn = best + normal @ np.linalg.cholesky(spread + JITTER * np.eye(len(best))).T
    inside = np.clip(drawn, _MIDDLE - 3.5 * _WIDTH, _MIDDLE + 3.5 * _WIDTH)
    return np.concatenate((best[None], inside))
