"""Trials of a plan: the test of its stated probability by exact sums over all courses."""

import numpy as np
import pytest
from scipy.stats import beta, binom, norm
from tests.fixtures import refused

from fixel.planning.trials import PlanTrial, Trials, _fixed_test, evidence_against, prior_counts

NOW = "2026-11-22T21:00:00+00:00"


def refuted_within(stated, truth, n_trials):
    """Probability that the e-value reaches 20 within `n_trials` trials, by dynamic programming.

    Up to a number of trials the e-value depends on the number of failures alone; after them also
    on whether the critical number was reached, which refutes by itself.
    """
    fixed = _fixed_test(stated)
    critical, horizon = fixed.critical, fixed.horizon
    alive = {0: 1.0}
    refuted = 0.0
    for n in range(1, n_trials + 1):
        after = {}
        for failures, chance in alive.items():
            after[failures] = after.get(failures, 0.0) + chance * truth
            after[failures + 1] = after.get(failures + 1, 0.0) + chance * (1.0 - truth)
        alive = {}
        for failures, chance in after.items():
            # The latest failures possible: no failure of the first ones counts too early.
            met = [True] * (n - failures) + [False] * failures
            if n > horizon:
                early = min(failures, critical - 1)
                late = failures - early
                met = [True] * (horizon - early) + [False] * early
                met += [True] * (n - horizon - late) + [False] * late
            if evidence_against(stated, met)[-1] >= 20.0:
                refuted += chance
            else:
                alive[failures] = chance
    return refuted


@pytest.mark.parametrize("stated", [0.99, 0.95, 0.93, 0.9, 0.8, 0.5])
def test_right_probabilities_are_refuted_with_at_most_five_percent(stated):
    assert refuted_within(stated, stated, 120) <= 0.05
    assert refuted_within(stated, 0.5 * (1.0 + stated), 120) <= 0.05


@pytest.mark.parametrize("stated", [0.99, 0.95, 0.93, 0.9, 0.8])
def test_power_is_nearly_that_of_the_best_test(stated):
    # No test that refutes right probabilities with at most 5 % has more power within 40 trials
    # than the randomised one of Neyman and Pearson on all 40.
    truth = stated - 0.15
    critical = next(c for c in range(42) if binom.sf(c - 1, 40, 1.0 - stated) <= 0.05)
    left = 0.05 - binom.sf(critical - 1, 40, 1.0 - stated)
    best = binom.sf(critical - 1, 40, 1.0 - truth)
    best += (
        left * binom.pmf(critical - 1, 40, 1.0 - truth) / binom.pmf(critical - 1, 40, 1 - stated)
    )
    power = refuted_within(stated, truth, 40)
    assert best - 0.015 <= power <= best
    assert (power >= 0.9) == (stated >= 0.95)


def test_optional_stopping_does_not_refute_more():
    rng = np.random.default_rng(0)
    highest = [evidence_against(0.9, rng.random(400) < 0.9).max() for _ in range(600)]
    assert np.mean(np.array(highest) >= 20.0) <= 0.05 + 2.0 * np.sqrt(0.05 * 0.95 / 600)


def test_e_values_of_all_courses_have_mean_one():
    # The mean over all 2^10 courses of ten trials, weighted by their probabilities.
    courses = (np.arange(1024)[:, None] >> np.arange(10)) & 1 == 1
    chance = np.where(courses, 0.9, 0.1).prod(axis=1)
    values = np.array([evidence_against(0.9, course) for course in courses])
    np.testing.assert_allclose(chance @ values, 1.0, rtol=1e-12)


def test_three_failures_in_the_first_ten():
    # Such a course has a probability of 0.0115, but a test after every trial needs more evidence.
    assert binom.sf(2, 10, 0.05) == pytest.approx(0.0115, abs=5e-5)
    met = [True, True, False, True, True, False, True, True, True, False]
    assert 5.0 < evidence_against(0.95, met)[-1] < 20.0
    assert evidence_against(0.95, [*met, False, False])[-1] >= 20.0
    assert evidence_against(0.95, [False] * 3)[-1] >= 20.0


def test_prior_has_the_mean_and_the_spread_of_the_statement():
    a, b = prior_counts(0.8, 0.5)
    assert a / (a + b) == pytest.approx(0.8)
    assert beta.std(a, b) == pytest.approx(0.3 / norm.ppf(0.95), rel=1e-3)
    assert sum(prior_counts(0.9992, 0.9962)) == pytest.approx(20.0)
    assert sum(prior_counts(0.9, 0.9)) == pytest.approx(20.0)
    assert sum(prior_counts(0.5, 0.0)) == pytest.approx(2.0)


def test_trials_update_a_success_probability():
    trials = Trials(plan="a1", stated=0.9, mean=0.95)
    assert trials.observed is None
    assert trials.updated.value == pytest.approx(0.95)
    trials = trials.added(*[PlanTrial(NOW, True)] * 30, *[PlanTrial(NOW, False, "slid off")] * 2)
    a, b = prior_counts(0.95, 0.9)
    assert trials.updated.value == pytest.approx((a + 30) / (a + b + 32))
    assert trials.updated.low == pytest.approx(beta.ppf(0.05, a + 30, b + 2))
    assert not trials.refuted
    assert trials.failures == {"slid off": 2}
    assert "Failures: slid off: 2." in repr(trials)
    worse = trials.added(*[PlanTrial(NOW, False)] * 12)
    assert worse.refuted
    assert worse.updated.value == pytest.approx((1 + 30) / (2 + 44))
    assert worse.added(*[PlanTrial(NOW, True)] * 100).refuted  # for good


def test_trials_are_saved_and_loaded(tmp_path):
    import fixel

    trials = Trials(plan="a1", stated=0.9, mean=0.95).added(
        PlanTrial(NOW, True, end=(0.0, 1.0, 2.0))
    )
    assert fixel.load(trials.save(tmp_path / "trials.fixel")) == trials


@pytest.mark.parametrize(("values", "where"), [
    ({"time": "yesterday"}, "time"),
    ({"time": "2026-11-22T21:00:00"}, "time"),
    ({"met": 1}, "met"),
    ({"failure": "slid off"}, "failure"),
    ({"start": (0.0, 1.0)}, "start"),
    ({"end": (0.0, 1.0, float("nan"))}, "end"),
    ({"by": "a\nb"}, "by"),
])  # fmt: skip
def test_impossible_trials_are_rejected(values, where):
    refused(PlanTrial, match=where, **{"time": NOW, "met": True} | values)


@pytest.mark.parametrize("values", [{"stated": 1.0}, {"stated": -0.1}, {"mean": 0.8}, {"plan": ""}])
def test_impossible_probabilities_are_rejected(values):
    refused(Trials, **{"plan": "a1", "stated": 0.9, "mean": 0.95} | values)
