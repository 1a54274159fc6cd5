"""Weights and resampling: unbiased, never dead, and kernels that keep mean and spread.

Statistical bounds are five standard deviations with fixed seeds.
"""

import numpy as np
import pytest

from fixel.filtering.particle_filter import UniformPrior
from fixel.filtering.particles import COARSE, effective_sample_size, normalised, power, systematic

PRIOR = UniformPrior(("mu_pusher", "tripod_radius"), np.array([0.1, 0.01]), np.array([1.0, 0.1]))


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


def test_the_likelihood_counts_as_far_as_particles_reach():
    nothing = np.zeros(500)
    score = -0.5 * (np.linspace(0.0, 60.0, 500)) ** 2

    assert effective_sample_size(normalised(COARSE * score)) < 20.0
    found = power(nothing, score, nothing, 50.0)
    assert 0.0 < found < COARSE
    assert 50.0 <= effective_sample_size(normalised(found * score)) < 60.0
    assert power(nothing, 1e-3 * score, nothing, 50.0) == COARSE
    # What the weights hold already is not counted twice.
    assert power(nothing, score, COARSE * score, 50.0) == COARSE


def test_free_scale_and_back():
    values = PRIOR.drawn(100, np.random.default_rng(6))

    np.testing.assert_allclose(PRIOR.bounded(PRIOR.free(values)), values, rtol=1e-9)
    pinned = UniformPrior(("mu_fixel",), np.array([0.3]), np.array([0.3]))
    np.testing.assert_array_equal(pinned.bounded(pinned.free(np.full((5, 1), 0.3))), 0.3)
