"""Measured paths of pushers, smoothed: against paths that are known."""

import numpy as np
import pytest

from fixel.filtering.head_path import smoothed

TIME = np.arange(300) / 30.0


def straight(noise, seed=0):
    path = np.column_stack((0.0135 * TIME, 0.0 * TIME))
    return path, path + noise * np.random.default_rng(seed).standard_normal(path.shape)


def test_noise_of_a_straight_path_goes():
    errors, rates = [], []
    for seed in range(20):
        path, measured = straight(7e-4, seed)
        found, rate = smoothed(TIME, measured)
        errors.append(found - path)
        rates.append(rate)
    # The best straight line would be wrong by the noise times root of 2 / n: 0.057 mm.
    assert np.sqrt(np.mean(np.square(errors))) < 1e-4
    assert np.min(rates) > 0.0


def test_an_exact_path_stays_exact_and_turns_are_followed():
    bent = np.column_stack((np.abs(TIME - 5.0), np.sin(TIME)))
    found, _ = smoothed(TIME, bent)
    np.testing.assert_allclose(found, bent, atol=2e-3)  # a corner of 2 m/s, a frame of 33 mm
    straightened, rate = smoothed(TIME, straight(0.0)[0])
    np.testing.assert_allclose(straightened, straight(0.0)[0], atol=1e-9)
    assert rate.max() < 1e-14


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_few_samples_stay_as_measured(n):
    _, measured = straight(7e-4)
    found, rate = smoothed(TIME[:n], measured[:n])
    np.testing.assert_array_equal(found, measured[:n])
    np.testing.assert_array_equal(rate, 0.0)
