"""Beliefs after a pose was seen during a plan."""

import numpy as np
import pytest

import fixel
from fixel import Belief, FreePushes, PoseRegion, StartError
from fixel.planning.seen import belief_after
from fixel.testing.scenes import pushed_square
from fixel.units import deg, mm

CAMERA = StartError(x=0.1 * mm, y=0.1 * mm, theta=0.1 * deg, kind="normal")


@pytest.fixture(scope="module")
def plan():
    goal = PoseRegion((0.02, 0.05, 1.0), position=8 * mm, angle=8 * deg)
    return fixel.plan(
        pushed_square(), goal, FreePushes(most=2, length=(10 * mm, 60 * mm)),
        Belief(parameters={"friction_centre_y": (-6 * mm, 6 * mm)}),
        rollouts=4_000, progress=False,
    )  # fmt: skip


@pytest.mark.system
def test_the_seen_pose_tells_the_pressure_centre_of_the_run(plan):
    """A world is simulated apart from the plan; its end after one push leads back to its value."""
    assert len(plan.pushes) == 2
    for truth in (-4 * mm, 3 * mm):
        end = fixel.simulate(plan.scenes[0], {"friction_centre_y": truth}, motion="quasistatic")
        found = belief_after(plan, end["part"].pose[-1], 1, CAMERA).belief
        drawn = np.array([own["friction_centre_y"] for own in found.parameters])
        assert drawn.mean() == pytest.approx(truth, abs=0.7 * mm)
        assert drawn.std() < 0.7 * mm


def test_a_pose_unlike_all_runs_says_nothing(plan):
    found = belief_after(plan, np.array([0.5, 0.5, 1.0]), 1, CAMERA)
    assert "unlike the planned runs" in found.note
    assert found.belief.parameters == plan.belief.parameters


def test_before_the_first_push_only_the_start_is_new(plan):
    found = belief_after(plan, plan.start[0], 0, CAMERA)
    assert found.belief.start == CAMERA
    assert found.belief.parameters == plan.belief.parameters
