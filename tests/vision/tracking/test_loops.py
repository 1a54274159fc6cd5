"""The compiled loops, against what they were made from."""

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens
from fixel.vision.tracking.loops import edges_expected, optics_of, seen_at
from fixel.vision.tracking.outline import OutlineEdges, plausible

LENSES = {
    "thesis": {"distortion": [0.0, -0.0536], "skew": 0.002},
    "all eight": {"distortion": [-0.1, 0.03, 1e-3, -2e-3, 0.01, 0.02, -0.01, 3e-3]},
    "fisheye": {"distortion": [0.02, -0.01, 3e-3, -1e-3], "fisheye": True},
}


def camera(name):
    lens = Lens(image_size=(640, 480), focal=(700.0, 710.0), centre=(321.0, 236.5), **LENSES[name])
    return Camera.looking_down(lens, 0.4, turned=0.3, tilted=(0.05, -0.03))


@pytest.mark.parametrize("name", LENSES)
def test_pixels_are_those_of_the_camera(name):
    seen = camera(name)
    for place in np.random.default_rng(1).uniform(-0.1, 0.1, (20, 2)):
        assert seen_at(seen, place, 0.03) == pytest.approx(seen.project_at(place, 0.03), abs=1e-9)
    assert seen_at(seen, seen.position[:2], 0.0) == pytest.approx(
        seen.project_at(seen.position[:2], 0.0), abs=1e-9
    )
    with pytest.raises(InvalidInput, match="behind the camera"):
        seen_at(seen, np.zeros(2), 0.5)


@pytest.mark.parametrize("name", LENSES)
def test_edges_move_with_the_pose_as_they_are_said_to(name):
    seen = camera(name)
    random = np.random.default_rng(2)
    angle = random.uniform(0.0, 2.0 * np.pi, 9)
    edges = OutlineEdges(
        point=random.uniform(-0.02, 0.02, (9, 2)),
        outward=np.column_stack((np.cos(angle), np.sin(angle))),
        height=np.full(9, 0.025),
        group=np.zeros(9, dtype=np.int64),
    )

    def at(pose):
        pixel, normal, slope = np.empty((9, 2)), np.empty((9, 2)), np.empty((9, 3))
        fine = edges_expected(
            optics_of(seen), np.array([7.0, 3.0]), edges.thing, pose, pixel, normal, slope
        )
        assert fine
        return pixel, normal, slope

    pose = np.array([0.01, -0.02, 0.7])
    pixel, normal, slope = at(pose)
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    places = edges.point @ turn.T + pose[:2]
    assert pixel == pytest.approx(seen.project_at(places, 0.025) - [7.0, 3.0], abs=1e-9)
    assert np.hypot(*normal.T) == pytest.approx(1.0)
    # Towards the bright side, and across the edge.
    step = 1e-4 * edges.outward @ turn.T
    ahead = seen.project_at(places + step, 0.025) - seen.project_at(places - step, 0.025)
    aside = step @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    along = seen.project_at(places + aside, 0.025) - seen.project_at(places - aside, 0.025)
    assert ((normal * ahead).sum(1) > 0.0).all()
    assert (normal * along).sum(1) == pytest.approx(0.0, abs=1e-5)
    for k, change in enumerate(1e-6 * np.eye(3)):
        moved = (at(pose + change)[0] - at(pose - change)[0]) / 2e-6
        assert slope[:, k] == pytest.approx((moved * normal).sum(1), rel=2e-3, abs=0.05)


def test_edges_of_other_brightness_are_no_edges_of_the_mark():
    found = np.column_stack((np.zeros(12), np.full(12, 30.0), np.full(12, 200.0)))
    found[2, 1], found[4, 2] = 110.0, 120.0
    group = np.repeat([0, 1], 6)
    clear = np.ones(12, dtype=np.bool_)
    clear[5] = False
    clear[9:] = False  # of the second mark, too few show to say what is usual
    usable = np.empty(12, dtype=np.bool_)
    assert plausible(found, group, clear, usable) == 3
    assert np.flatnonzero(usable).tolist() == [0, 1, 3]
