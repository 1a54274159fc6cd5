"""Weights of particles, and which particles go on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fixel.typing import FloatArray

# Power of the likelihood for parameters, where all is well: below 1, because all particles share
# errors that no one of them can explain, the pusher's smoothed path above all. Chosen on 17
# simulated pushes.
# Source: Miller & Dunson (2019), Robust Bayesian inference via coarsening.
COARSE = 0.6
# Tried from the largest on; each is a tenth less than the one before.
POWERS = tuple(COARSE * 0.9**k for k in range(60))

Indices = NDArray[np.int64]


def normalised(log_weight: FloatArray) -> FloatArray:
    """(n,) weights that sum to 1, from logarithms of which one at least is finite."""
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def effective_sample_size(weight: FloatArray) -> float:
    """Return the number of equal weights that would estimate as well, 1 to n [-].

    Source: Kong, Liu & Wong (1994), Sequential imputations and Bayesian missing data problems.
    """
    return float(1.0 / np.sum(weight * weight))


def power(log_weight: FloatArray, score: FloatArray, reached: FloatArray, least: float) -> float:
    """Return the largest power of the likelihood that leaves `least` particles alive.

    At most `COARSE`. Where that would leave fewer, for instance when a fixel is touched at last,
    the likelihood counts with a lower power until moves have spread the particles again.

    Parameters
    ----------
    log_weight : (n,) float64
        Of the particles before.
    score : (n,) float64
        Logarithm of the likelihood of all that was measured.
    reached : (n,) float64
        How much of it is in the weights already.
    least : float
        Effective number of particles [-].

    Source: the idea of Neal (2001), Annealed importance sampling.
    """
    best, most = COARSE, 0.0
    for trial in POWERS:
        alive = effective_sample_size(normalised(log_weight + trial * score - reached))
        if alive >= least:
            return trial
        if alive > most:
            best, most = trial, alive
    return best


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
