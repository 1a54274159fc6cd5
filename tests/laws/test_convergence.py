"""Errors fall with the step at the order a stepper declares, and with the tolerance."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.model import (
    Body,
    Disk,
    Fixel,
    LineDrive,
    PairFriction,
    Polygon,
    Pusher,
    Scene,
    SupportPoints,
    Tripod,
)
from fixel.simulation import Adaptive, Dynamic, Midpoint, QuasiStatic, StewartTrinkle, simulate
from fixel.testing.scenes import box, free_push, sliding_block, touching_pose

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
    # At coarse tolerances the longest step already limits the error.
    assert error[-1] < 0.15 * error[0]


@pytest.mark.parametrize("speed", [0.1, 0.5])
def test_adaptive_error_follows_its_tolerance_when_sliding_to_rest(speed):
    scene = sliding_block(speed, 0.25, duration=0.5)
    stop = speed**2 / (2 * 0.25 * 9.81)
    for tolerance in (1e-4, 1e-5, 1e-6, 1e-7):
        error = abs(_final(scene, Adaptive(tolerance=tolerance), Dynamic())[0] - stop)
        assert error < 2 * tolerance


def _gaps(finger, motion, n_steps):
    """Gaps [m] of a square and the finger that turns it, after each step, from their poses."""
    part = Body(
        "part", Polygon.rectangle(0.1, 0.1), mass=0.15, pose=(0.0, 0.0, 0.3),
        support=Tripod(radius=0.038, friction=0.25),
    )  # fmt: skip
    head = Pusher(
        "head", finger, friction=0.3, pose=(-0.08, 0.015, 0.0), drive=LineDrive(speed=0.02)
    )
    step = 2.0 / n_steps
    scene = Scene((part,), (head,), duration=2.0)
    run = simulate(scene, motion=motion, stepper=Midpoint(step=step), output_interval=step)
    x, y, angle = run.pose["part"].T
    c, s = np.cos(angle), np.sin(angle)
    away = run.pose["head"][:, 0] - x
    if isinstance(finger, Disk):
        return 0.05 + 0.005 + c * away + s * (run.pose["head"][:, 1] - y)
    corners = [c * a - s * b for a in (-0.05, 0.05) for b in (-0.05, 0.05)]
    return np.min(corners, axis=0) - 0.005 - away


@pytest.mark.parametrize("motion", [QuasiStatic(), Dynamic()], ids=["quasistatic", "dynamic"])
@pytest.mark.parametrize(
    "finger", [Disk(0.005), Polygon.rectangle(0.01, 0.2)], ids=["disk", "edge"]
)
def test_a_contact_of_turning_bodies_stays_closed_to_third_order(finger, motion):
    coarse, fine = (np.abs(_gaps(finger, motion, n)[-n // 4 :]).max() for n in (40, 80))
    assert coarse < 1.5e-6
    assert fine < 0.2 * coarse  # an eighth; of the second order, a quarter


@pytest.mark.parametrize("tolerance", [None, 1e-6, 1e-8])
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("press", [0.05, 0.2])
@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_a_block_slides_along_a_slower_one_as_far_as_friction_lets_it(
    speed, press, friction, tolerance
):
    """Both stop after v^2 / 2a; the rail, which slides along a smooth wall, stops first."""
    feet = 0.01 * np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])
    rail = Body(
        "rail", box(0.6, 0.04), mass=5.0, pose=(0.2, -0.02, 0.0), velocity=(speed, 0.0, 0.0),
        support=SupportPoints(points=feet * [20.0, -1.5], friction=0.6),
    )  # fmt: skip
    block = Body(
        "block", box(0.04, 0.04), mass=0.1, pose=(0.0, 0.02, 0.0), velocity=(0.5, 0.0, 0.0),
        force=(0.0, -press, 0.0), support=SupportPoints(points=feet, friction=0.2),
    )  # fmt: skip
    wall = Fixel("wall", box(1.0, 0.02), pose=(0.2, -0.05, 0.0), friction=0.0)
    pair = PairFriction(pair=("rail", "block"), friction=friction)
    scene = Scene((rail, block), fixels=(wall,), contact_friction=(pair,), duration=0.5)
    run = simulate(scene, stepper=tolerance and Adaptive(tolerance=tolerance))
    slowing = 0.2 * 9.81 + friction * press / 0.1
    assert run.final["block"].x == pytest.approx(0.5**2 / (2.0 * slowing), abs=5e-6)
    way = 0.5 * speed**2 / (0.6 * 9.81 - friction * press / 5.0)
    assert run.final["rail"].x == pytest.approx(0.2 + way, abs=1e-6)
