"""Every kind of verdict on a function made for it."""

import numpy as np
import pytest
from tests.calibration.toys import (
    DECAY_BOX,
    THRESHOLD,
    box,
    calibrated,
    decay_residuals,
    rough,
    run_profiles,
    space_of,
)
from tests.fixtures import refused

from fixel.calibration.honest import Honest
from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.profile import ProfileLikelihood
from fixel.calibration.result import find_solutions
from fixel.calibration.verdict import WORDS, judge

UNIT = box([0, 0, 0], [1, 1, 1])


def verdicts(residuals, where=UNIT, **options):
    _, found = calibrated(residuals, where)
    return judge(space_of(where), found, **options)


def words(estimates):
    return [verdict.verdict for verdict in estimates]


def test_identified():
    estimates = verdicts(decay_residuals(1), DECAY_BOX)
    assert words(estimates) == ["identified"] * 3
    for verdict, truth in zip(estimates, (2.0, 1.3, 0.5), strict=True):
        assert verdict.low < truth < verdict.high
        assert verdict.low < verdict.value < verdict.high
        assert "% of the range" in verdict.reason


@pytest.mark.parametrize(("residuals", "expected"), [
    (lambda p: np.c_[p[:, 0] - 0.3, p[:, 1] - 0.6, 0 * p[:, 2]] / 0.05,
     ["identified", "identified", "not identified"]),  # flat
    (lambda p: np.c_[(p[:, 0] - 0.5) / 0.2, (p[:, 1:] - 0.5) / 0.1],
     ["not identified", "identified", "identified"]),  # wide
    (lambda p: np.c_[p[:, 0] + p[:, 1] - 1, p[:, 2] - 0.4] / 0.01,
     ["trades off with mu_fixel", "trades off with mu_pusher", "identified"]),
    # Correlated, but narrow.
    (lambda p: np.c_[p[:, 0] + p[:, 1] - 1, 0.1 * (p[:, 0] - p[:, 1]), p[:, 2] - 0.4] / 0.005,
     ["identified"] * 3),
])  # fmt: skip
def test_words_of_linear_residuals(residuals, expected):
    estimates = verdicts(residuals)
    assert words(estimates) == expected
    assert [verdict.word for verdict in estimates] == [
        word.partition(" with ")[0] for word in expected
    ]


def test_sloppy_product_trades_off():
    where = box([0.05, 0.05], [1, 1], [0.3, 0.3])
    product = lambda p: np.c_[p[:, 0] * p[:, 1] - 0.25, p[:, 0] * p[:, 1] - 0.26] / 0.01  # noqa: E731
    assert words(verdicts(product, where)) == [
        "trades off with mu_fixel",
        "trades off with mu_pusher",
    ]


def test_the_interval_of_what_is_flat_is_open_and_of_what_is_wide_is_not():
    flat = verdicts(lambda p: np.c_[p[:, 0] - 0.3, p[:, 1] - 0.6, 0 * p[:, 2]] / 0.05)[2]
    assert (flat.low, flat.high) == (None, None)
    assert verdicts(lambda p: np.c_[(p[:, 0] - 0.5) / 0.2, (p[:, 1:] - 0.5) / 0.1])[0].low


@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2])
def test_flat_but_rough_is_not_identified(size):
    estimates = verdicts(
        rough(lambda p: np.c_[p[:, 0] - 0.3, p[:, 1] - 0.6, 0 * p[:, 2]] / 0.05, size, jump=0.0)
    )
    assert words(estimates) == ["identified", "identified", "not identified"]


def test_sum_of_three_names_both_others():
    estimates = verdicts(lambda p: np.c_[p.sum(axis=1) - 1.5, 1e-3 * p[:, 0]] / 0.01)
    assert estimates[0].verdict in (
        "trades off with mu_fixel, mu_support",
        "trades off with mu_support, mu_fixel",
    )


def test_at_bound_says_whether_the_deviance_still_falls():
    estimates = verdicts(lambda p: np.c_[p[:, 0] - 1.3, p[:, 1], p[:, 2] - 0.4] / 0.1)
    assert words(estimates) == ["at bound", "at bound", "identified"]
    assert estimates[0].value == 1.0
    assert estimates[0].high is None
    assert estimates[0].low == pytest.approx(0.95, abs=0.02)
    assert "still decreases at the bound 1" in estimates[0].reason
    assert "is the bound 0" in estimates[1].reason


def test_interval_that_reaches_a_bound():
    estimates = verdicts(lambda p: np.c_[p[:, 0] - 0.1, p[:, 1] - 0.5, p[:, 2] - 0.4] / 0.1)
    assert estimates[0].verdict == "at most"
    assert "do not distinguish it from the bound 0" in estimates[0].reason
    assert estimates[0].low is None
    assert 0.0 < estimates[0].value < estimates[0].high


def test_a_value_inside_is_not_at_a_bound_and_a_value_on_it_is():
    """The best lies at 0.86 or beyond 1; the interval reaches 1 either way."""
    for best, word in ((0.86, "at least"), (1.1, "at bound")):
        estimates = verdicts(lambda p, best=best: np.c_[p[:, 0] - best, p[:, 1:] - 0.4] / 0.1)
        assert (estimates[0].verdict, estimates[0].high) == (word, None)
        inside = 0.01 < estimates[0].value < 0.99
        assert inside == (word == "at least")
    assert (
        f"at least {0.86 - 0.196:.2f}"
        in verdicts(lambda p: np.c_[p[:, 0] - 0.86, p[:, 1:] - 0.4] / 0.1)[0].reason
    )


def test_one_sided_and_wide_says_on_which_side():
    estimates = verdicts(lambda p: np.c_[np.exp(-12 * p[:, 0]) / 0.05, (p[:, 1:] - 0.5) / 0.1])
    assert estimates[0].verdict in ("not identified", "at bound")
    assert estimates[0].low is not None
    assert estimates[0].high is None


def test_two_minima_are_not_identified_once_both_are_known():
    def two(p):
        return np.c_[(p[:, 0] - 0.2) * (p[:, 0] - 0.8) / 0.01, (p[:, 1:] - 0.5) / 0.1]

    search = LeastSquares(starts=6).start(UNIT._replace(start=np.array([0.1, 0.5, 0.5])))
    best = fit(search, two)
    fits = search.fits
    found = run_profiles(ProfileLikelihood().start(UNIT, best.point, THRESHOLD), two)
    groups = find_solutions(
        [f.point for f in fits], [f.deviance for f in fits], UNIT.scale, THRESHOLD
    )
    assert len(groups) == 2
    estimates = judge(space_of(UNIT), found, solutions=[group.point for group in groups])
    assert words(estimates) == ["not identified", "identified", "identified"]
    assert "explains the data as well" in estimates[0].reason
    # The interval holds both.
    assert estimates[0].low < 0.21
    assert estimates[0].high > 0.79


def test_bumps_are_reported():
    estimates = verdicts(rough(decay_residuals(2), size=0.5, jump=0.0), DECAY_BOX)
    assert any("smaller steps" in verdict.reason for verdict in estimates)


def test_not_excited_comes_first():
    estimates = verdicts(lambda p: (p - 0.5) / 0.05, excited={"mu_fixel": False})
    assert words(estimates) == ["identified", "not excited", "identified"]
    assert estimates[1].low is None


def test_prior_alone_is_nothing_learnt():
    prior = NormalPrior(mean=np.array([0.5, 0.5]), sd=np.array([0.05, 0.05]))
    where = box([0, 0], [1, 1])
    residuals = lambda p: np.c_[p[:, 0] - 0.52, 0.0 * p[:, 1]] / 0.03  # noqa: E731
    _, found = calibrated(residuals, where, prior=prior)
    estimates = judge(space_of(where, prior=0.05), found)
    assert words(estimates) == ["identified", "not identified"]
    assert "prior" in estimates[1].reason


def test_frozen_unknowns_are_not_judged_and_one_is_enough():
    where = box([0], [1])
    _, found = calibrated(lambda p: (p - 0.4) / 0.05, where)
    space = space_of(UNIT).with_frozen({"mu_fixel": 0.2, "mu_support": 0.3})
    (only,) = judge(space, found)
    assert (only.label, only.verdict, only.unit) == ("mu_pusher", "identified", "-")


def test_nothing_evaluated_is_a_verdict_too():
    def failing(points):
        return np.full((len(points), 3), np.inf)

    estimates = verdicts(failing)
    assert words(estimates) == ["not identified"] * 3
    assert "could not be evaluated" in estimates[0].reason


def test_refusals():
    _, found = calibrated(lambda p: (p - 0.4) / 0.05, box([0], [1]))
    refused(judge, space_of(UNIT), found, match="profiles")
    refused(judge, space_of(box([0], [1])), found, level=95.0, match="level")


def _misfitting(sd, **options):
    """Verdicts on three unknowns that noise alone fixes to 0.02, with standard errors of misfit."""
    honest = Honest(np.array([0.35, 0.5, 0.4]), np.full(3, sd), np.full(3, 1e6), 9)
    estimates = verdicts(lambda p: (p - [0.3, 0.6, 0.4]) / 0.01, honest=honest, **options)
    return estimates, honest


def test_a_value_lies_in_the_interval_that_allows_for_misfit():
    estimates, honest = _misfitting(0.05)
    low, high = honest.ends(0.95)
    for k, verdict in enumerate(estimates):
        assert verdict.low == pytest.approx(low[k])
        assert verdict.high == pytest.approx(high[k])
        assert verdict.low < verdict.value == honest.value[k] < verdict.high
    assert words(estimates[:2]) == ["identified", "identified"]
    assert "misfit makes it 5 times wider" in estimates[0].reason


def test_what_stands_for_something_else_is_effective_where_the_model_misfits():
    estimates, _ = _misfitting(0.05)
    assert estimates[2].label == "mu_support"
    assert estimates[2].verdict == "effective"
    right = verdicts(lambda p: (p - [0.3, 0.6, 0.4]) / 0.01)
    assert right[2].verdict == "identified"


def test_precise_is_what_only_noise_makes_narrow():
    estimates, _ = _misfitting(0.15)
    assert words(estimates[:2]) == ["precise, but the model misfits"] * 2
    assert estimates[2].verdict == "effective"
    assert {verdict.word for verdict in estimates} <= set(WORDS)


def test_an_interval_that_reaches_a_bound_is_open_there():
    estimates, _ = _misfitting(0.22)
    assert estimates[0].low is None
    assert estimates[0].high == pytest.approx(0.35 + 1.96 * 0.22, abs=1e-3)


def _with_misfit(best, sd, value, honest_sd):
    """Verdicts where noise alone puts every unknown at best +- sd, and misfit at others."""
    honest = Honest(np.full(3, value), np.full(3, honest_sd), np.full(3, 1e6), 4)
    return verdicts(lambda p: (p - best) / sd, honest=honest)


def test_an_interval_that_misfit_makes_wide_does_not_identify():
    """The film of the demo: 0.023 to 0.385 under residuals of 460 times the noise."""
    pusher, fixel, support = _with_misfit(0.2, 1e-3, 0.204, 0.181 / 1.96)
    for verdict in (pusher, fixel):
        assert (verdict.low, verdict.high) == pytest.approx((0.023, 0.385), abs=1e-3)
        assert verdict.verdict == "precise, but the model misfits"
        assert verdict.reason.startswith("noise alone gives 0.198 to 0.202")
    assert support.verdict == "effective"
    # Half as wide it is identified, and so it is where the model does not misfit.
    assert words(_with_misfit(0.2, 1e-3, 0.204, 0.09 / 1.96)[:2]) == ["identified"] * 2
    assert words(verdicts(lambda p: (p - 0.204) / (0.181 / 1.96))) == ["identified"] * 3
    # What noise alone leaves wide is not precise.
    assert _with_misfit(0.4, 0.2, 0.4, 0.09)[0].verdict == "not identified"


def test_one_sided_values_of_what_stands_for_something_else_are_effective():
    """The demo's mu_support read "at least 0.648" where 0.276 was true."""
    pusher, _, support = _with_misfit(0.9, 0.1, 0.9, 0.06)
    assert (support.high, support.low) == (None, pytest.approx(0.9 - 1.96 * 0.06, abs=1e-3))
    assert support.verdict == "effective"
    assert pusher.verdict == "at least"  # which has a true value
    assert verdicts(lambda p: (p - 0.9) / 0.06)[2].verdict == "at least"
