# RPI thesis, section 1.3.3: the actuator stalls at 34.3 N, which ends a grasp; the bound of
# 1e-9 m is ours: Coulomb friction sticks, it does not creep.
"""What is held does not move: blocks inside the friction cone, and a seated grasp."""

import time
from dataclasses import replace

import numpy as np
import pytest

from fixel import Adaptive, Dynamic, GaussSeidel, Newton, QuasiStatic, StewartTrinkle, simulate
from fixel.model import Body, Fixel, LineDrive, Pusher, Scene, SupportPoints, Tripod
from fixel.simulation import Midpoint
from fixel.testing.scenes import STALL_FORCE, box, grasp

STEPPERS = [Adaptive(), StewartTrinkle(step=0.01), Midpoint(step=0.01)]


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
@pytest.mark.parametrize("share", [0.5, 0.999])
def test_block_inside_the_cone_holds_for_a_minute(stepper, motion, share):
    reach = share * 0.3 * 0.5 * 9.81
    block = Body(
        name="block", shape=box(0.1, 0.05), mass=0.5, pose=(0.1, 0.2, 0.3),
        support=Tripod(radius=0.03, friction=0.3), force=(0.6 * reach, -0.8 * reach, 0.0),
    )  # fmt: skip
    run = simulate(Scene(bodies=(block,), duration=60.0), motion=motion, stepper=stepper)
    assert run.converged
    assert np.abs(run.pose["block"][-1] - block.pose).max() < 1e-9


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("solver", [Newton(), GaussSeidel()])
def test_gripped_block_holds_for_a_minute_against_a_side_force(stepper, solver):
    block = Body(
        name="block", shape=box(0.1, 0.1), mass=0.2, pose=(0, 0, 0),
        support=SupportPoints(points=[[0.01, 0], [-0.01, 0], [0, 0.01], [0, -0.01]], friction=1e-6),
        force=(0.0, 1.5, 0.0),
    )  # fmt: skip
    jaw = Pusher(
        name="jaw", shape=box(0.02, 0.06), pose=(-0.06, 0, 0),
        drive=LineDrive(direction=(1, 0), speed=0.01, force_limit=5.0), friction=0.3,
    )  # fmt: skip
    wall = Fixel(name="wall", shape=box(0.02, 0.06), pose=(0.06, 0, 0), friction=0.3)
    scene = Scene(bodies=(block,), pushers=(jaw,), fixels=(wall,), duration=60.0)
    # Two faces of 5 N at 0.3 hold 3 N, twice the force.
    run = simulate(scene, stepper=stepper, solver=solver)
    assert run.converged
    assert run.pushers["jaw"].stalled[1:].all()
    assert run.pushers["jaw"].force[-1] == pytest.approx(5.0, rel=1e-6)
    assert np.abs(run.pose["block"][-1]).max() < 1e-9


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
def test_seated_grasp_comes_to_rest_and_stays(stepper, motion):
    run = simulate(grasp("seated"), motion=motion, stepper=stepper, output_interval=0.1)
    assert run.converged
    trace = run.pushers["actuator"]
    assert trace.stalled[-1]
    assert trace.force[-1] == pytest.approx(STALL_FORCE, rel=1e-9)
    # From 7 s on, a second after the last peg is met, nothing moves at all.
    late = run.time >= 7.0
    assert late.sum() > 30
    for poses in run.pose.values():
        assert np.ptp(poses[late], axis=0).max() < 1e-9
    assert len(run.touching) >= 2


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("motion", [Dynamic(), QuasiStatic()])
def test_rigid_drive_jams_and_keeps_what_came_before(stepper, motion):
    run = simulate(grasp("seated", force_limit=None), motion=motion, stepper=stepper)
    assert run.status == "jammed"
    assert "force_limit" in run.advice
    assert 4.0 < run.stopped_at < 7.0
    assert run.time[-1] == pytest.approx(run.stopped_at)
    assert len(run.time) > 5
    # Up to there it is the grasp of the force-limited drive, which no limit has held yet.
    held = simulate(grasp("seated"), motion=motion, stepper=stepper)
    early = 0.8 * run.stopped_at
    a, b = (r["object"].at(early) for r in (run, held))
    # An adaptive step may end elsewhere: its tolerance, a thousandth of 44 mm, a few times over.
    assert np.abs(a - b).max() < (2e-3 if isinstance(stepper, Adaptive) else 1e-8)


def test_jammed_samples_end_where_it_stopped():
    run = simulate(grasp("seated", force_limit=None), output_interval=0.5)
    assert run.status == "jammed"
    assert run.time[-1] == pytest.approx(run.stopped_at)
    assert np.isfinite(run.pose["object"]).all()
    longer = replace(grasp("seated", force_limit=None), duration=run.stopped_at * 0.9)
    assert simulate(longer).converged


def test_a_jam_costs_no_more_than_a_few_ordinary_rollouts():
    """It cost up to eleven: thirty trials of a step, each by every means of the solver."""
    cost = {}
    for limit in (None, STALL_FORCE):
        scene = grasp("seated", force_limit=limit)
        spent = []
        for _ in range(6):
            start = time.process_time()
            run = simulate(scene, output_interval=1.0)
            spent.append(time.process_time() - start)
        cost[limit] = min(spent)
        assert run.status == ("jammed" if limit is None else "converged")
    assert cost[None] < 2.5 * cost[STALL_FORCE]
