"""Linear systems of the solvers against LAPACK."""

import numpy as np
import pytest

from fixel.kernels.jit import entry
from fixel.kernels.linear import solve_dense, solve_envelope

CLOSE = 1e-10  # relative; matrices of order 30 with a condition of about 1e3

dense = entry(lambda matrix, right, n: solve_dense(matrix, right, n))
envelope = entry(
    lambda matrix, reach, right, inner, n: solve_envelope(matrix, reach, right, inner, n)
)


@pytest.mark.parametrize("n", [1, 2, 5, 12])
def test_dense(n):
    rng = np.random.default_rng(n)
    matrix = rng.normal(size=(n, n))
    right = rng.normal(size=n)
    expected = np.linalg.solve(matrix, right)
    room = np.full((n + 2, n + 2), np.nan)
    room[:n, :n] = matrix
    x = np.append(right, [np.nan, np.nan])
    assert dense(room, x, n)
    assert x[:n] == pytest.approx(expected, rel=CLOSE)


def test_dense_needs_its_pivots():
    x = np.array([2.0, 3.0])
    assert dense(np.array([[0.0, 1.0], [1.0, 0.0]]), x, 2)
    assert x.tolist() == [3.0, 2.0]


def test_dense_tells_a_singular_matrix():
    assert not dense(np.zeros((2, 2)), np.ones(2), 2)


def test_nothing_to_solve():
    assert dense(np.zeros((0, 0)), np.zeros(0), 0)


@pytest.mark.parametrize("border", [0, 2])
def test_envelope_is_dense_within_its_reach(border):
    rng = np.random.default_rng(border)
    inner, n = 30, 30 + border
    # Columns couple up to `reach`, which never falls.
    reach = np.minimum(inner, np.maximum.accumulate(np.arange(inner) + rng.integers(1, 7, inner)))
    inside = np.zeros((n, n), bool)
    for k in range(inner):
        inside[k, k : reach[k]] = inside[k : reach[k], k] = True
    inside[inner:] = inside[:, inner:] = True
    matrix = np.where(inside, rng.normal(size=(n, n)), 0.0) + 10.0 * np.eye(n)
    right = rng.normal(size=n)
    expected = np.linalg.solve(matrix, right)
    # What lies beyond must be neither read nor written.
    room = np.where(inside, matrix, np.nan)
    x = right.copy()
    assert envelope(room, np.append(reach, np.full(border, n)), x, inner, n)
    assert x == pytest.approx(expected, rel=CLOSE, abs=CLOSE)
    assert np.isnan(room[~inside]).all()
