"""Small complementarity problems with known answers.

Source: Murty's exponential example; Cottle, Pang & Stone (1992), as collected in the tests of
Siconos (`lcp_exp_murty`, `lcp_CPS_1` to `lcp_CPS_5`). Retyped; where there is no printed number,
the answer is by enumeration.
Tolerances are rounding.
"""

import numpy as np
import pytest
from tests.kernels.entries import solve_lcp
from tests.kernels.test_lemke import solutions

from fixel.kernels.lemke import RAY, SOLVED

CPS_3 = np.array([[0, 0, 10, 20], [0, 0, 30, 15], [10, 20, 0, 0], [30, 15, 0, 0]], float)


@pytest.mark.parametrize("n", [1, 6, 16])
def test_murty_exponential_example(n):
    matrix = np.eye(n) + np.triu(np.full((n, n), 2.0), 1)
    z, code = solve_lcp(matrix, -np.ones(n), 1000)
    assert code == SOLVED
    assert z == pytest.approx(np.eye(n)[-1], abs=1e-14)


def test_a_line_of_solutions():
    z, code = solve_lcp(np.ones((2, 2)), -np.ones(2), 100)
    assert code == SOLVED
    assert z.min() >= 0.0
    assert z.sum() == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(("matrix", "vector", "answer"), [
    ([[0, -1, 2], [2, 0, -2], [-1, 1, 0]], [-3, 6, -1], [0, 1, 3]),
    ([[1, -1], [-1, 1]], [1, -1], [0, 1]),
], ids=["cps-2", "cps-5-tie"])  # fmt: skip
def test_cps_2_and_5(matrix, vector, answer):
    z, code = solve_lcp(np.array(matrix, float), np.array(vector, float), 100)
    assert code == SOLVED
    assert z == pytest.approx(answer, abs=1e-14)


def test_cps_3_has_three_solutions_and_ends_on_a_ray():
    """Lemke's method with a covering vector of ones finds none of them, and must say so."""
    vector = -np.ones(4)
    found = solutions(CPS_3, vector)
    assert len(found) == 3
    mixed = [z for z in found if (z > 0).all()]
    assert len(mixed) == 1
    assert mixed[0] == pytest.approx([1 / 90, 2 / 45, 1 / 90, 2 / 45], abs=1e-15)
    z, code = solve_lcp(CPS_3, vector, 100)
    assert code == RAY
    assert (z == 0.0).all()


@pytest.mark.parametrize("load", [-10.0, 0.0, 14.0, 22.9, 23.0, 24.0, 50.0])
def test_cps_4(load):
    matrix = np.array([[11, 0, 10, -1], [0, 11, 10, -1], [10, 10, 21, -1], [1, 1, 1, 0]], float)
    vector = np.array([50.0, 50.0, load, -6.0])
    z, code = solve_lcp(matrix, vector, 100)
    expected = [3.0, 3.0, 0.0, 83.0]
    if load <= 23.0:
        first = (load + 16.0) / 13.0
        expected = [first, first, 2.0 * (23.0 - load) / 13.0, (1286.0 - 9.0 * load) / 13.0]
    assert code == SOLVED
    assert z == pytest.approx(expected, abs=1e-12)


def test_no_solution_is_said_so():
    z, code = solve_lcp(-np.ones((1, 1)), -np.ones(1), 100)
    assert code == RAY
    assert (z == 0.0).all()
