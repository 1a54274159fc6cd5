"""Nets of support points."""

from dataclasses import replace
from timeit import repeat

import numpy as np
import pytest
import shapely

from fixel import Body, Disk, InvalidInput, Polygon, SupportPoints, UniformPressure
from fixel.model.footprint import INNER, OUTER, cells, support_grid

SQUARE = Polygon([[0.03, 0.03], [-0.03, 0.03], [-0.03, -0.03], [0.03, -0.03]])
TURN = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
ELLIPSE = Polygon(np.column_stack((0.05 * np.cos(TURN), 0.03 * np.sin(TURN))))
HOOK = Polygon([[0.0, 0.0], [0.1, 0.0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.1], [0.0, 0.1]])


def test_a_square_has_corners_middles_and_centre():
    net, part = support_grid(SQUARE)
    assert net.shape == (13, 2)
    assert part.tolist() == ["corner"] * 4 + ["edge"] * 4 + ["inside"] * 5
    assert np.abs(net[:4]).tolist() == pytest.approx(np.full((4, 2), 0.03 * OUTER))
    assert np.hypot(*net[4:8].T) == pytest.approx(np.full(4, 0.03 * OUTER))
    assert np.abs(net[8:12]).tolist() == pytest.approx(np.full((4, 2), 0.03 * INNER))
    assert net[12] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("shape", [ELLIPSE, Disk(0.04)], ids=["ellipse", "disk"])
def test_smooth_outlines_have_even_rings(shape):
    net, part = support_grid(shape)
    assert net.shape == (17, 2)
    assert part.tolist() == ["ring"] * 10 + ["inside"] * 7
    steps = np.hypot(*np.diff(net[:10], axis=0).T)
    assert np.ptp(steps) < 0.3 * steps.mean()


@pytest.mark.parametrize("shape", [SQUARE, ELLIPSE, Disk(0.04), HOOK])
def test_points_lie_inside_and_can_carry_a_body(shape):
    net, part = support_grid(shape)
    assert len(part) == len(net)
    inside = shapely.intersects_xy(shapely.Polygon(shape.outline), net[:, 0], net[:, 1])
    assert inside.all()
    assert len(np.unique(np.round(net, 9), axis=0)) == len(net)
    SupportPoints(points=net, friction=0.3)


@pytest.mark.parametrize("sizes", [{"outer": 1.0}, {"inner": 0.0}])
def test_rings_beyond_the_outline_are_refused(sizes):
    with pytest.raises(InvalidInput, match="number between 0 and 1"):
        support_grid(SQUARE, **sizes)


def test_cells_are_the_same_for_equal_shapes_and_cannot_be_written_to():
    points, share = cells(Polygon(ELLIPSE.vertices), 64)
    assert cells(ELLIPSE, 64)[0] is points
    with pytest.raises(ValueError, match="read-only"):
        points[0] = 0.0
    assert share @ points == pytest.approx(
        np.array(shapely.Polygon(ELLIPSE.outline).centroid.coords[0]), abs=1e-12
    )


def test_a_traced_outline_has_as_many_cells_as_requested():
    """A fan of triangles has one for each corner or more: 570 points instead of 64."""
    turn = np.arange(508) * (2.0 * np.pi / 508)
    radius = 0.05 * (1.0 + 0.3 * np.cos(2.0 * turn) + 0.1 * np.cos(4.0 * turn))
    corners = np.column_stack((radius * np.cos(turn), radius * np.sin(turn)))
    shape = Polygon(corners + np.array((0.2, 0.1)))

    points, share = cells(shape, 64)

    assert 40 <= len(points) <= 64
    assert share.sum() == pytest.approx(1.0)
    assert share.min() > 0.0
    assert share @ points == pytest.approx(shape.centroid, abs=1e-15)
    # Mean distance from the centroid, by the exact integral in polar coordinates.
    exact = (radius**3).sum() / (1.5 * (radius**2).sum())
    assert share @ np.hypot(*(points - shape.centroid).T) == pytest.approx(exact, rel=0.02)
    assert len(cells(shape, 3)[0]) == 4


def test_bodies_of_many_corners_are_built_again_as_fast_as_others():
    """A dataset builds its body once for every push, so the cells must not be cut each time."""
    took = {}
    for n in (4, 500):
        turn = np.arange(n) * (2.0 * np.pi / n)
        shape = Polygon(np.column_stack((0.05 * np.cos(turn), 0.04 * np.sin(turn))))
        body = Body("part", shape, mass=1.0, support=UniformPressure(friction=0.3))
        took[n] = min(repeat(lambda body=body: replace(body, pose=(0.1, 0.0, 0.0)), number=5))
    assert took[500] < 10.0 * took[4]  # 3 times; 40 times without the cells in memory
