"""Bounds for groups never seen, on made-up groups whose errors differ by a known random factor."""

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.domain.error_bound import CAUTIOUS, GUARANTEED, TYPICAL, ConformalBound
from fixel.errors import InvalidInput

LEVEL = 0.9
IDLE = np.zeros((20000, 1))


def group_errors(rng, n, spread, wrong=False):
    """Errors of the pushes of one new group; `wrong`: of two kinds, one of them rare and large."""
    factor = np.exp(spread * rng.standard_normal())
    errors = factor * np.abs(rng.standard_normal(n))
    return np.where(rng.random(n) < 0.1, 20.0 * errors, errors) if wrong else errors


def bounds(rng, sizes, spread, rule, wrong=False):
    own = [group_errors(rng, n, spread, wrong) for n in sizes]
    labels = [k for k, errors in enumerate(own) for _ in errors]
    errors = np.concatenate(own)
    fitted = ConformalBound.fit(IDLE[: len(errors)], errors, level=LEVEL, units=labels,
                                rule=rule, model="constant")  # fmt: skip
    return float(fitted.bounds(IDLE[:1])[0])


def coverage(sizes, spread, rule, repeats=300, wrong=False):
    """Share of the pushes of new groups within, and of the groups that have nine tenths within."""
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(repeats):
        bound = bounds(rng, sizes, spread, rule, wrong)
        shares.append(np.mean(group_errors(rng, 400, spread, wrong) <= bound))
    return float(np.mean(shares)), float(np.mean(np.array(shares) >= LEVEL - 0.02))


@pytest.mark.parametrize(
    "sizes", [(40,) * 7, (4, 9, 15, 30, 60, 120, 250)], ids=["equal", "unequal"]
)
@pytest.mark.parametrize("wrong", [False, True], ids=["normal", "two kinds"])
def test_a_typical_bound_holds_between_what_is_proved_and_the_level(sizes, wrong):
    n = len(sizes)
    share, _ = coverage(sizes, 0.7, TYPICAL, wrong=wrong)
    assert LEVEL * n / (n + 1) - 0.02 <= share <= LEVEL + 0.02


@pytest.mark.parametrize("wrong", [False, True], ids=["normal", "two kinds"])
def test_a_cautious_bound_holds_in_nearly_every_group(wrong):
    share, groups = coverage((60,) * 7, 0.7, CAUTIOUS, wrong=wrong)
    assert share >= 0.93
    assert groups >= 7 / 8 - 0.07


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.system) for n in (6, 12))])
def test_bounds_widen_for_the_number_of_groups_that_taught_them(n):
    """Over many sets of groups, each with a new group; the quantile of all pushes is too narrow."""
    rng = np.random.default_rng(n)
    within, naive, whole = [], [], []
    for _ in range(300):
        own = np.concatenate([group_errors(rng, 60, 0.7) for _ in range(n)])
        found = ConformalBound.fit(IDLE[: len(own)], own, level=LEVEL, rule=TYPICAL,
                                   units=np.repeat(np.arange(n), 60), model="constant")  # fmt: skip
        new = group_errors(rng, 400, 0.7)
        within.append(np.mean(new <= found.bounds(IDLE[:1])))
        whole.append(np.mean(new <= found.with_rule(CAUTIOUS).bounds(IDLE[:1])) >= LEVEL - 0.02)
        naive.append(np.mean(new <= np.quantile(own, LEVEL)))
    assert np.mean(within) == pytest.approx(LEVEL, abs=0.03)
    assert np.mean(whole) == pytest.approx(LEVEL, abs=0.05)
    if n == 3:
        assert np.mean(naive) < LEVEL - 0.03


def test_a_guarantee_holds_from_nine_groups_on_and_is_refused_before():
    share, _ = coverage((30,) * 10, 0.7, GUARANTEED)
    assert share >= LEVEL - 0.02
    with pytest.raises(InvalidInput, match=r"8 prove at most 88\.9 %.*typical"):
        bounds(np.random.default_rng(0), (30,) * 8, 0.7, GUARANTEED)
    with pytest.raises(InvalidInput, match="one unit does not show how much units differ"):
        bounds(np.random.default_rng(0), (30,), 0.7, TYPICAL)
    refused(bounds, np.random.default_rng(0), (30,) * 8, 0.7, "hopeful", match="rule")


def test_bounds_of_known_groups_fail_in_a_new_one():
    """The reason for it all: scores of the groups themselves, without leaving them out."""
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(200):
        own = [group_errors(rng, 60, 0.7) / 2.0 for _ in range(7)]  # calibrated to them
        errors = np.concatenate(own)
        blind = ConformalBound.fit(IDLE[: len(errors)], errors, model="constant")
        shares.append(np.mean(group_errors(rng, 200, 0.7) <= blind.bounds(IDLE[:1])[0]))
    assert np.mean(shares) < 0.75


def test_what_groups_prove_is_reported():
    rng = np.random.default_rng(0)
    errors, labels = np.abs(rng.standard_normal(70)), np.arange(70) % 7
    fitted = ConformalBound.fit(IDLE[:70], errors, units=labels.tolist(), rule=TYPICAL,
                                model="constant")  # fmt: skip
    assert fitted.n_unit == 7
    assert fitted.proved_level == pytest.approx(0.9 * 7 / 8)
    assert fitted.with_rule(CAUTIOUS).proved_level == pytest.approx(7 / 8)
    assert (fitted.bounds(IDLE[:1]) <= fitted.with_rule(CAUTIOUS).bounds(IDLE[:1])).all()
    refused(fitted.with_rule, GUARANTEED, match="prove at most")


def test_left_out_groups_bound_a_label_that_no_experiment_has():
    rng = np.random.default_rng(0)
    table, labels = rng.uniform(size=(120, 1)), (np.arange(120) % 10).tolist()
    errors = np.abs(rng.standard_normal(120))
    left = ConformalBound.fit(table, 3.0 * errors, units=labels, rule=TYPICAL)
    known = ConformalBound.fit(table, errors, labels)
    both = known.for_contacts(part=left)
    asked = [3, "new"]
    bound = both.bounds(table[:2], asked)
    assert bound[0] == known.bounds(table[:1], [3])[0]
    assert bound[1] == left.bounds(table[1:2])[0]
    assert both.reasons(table[:2], asked) == ("", "")
    assert both.unseen(asked) == ("", "no experiment with new")
    wider = both.with_rule(CAUTIOUS).bounds(table[:2], asked)
    assert wider[0] == bound[0]
    assert wider[1] > bound[1]
    refused(known.for_contacts, part=known, match="part: found bounds fitted without units")
