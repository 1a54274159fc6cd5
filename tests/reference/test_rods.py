# Known answers A5-A8: closed forms for a line of supports, derived in the list of known answers;
# A8 is M. T. Mason (1986), Mechanics and planning of manipulator pushing operations.
"""Rods on many supports, or on two, and what pushes them."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from fixel import Body, QuasiStatic, Scene, StewartTrinkle, SupportPoints, simulate
from fixel.testing.scenes import box, free_push, touching_pose

HALF = 0.1  # [m] half-length a of the rod
WEIGHT = 0.2 * 9.81
MU = 0.3


def _line(n):
    x = HALF * ((2 * np.arange(n) + 1) / n - 1)
    return SupportPoints(points=np.column_stack((x, np.zeros(n))), friction=MU)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9, 1.0])
def test_A5_limit_curve_of_a_uniform_rod(share):
    d = share * HALF
    # d falls between two of the 400 supports, where the sums are exact. It turns about (d, 0).
    rod = Body(
        name="rod", shape=box(2 * HALF, 0.002), mass=0.2, pose=(0, 0, 0),
        velocity=(0.0, -d * 10.0, 10.0), support=_line(400),
    )  # fmt: skip
    h = 1e-7
    run = simulate(Scene(bodies=(rod,), duration=h), stepper=StewartTrinkle(step=h))
    change = (run.twist["rod"][-1] - rod.velocity) / h
    force, torque = -rod.mass * change[1], -rod.moment_of_inertia * change[2]
    # Over the step the centre of rotation moves by about 1e-7 of the rod, which tips no support,
    # and the change of a velocity near 10 keeps nine digits of sixteen.
    assert -force == pytest.approx(MU * WEIGHT * d / HALF, abs=1e-5)
    assert torque == pytest.approx(MU * WEIGHT * (HALF**2 - d**2) / (2 * HALF), abs=1e-6)
    ratio = force / (MU * WEIGHT)
    assert torque == pytest.approx(MU * WEIGHT * HALF / 2 * (1 - ratio**2), abs=1e-6)


def _push(support, along, step=1e-2):
    """Velocity (3,) and push force of a rod, pushed square at `along` from its centre.

    Rows are taken at the step's start, so the first velocity is the same for any step.
    """
    scene = free_push(support, shape=box(2 * HALF, 0.002), step=step, speed=0.01)
    pose = touching_pose([along, -0.001], -pi / 2, 0.0)
    scene = replace(scene, bodies=(replace(scene.bodies[0], pose=pose),))
    run = simulate(scene, motion=QuasiStatic(), stepper=StewartTrinkle(step=step))
    assert run.converged
    turn = np.array([[np.cos(pose[2]), np.sin(pose[2])], [-np.sin(pose[2]), np.cos(pose[2])]])
    v = run.twist["body"][-1]
    return np.append(turn @ v[:2], v[2]), run.pushers["finger"].force[-1]


def test_A6_uniform_rod_pushed_at_its_end():
    n = 2000
    velocity, force = _push(_line(n), HALF)
    spacing = 2 * HALF / n
    # The centre of rotation settles on the support nearest to it.
    assert -velocity[1] / velocity[2] == pytest.approx(-(sqrt(2) - 1) * HALF, abs=spacing)
    assert velocity[0] == pytest.approx(0.0, abs=1e-9)
    assert force == pytest.approx((sqrt(2) - 1) * MU * WEIGHT, rel=2 / n)


@pytest.mark.parametrize("b", [0.02, 0.06, 0.099])
def test_A7_two_supports_pivot_on_the_far_one(b):
    support = SupportPoints(points=[[b, 0.0], [-b, 0.0]], friction=MU)
    velocity, force = _push(support, HALF)
    # Exact but for the residual of the step, 1e-9 scaled.
    assert -velocity[1] / velocity[2] == pytest.approx(-b, rel=1e-7)
    assert force == pytest.approx(MU * WEIGHT * b / (HALF + b), rel=1e-7)


@pytest.mark.parametrize("seed", range(20))
def test_A8_push_through_the_centre_of_friction_does_not_turn(seed):
    rng = np.random.default_rng(seed)
    loads = rng.uniform(0.1, 1.0, 5)
    points = rng.uniform(-0.05, 0.05, (5, 2))
    points -= loads @ points / loads.sum()
    scene = free_push(SupportPoints(points=points, friction=MU, loads=loads), step=1e-2)
    pose = touching_pose([0.0, -0.05], -pi / 2, 0.0)
    scene = replace(scene, bodies=(replace(scene.bodies[0], pose=pose),))
    run = simulate(scene, motion=QuasiStatic(), stepper=StewartTrinkle(step=1e-2))
    assert np.abs(run.twist["body"][-1, 2]) * 0.05 < 1e-8 * 0.01  # residual 1e-9, scaled
    assert run.twist["body"][-1, :2] == pytest.approx([0.01, 0.0], abs=1e-10)
