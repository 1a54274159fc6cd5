"""The best of many equal plans looks better than it is; fresh scenarios do not."""

import numpy as np
import pytest
from scipy.stats import binom
from tests.races import race

from fixel.planning.success import SuccessProbability

TRUTH = 0.8
# Expected success rate of the best of M plans that all succeed with 0.80, by n scenarios each.
BEST = {
    (100, 16): 0.9964, (100, 32): 0.9546, (100, 64): 0.915, (100, 256): 0.8603,
    (1000, 32): 0.9858, (1000, 64): 0.9431, (1000, 256): 0.8768, (10_000, 64): 0.964,
}  # fmt: skip


def _flat(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.where(rng.random(shape) < TRUTH, 0.5, -0.5)


@pytest.mark.parametrize(("n_plans", "n"), BEST)
def test_best_of_a_race_is_the_largest_of_equal_binomials(n_plans: int, n: int) -> None:
    below = binom.cdf(np.arange(n), n, TRUTH) ** n_plans  # of all plans
    expected = float(np.sum(1.0 - below)) / n
    assert expected == pytest.approx(BEST[n_plans, n], abs=1e-4)
    if n_plans > 1000 or n > 64:
        return
    rng = np.random.default_rng(0)
    found = [
        race(lambda plans, rows: _flat(rng, len(plans), len(rows)), n_plans, sizes=(n,))
        for _ in range(30)
    ]
    mean = np.mean([own.success[own.plans[0]] for own in found])
    assert mean == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("worlds", [False, True])
def test_interval_of_1000_searches_is_above_the_truth_in_at_most_3_5_percent(worlds: bool) -> None:
    rng = np.random.default_rng(1)
    above = 0
    for _ in range(1000):
        race(lambda plans, rows: _flat(rng, len(plans), len(rows)), 32, sizes=(8, 16, 32, 64))
        fresh = _flat(rng, 64, 16) if worlds else _flat(rng, 1024)
        above += SuccessProbability.of(fresh).low > TRUTH
    assert above <= 35
