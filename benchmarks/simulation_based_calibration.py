"""Simulation-based calibration: a test of the correctness of posteriors.

Truths are drawn from the prior and measurements simulated from them. The rank of each truth among
the samples of its posterior is computed. If simulator, likelihood and sampler are consistent, all
ranks are equally likely. Ranks at both ends show a posterior that is too narrow; ranks on one
side show a biased one.

Source: Talts, Betancourt, Simpson, Vehtari & Gelman (2018), arXiv:1804.06788.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.errors import InvalidInput, SolveFailed
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray, ProgressCallback
from fixel.uncertainty.error_terms import ModelError, draw_walks
from fixel.uncertainty.likelihood import LogLikelihood, ParameterPrior, expected_shares
from fixel.uncertainty.posterior import NestedSampling, Posterior

BINS: Final = 10
LEVEL: Final = 0.95


class Ranks(NamedTuple):
    """Ranks of truths in their posteriors."""

    labels: tuple[str, ...]
    truths: FloatArray  # (n_set, n)
    ranks: FloatArray  # (n_set, n) share of the samples below the truth, in [0, 1]

    @property
    def uniformity(self) -> FloatArray:
        """P-values (n,) of the test that ranks are uniform."""
        return np.array([uniformity(column) for column in self.ranks.T])

    @property
    def coverage(self) -> FloatArray:
        """Share (n,) of truths inside the central 95 % interval."""
        return np.asarray(np.mean(np.abs(self.ranks - 0.5) <= 0.5 * LEVEL, axis=0))


def uniformity(ranks: FloatArray, bins: int = BINS) -> float:
    """Return the p-value of the chi-square test that ranks (k,) in [0, 1] are uniform."""
    from scipy.stats import chisquare

    own = np.asarray(ranks, np.float64)
    if len(own) < 2 * bins:
        raise InvalidInput("ranks", found=len(own), expected=f"{2 * bins} or more")
    count, _ = np.histogram(own, bins, (0.0, 1.0))
    return float(chisquare(count).pvalue)


def rank_of(truth: FloatArray, samples: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return ranks (n,) of a truth (n,) among samples (k, n), ties broken at random."""
    below = np.sum(samples < truth, axis=0)
    equal = np.sum(samples == truth, axis=0)
    place = below + np.floor(rng.random(len(truth)) * (equal + 1.0))
    return np.asarray((place + rng.random(len(truth))) / (len(samples) + 1.0))


def calibrate_by_simulation(
    comparer: Comparer,
    noise: Noise,
    model_error: ModelError | None,
    data_sets: int,
    *,
    first: int = 0,
    seed: int = 0,
    sampling: NestedSampling | None = None,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> Ranks:
    """Compute the ranks of truths drawn from the prior.

    Parameters
    ----------
    comparer : Comparer
        Experiments that define the pushes and the times of the frames; their measured poses are
        not used.
    noise : Noise
        White noise (correlation 1).
    model_error : ModelError, optional
        Prior of model error, which is drawn for every data set.
    data_sets : int
    first : int
        Number of the first data set, so that several processes can share the work.
    seed : int
        Seed; a data set depends only on the seed and its number.
    sampling : NestedSampling, optional
    threads : int, optional
        Number of threads, all cores by default; does not affect the result.
    progress : callable, optional
        Called as `progress(done, of)`.
    """
    chosen = sampling or NestedSampling(samples=500)
    prior = ParameterPrior(comparer.space, model_error)
    truths, ranks = [], []
    for k in range(first, first + data_sets):
        rng = np.random.default_rng([seed, k])
        truth = prior.draw(1, rng)[0]
        posterior = _posterior(comparer, truth, prior, noise, chosen, rng, k, threads)
        truths.append(truth)
        ranks.append(rank_of(truth, posterior.points, rng))
        if progress is not None:
            progress(k + 1 - first, data_sets)
    return Ranks(prior.labels, np.array(truths), np.array(ranks))


def _posterior(
    comparer: Comparer,
    truth: FloatArray,
    prior: ParameterPrior,
    noise: Noise,
    sampling: NestedSampling,
    rng: np.random.Generator,
    number: int,
    threads: int | None,
) -> Posterior:
    members = range(len(comparer.targets))
    measured = [measured_path(comparer, m, truth, prior, noise, rng) for m in members]
    targets = [
        target._replace(pose=pose) for target, pose in zip(comparer.targets, measured, strict=True)
    ]
    ensemble = comparer.ensemble
    again = Comparer(
        targets,
        comparer.space,
        motion=ensemble.motion,
        stepper=ensemble.stepper,
        threads=threads,
    )
    likelihood = LogLikelihood(again, list(members), noise, prior.model_error)
    return sampling.sample(likelihood, prior, seed=number)


def measured_path(
    comparer: Comparer,
    member: int,
    truth: FloatArray,
    prior: ParameterPrior,
    noise: Noise,
    rng: np.random.Generator,
) -> FloatArray:
    """Return poses (n_sample, 3) of an experiment as measured under a truth (n,)."""
    target = comparer.targets[member]
    values = comparer.space.columns(truth[None, : len(comparer.space.labels)], target.conditions)
    outcome = comparer.ensemble.simulate(np.array([member]), values)
    if not outcome.converged[0]:
        raise SolveFailed(f"{target.key} under a draw of the prior: {outcome.reasons[0]}")
    path = outcome.pose[0, : len(target.pose)]
    if prior.model_error is not None:
        share = expected_shares(comparer, member, prior.model_error, path)
        path = path + draw_walks(share, truth[-1:], prior.model_error.sides, rng)[0]
    seen = path + rng.standard_normal(path.shape) * noise.standard_deviations
    seen[:, 2] = wrapped(seen[:, 2])
    return np.asarray(seen)
