"""Whatever the step problem, the chain solves it: 10,000 random ones, degenerate ones among them.

The million is `make soak`. Problems and why each has a solution: benchmarks.random_problems.
"""

import numpy as np
from benchmarks.random_problems import solve_many

from fixel.kernels import codes
from fixel.kernels.solve import TOLERANCE


def test_ten_thousand_random_steps_are_solved() -> None:
    failed = np.full(20, -1, np.int64)
    tally = np.zeros(4)
    n_failed = solve_many(0, 5_000, codes.NEWTON, 0, failed, tally)
    assert n_failed == 0, f"not solved: {failed[failed >= 0]} (2 seed + warm)"
    assert tally[0] == 10_000
    assert 0.0 < tally[2] <= TOLERANCE


def test_a_body_that_turns_almost_freely_is_solved() -> None:
    """Three supports at corners of their friction polygons, which one of them has to leave.

    The impulses are right within 1e-8 long before the body turns to where that one may."""
    assert solve_many(688_846, 1, codes.NEWTON, 0, np.full(1, -1, np.int64), np.zeros(4)) == 0
