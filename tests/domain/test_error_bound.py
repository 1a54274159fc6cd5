"""Bounds hold as often as they say, on made-up experiments whose errors are known."""

import math

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.domain import features as scales
from fixel.domain.error_bound import ConformalBound, constant_bound, min_experiments
from fixel.errors import InvalidInput

GROUPS = ("steel", "wood", "felt")
LARGER = np.array([1.0, 2.0, 0.5])


def made_up(n, seed):
    """Errors that grow with the first feature, by another factor in each group; 3 idle features."""
    rng = np.random.default_rng(seed)
    group = np.arange(n) % len(GROUPS)
    features = rng.uniform(0.0, 1.0, (n, 4))
    scale = LARGER[group] * np.exp(2.0 * features[:, 0])
    errors = scale * np.abs(rng.standard_t(4.0, n))
    return features, errors, [GROUPS[g] for g in group]


@pytest.mark.parametrize("model", ["forest", "neighbours", "constant"])
def test_bounds_hold_as_often_as_stated_overall_and_in_every_group(model):
    repeats, n_new = 4 if model == "forest" else 25, 300
    held = []
    for seed in range(repeats):
        features, errors, groups = made_up(150, seed)
        promise = ConformalBound.fit(features, errors, groups, seed=seed, model=model)
        new, off, where = made_up(n_new, 1000 + seed)
        held.append((off <= promise.bounds(new, where)).reshape(-1, len(GROUPS)))
    share = np.concatenate(held)
    # Each repeat scatters by its 150 judges, and by the 300 counted.
    sd = math.sqrt(0.09 / repeats * (1.0 / 150 + 1.0 / n_new))
    assert share.mean() == pytest.approx(0.905, abs=0.012 + 3.0 * sd)
    sd = math.sqrt(0.09 / repeats * (3.0 / 150 + 3.0 / n_new))
    # Groups borrow from each other; four times as large errors cost the worst some of its 90 %.
    assert (share.mean(axis=0) >= 0.85 - 3.0 * sd).all()


def test_without_groups_the_worst_of_them_is_let_down():
    """That is what group labels are for."""
    features, errors, _ = made_up(600, 0)
    new, off, groups = made_up(3000, 1)
    idle = np.zeros((600, 1)), np.zeros((3000, 1))
    bound = ConformalBound.fit(idle[0], errors, None).bounds(idle[1])
    worst = np.array([name == "wood" for name in groups])
    assert (off <= bound)[worst].mean() < 0.85
    assert features.shape == (600, 4)
    assert len(new) == 3000


def test_bounds_are_sharper_than_a_constant_where_features_tell():
    """Errors from e^0 to e^3 by the first feature, give or take a fifth: of bounds that know it
    the mean is 7.4, of the constant one 15."""
    rng = np.random.default_rng(0)
    features, new = rng.uniform(0.0, 1.0, (2, 450, 2))
    errors, off = (np.exp(3.0 * f[:, 0]) * rng.uniform(0.8, 1.2, len(f)) for f in (features, new))
    for model in ("forest", "neighbours"):
        bound = ConformalBound.fit(features, errors, model=model).bounds(new)
        assert bound.mean() < 0.65 * constant_bound(errors)
        assert (off <= bound).mean() == pytest.approx(0.9, abs=0.06)


def test_a_constant_model_without_groups_is_split_conformal():
    """Every experiment but its own fold sets the same constant, as nearly as medians do."""
    _, errors, _ = made_up(120, 5)
    idle = np.zeros((120, 1))
    promise = ConformalBound.fit(idle, errors, None, model="constant")
    assert promise.bounds(idle[:1])[0] == pytest.approx(constant_bound(errors), rel=0.1)


def test_constant_bound_is_the_next_larger_order_statistic():
    assert constant_bound(np.arange(1.0, 10.0), 0.9) == 9.0
    assert constant_bound(np.arange(1.0, 20.0), 0.9) == 18.0
    assert constant_bound(np.arange(1.0, 20.0), 0.5) == 10.0


def test_too_few_experiments_are_refused_with_the_number_needed():
    assert [min_experiments(level) for level in (0.5, 0.8, 0.9, 0.95, 0.99)] == [1, 4, 9, 19, 99]
    features, errors, _ = made_up(8, 0)
    refused(ConformalBound.fit, features, errors, match="8 held out, but fixel needs at least 9")
    refused(ConformalBound.fit, features, errors, level=0.95, match="19 for bounds with 95 %")
    refused(constant_bound, errors, match="at least 9")
    nine, off, _ = made_up(9, 0)
    promise = ConformalBound.fit(nine, off)
    assert promise.model == "constant"
    assert np.isfinite(promise.bounds(nine)).all()


@pytest.mark.parametrize(("change", "complaint"), [
    (lambda f, e: (f * np.nan, e), "not finite"),
    (lambda f, e: (f[:, 0], e), "table of finite numbers"),
    (lambda f, e: (f, -e), "0 or more"),
    (lambda f, e: (f, e * np.nan), "0 or more"),
    (lambda f, e: (f, e[:-1]), "fixel needs \\(30,\\)"),
])  # fmt: skip
def test_numbers_that_cannot_be_are_refused(change, complaint):
    features, errors, _ = made_up(30, 0)
    refused(ConformalBound.fit, *change(features, errors), match=complaint)


def test_levels_columns_and_labels_are_refused():
    features, errors, groups = made_up(30, 0)
    refused(ConformalBound.fit, features, errors, level=1.0, match="between 0 and 1")
    refused(ConformalBound.fit, features, errors, groups[:-1], match="29 labels")
    promise = ConformalBound.fit(features, errors, groups, model="constant")
    refused(promise.bounds, features[:, :3], groups, match="3 columns")
    with pytest.raises(InvalidInput, match=r"also\.features"):
        ConformalBound.fit(features, errors, also=(features[:, :2], errors))


def test_nothing_is_promised_far_from_all_evidence():
    features, errors, groups = made_up(90, 0)
    features[:, 3] = 7.0
    promise = ConformalBound.fit(features, errors, groups, model="neighbours")
    far = features[:3].copy()
    far[0, 0] += 10.0
    far[1, 3] = 8.0  # a setting that never varied
    bound = promise.bounds(far, groups[:3])
    assert np.isinf(bound).tolist() == [True, True, False]
    assert [not reason for reason in promise.reasons(far)] == [False, False, True]
    assert not any(promise.reasons(features))
    assert not np.isnan(promise.quantiles(far, groups[:3], (0.2, 0.99))).any()


def test_failed_simulations_count_as_errors_without_end():
    """One in five fails: no finite bound can hold with 90 %, one with 60 % can."""
    features, errors, _ = made_up(100, 0)
    errors[::5] = np.inf
    promise = ConformalBound.fit(features, errors, None, model="neighbours")
    high, low = promise.quantiles(features, None, (0.9, 0.6))
    assert np.isinf(high).all()
    assert np.isfinite(low).all()


def test_a_group_never_seen_has_no_bound_and_says_so():
    features, errors, groups = made_up(90, 0)
    promise = ConformalBound.fit(features, errors, groups, model="neighbours")
    asked = ["glass", "wood", None]
    assert np.isfinite(promise.bounds(features[:3], asked)).tolist() == [False, True, True]
    assert promise.reasons(features[:3], asked) == ("no experiment with glass", "", "")
    assert promise.unseen(asked) == ("no experiment with glass", "", "")
    one = ConformalBound.fit(features, errors, ["clay", *groups[1:]], model="neighbours")
    assert one.reasons(features[:2], ["clay", "wood"]) == ("only 1 experiment with clay", "")


def test_same_seed_same_bits_and_higher_levels_are_wider():
    features, errors, groups = made_up(90, 0)
    new, _, where = made_up(30, 1)
    first, again = (ConformalBound.fit(features, errors, groups, seed=4) for _ in range(2))
    assert np.array_equal(first.bounds(new, where), again.bounds(new, where))
    table = first.quantiles(new, where, (0.3, 0.5, 0.7, 0.9))
    assert (np.diff(table, axis=0) >= 0.0).all()


def test_what_shapes_the_model_judges_nothing():
    """Experience a hundred times too good cannot make a promise that does not hold."""
    features, errors, groups = made_up(300, 0)
    more, off, _ = made_up(300, 1)
    promise = ConformalBound.fit(
        features, errors, groups, model="neighbours", also=(more, 0.01 * off)
    )
    new, real, where = made_up(900, 2)
    assert (real <= promise.bounds(new, where)).mean() > 0.86
    assert promise.n == 300


def test_without_scikit_learn_neighbours_are_asked(monkeypatch):
    assert scales.default_model(29) == "constant"
    assert scales.default_model(30) in ("forest", "neighbours")
    monkeypatch.setitem(__import__("sys").modules, "sklearn", None)
    assert scales.default_model(30) == "neighbours"
    features, errors, groups = made_up(60, 0)
    assert ConformalBound.fit(features, errors, groups).model == "neighbours"


def test_no_configurations_have_no_bounds():
    features, errors, groups = made_up(60, 0)
    assert ConformalBound.fit(features, errors, groups).bounds(features[:0], []).shape == (0,)
