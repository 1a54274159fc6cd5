"""Causes of failures on problems whose answers are known."""

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.planning.causes import Explanation

N = 1024


def _effect(found, name):
    return next(own for own in found.effects if own.name == name)


@pytest.mark.parametrize("limit", [0.3, 0.5, 0.62])
def test_an_unknown_that_decides_everything_is_worth_the_whole_regret(limit):
    rng = np.random.default_rng(1)
    value, other = rng.random((2, N))
    margins = np.stack([limit - value, value - limit])
    found = Explanation.of(margins, {"other": other, "value": value})
    regret = 1.0 - max(np.mean(value <= limit), np.mean(value >= limit))
    assert found.regret == pytest.approx(regret)
    assert _effect(found, "value").worth == pytest.approx(regret, rel=0.1)
    assert _effect(found, "value").share > 0.85
    assert [own.name for own in found.effects] == ["value", "other"]


def test_an_unknown_without_influence_is_worth_nothing():
    # 32 plans whose success is chance alone. Choosing the best of each interval by the scenarios
    # that also judge it would gain 0.1 and more.
    worth, share = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        margins = np.where(rng.random((32, N)) < rng.uniform(0.6, 0.9, (32, 1)), 0.5, -0.5)
        found = Explanation.of(margins, {"value": rng.normal(size=N)})
        worth.append(found.effects[0].worth)
        share.append(found.effects[0].share)
    assert worth.count(0.0) >= 19
    assert share.count(0.0) >= 19
    assert max(worth) < 0.04


def test_draws_with_several_scenarios_are_not_divided():
    # 64 draws of five parameters with 16 runs each: one more, without influence, identifies
    # each draw, and would seem to explain failures that the other five cause.
    rng = np.random.default_rng(5)
    world = np.arange(N) % 64
    parameters = rng.normal(size=(64, 5))
    margins = 1.5 * (rng.normal(size=(16, 5)) @ parameters[world].T) + rng.normal(size=(16, N))
    without = rng.normal(size=64)[world]
    apart = Explanation.of(margins, {"none": without}, worlds=world).effects[0]
    mixed = Explanation.of(margins, {"none": without}).effects[0]
    assert apart.share == 0.0
    assert apart.worth == 0.0
    assert mixed.share > 0.2
    assert mixed.worth > 0.1


def test_unknowns_of_each_run_are_found_despite_different_draws():
    rng = np.random.default_rng(7)
    world = np.arange(N) % 64
    draw, run, none = rng.normal(size=64)[world], rng.normal(size=N), rng.normal(size=N)
    margins = (1.0 - draw - 0.7 * run)[None]
    found = Explanation.of(margins, {"draw": draw, "run": run, "none": none}, worlds=world)
    assert [own.name for own in found.effects] == ["draw", "run", "none"]
    assert found.effects[1].share > 0.1
    assert found.effects[2].share == 0.0


def test_value_of_a_noisy_influence():
    # Plan 0 succeeds with 0.85 + 0.1 on one side and 0.85 - 0.1 on the other, plan 1 reversed:
    # knowing the side gains 0.1.
    rng = np.random.default_rng(2)
    side = rng.normal(size=4096)
    chance = 0.85 + 0.1 * np.sign(side) * np.array([[1.0], [-1.0]])
    margins = np.where(rng.random((2, 4096)) < chance, 0.5, -0.5)
    effect = Explanation.of(margins, {"side": side}).effects[0]
    assert effect.worth == pytest.approx(0.1, abs=3.0 * effect.worth_error)
    assert 0.0 < effect.worth_error < 0.015
    # Variance of the rate, 0.1^2, as a share of that of the successes, 0.85 * 0.15.
    assert effect.share == pytest.approx(0.01 / (0.85 * 0.15), abs=0.02)


@pytest.mark.parametrize(("margin", "below", "above", "sentence"), [
    (lambda x: 0.006 - x, None, 0.006, "Fails when load is above "),
    (lambda x: x + 0.006, -0.006, None, "Fails when load is below -"),
    (lambda x: 0.008 - np.abs(x), -0.008, 0.008, "Fails when load is below -"),
])  # fmt: skip
def test_region_where_a_plan_fails(margin, below, above, sentence):
    load = np.random.default_rng(3).uniform(-0.01, 0.01, N)
    found = Explanation.of(margin(load)[None], {"load": load}, units={"load": "m"})
    assert found.sentences[0].startswith(sentence)
    region = found.effects[0].region
    for limit, expected in ((region.below, below), (region.above, above)):
        assert limit is None if expected is None else limit == pytest.approx(expected, abs=5e-4)
    assert region.failures > 0.9
    assert region.scenarios == pytest.approx(1.0 - found.success, abs=0.06)


def test_success_against_an_unknown_has_its_interval():
    rng = np.random.default_rng(4)
    load = rng.random(N)
    found = Explanation.of(np.where(rng.random(N) < load, 1.0, -1.0)[None], {"load": load})
    effect = found.effects[0]
    assert sum(own.n for own in effect.success) == N
    inside = [own.low <= x <= own.high for x, own in zip(effect.value, effect.success, strict=True)]
    assert sum(inside) >= 9


def test_value_of_a_wider_tolerance():
    error = np.linspace(0.0, 4.0, N)  # in units of the tolerance
    found = Explanation.of((1.0 - error)[None], {})
    for wide, success in found.tolerance.items():
        assert success == pytest.approx(wide / 4.0, abs=1e-3)
    assert "A tolerance 1.25 times as wide would raise success to 0.31." in found.sentences


def test_kinds_of_failures_are_counted():
    margins = np.where(np.arange(N) < 30, -1.0, 1.0)[None]
    kinds = ["slid off"] * 10 + ["jammed"] * 20 + ["jammed"] * (N - 30)
    found = Explanation.of(margins, {}, kinds=kinds)
    assert list(found.kinds.items()) == [("jammed", 20), ("slid off", 10)]
    assert "Failures: jammed 20, slid off 10." in repr(found)


def test_plan_without_failures_and_constant_unknowns():
    found = Explanation.of(np.ones((2, N)), {"load": np.full(N, 0.3)})
    assert found.effects[0].share == 0.0
    assert found.effects[0].region is None
    assert found.effects[0].success[0].n == N
    assert found.sentences == (f"The plan fails in none of {N} scenarios.",)


def test_explanation_is_saved_and_loaded(tmp_path):
    import fixel

    load = np.random.default_rng(6).normal(size=N)
    found = Explanation.of(np.stack([load + 1.0, 1.0 - load]), {"load": load})
    assert fixel.load(found.save(tmp_path / "explanation.fixel")) == found


@pytest.mark.parametrize(("options", "where"), [
    ({"margins": np.ones((1, 63))}, "63 scenarios"),
    ({"margins": np.full((1, N), np.nan)}, "margins"),
    ({"unknowns": {"load": np.ones(N - 1)}}, "load"),
    ({"unknowns": {"load": np.full(N, np.nan)}}, "load"),
    ({"worlds": np.arange(3)}, "worlds"),
    ({"plan": 1}, "plan"),
])  # fmt: skip
def test_impossible_input_is_rejected(options, where):
    given = {"margins": np.ones((1, N)), "unknowns": {}} | options
    with pytest.raises(InvalidInput, match=where):
        Explanation.of(**given)
