"""Weights of particles, and which particles go on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fixel.filtering.prior import Prior
from fixel.model.fields import FloatArray

HALVINGS = 10  # of the interval in which a power is looked for

Indices = NDArray[np.int64]


def normalised(log_weight: FloatArray) -> FloatArray:
    """(n,) weights that sum to 1, from logarithms of which one at least is finite."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def effective_sample_size(weight: FloatArray) -> float:
    """How many equal weights would estimate as well, 1 to n [-].

    Source: Kong, Liu & Wong (1994), Sequential imputations and Bayesian missing data problems.
    """
    return float(1.0 / np.sum(weight * weight))


def tempered(log_prior: FloatArray, log_likelihood: FloatArray, least: float) -> FloatArray:
    """Weights after an observation that leaves `least` effective particles, if need be by halves.

    Where the likelihood would leave fewer, for instance at the end of an occlusion, it counts with
    the largest power below 1 that does not, to about one part in a thousand.

    Parameters
    ----------
    log_prior, log_likelihood : (n,) float64
        Minus infinity where a particle has no weight; one finite sum at least.
    least : float
        Effective sample size [-]; fewer are left only where the prior has no more.

    Source: the idea of Neal (2001), Annealed importance sampling, cut short after one power.
    """
    weight = normalised(log_prior + log_likelihood)
    if effective_sample_size(weight) >= least:
        return weight
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if effective_sample_size(normalised(log_prior + middle * log_likelihood)) >= least:
            low = middle
        else:
            high = middle
    return normalised(log_prior + low * log_likelihood)


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


def shrunk(
    prior: Prior,
    values: FloatArray,
    weight: FloatArray,
    chosen: Indices,
    discount: float,
    random: np.random.Generator,
) -> FloatArray:
    """Parameters of the particles that go on, jittered without widening their distribution.

    Each set moves towards the mean by as much as a normal kernel then spreads it, so mean and
    covariance stay. On the free scale of the prior, where bounds do not matter.

    Parameters
    ----------
    prior : Prior
    values : (n, n_name) float64
    weight : (n,) float64
    chosen : (n,) int64
    discount : float
        How much of what is known stays known in one resampling, 0.95 to 0.99.

    Source: Liu & West (2001), Combined parameter and state estimation, section 10.3.
    """
    if not prior.names:
        return values[chosen]
    keep = (3.0 * discount - 1.0) / (2.0 * discount)
    free = prior.free(values)
    mean = np.sum(weight[:, None] * free, axis=0)
    away = free - mean
    # Sums in place of matrix products: the same bits on any number of threads of the library.
    covariance = np.einsum("i,ij,ik->jk", weight, away, away)
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 1e-12))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(mean)))
    kernel = np.einsum("ij,kj->ik", random.standard_normal(values.shape), factor) * scale
    jittered = mean + keep * away[chosen] + np.sqrt(1.0 - keep * keep) * kernel
    # On the free scale the bounds are far out; a walk beyond them would only be slow to return.
    return prior.bounded(np.clip(jittered, -12.0, 12.0))
