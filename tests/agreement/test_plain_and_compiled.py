"""The plain loop and the compiled one make the same bits."""

import numpy as np
import pytest

from fixel.model import Parameters
from fixel.simulation import (
    Adaptive,
    Dynamic,
    FirstOrder,
    GaussSeidel,
    Midpoint,
    QuasiStatic,
    StewartTrinkle,
    simulate,
)
from fixel.testing.scenes import grasp, heap, micro_push, sliding_block

MOTIONS = [Dynamic(), QuasiStatic(), FirstOrder()]
STEPPERS = [Adaptive(), StewartTrinkle(step=0.02), Midpoint(step=0.02)]


def _same(scene, parameters=None, **method):
    compiled = simulate(scene, parameters, **method)
    plain = simulate(scene, parameters, plain=True, **method)
    assert plain.status == compiled.status
    assert plain.steps == compiled.steps
    assert plain.fallbacks == compiled.fallbacks
    assert plain.max_residual == compiled.max_residual
    assert np.array_equal(plain.time, compiled.time)
    for name in compiled.pose:
        assert np.array_equal(plain.pose[name], compiled.pose[name])
        assert np.array_equal(plain.twist[name], compiled.twist[name])
    assert np.array_equal(plain.contacts, compiled.contacts)
    for name, trace in compiled.pushers.items():
        assert np.array_equal(plain.pushers[name].force, trace.force)
        assert np.array_equal(plain.pushers[name].stalled, trace.stalled)


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: m.name)
@pytest.mark.parametrize("stepper", STEPPERS, ids=lambda s: s.name)
@pytest.mark.parametrize("interval", [None, 0.37])
def test_a_grasp_is_the_same_bits(motion, stepper, interval):
    _same(grasp("seated"), motion=motion, stepper=stepper, output_interval=interval)


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda m: m.name)
@pytest.mark.parametrize("stepper", STEPPERS, ids=lambda s: s.name)
def test_many_bodies_are_the_same_bits(motion, stepper):
    _same(heap(5), motion=motion, stepper=stepper, duration=1.0)


@pytest.mark.parametrize("stepper", STEPPERS, ids=lambda s: s.name)
def test_a_jam_is_the_same_bits(stepper):
    _same(grasp("seated", force_limit=None), stepper=stepper)
    _same(grasp("seated", force_limit=None), stepper=stepper, output_interval=1.0)


def test_others_are_the_same_bits():
    _same(micro_push(4, "p2"), motion=QuasiStatic())
    _same(sliding_block(), stepper=Adaptive(tolerance=1e-5))
    _same(grasp("slip"), solver=GaussSeidel(), duration=6.0)
    _same(grasp("slip"), Parameters(mu_support=0.3, tripod_radius=0.03), stepper=STEPPERS[1])
    _same(grasp("slip", support_directions=16), stepper=STEPPERS[2])
