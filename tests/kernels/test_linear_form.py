"""The linear form of step problems built by hand, of random ones and of a grasp."""

import math

import numpy as np
import pytest
from tests.kernels.entries import solve_problem

from fixel import Body, Dynamic, Lemke, Polygon, QuasiStatic, Scene, UniformPressure, simulate
from fixel.kernels import entries
from fixel.kernels.lemke import RAY, SOLVED
from fixel.kernels.linear_form import NO_ROOM, NOT_LINEAR
from fixel.simulation.stepping import Midpoint, StewartTrinkle
from fixel.testing.scenes import grasp

STEP_TOLERANCE = 1e-9  # the judge's, as in kernels/solve.py
PIVOTS = 5000


def empty(n_free, n_drive, n_contact, n_element):
    """Problem and workspace without rows yet."""
    n_dof = 3 * n_free + n_drive
    problem, work = entries.empty(n_dof, n_contact, n_element, 0, 0, 0, 0)
    problem.size[:4] = n_dof, n_contact, n_element, 3 * n_free
    return problem, work


def set_foot(problem, e, dof, r, limit, sides):
    """A support point at r from the centre of mass."""
    problem.element_dof[e] = dof
    problem.element_sides[e] = sides
    problem.element_row[e, 0] = 1.0, 0.0, -r[1]
    problem.element_row[e, 1] = 0.0, 1.0, r[0]
    problem.element_limit[e] = limit
    problem.stiffness[dof : dof + 3] += limit


def set_drive(problem, e, dof, speed, limit):
    """A drive that wants `speed` and gives up at the impulse `limit`."""
    problem.element_dof[e] = dof
    problem.element_row[e, 0, 0] = 1.0
    problem.element_bias[e, 0] = -speed
    problem.element_limit[e] = limit
    problem.stiffness[dof] = problem.stiffness[: problem.size[3]].max()
    problem.velocity[dof] = speed


def set_side(problem, i, side, dof, n, r):
    """One of the two bodies of contact i, touched at r; the normal points into the first."""
    sign = 1.0 - 2.0 * side
    columns = slice(3 * side, 3 * side + 3)
    problem.contact_dof[i, side] = dof
    problem.normal[i, columns] = sign * np.array([n[0], n[1], r[0] * n[1] - r[1] * n[0]])
    problem.tangent[i, columns] = sign * np.array([-n[1], n[0], r @ n])


def pushed_block(sides, quasi_static, slide, drive_limit):
    """A block on a tripod, pushed off its centre at unit speed along +x; `slide`: also along +y."""
    driven = drive_limit is not None
    problem, work = empty(1, int(driven), 1, 3 + int(driven))
    if not quasi_static:
        problem.inertia[0, 0] = problem.inertia[1, 1] = 1.0
        problem.inertia[2, 2] = 0.5
        problem.stiffness[:3] = 1.0
    for j in range(3):
        angle = 0.2 + 2.0 * math.pi * j / 3.0
        foot = 0.8 * np.array([math.cos(angle), math.sin(angle)])
        set_foot(problem, j, 0, foot, 0.1, sides)
    normal = np.array([1.0, 0.0])
    set_side(problem, 0, 0, 0, normal, np.array([-1.0, 0.3]))
    problem.friction[0] = 0.4
    if drive_limit is None:
        problem.contact_dof[0, 1] = -1
        problem.bias[0] = -1.0, -slide
    else:
        set_drive(problem, 3, 3, 1.0, drive_limit)
        problem.contact_dof[0, 1] = 3
        problem.normal[0, 3] = -1.0
        problem.tangent[0, 3] = -slide
    return problem, work


@pytest.mark.parametrize("sides", [4, 8, 16])
@pytest.mark.parametrize("quasi_static", [False, True])
@pytest.mark.parametrize("slide", [0.0, 0.1, 3.0])
@pytest.mark.parametrize("drive_limit", [None, 0.05, 1000.0])
def test_pushed_block(sides, quasi_static, slide, drive_limit):
    problem, work = pushed_block(sides, quasi_static, slide, drive_limit)
    off, code, _ = solve_problem(problem, work, 0, PIVOTS)
    assert code == SOLVED
    assert off <= STEP_TOLERANCE
    p_n, p_t = problem.impulse[0]
    if drive_limit == 0.05:
        # Too weak to move the block: 0.3 of friction and the drive at its limit.
        assert problem.element_impulse[3, 0] <= 0.05 + 1e-12
        if quasi_static:
            assert problem.velocity[:3] == pytest.approx(0.0, abs=1e-9)
    elif slide == 3.0:
        assert p_t == pytest.approx(0.4 * p_n, abs=1e-12)
    elif slide == 0.0 and not quasi_static:
        assert abs(p_t) < 0.4 * p_n


def test_block_slides_to_rest_in_the_closed_form():
    """All feet alike and no turning: the impulse is the limit, or what stops the block."""
    for speed, left in ((1.0, 0.7), (0.2, 0.0)):
        problem, work = pushed_block(16, False, 0.0, None)
        problem.size[1] = 0
        problem.momentum[0] = speed
        off, code, _ = solve_problem(problem, work, 0, PIVOTS)
        assert code == SOLVED
        assert off <= STEP_TOLERANCE
        assert problem.velocity[:3] == pytest.approx([left, 0.0, 0.0], abs=1e-12)


def random_problem(random, sides, quasi_static, driven):
    """One to four bodies on tripods; at most one contact pushes, so that nothing can jam."""
    n_free = int(random.integers(1, 5))
    n_contact = int(random.integers(0, 9))
    problem, work = empty(n_free, int(driven), n_contact, 3 * n_free + int(driven))
    uneven = random.random() < 0.3
    for b in range(n_free):
        mass = 10.0 ** random.uniform(-3.0, 3.0) if uneven else random.uniform(0.5, 2.0)
        dof = 3 * b
        problem.velocity[dof : dof + 3] = random.choice([0.0, 1.0]) * random.normal(size=3)
        if not quasi_static:
            problem.inertia[range(dof, dof + 3), range(3)] = mass, mass, 0.5 * mass
            problem.momentum[dof : dof + 3] = mass * problem.velocity[dof : dof + 3]
            problem.stiffness[dof : dof + 3] = mass
        start = random.uniform(0.0, 2.0 * math.pi)
        for j in range(3):
            angle = start + 2.0 * math.pi * j / 3.0
            foot = 0.8 * np.array([math.cos(angle), math.sin(angle)])
            if uneven and b == 0:
                foot = np.array([0.3 * j, 0.0])  # all feet on a line
            set_foot(problem, 3 * b + j, dof, foot, mass * random.uniform(0.1, 1.0), sides)
    if driven:
        # Stronger drives leave the lightest bodies with more than 1e-9 of rounding.
        limit = 10.0 ** random.uniform(-2.0, 2.0)
        set_drive(problem, 3 * n_free, 3 * n_free, random.uniform(0.1, 2.0), limit)
    for i in range(n_contact):
        angle = random.uniform(0.0, 2.0 * math.pi)
        normal = np.array([math.cos(angle), math.sin(angle)])
        a = int(random.integers(n_free))
        set_side(problem, i, 0, 3 * a, normal, random.normal(size=2))
        problem.contact_dof[i, 1] = -1
        problem.friction[i] = random.choice([0.0, random.uniform(0.0, 1.2)])
        problem.bias[i, 0] = random.choice([0.0, random.random()])
        if a + 1 < n_free and random.random() < 0.6:
            other = int(random.integers(a + 1, n_free))
            set_side(problem, i, 1, 3 * other, normal, random.normal(size=2))
        elif driven and random.random() < 0.6:
            way = random.normal(size=2)
            problem.contact_dof[i, 1] = 3 * n_free
            problem.normal[i, 3] = -normal @ way
            problem.tangent[i, 3] = -(normal[0] * way[1] - normal[1] * way[0])
    if n_contact > 1 and uneven:
        for rows in (problem.contact_dof, problem.normal, problem.tangent, problem.bias):
            rows[-1] = rows[0]
        problem.friction[-1] = problem.friction[0]
    elif n_contact and problem.contact_dof[0, 1] < 0 and (problem.contact_dof[1:, 1] >= 0).all():
        problem.bias[0] = -random.random(), random.normal()
    return problem, work


@pytest.mark.parametrize("n", [50, pytest.param(5000, marks=pytest.mark.soak)])
@pytest.mark.parametrize("sides", [4, 8, 16])
@pytest.mark.parametrize("quasi_static", [False, True])
@pytest.mark.parametrize("driven", [False, True])
def test_random_steps(sides, quasi_static, driven, n):
    """Never solved and wrong; unsolved in at most one of a thousand (mass ratio 1e6)."""
    random = np.random.default_rng(sides if n == 50 else 1000 + sides)
    n_failed = 0
    for _ in range(n):
        problem, work = random_problem(random, sides, quasi_static, driven)
        off, code, _ = solve_problem(problem, work, 0, PIVOTS)
        n_failed += code != SOLVED
        assert code != SOLVED or off <= STEP_TOLERANCE
    assert n_failed <= n // 1000


@pytest.mark.parametrize("sides", [4, 16])
@pytest.mark.parametrize("quasi_static", [False, True])
def test_pivots_of_a_step_are_bounded(sides, quasi_static):
    """In all, not for each call; ten a row are enough for all but one step in a hundred."""
    random = np.random.default_rng(40 + sides)
    n_failed = 0
    for _ in range(250):
        problem, work = random_problem(random, sides, quasi_static, True)
        rows = 4 * problem.size[1] + 3 * (problem.size[3] // 3) * (sides + 1) + 3
        off, code, pivots = solve_problem(problem, work, 0, 10 * rows)
        assert pivots <= 10 * rows + 1 + rows // 3
        assert code != SOLVED or off <= STEP_TOLERANCE
        n_failed += code != SOLVED
    assert n_failed <= 2


def test_too_many_rows_are_left_to_newton():
    """64 points of support with 16 directions each are 1,088 rows: a second of pivots a step."""
    block = Body(
        name="block", shape=Polygon([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]),
        mass=1.0, pose=(0.0, 0.0, 0.0), velocity=(0.3, 0.0, 1.0),
        support=UniformPressure(friction=0.3, n_points=64),
    )  # fmt: skip
    scene = Scene(bodies=(block,), duration=0.02, support_directions=16)
    run = simulate(scene, stepper=StewartTrinkle(step=0.01), solver=Lemke())
    assert run.status == "converged"
    assert run.max_residual <= STEP_TOLERANCE
    assert run.fallbacks == run.steps == 2


@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
@pytest.mark.parametrize("force_limit", [None, 34.3])
@pytest.mark.parametrize("sides", [4, 16])
def test_grasp_step_by_step(motion, force_limit, sides):
    """Every step of a whole grasp by pivoting alone; the seated one ends with the drive stalled."""
    scene = grasp("slip" if force_limit is None else "seated", force_limit, sides)
    result = simulate(scene, motion=motion, stepper=Midpoint(step=0.1), solver=Lemke())
    assert result.status == "converged"
    assert result.max_residual <= STEP_TOLERANCE
    assert result.fallbacks == 0


def test_squeezed_block_ends_on_a_ray():
    """Two rigid pushers from two sides: no solution, and said so, for any motion."""
    for quasi_static in (False, True):
        problem, work = empty(1, 0, 2, 3)
        if not quasi_static:
            problem.inertia[range(3), range(3)] = 1.0
            problem.stiffness[:3] = 1.0
        for j in range(3):
            foot = np.array([math.cos(2.0 * j), math.sin(2.0 * j)])
            set_foot(problem, j, 0, foot, 0.1, 16)
        for i, x in enumerate((-1.0, 1.0)):
            set_side(problem, i, 0, 0, np.array([-x, 0.0]), np.array([x, 0.0]))
            problem.contact_dof[i, 1] = -1
            problem.bias[i, 0] = -1.0
            problem.friction[i] = 0.3
        assert solve_problem(problem, work, 0, PIVOTS)[1] == RAY


def test_discs_are_refused_or_approximated():
    problem, work = pushed_block(0, False, 0.1, None)
    assert solve_problem(problem, work, 0, PIVOTS)[1] == NOT_LINEAR
    off, code, _ = solve_problem(problem, work, 16, PIVOTS)
    assert code == SOLVED
    # The polygon lies inside the disc by 1 - cos(pi / 16) of the limit, 2 %; the turn of its
    # impulse is up to half a wedge, 20 %.
    assert 0.0 < off < 0.2 * 0.1


def test_ellipsoids_are_not_linear():
    problem, work = pushed_block(16, False, 0.1, None)
    problem.element_row[0, 2, 2] = 0.5
    assert solve_problem(problem, work, 16, PIVOTS)[1] == NOT_LINEAR


def test_small_tableau_is_reported():
    problem, work = pushed_block(16, False, 0.1, None)
    assert solve_problem(problem, work, 0, PIVOTS, 4 + 3 * 17 - 1)[1] == NO_ROOM
    assert solve_problem(problem, work, 0, PIVOTS, 4 + 3 * 17)[1] == SOLVED


def test_a_free_body_has_no_rows():
    problem, work = empty(1, 0, 0, 0)
    problem.inertia[range(3), range(3)] = 2.0
    problem.stiffness[:3] = 2.0
    problem.momentum[:3] = 1.0, 2.0, 3.0
    off, code, _ = solve_problem(problem, work, 0, PIVOTS)
    assert (off, code) == (0.0, SOLVED)
    assert problem.velocity[:3] == pytest.approx([0.5, 1.0, 1.5])
