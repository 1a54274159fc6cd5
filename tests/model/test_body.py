"""Free bodies, pushers, fixels, plane: values left out, refusals."""

import pickle
from math import inf, pi

import numpy as np
import pytest
from tests.fixtures import refused

from fixel import Body, Disk, LineDrive, PathDrive, Plane, Polygon, Pusher, SupportPoints, Tripod
from fixel.model import FrictionMap, Spring

SQUARE = Polygon([[0, 0], [2, 0], [2, 2], [0, 2]])


def body(**changes):
    return Body(**{"name": "object", "shape": SQUARE, "mass": 3.0, "pose": (0, 0, 0), **changes})


def pusher(**changes):
    drive = LineDrive(direction=(1, 0), speed=0.1)
    fields = {"name": "p", "shape": Disk(1.0), "pose": (0, 0, 0), "drive": drive, "friction": 0.2}
    return Pusher(**{**fields, **changes})


def test_inertia_and_centre_of_mass_left_out_are_those_of_uniform_density():
    assert body().com == pytest.approx([1, 1])
    assert body().moment_of_inertia == pytest.approx(3.0 * 4 / 6)


def test_inertia_left_out_is_about_the_centroid_also_when_the_centre_of_mass_is_elsewhere():
    assert body(centre_of_mass=(0.5, 1)).moment_of_inertia == pytest.approx(3.0 * 4 / 6)
    assert body(centre_of_mass=(0.5, 1)).com == pytest.approx([0.5, 1])
    assert body(inertia=7.0).moment_of_inertia == 7.0


def test_bodies_are_compared_by_value_and_can_be_pickled():
    one = body(support=Tripod(radius=1, friction=0.1), spring=Spring(stiffness=1, anchor=(0, 0)))
    assert pickle.loads(pickle.dumps(one)) == one
    assert len({one, body(), body()}) == 2


NO_WEIGHT = SupportPoints(points=[[0, 0], [1, 0], [0, 0.5]], friction=0.1)


@pytest.mark.parametrize(("build", "where"), [
    (lambda: body(pose=(0, 0, inf)), "body 'object'.pose"),
    (lambda: body(force=None), "body 'object'.force"),
    (lambda: body(shape="square"), "body 'object'.shape"),
    (lambda: body(support=0.25), "body 'object'.support"),
    (lambda: body(spring=1.0), "body 'object'.spring"),
    (lambda: body(name=""), "body.name"),
    (lambda: body(name=3), "body.name"),
    (lambda: body(support=NO_WEIGHT), "body 'object'.support.points.at"),
    (lambda: pusher(pose=None), "pusher 'p'.pose"),
    (lambda: pusher(drive="north"), "pusher 'p'.drive"),
    (lambda: LineDrive(speed=1, direction=(0, 0)), "drive.direction"),
    (lambda: LineDrive(speed=1, travel=float("nan")), "drive.travel"),
    (lambda: Plane(anisotropy=(1, 0)), "plane.anisotropy"),
    (lambda: Plane(axis=inf), "plane.axis"),
    (lambda: Plane(friction_map=[[1]]), "plane.friction_map"),
    (lambda: FrictionMap(origin=(0, 0), cell=(0, 1), factor=[[1]]), "friction_map.cell"),
    (lambda: FrictionMap(origin=(0, 0), cell=(1, 1), factor=[]), "friction_map.factor"),
    (lambda: FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[]]), "friction_map.factor"),
    (lambda: FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[1, 1], [1, -1]]),
     "friction_map.factor[1][1]"),
])  # fmt: skip
def test_what_cannot_be_is_refused(build, where):
    assert refused(build).where == where


def test_the_direction_of_a_drive_is_scaled_once():
    drive = LineDrive(direction=(3, 4), speed=0.1)
    assert drive.direction == pytest.approx([0.6, 0.8])
    assert LineDrive(direction=drive.direction, speed=0.1) == drive
    assert drive.travel == inf


def test_a_path_says_where_the_pusher_starts():
    drive = PathDrive(waypoints=[[-1, 0, 0, 0], [1, 2, 4, 1]])
    assert pusher(drive=drive, pose=None).pose == pytest.approx([1, 2, 0.5])
    assert pusher(drive=drive).pose == pytest.approx([1, 2, 0.5])
    late = PathDrive(waypoints=[[1, 2, 4, 1], [2, 0, 0, 0]])
    assert pusher(drive=late, pose=None).pose == pytest.approx([2, 4, 1])


@pytest.mark.parametrize(("waypoints", "where", "words"), [
    ([[0, 0, 0, 0], [2, 1, 0, 0], [1, 2, 0, 0]], "drive.waypoints[2]", "has decreasing times"),
    ([[0, 0, 0, 0], [0, 1, 0, 0]], "drive.waypoints[1]", "has repeated times"),
    ([[0, 0, 0, 3.1], [1, 0, 0, -3.1]], "drive.waypoints[1]", "unwrap"),
    ([[0, 0, 0, 0], [1, 0, float("nan"), 0]], "drive.waypoints[1]", "finite"),
    ([], "drive.waypoints", "empty"),
    ([[0, 0, 0]], "drive.waypoints", "4 numbers"),
])  # fmt: skip
def test_a_path_that_cannot_be_driven_is_refused(waypoints, where, words):
    assert refused(PathDrive, waypoints=waypoints, match=words).where == where


def test_half_a_turn_between_samples_is_fine():
    assert PathDrive(waypoints=[[0, 0, 0, 0], [1, 0, 0, pi]]).waypoints[-1, 3] == pi


def test_a_friction_map_is_bilinear_and_constant_beyond_its_border():
    grid = FrictionMap(origin=(1, 2), cell=(2, 1), factor=[[1, 2, 3], [3, 4, 5]])
    at = grid.at([[1, 2], [2, 2], [1, 2.5], [3, 2.5], [-9, -9], [99, 99], [5, 3]])
    np.testing.assert_allclose(at, [1, 1.5, 2, 3, 1, 5, 5])
    assert FrictionMap(origin=(0, 0), cell=(1, 1), factor=[[2.0]]).at((5, 5)) == 2.0
