"""Scenes of rows, and rigid motions of scenes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.model import Disk, Fixel, LineDrive, PathDrive, PlannedExperiment, Polygon, Scene, Spring
from fixel.sampling import about_part, eight_push_plan, table_plan, thesis_plan
from fixel.sampling.plan import scene_problems
from fixel.sampling.rows import moved, moved_onto, row_scene
from fixel.testing.scenes import micro_push

PUSH = thesis_plan().experiments[0].scene


def matrix(pose):
    """Homogeneous matrix of a pose."""
    x, y, angle = pose
    return np.array(
        [
            [math.cos(angle), -math.sin(angle), x],
            [math.sin(angle), math.cos(angle), y],
            [0.0, 0.0, 1.0],
        ]
    )


def between(scene, first, second):
    """Pose of one thing in the frame of another, as a matrix."""
    things = {thing.name: thing for thing in (*scene.bodies, *scene.pushers, *scene.fixels)}
    return np.linalg.inv(matrix(things[first].pose)) @ matrix(things[second].pose)


@pytest.mark.parametrize("pose", [(0.3, -0.2, 2.5), (0.0, 0.0, -3.0)])
def test_a_moved_scene_has_the_same_poses_within_it(pose):
    scene = moved_onto(PUSH, PUSH.pushers[0].pose, pose)

    np.testing.assert_allclose(scene.pushers[0].pose, pose, atol=1e-12)
    for other in ("actuator", *(fixel.name for fixel in PUSH.fixels)):
        np.testing.assert_allclose(
            between(scene, "object", other), between(PUSH, "object", other), atol=1e-12
        )
    angle = math.atan2(*scene.pushers[0].drive.direction[::-1])
    assert math.remainder(angle - pose[2], math.tau) == pytest.approx(0.0, abs=1e-12)


def test_paths_velocities_forces_and_springs_are_moved_too():
    path = PathDrive([(0.0, 0.0, 0.0, 0.0), (1.0, 0.05, 0.0, 0.1)])
    spring = Spring(stiffness=2.0, anchor=(0.03, 0.01))
    body = replace(PUSH.bodies[0], velocity=(0.01, 0.0, 2.0), force=(0.0, 3.0, 0.5), spring=spring)
    scene = replace(PUSH, bodies=(body,), pushers=(replace(PUSH.pushers[0], drive=path),))
    new = moved(scene, (0.1, 0.2, math.pi / 2))

    np.testing.assert_allclose(new.bodies[0].velocity, [0.0, 0.01, 2.0], atol=1e-12)
    np.testing.assert_allclose(new.bodies[0].force, [-3.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(new.bodies[0].spring.anchor, [0.09, 0.23], atol=1e-12)
    np.testing.assert_allclose(
        new.pushers[0].drive.waypoints,
        [[0.0, 0.1, 0.2, math.pi / 2], [1.0, 0.1, 0.25, math.pi / 2 + 0.1]],
        atol=1e-12,
    )


@pytest.mark.parametrize("pose", [None, (0.01, -0.02, 1.0)])
def test_pushes_about_the_part_are_the_same_pushes(pose):
    rows = table_plan().experiments[:9]
    fixed = about_part(rows, pose)
    wanted = rows[0].scene.bodies[0].pose if pose is None else pose

    assert [row.name for row in fixed] == [row.name for row in rows]
    for old, new in zip(rows, fixed, strict=True):
        assert tuple(new.scene.bodies[0].pose) == tuple(wanted)
        np.testing.assert_allclose(
            between(new.scene, "object", "actuator"),
            between(old.scene, "object", "actuator"),
            atol=1e-12,
        )
        assert not any(name.startswith("place_") for name in new.conditions)
        assert new.conditions["axis"] == "list"


def test_the_eight_pushes_come_from_eight_sides_of_the_part():
    """Five pushes on the long side, from -x; three on the short one, a quarter turn away."""
    fixed = about_part(eight_push_plan().experiments, (0.0, 0.0, 0.0))[::3]
    ways = [tuple(np.round(row.scene.pushers[0].drive.direction, 12) + 0.0) for row in fixed]

    assert ways == [(1.0, 0.0)] * 5 + [(0.0, -1.0)] * 3
    assert about_part(()) == ()


def test_values_of_a_row():
    scene = row_scene(PUSH, {"x_m": 0.15, "angle_rad": 0.3, "fixel-2_y_m": 0.05, "head_x_m": -0.01})

    assert scene.bodies[0].pose.tolist() == [0.15, PUSH.bodies[0].pose[1], 0.3]
    assert scene.pushers[0].pose.tolist() == [-0.01, 0.0, 0.0]
    assert scene.fixels[1].pose[1] == 0.05
    assert scene.fixels[0] == PUSH.fixels[0]
    assert scene.duration == PUSH.duration


def test_the_motion_of_a_row():
    values = {"direction_rad": math.pi / 6, "travel_m": 0.06, "speed_m_s": 0.02}
    scene = row_scene(PUSH, values)
    drive = scene.pushers[0].drive

    np.testing.assert_allclose(drive.direction, [math.sqrt(3) / 2, 0.5])
    assert (drive.travel, drive.speed, drive.force_limit) == (0.06, 0.02, 34.3)
    assert scene.duration == pytest.approx(3.0)


def test_offsets_are_along_the_motion_and_about_the_centroid():
    """In a scene that was turned by a quarter, an offset to the left is one along -x."""
    plan = thesis_plan()
    square = plan.shapes[0]
    for k, (x, y, theta) in enumerate([(0.01, -0.016, 0.0), (0.0, 0.0, 0.4)]):
        values = {"offset_x_m": x, "offset_y_m": y, "offset_angle_rad": theta}
        turned = moved(PUSH, (0.0, 0.0, math.pi / 2))
        part = row_scene(turned, values).bodies[0]
        old = turned.bodies[0]
        centre = (matrix(part.pose) @ [*square.shape.centroid, 1.0])[:2]
        before = (matrix(old.pose) @ [*square.shape.centroid, 1.0])[:2]
        np.testing.assert_allclose(centre - before, [-y, x], atol=1e-12), k
        assert part.pose[2] - old.pose[2] == pytest.approx(theta)


def test_a_measured_path_becomes_a_straight_drive():
    """At rest for a second, 20 mm/s along 30 degrees for 2 s, at rest for another."""
    time = np.linspace(0.0, 4.0, 121)
    way = 0.02 * np.clip(time - 1.0, 0.0, 2.0)
    x, y = way * math.cos(math.pi / 6), way * math.sin(math.pi / 6)
    noise = np.random.default_rng(1).normal(0.0, 5e-5, len(time))
    path = PathDrive(np.column_stack((time, x, y + noise, 0.0 * time)), force_limit=9.0)
    scene = replace(PUSH, pushers=(replace(PUSH.pushers[0], drive=path),))
    drive = row_scene(scene, {}).pushers[0].drive

    assert isinstance(drive, LineDrive)
    assert math.degrees(math.atan2(*drive.direction[::-1])) == pytest.approx(30.0, abs=0.3)
    assert drive.travel == pytest.approx(0.04, abs=2e-4)
    assert drive.speed == pytest.approx(0.02, rel=0.03)
    assert drive.force_limit == 9.0
    short = PathDrive([(0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.05, 0.0)])
    drive = row_scene(replace(PUSH, pushers=(replace(PUSH.pushers[0], drive=short),)), {})
    assert drive.pushers[0].drive.speed == pytest.approx(0.025)
    assert drive.duration == pytest.approx(2.0)
    curved = PathDrive(np.column_stack((time, x, 40.0 * x * x, 0.0 * time)))
    with pytest.raises(InvalidInput, match="straight"):
        row_scene(replace(PUSH, pushers=(replace(PUSH.pushers[0], drive=curved),)), {})


def test_a_drive_without_end_stops_with_its_scene():
    drive = LineDrive(speed=0.02)
    scene = replace(PUSH, pushers=(replace(PUSH.pushers[0], drive=drive),), duration=3.0)

    assert row_scene(scene, {}).pushers[0].drive.travel == pytest.approx(0.06)


def test_other_scenes_are_refused():
    two = Scene(
        bodies=PUSH.bodies,
        fixels=(Fixel(name="peg", shape=Disk(0.005), pose=(1.0, 0.0, 0.0), friction=0.2),),
        duration=1.0,
    )
    refused(row_scene, two, {}, match="one free body and one pusher")
    refused(row_scene, PUSH, {"fixel-9_x_m": 0.1}, match=r"fixel-9_x_m: .* fixel needs one of")
    endless = replace(PUSH.pushers[0], drive=LineDrive(speed=0.02))
    with pytest.raises(InvalidInput, match=r"drive: found inf mm at 20 mm/s"):
        row_scene(replace(PUSH, pushers=(endless,), duration=None), {})
    refused(row_scene, PUSH, {"x_m": 0.05}, match="overlap")
    assert PlannedExperiment(name="a", scene=row_scene(micro_push(), {})).scene


def test_a_push_in_another_direction_is_checked_along_it():
    """Push straight down from the far left, on the part and past it."""
    x, y, _ = PUSH.bodies[0].pose
    values = {"head_x_m": x, "head_y_m": y + 0.12, "direction_rad": -math.pi / 2}
    open_plate = replace(PUSH, fixels=())

    assert [*scene_problems(row_scene(open_plate, values))] == []
    passed = row_scene(open_plate, values | {"head_x_m": x + 0.1})
    assert [*scene_problems(passed)] == ["the head passes the object without contact"]
    (short,) = scene_problems(row_scene(open_plate, values | {"travel_m": 0.01}))
    assert short.startswith("the head stops")


def test_fixels_of_any_shape_are_checked():
    """A bar across the way, of 60 mm, is reached; the same bar far aside is not."""
    bar = Polygon.rectangle(0.01, 0.06)
    for y, words in ((0.0, []), (0.4, ["the object cannot reach a fixel"])):
        fixel = Fixel(name="bar", shape=bar, pose=(0.24, y, 0.0), friction=0.2)
        found = [*scene_problems(row_scene(replace(PUSH, fixels=(fixel,)), {}))]
        assert [sentence.partition(":")[0] for sentence in found] == words
