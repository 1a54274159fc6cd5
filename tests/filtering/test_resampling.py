"""Weights and resampling: unbiased, never dead, and kernels that keep mean and spread.

Statistical bounds are five standard deviations with fixed seeds.
"""

import numpy as np
import pytest

from fixel.filtering.prior import Prior
from fixel.filtering.resampling import (
    effective_sample_size,
    normalised,
    shrunk,
    systematic,
    tempered,
)

PRIOR = Prior(("mu_pusher", "tripod_radius"), np.array([0.1, 0.01]), np.array([1.0, 0.1]))


def weights(n, seed=0):
    drawn = np.random.default_rng(seed).random(n) ** 4
    return drawn / drawn.sum()


def test_each_particle_goes_on_as_often_as_its_weight_says():
    weight, random, rounds = weights(20), np.random.default_rng(1), 4000
    counts = np.zeros(20)
    for _ in range(rounds):
        own = np.bincount(systematic(weight, random), minlength=20)
        assert (np.abs(own - 20 * weight) < 1.0).all()
        counts += own
    # A count is one of two neighbouring whole numbers: its deviation is at most a half.
    np.testing.assert_allclose(counts / rounds, 20 * weight, atol=5 * 0.5 / np.sqrt(rounds))


def test_the_dead_stay_dead():
    weight = np.zeros(10)
    weight[[2, 7]] = 0.5
    for seed in range(50):
        assert set(systematic(weight, np.random.default_rng(seed))) == {2, 7}


def test_sample_size_counts_equal_weights():
    assert effective_sample_size(np.full(8, 0.125)) == pytest.approx(8.0)
    assert effective_sample_size(np.array([1.0, 0.0, 0.0])) == 1.0


def test_weights_far_below_rounding_are_weights():
    weight = normalised(np.array([-2000.0, -2000.0 - np.log(3.0), -np.inf]))

    np.testing.assert_allclose(weight, [0.75, 0.25, 0.0])


def test_one_observation_leaves_as_many_as_asked():
    log_prior = np.full(500, -np.log(500.0))
    likelihood = -0.5 * (np.linspace(0.0, 60.0, 500)) ** 2

    assert effective_sample_size(normalised(log_prior + likelihood)) < 20.0
    weight = tempered(log_prior, likelihood, 50.0)
    assert 50.0 <= effective_sample_size(weight) < 55.0
    assert (np.diff(weight) <= 0.0).all()
    mild = likelihood * 1e-3
    np.testing.assert_array_equal(tempered(log_prior, mild, 50.0), normalised(log_prior + mild))


def test_jitter_keeps_mean_and_spread_on_the_free_scale():
    random = np.random.default_rng(3)
    values, weight = PRIOR.drawn(20_000, random), weights(20_000, 4)
    chosen = systematic(weight, random)
    jittered = shrunk(PRIOR, values, weight, chosen, 0.95, random)

    before, after = PRIOR.free(values), PRIOR.free(jittered)
    mean = np.sum(weight[:, None] * before, axis=0)
    spread = np.sqrt(np.sum(weight[:, None] * (before - mean) ** 2, axis=0))
    np.testing.assert_allclose(after.mean(axis=0), mean, atol=0.05)
    np.testing.assert_allclose(after.std(axis=0), spread, rtol=0.05)
    assert len(np.unique(jittered[:, 0])) > len(np.unique(chosen))


def test_nothing_leaves_its_bounds():
    random = np.random.default_rng(5)
    values = PRIOR.low + (PRIOR.high - PRIOR.low) * random.integers(0, 2, (400, 2))
    chosen = np.arange(400)
    for _ in range(20):
        values = shrunk(PRIOR, values, np.full(400, 1 / 400), chosen, 0.9, random)
    assert (values >= PRIOR.low).all()
    assert (values <= PRIOR.high).all()


def test_free_scale_and_back():
    values = PRIOR.drawn(100, np.random.default_rng(6))

    np.testing.assert_allclose(PRIOR.bounded(PRIOR.free(values)), values, rtol=1e-9)
    pinned = Prior(("mu_fixel",), np.array([0.3]), np.array([0.3]))
    np.testing.assert_array_equal(pinned.bounded(pinned.free(np.full((5, 1), 0.3))), 0.3)
