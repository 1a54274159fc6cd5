# Known answer: K. M. Lynch, M. T. Mason (1996), Stable pushing: mechanics, controllability, and
# planning, for an ellipsoidal limit surface.
"""Pushes by a tool that turns, which a flush part follows rigidly within the stable bound."""

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

import fixel
from fixel import Body, Ellipsoid, FreePushes, InvalidInput, Polygon, PoseRegion, Scene
from fixel.formats.goal_file import goal_file_from_dict
from fixel.planning.corrections import CorrectionTable
from fixel.planning.plan import simulator_of
from fixel.planning.pushes import PlanPush
from fixel.units import deg, mm

HALF, WIDE, ARM, FRICTION = 50 * mm, 30 * mm, 41 * mm, 0.5
FLUSH = 0.875  # middle of the left side, as a share of the way round
TOOL = Polygon([(-10 * mm, -WIDE), (0, -WIDE), (0, WIDE), (-10 * mm, WIDE)])
LENGTH = 60 * mm


def scene():
    part = Body(
        "part", Polygon.rectangle(2 * HALF, 2 * HALF), mass=0.2,
        support=Ellipsoid(force=0.5, torque=0.5 * ARM),
    )  # fmt: skip
    return Scene((part,), duration=1.0)


def frame(pose):
    """Return the homogeneous matrix of a pose."""
    x, y, angle = pose
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def bound():
    """Return the largest curvature [rad/m] at which the part stays on the tool.

    With the tool's front at the origin and the part's centre `HALF` ahead, the part moves with
    (1, HALF w, w). The forces at both ends of the front have the resultant (1, HALF w) and the
    torque ARM^2 w about the centre. They are within the friction cones, and push at both ends.
    """
    return min(FRICTION / HALF, WIDE / (HALF**2 + ARM**2))


def pushed(turn):
    """Return pose of the part after a push, and the pose that it has if it follows the tool."""
    choose = FreePushes(tool=TOOL, friction=FRICTION, turn=(-2.0, 2.0))
    own = choose.prepared(scene())
    numbers = choose.numbers([PlanPush(FLUSH, 0.0, LENGTH, turn)])
    path = choose.motions(own, numbers, np.zeros((1, 3))).path[0]
    tool = replace(own.pushers[0], pose=path[0, 1:], drive=fixel.PathDrive(path))
    run = replace(own, pushers=(tool,), duration=float(path[-1, 0]))
    end = fixel.simulate(run, motion="quasistatic")["part"].pose[-1]
    touch, last = path[1, 1:], path[-2, 1:]
    return frame(end), frame(last) @ np.linalg.inv(frame(touch)), path


@pytest.mark.parametrize("turn", [-1.5, -0.9, -0.3, 0.3, 0.9, 1.5])
def test_a_flush_part_follows_a_tool_that_turns_gently_and_no_other(turn):
    end, rigid, _ = pushed(turn * bound() * LENGTH)
    off = np.abs(end - rigid)
    if abs(turn) < 1.0:
        assert off.max() < 2e-3
        assert off[:2, 2].max() < 0.05 * mm
    else:
        assert off[:2, :2].max() > 0.02


def test_the_tool_moves_along_an_arc_in_its_own_direction():
    _, _, path = pushed(1.2)
    on = path[1:-1]
    steps, angle = np.diff(on[:, 1:3], axis=0), on[:, 3]
    middle = 0.5 * (angle[1:] + angle[:-1])
    assert np.allclose(np.arctan2(steps[:, 1], steps[:, 0]), middle, atol=1e-12)
    radius = LENGTH / 1.2
    centre = on[:, 1:3] + radius * np.column_stack((-np.sin(angle), np.cos(angle)))
    assert np.ptp(centre, axis=0) == pytest.approx(0.0, abs=1e-12)
    assert angle[-1] - angle[0] == pytest.approx(1.2)
    back = path[-1] - path[-2]
    assert np.arctan2(-back[2], -back[1]) == pytest.approx(angle[-1])
    assert path[-1, 0] == pytest.approx((2 * 0.25 * np.hypot(HALF, HALF) + LENGTH) / 0.02)


@pytest.mark.system
def test_one_turning_push_reaches_what_no_straight_one_does():
    goal = PoseRegion((48 * mm, 19.5 * mm, 15 * deg), position=3 * mm, angle=3 * deg)
    straight = FreePushes(tool=TOOL, friction=FRICTION, length=(5 * mm, 60 * mm), angle=1e-6)
    start = fixel.StartError(x=0.5 * mm, y=0.5 * mm, theta=0.5 * deg, kind="uniform")
    belief = fixel.Belief(start=start)
    turning = replace(straight, turn=(-0.6, 0.6))
    plan = fixel.plan(scene(), goal, turning, belief, rollouts=8_000, progress=False)
    assert plan.success.mean > 0.9
    assert plan.pushes[0].turn > 0.0
    assert "turning by +" in str(plan.pushes[0])
    try:
        other = fixel.plan(scene(), goal, straight, belief, rollouts=8_000, progress=False)
    except InvalidInput:
        return
    assert other.success.mean < 0.5


def test_a_plan_that_turns_can_be_stored_and_named_in_a_goal_file(tmp_path):
    raw = {
        "fixel": 1,
        "goal": {"pose": {"pose_mm_deg": [30, 0, 0], "position_mm": 8}},
        "choose": {"free": {"turn_deg": [-20, 20]}},
    }
    found = goal_file_from_dict(raw)
    assert found.choose.turn == pytest.approx((-20 * deg, 20 * deg))
    plan = fixel.plan(scene(), found.goal, found.choose, rollouts=1_000, progress=False)
    assert fixel.load(plan.save(tmp_path / "turn.plan")) == plan


def test_turns_that_are_none():
    refused(FreePushes, turn=(0.2, -0.2), match=r"choose\.turn")
    refused(FreePushes().numbers, [PlanPush(0.5, 0.0, 0.02, 0.1)], match=r"first: .*do not turn")


@pytest.mark.parametrize("turn", [None, (-0.5, 0.5)])
def test_shorter_corrections_turn_less(turn):
    """Poses on the way of the longest push are the ends of the shorter ones, simulated whole."""
    choose = FreePushes(
        tool=TOOL, friction=FRICTION, length=(5 * mm, 40 * mm), angle=0.2, turn=turn
    )
    goal = PoseRegion((20 * mm, 0.0, 0.0), position=3 * mm)
    simulator = simulator_of(
        choose.prepared(scene()), goal, choose, fixel.Belief(), None, None, None
    )
    table = CorrectionTable.of(simulator, fixel.Belief(), 8_000, seed=3)
    rows = np.random.default_rng(0).choice(len(table.numbers), 60, replace=False)
    ends = simulator.planned(table.numbers[rows][:, None]).nominal.pose[:, -1]
    off = np.abs(ends - table.moved[rows, 0])
    assert np.median(off[:, :2]) < 0.01 * mm
    assert np.quantile(off, 0.9, axis=0) == pytest.approx(0.0, abs=2e-3)


def test_corrections_are_of_a_part_away_from_obstacles():
    """The table has the part at the origin, wherever the obstacles of the scene are."""
    near = [(55 * mm, -60 * mm), (60 * mm, -60 * mm), (60 * mm, 60 * mm), (55 * mm, 60 * mm)]
    goal = PoseRegion((20 * mm, 0.0, 0.0), position=3 * mm)
    tables = []
    for obstacles in ((), (near,)):
        choose = FreePushes(length=(5 * mm, 40 * mm), obstacles=obstacles)
        own = choose.prepared(scene())
        simulator = simulator_of(own, goal, choose, fixel.Belief(), None, None, None)
        tables.append(CorrectionTable.of(simulator, fixel.Belief(), 8_000, seed=3))
    assert np.array_equal(tables[0].moved, tables[1].moved)
