"""Stated intervals and ranges of success hold as often as they say, for known distributions."""

import numpy as np
import pytest
from scipy.stats import beta

from fixel.planning.success import SuccessProbability

RATES = [(9.0, 1.0), (3.0, 1.5), (0.5, 0.5), (40.0, 20.0), (1.0, 12.0)]


def _stated(rng: np.random.Generator, a: float, b: float) -> SuccessProbability:
    """Success of a plan whose rates over the parameters are beta distributed."""
    draws = rng.random(2400) - rng.beta(a, b, 2400)
    worlds = rng.random((256, 16)) - rng.beta(a, b, (256, 1))
    return SuccessProbability.of(-worlds, independent=-draws)


@pytest.mark.parametrize(("a", "b"), RATES)
def test_interval_of_the_mean_holds_in_95_percent(a: float, b: float) -> None:
    rng = np.random.default_rng(0)
    truth = a / (a + b)
    found = [_stated(rng, a, b) for _ in range(600)]
    assert np.mean([own.low <= truth <= own.high for own in found]) == pytest.approx(0.95, abs=0.02)
    assert max(own.high - own.low for own in found) <= 0.041
    assert np.mean([own.stated for own in found]) == pytest.approx(truth, abs=0.002)


@pytest.mark.parametrize(("a", "b"), RATES)
def test_range_has_90_percent_of_the_rates(a: float, b: float) -> None:
    rng = np.random.default_rng(1)
    found = [_stated(rng, a, b) for _ in range(200)]
    ends = np.array([(own.worst, own.best) for own in found])
    np.testing.assert_allclose(ends.mean(axis=0), beta.ppf([0.05, 0.95], a, b), atol=0.02)
    assert ends.std(axis=0).max() < 0.05


def test_the_range_of_equal_rates_is_narrow_and_that_of_two_kinds_is_wide() -> None:
    rng = np.random.default_rng(2)
    equal = SuccessProbability.of(0.7 - rng.random((256, 16)), independent=0.7 - rng.random(2400))
    assert equal.best - equal.worst < 0.15  # the observed rates of 16 runs spread over 0.38
    assert not equal.calibrate_first
    kinds = np.where(np.arange(256) < 64, 0.2, 0.9)[:, None]
    two = SuccessProbability.of(kinds - rng.random((256, 16)))
    assert two.worst < 0.25
    assert two.best > 0.85
    assert two.calibrate_first
