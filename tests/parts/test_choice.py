"""Choice of pushes, compared with conditional covariances of samples and with brute force."""

from itertools import permutations

import numpy as np
import pytest

from fixel.parts.fit import MISFIT_SHARE, NOISE, choose_pushes

MM = 1e-3


def _slopes(rng, n, parameters=4):
    return rng.normal(size=(n, 3, parameters)) * 2 * MM


def _variance_after(candidates, intended, which):
    """Mean variance of the intended ends by one regression on all chosen ends at once."""
    precision = np.eye(candidates.shape[2])
    for seen in candidates[list(which)]:
        precision += seen.T @ seen / (NOISE**2 + MISFIT_SHARE**2 * np.sum(seen**2))
    own = intended.reshape(-1, candidates.shape[2])
    return np.sum(own * np.linalg.solve(precision, own.T).T) / len(intended)


def test_variances_are_those_of_one_regression_on_all_chosen_pushes():
    rng = np.random.default_rng(1)
    candidates, intended = _slopes(rng, 9), _slopes(rng, 5)
    chosen, variance = choose_pushes(candidates, intended, 6)
    expected = [_variance_after(candidates, intended, chosen[:k]) for k in range(7)]
    np.testing.assert_allclose(variance, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_the_first_push_is_the_best_of_all_and_three_are_nearly_the_best_three(seed):
    rng = np.random.default_rng(seed)
    candidates, intended = _slopes(rng, 7), _slopes(rng, 4)
    chosen, variance = choose_pushes(candidates, intended, 3)
    alone = [_variance_after(candidates, intended, [k]) for k in range(7)]
    assert chosen[0] == np.argmin(alone)
    best = min(_variance_after(candidates, intended, own) for own in permutations(range(7), 3))
    first = variance[0]
    assert first - variance[3] >= 0.9 * (first - best)


@pytest.mark.parametrize("seed", range(5))
def test_variance_never_rises_and_no_push_is_chosen_twice(seed):
    rng = np.random.default_rng(seed)
    candidates = _slopes(rng, 12)
    candidates[3:6] = 0.0  # pushes that tell nothing
    chosen, variance = choose_pushes(candidates, _slopes(rng, 6), 12)
    assert (np.diff(variance) <= 1e-15).all()
    assert sorted(chosen.tolist()) == list(range(12))


def test_the_order_of_the_candidates_does_not_matter():
    rng = np.random.default_rng(3)
    candidates, intended = _slopes(rng, 20), _slopes(rng, 20)
    order = rng.permutation(20)
    one, before = choose_pushes(candidates, intended, 8)
    other, after = choose_pushes(candidates[order], intended, 8)
    assert order[other].tolist() == one.tolist()
    np.testing.assert_allclose(before, after, rtol=1e-12)


def test_more_pushes_than_candidates_are_all_of_them():
    table = _slopes(np.random.default_rng(4), 3)
    assert len(choose_pushes(table, table, 10)[0]) == 3
    assert choose_pushes(table, table[:0], 2)[1].tolist() == [0.0, 0.0, 0.0]
