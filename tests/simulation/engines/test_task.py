"""Tests of simulations as plain numbers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixel import Body, Disk, Ellipsoid, Fixel, PathDrive, Plane, Polygon, Pusher, Scene, load_scene
from fixel.model.bodies import Spring
from fixel.model.support import UniformPressure
from fixel.simulation.engines.contract import fault, overlap
from fixel.simulation.engines.scripts import drive
from fixel.simulation.engines.task import bench_units, plain, task_from, task_of, unsupported
from fixel.testing.scenes import pushed_square

L_SHAPE = Polygon([(0, 0), (0.08, 0), (0.08, 0.03), (0.03, 0.03), (0.03, 0.09), (0, 0.09)])
PATH = np.array([(0.0, -0.01, 0.05, 0.0), (0.7, 0.02, 0.06, 0.0), (1.0, 0.03, 0.05, 0.2)])
SCENE = Scene(
    Body("part", L_SHAPE, mass=0.3, pose=(0.1, -0.2, 0.4), support=UniformPressure(friction=0.3)),
    Pusher("finger", Disk(0.005), friction=0.25, drive=PathDrive(PATH)),
    Fixel("peg", Disk(0.004), pose=(0.4, 0.1, 0.0), friction=0.15),
)
TIMES = np.array([0.1, 0.33, 0.7 + 1e-13, 1.5])


def test_a_task_survives_json():
    task, _ = task_of(SCENE, TIMES, {}, {"grip": 0.5})
    back = task_from(json.loads(json.dumps(plain(task))))
    assert plain(back) == plain(task)
    assert back.body.points.shape == task.body.points.shape


def test_parameters_mean_what_they_mean_to_fixel():
    values = {"mu_pusher": 0.11, "mu_fixel": 0.12, "mu_support": 0.4, "mass": 0.6}
    task, _ = task_of(SCENE, TIMES, values | {"contact_offset": 1e-3}, {})
    assert task.pusher.friction == 0.11
    assert task.fixels[0].friction == 0.12
    assert task.pusher.outline.radius == pytest.approx(0.006)
    assert task.body.mass == pytest.approx(0.6)
    assert set(task.body.friction.tolist()) == {0.4}
    # The weight of 0.6 kg on all points.
    assert float(task.body.loads.sum()) == pytest.approx(0.6 * 9.81)


def test_registration_moves_the_path():
    task, _ = task_of(SCENE, TIMES, {"registration_x": 2e-3, "registration_theta": np.pi / 2}, {})
    # A quarter turn about the origin of the world, then the shift.
    np.testing.assert_allclose(task.pusher.path[:, 1], -PATH[:, 2] + 2e-3, atol=1e-15)
    np.testing.assert_allclose(task.pusher.path[:, 2], PATH[:, 1], atol=1e-15)


def test_frames_return_to_the_scene():
    """The start of a task, whose frame is at the centre of mass, is the start of the body."""
    task, scene_poses = task_of(SCENE, TIMES, {}, {})
    body = SCENE.bodies[0]
    np.testing.assert_allclose(scene_poses(task.body.start), body.pose, atol=1e-15)
    moved = task.body.start + np.array([0.01, 0.0, 0.0])
    np.testing.assert_allclose(scene_poses(moved) - body.pose, [0.01, 0, 0], atol=1e-15)


def segments(task):
    """Return durations (n,), velocities (n, 3) and samples of the segments of a task."""
    model = {"choices": {"step": 1e-3}, **plain(task)}
    durations, velocities, samples = [], [], []
    for n, step, velocity, sample in drive.segments(model):
        assert step < 1e-3 * (1.0 + 1e-8)
        durations.append(n * step)
        velocities.append(velocity)
        samples.append(sample)
    return np.array(durations), np.array(velocities), samples


def test_segments_reach_every_sample_and_follow_the_path():
    task, _ = task_of(SCENE, TIMES, {}, {})
    duration, velocity, samples = segments(task)
    assert samples == [True, True, True, False, True]
    np.testing.assert_allclose(np.cumsum(duration), [0.1, 0.33, 0.7, 1.0, 1.5], atol=1e-12)
    way = np.cumsum(duration[:, None] * velocity, axis=0)
    np.testing.assert_allclose(way[2], PATH[1, 1:] - PATH[0, 1:], atol=1e-12)
    np.testing.assert_allclose(way[-1], PATH[2, 1:] - PATH[0, 1:], atol=1e-12)
    assert duration.min() > 1e-6


def test_a_sample_at_the_last_waypoint_is_one_end():
    task, _ = task_of(SCENE, np.array([0.5, 1.0, 1.5]), {}, {})
    assert segments(task)[0] == pytest.approx([0.5, 0.2, 0.3, 0.5])


PUSH = pushed_square()
ON_SPRING = replace(PUSH.bodies[0], spring=Spring(stiffness=10.0, anchor=np.zeros(2)))
BOUNCY = replace(PUSH.pushers[0], restitution=0.5)


@pytest.mark.parametrize(("scene", "found"), [
    (PUSH, ""),
    (replace(PUSH, plane=Plane(anisotropy=(1.1, 0.9))), "direction or place"),
    (replace(PUSH, bodies=(ON_SPRING,)), "a spring"),
    (replace(PUSH, bodies=(replace(PUSH.bodies[0], force=(0.1, 0.0, 0.0)),)), "a force"),
    (replace(PUSH, pushers=(BOUNCY,)), "restitution"),
])  # fmt: skip
def test_what_a_task_cannot_hold_is_said(scene, found):
    assert found in unsupported(scene)
    assert bool(unsupported(scene)) == bool(found)


MICRO = load_scene(str(Path(__file__).parents[3] / "examples/scenes/micro_push.yaml")).scene


def test_a_small_task_becomes_one_of_the_bench_with_the_same_motion():
    """Ratios without units, from which the motion follows, are those of the task in SI."""
    fixed = Fixel("peg", Disk(2e-4), pose=(0.0, 2e-3, 0.1), friction=0.15)
    task, _ = task_of(replace(MICRO, fixels=(fixed,)), np.array([1.0, 7.0]), {}, {})
    units = bench_units(task.body)
    found = units.task(task)

    def ratios(own):
        body, path = own.body, own.pusher.path
        size = float(np.ptp(body.outline.pieces[0][:, 0]))
        speed = np.hypot(*(path[1] - path[0])[1:3]) / path[1, 0]
        return [
            speed**2 / (own.gravity * size),
            body.inertia / (body.mass * size**2),
            own.times[-1] * speed / size,
            own.pusher.outline.radius / size,
            own.fixels[0].outline.radius / size,
            *(body.loads / (body.mass * own.gravity)).tolist(),
            *(body.points / size).ravel().tolist(),
            *((body.start - path[0, 1:])[:2] / size).tolist(),
            *((body.start - own.fixels[0].pose)[:2] / size).tolist(),
            path[-1, 3] - own.fixels[0].pose[2],
        ]

    assert ratios(found) == pytest.approx(ratios(task), rel=1e-12, abs=1e-12)
    assert found.gravity == task.gravity
    farthest = float(np.hypot(*found.body.outline.pieces[0].T).max())
    assert (farthest, found.body.mass) == (pytest.approx(0.05), pytest.approx(0.1))
    np.testing.assert_allclose(units.si_poses(found.body.start), task.body.start, atol=1e-18)


def test_a_task_of_the_bench_stays_as_it_is():
    task, _ = task_of(SCENE, TIMES, {}, {})
    assert bench_units(task.body).task(task) is task


def test_the_judge_is_as_strict_with_small_parts():
    """A finger of 12.5 micrometres passes through a part of 1.6 mm that does not move."""
    task, _ = task_of(MICRO, np.array([3.0, 7.0]), {}, {})
    still = np.repeat(task.body.start[None], 2, axis=0)
    assert "inside an obstacle" in fault(task, still)
    away = still + np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0]])
    assert "a jump" in fault(task, away)


def test_an_ellipsoid_keeps_its_arm():
    support = Ellipsoid(force=0.4, torque=0.012)
    scene = replace(pushed_square(), bodies=(replace(pushed_square().bodies[0], support=support),))
    task, _ = task_of(scene, TIMES, {}, {})
    assert task.body.arms.tolist() == [pytest.approx(0.03)]
    assert task.body.loads.tolist() == [pytest.approx(0.4)]


def test_the_judge_measures_overlap():
    """A body that stays where a pusher of radius 5 mm passes through its edge."""
    task, _ = task_of(pushed_square(), np.array([1.0, 2.0]), {}, {})
    still = np.repeat(task.body.start[None], 2, axis=0)
    way = task.pusher.path[-1, 1] - task.pusher.path[0, 1]
    assert overlap(task, still) == pytest.approx(way - 5e-3, abs=1e-9)  # it starts 5 mm away
    assert "inside an obstacle" in fault(task, still)
    along = still + np.array([[0.5 * way, 0.0, 0.0], [way, 0.0, 0.0]])
    assert fault(task, along) == ""


def test_a_path_that_began_before_the_push_is_at_its_place_at_time_zero() -> None:
    early = PATH[0] - [1.0, 0.02, -0.01, 0.3]
    begun = PathDrive(np.vstack((early, PATH[1:])))
    scene = replace(SCENE, pushers=(replace(SCENE.pushers[0], drive=begun),))
    task, _ = task_of(scene, TIMES, {}, {})
    assert task.pusher is not None
    assert task.pusher.path[0, 0] == 0.0
    duration, velocity, _ = segments(task)
    way = np.cumsum(duration[:, None] * velocity, axis=0)
    for place, time in zip(way, (0.1, 0.33, 0.7, 1.0, 1.5), strict=True):
        np.testing.assert_allclose(task.pusher.path[0, 1:] + place, begun.pose_at(time), atol=1e-12)


def test_a_path_that_begins_after_the_push_rests_until_then() -> None:
    late = PathDrive(PATH + np.array([0.4, 0.0, 0.0, 0.0]))
    scene = replace(SCENE, pushers=(replace(SCENE.pushers[0], drive=late),))
    task, _ = task_of(scene, np.array([0.2, 1.5]), {}, {})
    place, time = PATH[0, 1:], 0.0
    duration, velocity, _ = segments(task)
    for lasted, speed in zip(duration, velocity, strict=True):
        place, time = place + lasted * speed, time + lasted
        np.testing.assert_allclose(place, late.pose_at(time), atol=1e-12)
    assert duration[~velocity.any(axis=1)].sum() == pytest.approx(0.5)


def test_bodies_may_coast_and_pushers_return():
    """A finger that returns between two samples has pushed for 100 mm; the body slides on."""
    task, _ = task_of(pushed_square(), np.array([4.0]), {}, {})
    forth = np.array([(0.0, -0.055, 0.0, 0.0), (2.0, 0.045, 0.0, 0.0), (4.0, -0.055, 0.0, 0.0)])
    for path, end in ((forth, 0.1), (np.array([forth[0], [0.1, 0.045, 0.0, 0.0]]), 3.9)):
        pusher = task.pusher._replace(path=path)
        assert fault(task._replace(pusher=pusher), [[end, 0.0, 0.0]]) == ""
        assert "a jump" in fault(task._replace(pusher=pusher), [[end + 0.2, 0.0, 0.0]])
