"""Candidates of pushes: free at the start, and aimed at the part."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from tests.fixtures import refused

from fixel import Body, Disk, Fixel, PairFriction, Polygon, Pusher, Scene, UniformPressure
from fixel.model import placed
from fixel.parts.next_pushes import push_candidates
from fixel.testing.scenes import box

U_SHAPE = [(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (0.004, 0.05), (0.004, -0.03),
           (-0.004, -0.03), (-0.004, 0.05), (-0.05, 0.05)]  # fmt: skip


def _body(shape, pose=(0.0, 0.0, 0.0)):
    return Body("part", shape, mass=0.5, pose=pose, support=UniformPressure(friction=0.3))


def _gap(scene, way=0.0):
    """Gap between tip and part after a part of the way, with the part at rest."""
    (tip,) = scene.pushers
    corners = placed(scene.bodies[0].shape.outline, scene.bodies[0].pose)
    at = tip.pose[:2] + way * tip.drive.direction
    return shapely.distance(shapely.Polygon(corners), shapely.Point(at)) - 0.005


@pytest.mark.parametrize(
    "shape",
    [box(0.1, 0.06), Disk(0.04), Polygon(U_SHAPE)],
    ids=["box", "disk", "concave with a narrow notch"],
)
def test_candidates_start_next_to_the_part_and_move_towards_it(shape):
    body = _body(shape, pose=(0.2, -0.1, 0.7))
    scenes = push_candidates(body, contacts=40, travel=0.03, speed=0.02)
    assert len(scenes) >= 60
    for scene in scenes:
        assert 0.0 <= _gap(scene) < 3e-4
        assert scene.duration == pytest.approx(1.5)
        assert _gap(scene, 2e-3) < 0.0


def test_directions_are_the_normal_and_twenty_degrees_to_either_side():
    scenes = push_candidates(_body(box(0.1, 0.1)), contacts=4)
    angles = [math.degrees(math.atan2(*own.pushers[0].drive.direction[::-1])) for own in scenes]
    to_axis = np.abs((np.array(angles) + 45.0) % 90.0 - 45.0).reshape(4, 3)
    np.testing.assert_allclose(to_axis, [[20.0, 0.0, 20.0]] * 4, atol=1e-6)


def test_contacts_behind_a_fixel_are_left_out():
    body = _body(box(0.1, 0.1))
    fixel = Fixel("fixel", Disk(0.01), pose=(0.0612, 0.0, 0.0), friction=0.3)
    free = push_candidates(Scene(bodies=(body,), duration=1.0), contacts=40)
    some = push_candidates(Scene(bodies=(body,), fixels=(fixel,), duration=1.0), contacts=40)
    assert 0 < len(free) - len(some) <= 24
    assert all(np.hypot(*(own.pushers[0].pose[:2] - fixel.pose[:2])) > 0.015 for own in some)


def test_the_tip_of_a_scene_is_used():
    scene = push_candidates(_body(box(0.1, 0.1)), radius=0.008, friction=0.5)[0]
    (tip,) = push_candidates(scene, radius=0.001)[3].pushers
    assert (tip.shape.radius, tip.friction) == (0.008, 0.5)


def polygon_pusher():
    scene = push_candidates(_body(box(0.1, 0.1)))[0]
    tip = scene.pushers[0]
    square = Pusher("tip", box(0.01, 0.01), pose=tip.pose, drive=tip.drive, friction=0.2)
    return replace(scene, pushers=(square,))


def two_bodies():
    scene = push_candidates(_body(box(0.1, 0.1)))[0]
    other = Body("other", box(0.05, 0.05), mass=0.5, pose=(1.0, 0.0, 0.0))
    pair = PairFriction(pair=("part", "other"), friction=0.3)
    return replace(scene, bodies=(*scene.bodies, other), contact_friction=(pair,))


@pytest.mark.parametrize(("part", "options", "where"), [
    (_body(box(0.1, 0.1)), {"radius": 0.0}, "radius"),
    (_body(box(0.1, 0.1)), {"travel": -0.1}, "travel"),
    (_body(box(0.1, 0.1)), {"speed": math.nan}, "speed"),
    (_body(box(0.1, 0.1)), {"contacts": 0}, "contacts"),
    (polygon_pusher(), {}, "part"),
    (two_bodies(), {}, "part"),
    ("a square", {}, "part"),
])  # fmt: skip
def test_bad_input_is_rejected(part, options, where):
    assert refused(push_candidates, part, **options).where == where


def test_an_outline_of_thousands_of_vertices_is_quick():
    turn = np.linspace(0.0, 2.0 * np.pi, 5001)[:-1]
    wavy = (0.05 + 1e-4 * np.cos(7 * turn))[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
    assert len(push_candidates(_body(Polygon(wavy)), contacts=24)) == 72
