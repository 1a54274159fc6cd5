"""What every contact of every step obeys: no tension, inside the cone, no overlap, solved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.laws.scenes import SIZE, scenes

from fixel.model import (
    Body,
    Disk,
    LineDrive,
    PairFriction,
    Parameters,
    Pusher,
    Scene,
    SupportPoints,
    UniformPressure,
)
from fixel.model.overlap import overlap_depth
from fixel.simulation import (
    Adaptive,
    Dynamic,
    FirstOrder,
    Midpoint,
    QuasiStatic,
    StewartTrinkle,
    simulate,
)
from fixel.testing.scenes import box, grasp

STEPPERS = st.sampled_from([StewartTrinkle(step=2e-3), Midpoint(step=2e-3), Adaptive()])


@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic(), FirstOrder()])
@given(scene=scenes(), stepper=STEPPERS)
@settings(max_examples=25)
def test_every_step_is_solved_and_every_contact_lawful(motion, scene, stepper):
    run = simulate(scene, motion=motion, stepper=stepper)
    assert run.converged
    assert run.max_residual <= 1e-9
    names = run.names
    contacts = run.contacts
    mu = np.array([scene.friction(names[c["body"]], names[c["other"]]) for c in contacts])
    normal, tangent = contacts["normal_force"], contacts["tangential_force"]
    # A residual of 1e-9 is one of impulses in scaled units; over the step it is a force.
    scale = max(1.0, float(normal.max(initial=0.0)))
    assert (normal >= -1e-6 * scale).all()
    assert (np.abs(tangent) <= mu * normal + 1e-6 * scale).all()
    assert (contacts["gap"] >= -1e-9 * SIZE).all()
    assert np.abs(np.hypot(*contacts["normal"].T) - 1.0).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
@given(scene=scenes())
@settings(max_examples=25)
def test_bodies_do_not_overlap(motion, scene):
    run = simulate(scene, motion=motion, output_interval=0.05)
    assert run.converged
    things = [*scene.bodies, *scene.pushers]
    for k in range(len(run.time)):
        placed = [(x.shape, run.pose[x.name][k]) for x in things]
        placed += [(f.shape, f.pose) for f in scene.fixels]
        for i in range(len(scene.bodies)):
            for j in range(i + 1, len(placed)):
                # Gaps are linear within a step, and an adaptive step turns a body by as much as its
                # tolerance, a thousandth of the characteristic length, allows: a few of those.
                assert overlap_depth(*placed[i], *placed[j]) < 5e-3 * SIZE


def test_a_solve_that_overflows_spoils_no_later_one():
    """Newton runs away to infinity in this step; what comes after starts from clean scratch."""
    scene = grasp("slip")
    start = (0.10795308789546092, -0.015154788518290451, 0.8789603337067221)
    scene = replace(scene, bodies=(replace(scene.bodies[0], pose=start),))
    parameters = Parameters(
        mu_support=0.17738638050666652,
        mu_pusher=0.2513407470464373,
        mu_fixel=0.1383765442752435,
        tripod_radius=0.025712024944277413,
    )
    run = simulate(scene, parameters, motion=QuasiStatic())
    assert run.converged
    assert run.max_residual <= 1e-9


def test_three_bodies_before_a_plate_are_solved_without_inertia():
    """Found by Hypothesis among random scenes; it once defeated the solver chain."""
    points = [(0.01, 0.0), (0.0, 0.012), (-0.008, -0.01), (0.004, -0.002)]
    support = SupportPoints(points=points, friction=0.05)
    even = UniformPressure(friction=0.05, n_points=12)
    bodies = (
        Body(name="a", shape=Disk(0.01), mass=0.05, pose=(-0.005, -0.08, -3), support=support),
        Body(name="b", shape=Disk(0.01), mass=0.05, pose=(0.07, -0.005, -3), support=support),
        Body(name="c", shape=box(0.01, 0.01), mass=0.05, pose=(-0.005, 0.07, -3), support=even),
    )
    drive = LineDrive(direction=(1, 0), speed=0.152426, travel=0.06)
    plate = Pusher(
        name="plate", shape=box(0.01, 0.3), pose=(-0.06, 0, 0), drive=drive, friction=0.01863
    )
    scene = Scene(
        bodies=bodies,
        pushers=(plate,),
        contact_friction=(PairFriction(pair=("*", "*"), friction=0.01863),),
        duration=0.5,
    )
    assert simulate(scene, motion=QuasiStatic(), stepper=StewartTrinkle(step=0.005)).converged
