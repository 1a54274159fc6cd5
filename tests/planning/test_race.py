"""Races against uniform ones, on problems with known answers."""

import numpy as np
import pytest
from scipy.stats import binomtest
from tests.fixtures import refused
from tests.races import race

from fixel.planning.race import _sign_test, race_rounds

N = 1024


def problem(kind, n_plans, seed):
    """Margins of plans that differ in middle, sensitivity to shared unknowns, and noise."""
    rng = np.random.default_rng([seed, 7])
    middle = rng.normal(-0.5, 0.8, n_plans)
    sensitivity = rng.normal(0.0, 0.4, (n_plans, 6))
    if kind == "ties":
        middle = rng.choice([-0.5, 0.0, 0.5, 1.2], n_plans)
        sensitivity = 0.5 * sensitivity[rng.integers(0, 8, n_plans)]
    if kind == "correlated":
        sensitivity = 0.2 * sensitivity + rng.normal(0.0, 0.5, 6)
    if kind == "hard":
        middle -= 1.5
    unknowns = rng.normal(size=(6, N))
    noise = rng.standard_t(2, (n_plans, N)) if kind == "heavy" else rng.normal(size=(n_plans, N))
    spread = rng.uniform(0.2, 0.8, (n_plans, 1))
    return middle[:, None] + sensitivity @ unknowns + spread * noise


def lookup(margins):
    return lambda plans, scenarios: margins[np.ix_(plans, scenarios)]


@pytest.mark.parametrize("kind", ["light", "heavy", "ties", "correlated", "hard"])
def test_race_finds_the_plan_of_a_uniform_race_with_a_tenth_of_its_rollouts(kind):
    same, rollouts = [], []
    for seed in range(6):
        margins = problem(kind, 512, seed)
        rate = np.mean(margins >= 0.0, axis=1)
        found = race(lookup(margins), 512)
        same.append(rate[found.plans[0]] >= rate.max() - 0.002)
        rollouts.append(found.rounds[-1].rollouts)
    assert np.mean(same) == 1.0
    assert np.mean(rollouts) <= 512 * N / 10


def test_comparison_with_the_best_is_the_exact_sign_test():
    rng = np.random.default_rng(0)
    good = rng.random((5, 40)) < np.array([0.9, 0.85, 0.7, 0.6, 0.3])[:, None]
    found = _sign_test(good, 0)
    for k in range(1, 5):
        better, worse = int(np.sum(good[0] & ~good[k])), int(np.sum(good[k] & ~good[0]))
        expected = binomtest(better, better + worse, alternative="greater").pvalue
        assert found[k] == pytest.approx(expected, rel=1e-12)
    assert found[0] == 1.0


def test_race_is_repeated_from_its_answers():
    margins = problem("light", 200, 3)
    first = race(lookup(margins), 200)
    stored = []
    rounds = race_rounds(200)
    wanted = next(rounds)
    for _ in range(3):  # the process dies after three rounds
        stored.append(margins[np.ix_(*wanted)])
        wanted = rounds.send(stored[-1])
    again = race_rounds(200)
    wanted = next(again)
    answers = iter(stored)
    while True:
        try:
            wanted = again.send(next(answers, margins[np.ix_(*wanted)]))
        except StopIteration as end:
            found = end.value
            break
    np.testing.assert_array_equal(found.plans, first.plans)
    assert found.rounds == first.rounds


def test_race_compares_plans_by_their_worst_draws():
    worlds = np.arange(N) % 64
    bad = worlds < 6
    # Plan 0 always succeeds in most draws and never in a few; plan 1 mostly succeeds in all.
    rng = np.random.default_rng(1)
    steady = np.where(rng.random(N) < 0.85, 1.0, -1.0)
    margins = np.stack([np.where(bad, -1.0, 1.0), steady, np.full(N, -0.5)])
    assert race(lookup(margins), 3).plans[0] == 0
    found = race(lookup(margins), 3, worlds=worlds)
    assert found.plans[0] == 1
    rates = (margins[1] >= 0.0).reshape(16, 64).mean(axis=0)
    assert found.score[0] == pytest.approx(np.sort(rates)[:6].mean())


def test_race_reports_its_best_plan_after_every_round_and_respects_its_budget():
    margins = problem("light", 100, 5)
    reports = []
    found = race(lookup(margins), 100, budget=2000, report=reports.append)
    assert tuple(reports) == found.rounds
    assert reports[-1].rollouts <= 2000
    assert reports[-1].n_scenarios < N
    assert found.met.max() == reports[-1].n_scenarios
    assert reports[-1].rollouts == found.met.sum()


def test_race_of_one_plan():
    assert race(lambda plans, scenarios: np.ones((len(plans), len(scenarios))), 1).plans[0] == 0


@pytest.mark.parametrize(("options", "where"), [
    ({"sizes": (8, 8)}, "sizes"),
    ({"sizes": ()}, "sizes"),
    ({"finalists": 0}, "finalists"),
    ({"worlds": np.arange(N - 1)}, "worlds"),
    ({"confidence": 1.0}, "confidence"),
])  # fmt: skip
def test_impossible_races_are_rejected(options, where):
    refused(race, lookup(np.ones((4, N))), 4, match=where, **options)


def test_answers_of_another_shape_are_rejected():
    refused(race, lambda plans, scenarios: np.ones((4, 7)), 4, match=r"shape \(4, 8\)")
