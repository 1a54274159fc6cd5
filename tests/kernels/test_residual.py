"""The judge: zero for answers, and as large as what is wrong otherwise, row by row."""

import math

import numpy as np
import pytest

from fixel.kernels import entries
from fixel.testing.contracts import step_problem

OFF = 1e-3


def solved():
    """A body pressed on a wall and dragged along it: every impulse known."""
    problem, work = step_problem((0.0, -2.0, 0.0), ((math.pi / 2, 0.0, 0.5),), limit=0.25)
    problem.velocity[:3] = 0.0
    problem.impulse[0] = 2.0, 0.0
    return problem, work


def judged(problem, work):
    return entries.judge(problem, work.right)


def test_an_answer_has_none():
    assert judged(*solved()) <= 1e-15


@pytest.mark.parametrize("dof", range(3))
def test_momentum(dof):
    problem, work = solved()
    problem.momentum[dof] += OFF
    assert judged(problem, work) == pytest.approx(OFF)


WRONG = {
    "an overlap at the end": {("bias", (0, 0)): -OFF},
    "a pull": {("impulse", 0): (-OFF, 0.0), ("momentum", 1): OFF},
    "a push across a gap": {("bias", (0, 0)): OFF},
    "more friction than there is": {("impulse", (0, 1)): 1.0 + OFF, ("momentum", 0): 1.0 + OFF},
    "slip without friction against it": {("bias", (0, 1)): OFF},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_as_large_as_it_is(changes):
    problem, work = solved()
    for (field, place), value in changes.items():
        getattr(problem, field)[place] = value
    assert judged(problem, work) == pytest.approx(OFF)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["velocity", "impulse", "element_impulse"])
def test_no_number_is_infinitely_wrong(where, value):
    problem, work = solved()
    getattr(problem, where).flat[0] = value
    assert judged(problem, work) == math.inf


@pytest.mark.parametrize("sides", [0, 16])
def test_a_speed_without_a_square_is_no_answer(sides):
    problem, work = step_problem((0.0, 0.0, 0.0), limit=0.25)
    problem.inertia[:] = 0.0  # as in quasi-static motion: friction alone speaks against it
    problem.element_sides[0] = sides
    problem.velocity[0] = 1e200
    assert judged(problem, work) > 0.2


@pytest.mark.parametrize("sides", [0, 4, 16])
def test_a_support_impulse_beyond_its_limit(sides):
    problem, work = solved()
    problem.element_sides[0] = sides
    # Towards a corner of the polygon, which lies on the circle.
    problem.element_impulse[0, 0] = 0.25 + OFF
    problem.momentum[0] = -(0.25 + OFF)
    problem.velocity[0] = 0.0
    assert judged(problem, work) == pytest.approx(OFF)


@pytest.mark.parametrize("sides", [0, 8])
def test_a_support_that_slips_the_way_it_is_pushed(sides):
    problem, work = solved()
    problem.element_sides[0] = sides
    problem.velocity[0] = OFF
    problem.momentum[0] = OFF
    problem.impulse[0, 1] = 1.0
    problem.momentum[0] += 1.0
    problem.bias[0, 1] = OFF  # the wall goes along
    # The support should drag with up to 0.25, and does not at all.
    assert judged(problem, work) == pytest.approx(OFF)


def test_scratch_holds_what_is_left_over():
    problem, work = solved()
    problem.momentum[:3] += [0.1, -0.2, 0.3]
    judged(problem, work)
    assert np.abs(work.right[:3]) == pytest.approx([0.1, 0.2, 0.3])


@pytest.mark.parametrize("value", [0.0, OFF, math.nan, math.inf, 1e200])
@pytest.mark.parametrize("field", ["element_impulse", "element_bias", "element_row"])
@pytest.mark.parametrize("n", [8, 16, 41])
def test_many_elements_together_and_one_by_one(n, field, value):
    rng = np.random.default_rng(n)
    problem, work = entries.empty(3, 0, n, 0, 0, 0, 0)
    problem.size[:4] = 3, 0, n, 3
    problem.velocity[:3] = rng.normal(size=3)
    problem.element_row[:] = rng.normal(size=(n, 3, 3))
    problem.element_bias[:] = rng.normal(size=(n, 3))
    problem.element_impulse[:] = 0.1 * rng.normal(size=(n, 3))
    problem.element_limit[:] = rng.uniform(0.1, 1.0, n)
    getattr(problem, field)[n // 2, 1] += value
    one_by_one = np.zeros(problem.momentum.size)
    expected = entries.judge(problem, one_by_one)
    assert judged(problem, work) == pytest.approx(expected, rel=1e-12)
    if math.isfinite(expected):
        assert work.right[:3] == pytest.approx(one_by_one[:3], rel=1e-12)
    else:
        assert expected == math.inf
