"""Pressure points in groups: the answers of one friction element at a time."""

import numpy as np
import pytest

from fixel.kernels import codes, entries
from fixel.kernels.arrays import N_POINT
from fixel.kernels.one_body import LANES
from fixel.kernels.solve import MAX_ATTEMPTS

TOLERANCE = 1e-9  # the judge's


def solve(problem, work):
    guess = np.zeros_like(problem.velocity)
    return entries.solve_problem(problem, work, guess, codes.NEWTON, 0, MAX_ATTEMPTS)


EVEN = np.eye(2)
# An ellipse of friction with half-axes of 0.8 and 1.3, turned by 0.4 rad.
UNEVEN = np.array([[0.8 * np.cos(0.4), 0.8 * np.sin(0.4)], [-1.3 * np.sin(0.4), 1.3 * np.cos(0.4)]])


def pushed_bodies(seed, n_points, inertia=1.0, axes=EVEN):
    """Bodies on points, each pushed on one side by a wall that moves, without a solution yet."""
    rng = np.random.default_rng(seed)
    n_body, n = len(n_points), sum(n_points)
    problem, work = entries.empty(3 * n_body, n_body, n, 0, 0, 0, 0)
    problem.size[:4] = 3 * n_body, n_body, n, 3 * n_body
    e = 0
    for b, own in enumerate(n_points):
        o = 3 * b
        problem.inertia[o : o + 3] = inertia * np.eye(3)
        problem.momentum[o : o + 3] = inertia * rng.normal(size=3)
        problem.contact_dof[b] = o, -1
        problem.normal[b, :3] = 1.0, 0.0, rng.uniform(-0.5, 0.5)
        problem.tangent[b, :3] = 0.0, 1.0, -1.0
        problem.bias[b, 0] = -1.0
        problem.friction[b] = 0.3
        for _ in range(own):
            x, y = rng.uniform(-1.0, 1.0, 2)
            problem.element_dof[e] = o
            problem.element_row[e, :2] = axes @ [[1.0, 0.0, -y], [0.0, 1.0, x]]
            problem.element_limit[e] = rng.uniform(0.5, 1.5) / own
            e += 1
    entries.set_stiffness(problem, n)
    return problem, work


@pytest.mark.parametrize(
    "n_points", [(64,), (25,), (LANES,), (24, 64), (13, 20, 3)], ids=lambda n: "+".join(map(str, n))
)
@pytest.mark.parametrize("axes", [EVEN, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("inertia", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_groups_have_the_solution_of_single_points(n_points, inertia, axes, seed):
    single, work = pushed_bodies(seed, n_points, inertia, axes)
    assert solve(single, work)[0] <= TOLERANCE
    grouped, work = pushed_bodies(seed, n_points, inertia, axes)
    grouped.size[N_POINT] = sum(n_points)
    assert solve(grouped, work)[0] <= TOLERANCE
    assert grouped.velocity == pytest.approx(single.velocity, abs=1e-7)
    assert grouped.impulse == pytest.approx(single.impulse, abs=1e-7)


def test_a_body_at_rest_sticks_on_all_its_points():
    problem, work = pushed_bodies(0, (64,))
    problem.momentum[:3] = 0.1, -0.1, 0.05
    problem.bias[0, 0] = 1.0
    problem.size[N_POINT] = 64
    residual, fell_back = solve(problem, work)
    assert residual <= TOLERANCE
    assert not fell_back
    assert abs(problem.velocity[:3]).max() < 1e-9
