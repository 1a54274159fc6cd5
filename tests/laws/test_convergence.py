"""Errors fall with the step at the order a stepper declares, and with the tolerance."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.model import Tripod
from fixel.simulation import Adaptive, Dynamic, Midpoint, QuasiStatic, StewartTrinkle, simulate
from fixel.testing.scenes import free_push, sliding_block, touching_pose

DURATION = 2.0


def _smooth_push(friction: float):
    """A box pushed off its middle by a finger: one contact, that keeps sliding or sticking."""
    scene = free_push(
        Tripod(radius=0.03, friction=0.3, angle=0.4), friction=friction, step=DURATION
    )
    pose = touching_pose([0.018, -0.05], -np.pi / 2, 0.15)
    return replace(scene, bodies=(replace(scene.bodies[0], pose=pose),))


def _final(scene, stepper, motion):
    run = simulate(scene, stepper=stepper, motion=motion, output_interval=scene.duration)
    assert run.converged
    return run.pose[scene.bodies[0].name][-1] * [1.0, 1.0, 0.04]


@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0])
@pytest.mark.parametrize(
    ("stepper", "slack"), [(StewartTrinkle, 0.15), (Midpoint, 0.2)], ids=["first", "second"]
)
def test_observed_order_is_the_declared_one(stepper, slack, friction):
    scene = _smooth_push(friction)
    exact = _final(scene, Midpoint(step=DURATION / 16384), QuasiStatic())
    steps = DURATION / np.array([16, 32, 64, 128, 256])
    error = [np.linalg.norm(_final(scene, stepper(step=h), QuasiStatic()) - exact) for h in steps]
    slope = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert slope == pytest.approx(stepper.order, abs=slack)


@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0])
def test_adaptive_error_follows_its_tolerance_in_a_push(friction):
    scene = _smooth_push(friction)
    exact = _final(scene, Midpoint(step=DURATION / 16384), QuasiStatic())
    tolerances = np.array([1e-4, 1e-5, 1e-6, 1e-7])
    error = np.array(
        [
            np.linalg.norm(_final(scene, Adaptive(tolerance=t), QuasiStatic()) - exact)
            for t in tolerances
        ]
    )
    # A few steps of that tolerance each, of which the second-order step uses up a part.
    assert (error < 10 * tolerances).all()
    assert error[-1] < 0.05 * error[0]


@pytest.mark.parametrize("speed", [0.1, 0.5])
def test_adaptive_error_follows_its_tolerance_when_sliding_to_rest(speed):
    scene = sliding_block(speed, 0.25, duration=0.5)
    stop = speed**2 / (2 * 0.25 * 9.81)
    for tolerance in (1e-4, 1e-5, 1e-6, 1e-7):
        error = abs(_final(scene, Adaptive(tolerance=tolerance), Dynamic())[0] - stop)
        assert error < 2 * tolerance
