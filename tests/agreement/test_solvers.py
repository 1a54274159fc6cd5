"""Three solvers that share no algorithm find one motion."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.model import PairFriction
from fixel.simulation import (
    Dynamic,
    FirstOrder,
    GaussSeidel,
    Lemke,
    Midpoint,
    Newton,
    QuasiStatic,
    StewartTrinkle,
    simulate,
)
from fixel.testing.scenes import grasp, heap, micro_push


def _apart(scene, solver, **method):
    """Largest distance from Newton's motion, angles by 30 mm/rad."""
    a = simulate(scene, solver=Newton(), **method)
    b = simulate(scene, solver=solver, **method)
    assert a.converged
    assert b.converged
    assert max(a.max_residual, b.max_residual) <= 1e-9
    return max(
        np.abs((a.pose[body.name] - b.pose[body.name]) * [1.0, 1.0, 0.03]).max()
        for body in scene.bodies
    )


@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic(), FirstOrder()], ids=lambda m: m.name)
@pytest.mark.parametrize("solver", [GaussSeidel(), Lemke()], ids=lambda s: s.name)
@pytest.mark.parametrize("stepper", [StewartTrinkle(step=0.1), Midpoint(step=0.08)])
def test_one_motion_of_a_grasp(motion, solver, stepper):
    scene = grasp("slip", force_limit=None, support_directions=16)
    # A residual of 1e-9 in each of a hundred steps, where nothing is indeterminate.
    assert _apart(scene, solver, motion=motion, stepper=stepper) < 1e-6


@pytest.mark.parametrize("test", [2, 5, 7])
def test_one_motion_of_a_micro_push(test):
    scene = micro_push(test)
    stepper = StewartTrinkle(step=scene.duration / 100)
    apart = _apart(scene, GaussSeidel(), motion=QuasiStatic(), stepper=stepper)
    assert apart < 1e-6 * 1.6e-3 + 1e-10


def test_one_motion_of_five_bodies():
    assert _apart(heap(5), GaussSeidel(), stepper=StewartTrinkle(step=0.01), duration=1.0) < 1e-6


def test_heaps_far_apart_move_as_if_alone():
    near = heap(12, duration=0.6)
    away = np.array([0.0, 5.0, 0.0])
    bodies = tuple(
        replace(b, name=f"other-{b.name}", pose=np.asarray(b.pose) + away) for b in near.bodies
    )
    plate = near.pushers[0]
    other = replace(plate, name="other", pose=np.asarray(plate.pose) + away)
    both = replace(
        near,
        bodies=(*near.bodies, *bodies),
        pushers=(plate, other),
        contact_friction=(PairFriction(pair=("*body-*", "*body-*"), friction=0.3),),
    )
    alone = simulate(near, stepper=StewartTrinkle(step=0.02))
    together = simulate(both, stepper=StewartTrinkle(step=0.02))
    for body in near.bodies:
        expected = alone.pose[body.name][-1]
        assert np.abs(together.pose[body.name][-1] - expected).max() < 1e-6
        moved = together.pose[f"other-{body.name}"][-1] - away
        assert np.abs(moved - expected).max() < 1e-6
