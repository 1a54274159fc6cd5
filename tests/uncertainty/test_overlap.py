"""Depths against shapely and the model's own check; bodies set apart touch and do not overlap."""

import numpy as np
import pytest
import shapely

from fixel.model import Disk, Polygon, placed
from fixel.model.overlap import overlap_depth, overlaps
from fixel.testing.scenes import box
from fixel.uncertainty.start_ensemble import Neighbour, remove_overlap

NOTCHED = Polygon(np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]]) * 0.01)
SHAPES = {"disk": Disk(0.015), "box": box(0.05, 0.03), "notched": NOTCHED}


@pytest.mark.parametrize("first", SHAPES)
@pytest.mark.parametrize("second", SHAPES)
def test_depth_is_that_of_the_model(first, second):
    draw = np.random.default_rng(3)
    poses = draw.uniform((-0.05, -0.05, -3.0), (0.05, 0.05, 3.0), (60, 3))
    still = np.array([0.004, -0.003, 0.4])
    a, b = SHAPES[first], SHAPES[second]
    found = overlaps(a, poses, b, still)
    values = np.array([overlap_depth(a, pose, b, still) for pose in poses])
    np.testing.assert_allclose(found.depth, values, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*found.way.T), 1.0, atol=1e-12)


@pytest.mark.parametrize("shape", ["disk", "box"])
def test_convex_bodies_set_apart_touch_their_neighbour(shape):
    draw = np.random.default_rng(4)
    poses = draw.uniform((-0.03, -0.03, -3.0), (0.03, 0.03, 3.0), (80, 3))
    other = Neighbour("block", box(0.02, 0.02), np.array([0.0, 0.0, 0.3]))
    moved, reasons = remove_overlap(SHAPES[shape], poses, [other], most=0.1)

    assert reasons == [""] * 80
    before = overlaps(SHAPES[shape], poses, other.shape, other.pose).depth
    after = overlaps(SHAPES[shape], moved, other.shape, other.pose).depth
    assert (after < 1e-10).all()
    np.testing.assert_allclose(after[before > 0.0], 0.0, atol=1e-10)
    np.testing.assert_array_equal(moved[before <= 0.0], poses[before <= 0.0])
    np.testing.assert_array_equal(moved[:, 2], poses[:, 2])


def test_a_body_with_a_notch_leaves_it():
    other = Neighbour("peg", Disk(0.004), np.zeros(3))
    poses = np.column_stack((np.linspace(-0.03, 0.0, 40), np.full(40, -0.012), np.zeros(40)))
    moved, reasons = remove_overlap(NOTCHED, poses, [other], most=0.1)
    peg = shapely.Point(0.0, 0.0).buffer(0.004 * (1.0 - 1e-3), quad_segs=64)
    for pose, reason in zip(moved, reasons, strict=True):
        assert reason or not shapely.Polygon(placed(NOTCHED.outline, pose)).intersects(peg)
    assert not all(reasons)


def test_neighbours_that_were_moved_are_met_where_they_are():
    poses = np.array([[0.0, 0.024, 0.0]] * 2)
    moved = np.array([[0.0, 0.0, 0.0], [0.0, 0.005, 0.1]])
    other = Neighbour("peg", Disk(0.01), np.zeros(3), moved)
    found, _ = remove_overlap(Disk(0.015), poses, [other], most=0.1)
    np.testing.assert_allclose(found[:, 1], [0.025, 0.030], atol=1e-12)


def test_no_room_has_a_reason():
    walls = [
        Neighbour("left", box(0.02, 0.1), np.array([-0.018, 0.0, 0.0])),
        Neighbour("right", box(0.02, 0.1), np.array([0.018, 0.0, 0.0])),
    ]
    _, caught = remove_overlap(Disk(0.01), np.zeros((1, 3)), walls, most=0.1)
    assert caught[0].startswith("starts inside")
    _, far = remove_overlap(Disk(0.01), np.zeros((1, 3)), walls[:1], most=1e-4)
    assert "no free space" in far[0]
