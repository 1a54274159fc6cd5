"""Starts from the contact of one body: Newton arrives, where sweeps arrive too."""

import numpy as np
import pytest

from fixel.kernels import codes, entries
from fixel.kernels.arrays import N_POINT
from fixel.kernels.solve import MAX_ATTEMPTS

TOLERANCE = 1e-9  # the judge's
SWEEPS = 20_000


def pushed_body(seed, n_point, closing):
    """A body at rest on points, without inertia, and one rigid pusher."""
    rng = np.random.default_rng(seed)
    problem, work = entries.empty(3, 1, n_point, 0, 0, 0, 0)
    problem.size[:4] = 3, 1, n_point, 3
    problem.size[N_POINT] = n_point
    angle, side = rng.uniform(-np.pi, np.pi, 2)
    nx, ny = np.cos(angle), np.sin(angle)
    x, y = -nx + 0.8 * np.sin(side) * ny, -ny - 0.8 * np.sin(side) * nx
    problem.contact_dof[0] = 0, -1
    problem.normal[0, :3] = nx, ny, x * ny - y * nx
    problem.tangent[0, :3] = -ny, nx, x * nx + y * ny
    problem.friction[0] = rng.uniform(0.0, 0.5)
    problem.bias[0] = -closing, rng.uniform(-1.0, 1.0)
    for e in range(n_point):
        x, y = rng.uniform(-1.0, 1.0, 2)
        problem.element_row[e, 0] = 1.0, 0.0, -y
        problem.element_row[e, 1] = 0.0, 1.0, x
        problem.element_limit[e] = rng.uniform(0.5, 1.5) / n_point
    entries.set_stiffness(problem, n_point)
    return problem, work


def solved(problem, work, solver=codes.NEWTON, sweeps=0):
    guess = problem.velocity.copy()
    worst, fell_back = entries.solve_problem(problem, work, guess, solver, sweeps, MAX_ATTEMPTS)
    assert worst <= TOLERANCE
    return problem.velocity[:3], fell_back


@pytest.mark.parametrize("n_point", [3, 7, 19])
@pytest.mark.parametrize("seed", range(8))
def test_first_contact_from_rest_moves_the_body_as_sweeps_do(seed, n_point):
    velocity, fell_back = solved(*pushed_body(seed, n_point, 0.7))
    by_sweeps, _ = solved(*pushed_body(seed, n_point, 0.7), codes.GAUSS_SEIDEL, SWEEPS)
    assert velocity == pytest.approx(by_sweeps, abs=1e-6)
    assert n_point < 19 or fell_back == 0  # a body may turn about one of few points
    assert np.abs(velocity).max() > 0.1


@pytest.mark.parametrize("seed", range(4))
def test_a_body_rests_when_its_pusher_leaves(seed):
    problem, work = pushed_body(seed, 19, 0.7)
    solved(problem, work)
    problem.bias[0, 0] = 0.05  # leaves along the side, with the impulses of the push before
    velocity, _ = solved(problem, work)
    assert velocity == pytest.approx(0.0, abs=1e-9)
    assert problem.impulse[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_turned_pusher_finds_the_motion_from_rest(seed):
    problem, work = pushed_body(seed, 19, 0.7)
    solved(problem, work)
    problem.bias[0] = -0.3, -3.0 * problem.bias[0, 1]
    velocity = solved(problem, work)[0].copy()
    problem, work = pushed_body(seed, 19, 0.3)
    problem.bias[0, 1] *= -3.0
    assert velocity == pytest.approx(solved(problem, work)[0], abs=1e-6)
