"""Success probabilities against known truths, and against SciPy's own intervals."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binomtest

from fixel.errors import InvalidInput
from fixel.planning.success import SuccessProbability, lower_bound, rate_quantile

TRUTHS = {
    "alike": lambda rng, n: np.full(n, 0.9),
    "perfect": lambda rng, n: np.ones(n),
    "wide": lambda rng, n: rng.beta(9.0, 1.0, n),
    "narrow": lambda rng, n: rng.beta(50.0, 5.0, n),
    "U-shaped": lambda rng, n: rng.beta(0.5, 0.2, n),
    "0 or 1": lambda rng, n: (rng.random(n) < 0.8).astype(float),
    "two kinds": lambda rng, n: np.where(rng.random(n) < 0.9, 0.98, 0.5),
    "logistic": lambda rng, n: 1.0 / (1.0 + np.exp(-3.0 - 2.0 * rng.normal(size=n))),
}


def _margins(rng, rates, n_runs):
    return np.where(rng.random((len(rates), n_runs)) < rates[:, None], 0.5, -0.5)


@pytest.mark.parametrize(("n", "confidence", "bound"), [
    (29, 0.95, 0.90), (59, 0.95, 0.95), (299, 0.95, 0.99), (2995, 0.95, 0.999),
    (44, 0.99, 0.90), (90, 0.99, 0.95), (459, 0.99, 0.99), (4603, 0.99, 0.999),
])  # fmt: skip
def test_smallest_number_of_runs_without_failure_for_a_bound(n, confidence, bound):
    # Closed form: the bound of n successes in n runs is (1 - confidence)^(1/n).
    assert lower_bound(n, n, confidence) >= bound > lower_bound(n - 1, n - 1, confidence)
    assert lower_bound(n, n, confidence) == pytest.approx((1.0 - confidence) ** (1.0 / n))


@pytest.mark.parametrize(("good", "n"), [(0, 20), (13, 20), (20, 20), (990, 1000), (4096, 4096)])
def test_interval_is_that_of_scipy(good, n):
    found = SuccessProbability.of(np.where(np.arange(n) < good, 1.0, -1.0))
    both = binomtest(good, n).proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((both.low, both.high), abs=1e-12)
    assert found.worst is None
    assert found.best is None
    assert found.stated == good / n
    assert found.least == found.low


def test_one_sided_bound_is_that_of_scipy():
    one = binomtest(13, 20, alternative="greater").proportion_ci(0.95, method="exact")
    assert lower_bound(13, 20) == pytest.approx(one.low, abs=1e-12)
    assert lower_bound(4096, 4096) == pytest.approx(0.99927, abs=5e-6)


@pytest.mark.parametrize("name", TRUTHS)
def test_five_percent_of_new_draws_are_below_the_least_rate(name):
    rng = np.random.default_rng(1)
    many = np.sort(TRUTHS[name](rng, 100_000))
    below = []
    for _ in range(200):
        found = SuccessProbability.of(_margins(rng, TRUTHS[name](rng, 64), 64))
        below.append(np.searchsorted(many, found.least) / len(many))
    assert np.mean(below) <= 0.065
    if name in ("wide", "narrow", "logistic", "two kinds"):
        assert np.mean(below) >= 0.035


def test_rates_of_few_runs_have_no_more_spread_than_the_truth():
    rng = np.random.default_rng(2)
    observed, corrected = [], []
    for _ in range(100):
        successes = rng.binomial(16, np.full(64, 0.9))
        observed.append(np.quantile(successes / 16, 0.05))
        corrected.append(float(rate_quantile(successes, 16)))
    assert np.mean(observed) < 0.80
    assert np.mean(corrected) > 0.86


@pytest.mark.parametrize("name", ["alike", "wide", "narrow", "U-shaped", "logistic", "0 or 1"])
def test_interval_of_the_mean_over_worlds_covers(name):
    rng = np.random.default_rng(3)
    truth = float(np.mean(TRUTHS[name](rng, 400_000)))
    found = [SuccessProbability.of(_margins(rng, TRUTHS[name](rng, 64), 16)) for _ in range(400)]
    above = np.mean([own.low > truth for own in found])
    assert above <= 0.025 + 3.0 * np.sqrt(0.025 * 0.975 / 400)


def test_the_range_is_what_the_worst_and_best_draws_reach():
    margins = np.ones((64, 64))
    margins[:8, :32] = -0.2
    found = SuccessProbability.of(margins)
    assert found.stated == found.mean == 0.9375
    assert found.worst == found.least == pytest.approx(0.5, abs=0.01)
    assert found.best == pytest.approx(1.0, abs=0.01)
    assert found.calibrate_first
    assert "Calibrate first" in repr(found)
    assert found.margin == -0.2
    assert found.spare(0.9) == pytest.approx(0.0375)


def test_few_runs_of_equal_draws_are_no_reason_to_calibrate():
    rng = np.random.default_rng(6)
    found = [SuccessProbability.of(_margins(rng, np.full(64, 0.5), 8)) for _ in range(100)]
    assert sum(own.mean - own.worst > 0.05 for own in found) > 20
    assert sum(own.calibrate_first for own in found) <= 3


def test_independent_scenarios_decide_the_mean():
    worlds = np.where(np.arange(64)[:, None] < 8, -1.0, np.ones((64, 64)))
    found = SuccessProbability.of(worlds, independent=np.ones(299))
    assert found.mean == 1.0
    # Closed form of the two-sided interval of 299 successes in 299 scenarios.
    assert found.low == pytest.approx(0.025 ** (1.0 / 299.0))
    assert found.worst == 0.0
    assert found.stated == 1.0
    assert found.least == 0.0


@pytest.mark.parametrize("rate", [0.3, 0.94, 0.9995])
def test_the_mean_is_in_the_range_of_draws_that_are_all_alike(rate):
    """Two samples of one rate differ by chance; the range of equal draws is that rate alone."""
    rng, truth = np.random.default_rng(7), np.full(256, rate)
    for _ in range(100):
        met = rng.random(2400) < rate
        found = SuccessProbability.of(_margins(rng, truth, 16), independent=met - 0.5)
        assert found.worst <= found.mean <= found.best
        assert abs(rate - found.worst) < 0.1
        assert found.mean == 1.0 or "1.000 " not in found.sentence + " "


def test_a_larger_tolerance_never_lowers_anything():
    rng = np.random.default_rng(4)
    error = rng.gamma(2.0, 1.0, (64, 64)) * rng.uniform(0.5, 1.5, (64, 1))
    found = [SuccessProbability.of(1.0 - error / tolerance) for tolerance in (2.0, 3.0, 5.0)]
    for smaller, larger in pairwise(found):
        assert smaller.mean <= larger.mean
        assert smaller.low <= larger.low
        assert smaller.margin <= larger.margin


@pytest.mark.parametrize("bad", [[], [[]], [np.nan, 1.0], [[np.inf]], np.ones((2, 2, 2))])
def test_margins_that_are_no_answer_are_rejected(bad):
    with pytest.raises(InvalidInput, match="margins"):
        SuccessProbability.of(bad)


def test_the_sentence_never_rounds_a_failure_away():
    for failures, text in ((0, "1.0000 (0.9985 to 1.0000)"), (1, "0.9996 (0.9977 to 1.0000)")):
        found = SuccessProbability.of(np.where(np.arange(2400) < failures, -1.0, 1.0))
        assert found.sentence == f"success probability {text}"
        assert f" {text[:6]} " in repr(found).splitlines()[2]
