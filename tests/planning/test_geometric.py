"""Closed-form pushes against other models of the same motion."""

from math import pi

import numpy as np
import pytest
import shapely
from tests import closed_form

from fixel import Belief, FreePushes, InvalidInput, simulate_batch
from fixel.model import Body, Disk, Ellipsoid, LineDrive, Polygon, PoseRegion, Pusher, Scene
from fixel.planning.candidates import plans_of_mechanics
from fixel.planning.geometric import fence_pushes, geometric_pushes, point_push
from fixel.planning.plan import simulator_of
from fixel.planning.pushes import outline_points

ARM = 0.03
PART = Body(
    "part", Polygon.rectangle(0.10, 0.06), mass=1.0, support=Ellipsoid(force=1.0, torque=ARM)
)


@pytest.mark.parametrize("offset", [0.0, 0.004, -0.01])
def test_a_point_push_agrees_with_the_differential_equation_of_the_ellipsoid(offset, monkeypatch):
    monkeypatch.setattr(closed_form, "TIP", 0.0)
    way = 0.03
    _, poses, tips = closed_form.push(1.0, offset, speed=0.02, duration=way / 0.02)
    contact = (-closed_form.SIDE / 2, offset)
    moved = point_push(contact, 0.0, tips[:, 0] - tips[0, 0], closed_form.LEVER)
    assert np.abs(moved - poses).max() < 1e-6


def simulated(part, numbers, friction, tip=1e-4):
    """Ends (n, 3) of pushes by a small tip, in the frame of the part before them."""
    ends = []
    for share, angle, length in numbers:
        point, inward = (x[0] for x in outline_points(part.shape, np.array([share])))
        c, s = np.cos(angle), np.sin(angle)
        direction = np.array([[c, -s], [s, c]]) @ inward
        start = (*(point - tip * inward), 0.0)
        drive = LineDrive(direction, speed=length)
        pusher = Pusher("tip", Disk(tip), pose=start, drive=drive, friction=friction)
        ends.append(Scene(part, pusher, duration=1.0))
    return np.array([run.final[0, 0] for run in simulate_batch(ends, motion="quasistatic")])


def size(moved):
    return np.hypot(*moved[:2]) + ARM * abs(moved[2])


@pytest.mark.parametrize(
    "wanted",
    [(0.02, 0.0, 0.0), (0.0, 0.03, 0.3), (-0.03, 0.0, -0.2), (0.01, -0.04, 0.15), (0.0, 0.02, 0.0)],
)
def test_the_first_push_ends_near_the_displacement_in_the_simulator(wanted):
    numbers = geometric_pushes(PART, wanted, friction=0.4, tool_radius=1e-4)
    assert numbers.shape == (32, 3)
    assert size(simulated(PART, numbers[:1], 0.4)[0] - wanted) < 0.2 * size(wanted)


def test_displacements_are_those_of_the_frame_and_not_of_the_centre_of_mass():
    com = np.array([0.2, 0.1])
    support = Ellipsoid(force=1.0, torque=ARM, centre=com)
    offset = Body("part", Polygon(PART.shape.outline + com), mass=1.0, support=support)
    moved = point_push((-0.05, 0.01), 0.0, 0.03, ARM)
    c, s = np.cos(moved[2]), np.sin(moved[2])
    wanted = np.append(moved[:2] + com - np.array([[c, -s], [s, c]]) @ com, moved[2])
    assert size(wanted - moved) > 0.5 * size(moved)
    numbers = geometric_pushes(offset, wanted, friction=0.5)
    assert size(simulated(offset, numbers[:1], 0.5)[0] - wanted) < 0.2 * size(moved)


@pytest.mark.parametrize("turns", [-1, 1, 2])
def test_a_displacement_by_more_than_half_a_turn_is_the_one_the_other_way(turns):
    near = geometric_pushes(PART, (0.02, 0.005, -0.2), n=5)
    same = geometric_pushes(PART, (0.02, 0.005, 2.0 * pi * turns - 0.2), n=5)
    np.testing.assert_allclose(same, near, atol=1e-9)


def test_a_goal_with_symmetry_has_pushes_by_its_smallest_turn():
    """A square that is wanted at 80 degrees, or a quarter turn from it, turns by 10 back."""
    body = Body("part", Polygon.rectangle(0.1, 0.1), mass=1.0, support=PART.support)
    tool = Pusher(
        "tip", Disk(1e-3), pose=(-0.2, 0.0, 0.0), drive=LineDrive(speed=0.01), friction=0.3
    )
    scene = Scene(bodies=(body,), pushers=(tool,), duration=1.0)
    choice = FreePushes(length=(5e-3, 80e-3))
    found = []
    for degrees, symmetry in ((-10.0, 1), (80.0, 4)):
        goal = PoseRegion(
            (0.02, 0.005, np.radians(degrees)), position=1e-3, angle=0.01, symmetry=symmetry
        )
        simulator = simulator_of(scene, goal, choice, Belief(), None, None, 1)
        found.append({np.round(own, 6).tobytes() for own in plans_of_mechanics(simulator)})
    assert found[0]
    assert found[0] <= found[1]


def test_pushes_through_the_centre_are_offered_where_edges_allow_it():
    assert geometric_pushes(PART, (0.03, 0.0, 0.0))[0] == pytest.approx([0.90625, 0.0, 0.03])
    support = Ellipsoid(force=1.0, torque=ARM, centre=(0.1 / 3, 0.04 / 3))
    shape = Polygon([(0, 0), (0.1, 0), (0, 0.04)])
    triangle = Body("part", shape, mass=1.0, support=support)
    first = geometric_pushes(triangle, (0.0, 0.02, 0.0), friction=0.0)[0]
    length = shapely.LinearRing(triangle.shape.outline).length
    assert first == pytest.approx([0.1 / 3 / length, 0.0, 0.02], abs=1e-9)


def test_contacts_that_the_tool_does_not_reach_are_left_out():
    notch = [(0, 0), (0.1, 0), (0.1, 0.06), (0.053, 0.06), (0.053, 0.02), (0.047, 0.02),
             (0.047, 0.06), (0, 0.06)]  # fmt: skip
    part = Body("part", Polygon(notch), mass=1.0, support=Ellipsoid(force=1.0, torque=ARM))
    for radius, inside in ((0.001, True), (0.01, False)):
        numbers = geometric_pushes(part, (0.0, -0.02, 0.0), tool_radius=radius, n=1000)
        point, _ = outline_points(part.shape, numbers[:, 0])
        deep = (np.abs(point[:, 0] - 0.05) < 0.004) & (point[:, 1] < 0.05) & (point[:, 1] > 0.01)
        assert deep.any() == inside


def test_lengths_and_angles_stay_in_their_ranges():
    numbers = geometric_pushes(PART, (0.05, 0.02, 1.0), angle=pi / 8, length=(0.01, 0.03), n=500)
    assert numbers[:, 2].min() >= 0.01
    assert numbers[:, 2].max() <= 0.03
    assert np.abs(numbers[:, 1]).max() <= pi / 8
    assert len(np.unique(numbers[:, :2], axis=0)) == len(numbers)


@pytest.mark.parametrize("wanted", [(0, 0, 0), (np.nan, 0, 0), (1, 2)])
def test_a_displacement_that_is_none_is_refused(wanted):
    with pytest.raises(InvalidInput, match="displacement"):
        geometric_pushes(PART, wanted)


def test_mechanics_propose_nothing_for_a_goal_that_is_met_already():
    """Also where a symmetric pose of the goal is the start."""
    square = Body("part", Polygon.rectangle(0.06, 0.06), mass=1.0, support=PART.support)
    choose = FreePushes(tool=Disk(0.002))
    goal = PoseRegion((0.02, 0.0, 0.0), position=0.1, angle=0.1, symmetry=4)
    near = PoseRegion((0.0, 0.0, pi / 2), position=0.1, angle=0.1, symmetry=4)
    for own, some in ((goal, True), (near, False)):
        scene = choose.prepared(Scene(square, duration=1.0))
        plans = plans_of_mechanics(simulator_of(scene, own, choose, Belief(), None, None, None))
        assert len(plans) >= 32 * some


def test_plans_by_a_fence_keep_to_the_largest_angle():
    wide = {"most": 2, "length": (0.0, 0.2)}
    [plan] = fence_pushes(PART, 0.3, angle=0.8, **wide)
    assert np.abs(plan[:, 1]).max() == pytest.approx(pi / 4, abs=0.01)
    assert fence_pushes(PART, 0.3, angle=0.7, **wide) == []
    assert fence_pushes(PART, 0.3, angle=0.8, most=1, length=(0.0, 0.2)) == []


def test_half_a_turn_is_the_same_to_either_side():
    square = Polygon.rectangle(0.1, 0.1)
    part = Body("part", square, mass=1.0, support=Ellipsoid(force=1.0, torque=0.038))
    left, right = (geometric_pushes(part, (0.02, 0.0, turn), n=64) for turn in (pi, -pi))
    np.testing.assert_allclose(np.sort(left, axis=0), np.sort(right, axis=0), atol=1e-9)
    # Of an outline that is its own mirror image, so are the pushes: half of them turn it each way.
    np.testing.assert_allclose(np.sort(left[:8, 1]), -np.sort(left[:8, 1])[::-1], atol=1e-9)
