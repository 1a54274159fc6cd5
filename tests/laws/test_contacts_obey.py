"""What every contact of every step obeys: no tension, inside the cone, no overlap, solved."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.laws.scenes import SIZE, scenes

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
