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
