"""Newton's method for one body: the answers of the method for any number of bodies."""

import numpy as np
import pytest

from fixel.kernels import codes, entries
from fixel.kernels.arrays import N_POINT
from fixel.kernels.solve import MAX_ATTEMPTS

TOLERANCE = 1e-9  # the judge's


def pushed_body(seed, inertia, n_point, drive_limit, axes):
    """A body on points in the corner of a fixed wall and a pusher, without a solution yet.

    The pusher is a drive with this limit; rigid for none. The rows of `axes` (2, 2) are the axes of
    friction, scaled.
    """
    rng = np.random.default_rng(seed)
    driven = drive_limit is not None
    n_dof, n_contact, n_element = 3 + driven, 3, n_point + driven
    problem, work = entries.empty(n_dof, n_contact, n_element, 0, 0, 0, 0)
    problem.size[:4] = n_dof, n_contact, n_element, 3
    problem.inertia[:3] = inertia * np.eye(3)
    problem.momentum[:3] = inertia * rng.normal(size=3)
    for i, angle in enumerate(rng.uniform(-0.3, 0.3, 3) + np.array([0.0, 0.0, 2.0])):
        nx, ny = np.cos(angle), np.sin(angle)
        x, y = rng.uniform(-1.0, 1.0, 2)
        problem.contact_dof[i] = 0, -1
        problem.normal[i, :3] = nx, ny, x * ny - y * nx
        problem.tangent[i, :3] = -ny, nx, x * nx + y * ny
        problem.friction[i] = rng.uniform(0.0, 0.5)
        if i < 2 and driven:
            problem.contact_dof[i, 1] = 3
            problem.normal[i, 3], problem.tangent[i, 3] = -nx, ny
        elif i < 2:
            problem.bias[i] = -nx, ny
    for e in range(n_point):
        x, y = rng.uniform(-1.0, 1.0, 2)
        problem.element_row[e, :2] = axes @ [[1.0, 0.0, -y], [0.0, 1.0, x]]
        problem.element_limit[e] = rng.uniform(0.5, 1.5) / n_point
    if driven:
        problem.element_dof[n_point] = 3
        problem.element_row[n_point, 0, 0] = 1.0
        problem.element_bias[n_point, 0] = -1.0
        problem.element_limit[n_point] = drive_limit
    entries.set_stiffness(problem, n_point)
    return problem, work


@pytest.mark.parametrize("drive_limit", [None, 0.3, 30.0], ids=["rigid", "stalls", "drives"])
@pytest.mark.parametrize("n_point", [1, 3, 7, 20])
@pytest.mark.parametrize(
    "axes", [np.eye(2), np.array([[0.7, 0.4], [-0.6, 1.1]])], ids=["even", "uneven"]
)
@pytest.mark.parametrize("inertia", [0.01, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_solution_is_that_of_any_number_of_bodies(seed, inertia, n_point, drive_limit, axes):
    solutions = []
    for known in (0, n_point):
        problem, work = pushed_body(seed, inertia, n_point, drive_limit, axes)
        problem.size[N_POINT] = known
        guess = np.zeros_like(problem.velocity)
        worst, _ = entries.solve_problem(problem, work, guess, codes.NEWTON, 0, MAX_ATTEMPTS)
        assert worst <= TOLERANCE
        solutions.append(problem)
    any_number, one = solutions
    assert one.velocity == pytest.approx(any_number.velocity, abs=1e-6)
