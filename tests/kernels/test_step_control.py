"""Tests of the error of a step, for few bodies and for many."""

import math

import numpy as np
import pytest

from fixel.kernels import entries
from fixel.kernels.jit import entry
from fixel.kernels.step_control import CROWD, largest_change

change = entry(lambda problem, guess: largest_change(problem, guess))


@pytest.mark.parametrize("n", [1, CROWD, CROWD + 1, 9 * CROWD])
def test_one_body_that_jumps_counts_less_in_a_crowd(n):
    problem, _ = entries.empty(3 * n, 0, 0, 0, 0, 0, 0)
    problem.size[:4] = 3 * n, 0, 0, 3 * n
    guess = np.zeros(3 * n + 2)
    problem.velocity[3 * n - 3 : 3 * n] = 3.0, 4.0, 1.0
    expected = 6.0 if n <= CROWD else 6.0 * math.sqrt(CROWD / n)
    assert change(problem, guess) == pytest.approx(expected, rel=1e-12)
    problem.velocity[:3] = 60.0, 0.0, 0.0
    assert change(problem, guess) >= 60.0 * min(1.0, math.sqrt(CROWD / n)) * (1.0 - 1e-12)


def test_a_crowd_that_changes_together_counts_in_full():
    n = 4 * CROWD
    problem, _ = entries.empty(3 * n, 0, 0, 0, 0, 0, 0)
    problem.size[:4] = 3 * n, 0, 0, 3 * n
    problem.velocity[: 3 * n] = np.tile([3.0, 4.0, 1.0], n)
    assert change(problem, np.zeros(3 * n + 2)) == pytest.approx(6.0, rel=1e-12)
