"""What stands behind Newton: sweeps, proximal steps, islands, the certificate of a squeeze."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import linprog
from tests.kernels.entries import is_proven_unsolvable

from fixel.kernels import codes, entries
from fixel.kernels.gauss_seidel import gauss_seidel, nearest_in_polygon
from fixel.kernels.jit import entry
from fixel.kernels.proximal import (
    begin_line,
    linearise_any,
    proximal_newton,
    spring_force,
    stiffening_newton,
)
from fixel.kernels.solve import MAX_ATTEMPTS, STIFFENING, TOLERANCE
from fixel.testing.contracts import step_problem

FLOOR = math.pi / 2
WALLS = ((FLOOR, 0.0, 0.3), (0.0, 0.1, 0.5))

swept = entry(lambda problem, work, sweeps: gauss_seidel(problem, work, 1e-14, sweeps))
proximal = entry(
    lambda problem, work, rounds: proximal_newton(
        problem, work, 10.0, 1e6, rounds, 1e-12, -1, 1.0, 0.0
    )
)

stiffened = entry(lambda problem, work: stiffening_newton(problem, work, 1e-12, 60, math.inf))
stiffened_early = entry(
    lambda problem, work: stiffening_newton(problem, work, TOLERANCE, STIFFENING, math.inf)
)


@entry
def residual_along(problem, work, sigma, tresca, place):
    """Return the residual along the search direction, by the springs' slips and by linearising."""
    start, growth = begin_line(problem, work, sigma)
    quick = start + growth * place - spring_force(problem, work, sigma, tresca, place)
    n = problem.size[0]
    for i in range(n):
        problem.velocity[i] = work.search[i, 0] + place * work.search[i, 1]
    linearise_any(problem, work, 1.0 / sigma, 1.0 / sigma, True, tresca, False)
    total = 0.0
    for i in range(n):
        total -= work.right[i] * work.search[i, 1]
    return quick, total


polygon = entry(lambda x, y, limit, sides: nearest_in_polygon(x, y, limit, sides))


@pytest.mark.system
@pytest.mark.parametrize(("solve", "quasi_static", "allowed"), [
    (lambda problem, work: swept(problem, work, 1000), False, TOLERANCE),
    (lambda problem, work: swept(problem, work, 100_000), True, TOLERANCE),
    (lambda problem, work: proximal(problem, work, 30), False, 1e-6),
], ids=["sweeps", "sweeps of a body without inertia", "proximal steps"])  # fmt: skip
def test_what_stands_behind_newton_settles_on_the_answer(solve, quasi_static, allowed):
    momentum, limit = ((-0.6, -2.0, 0.0), 2.0) if quasi_static else ((-1.0, -2.0, 0.5), 0.25)
    problem, work = step_problem(momentum, WALLS, limit=limit)
    if quasi_static:
        problem.inertia[:] = 0.0
        entries.set_stiffness(problem, 1)
    solve(problem, work)
    assert entries.judge(problem, work.right) <= allowed


@pytest.mark.system
@pytest.mark.parametrize("height", [1e-7, 1e-5, 1e-3])
def test_contacts_that_only_one_of_can_hold(height):
    """Two floors at nearly the same height share the weight at first; the higher one bears it."""
    floors = ((FLOOR, 0.0, 0.3), (FLOOR, -height, 0.3))
    problem, work = step_problem((-0.1, -2.0, 0.5), floors)
    problem.impulse[:2, 0] = 1.0
    assert stiffened(problem, work) <= 1e-12
    assert problem.impulse[:, 0] == pytest.approx([0.0, 2.0 + height], abs=1e-12)
    assert problem.velocity[:3] == pytest.approx([0.0, height, 0.5], abs=1e-12)


@pytest.mark.system
def test_line_of_bodies_by_stiffening_and_by_sweeps():
    softly, work = many_bodies(4, coupled=True)
    assert stiffened(softly, work) <= 1e-12
    plainly, work = many_bodies(4, coupled=True)
    swept(plainly, work, 10_000)
    assert softly.velocity == pytest.approx(plainly.velocity, abs=1e-9)


@pytest.mark.system
def test_contacts_that_stick_do_not_slide_back_and_forth():
    """Most random rows of pushed blocks are solved at once; a third of them went round in circles
    where a contact that sticks was as soft as its block."""
    solved = 0
    for seed in range(40):
        problem, work = row_of_blocks(4, np.random.default_rng(seed))
        solved += stiffened_early(problem, work) <= TOLERANCE
    assert solved >= 33


def row_of_blocks(n, rng):
    """Blocks on three feet each in a row, with two contacts on every face, that a wall pushes."""
    problem, work = entries.empty(3 * n, 2 * n, 3 * n, 0, 0, 0, 0)
    problem.size[:4] = 3 * n, 2 * n, 3 * n, 3 * n
    problem.friction[:] = 0.3
    problem.element_limit[:] = 0.3
    problem.bias[:2, 0] = -1.0
    work.profile[: 3 * n] = 3 * n
    for b in range(n):
        problem.inertia[3 * b : 3 * b + 3] = np.eye(3)
        problem.momentum[3 * b : 3 * b + 3] = 0.3 * rng.normal(size=3)
        for e in range(3 * b, 3 * b + 3):
            angle = math.pi * 2 / 3 * e + rng.random()
            problem.element_dof[e] = 3 * b
            problem.element_row[e, 0] = 1.0, 0.0, -0.6 * math.sin(angle)
            problem.element_row[e, 1] = 0.0, 1.0, 0.6 * math.cos(angle)
        for i, side in ((2 * b, -0.8), (2 * b + 1, 0.8)):
            y = side + 0.1 * rng.normal()
            slope = 0.1 * rng.normal()
            problem.contact_dof[i] = 3 * b, 3 * b - 3 if b > 0 else -1
            for row, x, z in (
                (problem.normal[i], math.cos(slope), math.sin(slope)),
                (problem.tangent[i], -math.sin(slope), math.cos(slope)),
            ):
                row[:3] = x, z, -z - y * x
                if b > 0:
                    row[3:] = -x, -z, y * x - z
    entries.set_stiffness(problem, 3 * n)
    return problem, work


@pytest.mark.system
@pytest.mark.parametrize("tresca", [False, True])
@pytest.mark.parametrize("sides", [0, 6])
def test_line_searches_see_the_balance(sides, tresca):
    problem, work = step_problem((-1.0, -2.0, 0.5), WALLS, limit=0.25)
    problem.element_sides[0] = sides
    rng = np.random.default_rng(sides)
    for _ in range(20):
        work.search[:3, :2] = rng.normal(size=(3, 2))
        work.centre[:3] = rng.normal(size=3)
        problem.impulse[:] = rng.normal(size=problem.impulse.shape)
        problem.element_impulse[:] = rng.normal(size=problem.element_impulse.shape)
        work.contact_change[:, 4] = rng.random(len(work.contact_change))
        quick, whole = residual_along(problem, work, 30.0, tresca, rng.random())
        assert quick == pytest.approx(whole, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("sides", [4, 7, 16])
def test_nearest_point_of_a_polygon(sides):
    corner = 2.0 * math.pi * np.arange(sides + 1) / sides
    ring = np.column_stack([np.cos(corner), np.sin(corner)])
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    border = np.concatenate([a + along * (b - a) for a, b in pairwise(ring)])
    rng = np.random.default_rng(sides)
    for x, y in rng.normal(size=(50, 2)) * 2.0:
        nearest = np.array(polygon(x, y, 1.0, sides))
        best = np.hypot(*(border - [x, y]).T).min()
        inside = np.array_equal(nearest, [x, y])
        assert inside or np.hypot(*(nearest - [x, y])) == pytest.approx(best, abs=1e-6)
        assert np.hypot(*nearest) <= 1.0 + 1e-12


def test_no_certificate_where_there_is_a_way_out():
    problem, work = step_problem((0.0, 0.0, 0.0), ((0.0, -1.0, 0.2), (2.0, -1.0, 0.2)))
    assert not entries.may_jam(problem, work, False)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_certificate_where_there_is_none(friction):
    jaws = ((0.0, -1.0, friction), (math.pi, -1.0, friction))
    problem, work = step_problem((0.0, 0.0, 0.0), jaws)
    assert entries.may_jam(problem, work, False)


def test_friction_holds_a_wedge_that_would_slip_out_without():
    # Jaws that close at an angle of 20 degrees to each other: the body squeezes out sideways
    # unless friction exceeds the tangent of half of that.
    half = math.radians(10)
    for friction, held in ((0.1, False), (0.25, True)):
        jaws = ((half, -1.0, friction), (math.pi - half, -1.0, friction))
        problem, work = step_problem((0.0, 0.0, 0.0), jaws)
        assert entries.may_jam(problem, work, False) is held


def many_bodies(n, coupled):
    """A row of bodies that fall on a floor; neighbours push each other sideways where coupled."""
    n_contact = n + (n - 1 if coupled else 0)
    problem, work = entries.empty(3 * n, n_contact, 0, 0, 0, 0, 0)
    problem.size[:4] = 3 * n, n_contact, 0, 3 * n
    for b in range(n):
        problem.inertia[3 * b : 3 * b + 3] = np.eye(3)
        problem.momentum[3 * b : 3 * b + 3] = 1.0 - 0.3 * b, -1.0, 0.1 * b
        problem.contact_dof[b] = 3 * b, -1
        problem.normal[b, :3] = 0.0, 1.0, 0.1
        problem.tangent[b, :3] = -1.0, 0.0, 0.5
        problem.friction[b] = 0.4
    for c in range(n, n_contact):
        a = c - n
        problem.contact_dof[c] = 3 * a, 3 * (a + 1)
        problem.normal[c] = -1.0, 0.0, 0.1, 1.0, 0.0, 0.1
        problem.tangent[c] = 0.0, -1.0, 0.5, 0.0, 1.0, 0.5
        problem.friction[c] = 0.2
    entries.set_stiffness(problem, 0)
    return problem, work


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("n", [3, 8, 20])
def test_rows_of_bodies_island_by_island(n, coupled):
    problem, work = many_bodies(n, coupled)
    residual, _ = entries.solve_problem(
        problem, work, np.zeros(3 * n + 2), codes.NEWTON, 0, MAX_ATTEMPTS
    )
    assert residual <= TOLERANCE


def test_an_island_is_solved_as_if_it_were_alone():
    many, work = many_bodies(8, coupled=False)
    entries.solve_problem(many, work, np.zeros(26), codes.NEWTON, 0, MAX_ATTEMPTS)
    for b in range(8):
        one, own = many_bodies(1, coupled=False)
        one.momentum[:3] = many.momentum[3 * b : 3 * b + 3]
        entries.solve_problem(one, own, np.zeros(5), codes.NEWTON, 0, MAX_ATTEMPTS)
        assert many.velocity[3 * b : 3 * b + 3] == pytest.approx(one.velocity[:3], abs=1e-9)


def _random_squeeze(rng):
    """One body between two to five walls, each moving in or out, with random arms."""
    angles = rng.uniform(0.0, 2.0 * math.pi, int(rng.integers(2, 6)))
    walls = [(a, rng.uniform(-1.0, 1.0), rng.choice([0.0, rng.random()])) for a in angles]
    problem, work = step_problem(tuple(rng.normal(size=3)), tuple(walls), rng.choice([0.1, 1.0]))
    if rng.random() < 0.5:
        problem.inertia[:] = 0.0
        problem.momentum[:] = 0.0
        entries.set_stiffness(problem, 1)
    problem.normal[:, 2] = rng.normal(size=len(walls))
    problem.tangent[:, 2] = rng.normal(size=len(walls))
    problem.bias[:, 1] = rng.normal(size=len(walls)) * rng.choice([0.0, 1.0])
    return problem, work


def _has_motion(problem, mu):
    """Return whether some velocity has ``u_n >= mu |u_t|`` everywhere, by linear programming."""
    rows = [problem.normal + s * mu[:, None] * problem.tangent for s in (1.0, -1.0)]
    bias = [problem.bias[:, 0] + s * mu * problem.bias[:, 1] for s in (1.0, -1.0)]
    a, b = np.concatenate(rows)[:, :3], np.concatenate(bias)
    return linprog(np.zeros(3), A_ub=-a, b_ub=b, bounds=(None, None), method="highs").status == 0


def test_certificates_against_linear_programming():
    """A proof is one exactly where no motion keeps the bodies apart; then nothing is solved."""
    rng = np.random.default_rng(19)
    proven = held = slipped = 0
    for _ in range(400):
        problem, work = _random_squeeze(rng)
        proof = is_proven_unsolvable(problem, work)
        may_jam = entries.may_jam(problem, work, False)
        assert proof != _has_motion(problem, 0.0 * problem.friction)
        assert may_jam != _has_motion(problem, problem.friction)
        off, _ = entries.solve_problem(problem, work, np.zeros(5), codes.NEWTON, 0, MAX_ATTEMPTS)
        solved = off <= TOLERANCE
        assert solved or may_jam
        assert not (solved and proof)
        proven += proof
        held += may_jam and not proof and not solved
        slipped += may_jam and solved
    # Where friction may jam, two bodies in five slip out all the same: it proves nothing.
    assert min(proven, held, slipped) > 10


def test_nothing_is_tried_where_a_jam_is_proven():
    jaws = ((0.0, -1.0, 0.3), (math.pi, -1.0, 0.3))
    problem, work = step_problem((0.0, 0.0, 0.0), jaws)
    problem.velocity[:3] = 0.3, -0.2, 0.1
    residual, fell_back = entries.solve_problem(
        problem, work, np.zeros(5), codes.NEWTON, 0, MAX_ATTEMPTS
    )
    assert residual > 0.1
    assert fell_back == 1
    assert problem.velocity[:3] == pytest.approx([0.3, -0.2, 0.1], abs=0.0)
    assert not problem.impulse.any()
