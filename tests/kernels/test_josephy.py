"""Pivoting on the contacts: exact where the problem is linear, and where Newton goes in circles."""

import math

import numpy as np
import pytest

from fixel.kernels import entries
from fixel.kernels.jit import entry
from fixel.kernels.josephy import MAX_CONTACTS, josephy
from fixel.kernels.newton import newton

pytestmark = pytest.mark.system  # these compile for long
TOLERANCE = 1e-9  # the judge's
STIFF_DRIVE = 90.0  # largest impulse of the drive, a hundred times what sliding takes


@entry
def turns_of(problem, work, n, iterations):
    """Take turns of pivoting, then iterations of Newton; two functions would compile longer."""
    more = True
    for turn in range(n):
        more = josephy(problem, work, turn, turn)
        if not more:
            break
    if iterations:
        newton(problem, work, 1e-11, iterations)
    return more


def body(momentum, contacts, inertia=1.0):
    """One free body; contacts are (direction of the normal, arm, bias, friction)."""
    n = len(contacts)
    problem, work = entries.empty(3, n, 0, 0, 0, 0, 0)
    problem.size[:4] = 3, n, 0, 3
    problem.inertia[:3] = inertia * np.eye(3)
    problem.momentum[:3] = momentum
    for i, (angle, arm, bias, friction) in enumerate(contacts):
        c, s = math.cos(angle), math.sin(angle)
        problem.contact_dof[i] = 0, -1
        problem.normal[i, :3] = c, s, arm
        problem.tangent[i, :3] = -s, c, 0.3
        problem.bias[i, 0] = bias
        problem.friction[i] = friction
    entries.set_stiffness(problem, 0)
    return problem, work


def seating(limit=STIFF_DRIVE):
    """A block between a pusher and a peg that close on it in this step, on three supports.

    Before the step the block slides along with the pusher; by its end the peg is met, and only the
    drive gives way.
    """
    problem, work = entries.empty(4, 3, 4, 0, 0, 0, 0)
    problem.size[:4] = 4, 3, 4, 3
    problem.inertia[:3] = 0.17 * np.eye(3)
    problem.momentum[:3] = 0.1639, 0.0136, -0.0098
    rows = [
        (0.998, 0.0626, -0.466, -0.0626, 0.998, -1.2247, 0.0, 0.29, 3, -0.998, 0.0626),
        (-0.0626, 0.998, 0.3425, -0.998, -0.0626, -1.2247, -0.0001, 0.1008, 3, -0.9981, 0.0618),
        (-0.998, -0.0626, -0.0258, 0.0626, -0.998, -1.227, 0.9676, 0.1008, -1, 0.0, 0.0),
    ]
    for i, (nx, ny, na, tx, ty, ta, bias, friction, second, nd, td) in enumerate(rows):
        problem.contact_dof[i] = 0, second
        problem.normal[i] = nx, ny, na, nd, 0.0, 0.0
        problem.tangent[i] = tx, ty, ta, td, 0.0, 0.0
        problem.bias[i, 0] = bias
        problem.friction[i] = friction
    # The second contact is with a peg, not with the pusher.
    problem.contact_dof[1, 1] = -1
    for e, (x, y) in enumerate([(-0.0733, 1.1679), (-0.9748, -0.6474), (1.048, -0.5205)]):
        problem.element_row[e, 0] = 1.0, 0.0, -y
        problem.element_row[e, 1] = 0.0, 1.0, x
        problem.element_limit[e] = 0.2277
    problem.element_dof[3] = 3
    problem.element_row[3, 0, 0] = 1.0
    problem.element_bias[3, 0] = -1.0
    problem.element_limit[3] = limit
    entries.set_stiffness(problem, 3)
    problem.velocity[:4] = 0.9678, 0.0795, -0.0587, 1.0
    problem.impulse[0] = 0.7038, -0.2041
    problem.impulse[1] = 0.2171, 0.0219
    return problem, work


@pytest.mark.parametrize("inertia", [1e-6, 1.0, 1e6])
def test_a_linear_problem_takes_one_turn(inertia):
    walls = [(math.pi / 2, 0.1, 0.0, 0.5), (0.0, -0.2, 0.3, 0.2), (0.7, 0.4, -0.1, 0.0)]
    problem, work = body(inertia * np.array([-1.0, -2.0, 0.5]), walls, inertia)
    turns_of(problem, work, 1, 0)
    # Every block is pulled towards where it was by 1e-11 of its stiffness.
    assert entries.judge(problem, work.right) <= 1e-11 * max(1.0, inertia)
    assert (problem.impulse[:3, 0] >= 0.0).all()


def test_the_same_contact_twice():
    walls = [(math.pi / 2, 0.1, 0.0, 0.5)] * 3
    problem, work = body((-1.0, -2.0, 0.5), walls)
    turns_of(problem, work, 1, 0)
    assert entries.judge(problem, work.right) <= TOLERANCE


def test_newton_alone_goes_in_circles_where_a_part_seats():
    problem, work = seating()
    turns_of(problem, work, 0, 60)
    assert entries.judge(problem, work.right) > 1e-4


def test_a_part_that_seats_stalls_the_drive():
    problem, work = seating()
    turns_of(problem, work, 3, 10)
    assert entries.judge(problem, work.right) <= TOLERANCE
    assert problem.element_impulse[3, 0] == pytest.approx(STIFF_DRIVE)
    assert 0.0 < problem.velocity[3] < 1.0
    # The peg takes what the pusher gives.
    assert problem.impulse[2, 0] > 0.5 * STIFF_DRIVE


@pytest.mark.parametrize("limit", [0.5, 5.0, 500.0])
def test_it_does_so_at_any_strength(limit):
    problem, work = seating(limit)
    guess = problem.velocity.copy()
    residual, _ = entries.solve_problem(problem, work, guess, 0, 0, 8)
    assert residual <= TOLERANCE


def test_more_contacts_than_it_is_for_are_left_alone():
    walls = [(0.3 * i, 0.1, 0.0, 0.5) for i in range(MAX_CONTACTS + 1)]
    problem, work = body((-1.0, -2.0, 0.5), walls)
    problem.velocity[:3] = 0.1, 0.2, 0.3
    assert not turns_of(problem, work, 1, 0)
    assert problem.velocity[:3].tolist() == [0.1, 0.2, 0.3]


def test_walls_that_squeeze_have_no_answer():
    problem, work = body((0.0, 0.0, 0.0), [(0.0, 0.0, -1.0, 0.0), (math.pi, 0.0, -1.0, 0.0)])
    turns_of(problem, work, 4, 0)
    assert np.isfinite(problem.velocity[:3]).all()
    assert entries.judge(problem, work.right) > TOLERANCE
