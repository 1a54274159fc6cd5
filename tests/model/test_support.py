"""Nets of support points.
Supports: loads from statics, quadrature, refusals.
"""

from dataclasses import replace
from math import asinh, pi, sqrt
from timeit import repeat

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, strategies as st
from tests.fixtures import refused

from fixel import (
    Body,
    Disk,
    Ellipsoid,
    NoSupport,
    Polygon,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.errors import InvalidInput
from fixel.model import support_points
from fixel.model.support import INNER, OUTER, cells, support_grid

UNIT_SQUARE = Polygon([[0.03, 0.03], [-0.03, 0.03], [-0.03, -0.03], [0.03, -0.03]])
TURN = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
ELLIPSE = Polygon(np.column_stack((0.05 * np.cos(TURN), 0.03 * np.sin(TURN))))
HOOK = Polygon([[0.0, 0.0], [0.1, 0.0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.1], [0.0, 0.1]])


def test_a_square_has_corners_middles_and_centre():
    net, part = support_grid(UNIT_SQUARE)
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


@pytest.mark.parametrize("shape", [UNIT_SQUARE, ELLIPSE, Disk(0.04), HOOK])
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
        support_grid(UNIT_SQUARE, **sizes)


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


SQUARE = Polygon([[-1, -1], [1, -1], [1, 1], [-1, 1]])
ELL = Polygon([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
TRIANGLE = [[-1.0, -1.0], [2.0, -1.0], [0.0, 2.0]]


def balance(support, shape, com, mass=2.0, gravity=10.0):
    points, loads, _ = support_points(support, shape, com, mass, gravity)
    return loads.sum() / (mass * gravity), loads @ points / (mass * gravity)


def test_a_tripod_stands_about_the_centre_of_mass():
    points, loads, friction = support_points(
        Tripod(radius=0.5, friction=0.2, angle=pi / 2), SQUARE, (0.3, 0.1), 3.0, 10.0
    )
    assert points[0] == pytest.approx([0.0, 0.5])
    assert loads == pytest.approx([10.0] * 3)
    assert friction == pytest.approx([0.2] * 3)
    assert points.sum(axis=0) == pytest.approx([0, 0], abs=1e-15)


@given(st.floats(-0.9, 1.5), st.floats(-0.9, 1.5))
def test_three_points_carry_what_statics_says(x, y):
    assume(3 * y <= 6 - 4.5 * x and 3 * x - y >= -2)
    total, lever = balance(SupportPoints(points=TRIANGLE, friction=0.3), SQUARE, (x, y))
    assert total == pytest.approx(1.0)
    assert lever == pytest.approx([0, 0], abs=1e-12)


def test_a_centre_of_mass_outside_the_triangle_is_refused_with_its_weights():
    with pytest.raises(InvalidInput, match=r"outside the support triangle .*weights .*-0\.\d") as e:
        support_points(SupportPoints(points=TRIANGLE, friction=0.3), SQUARE, (-1, 1), 1.0, 9.81)
    assert e.value.where == "support.points.at"


def test_three_points_on_a_line_are_refused():
    support = SupportPoints(points=[[0, 0], [1, 0], [2, 0]], friction=0.3)
    refused(support_points, support, SQUARE, (0, 0), 1.0, 9.81, match="on one line")


def test_more_points_carry_equal_loads_or_those_given():
    four = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
    equal = SupportPoints(points=four, friction=0.3)
    assert support_points(equal, SQUARE, (0, 0), 4.0, 10.0)[1] == pytest.approx([10] * 4)
    given_loads = SupportPoints(points=four, friction=[0.1, 0.2, 0.3, 0.4], loads=[1, 2, 3, 4])
    _, loads, friction = support_points(given_loads, SQUARE, (0, 0), 4.0, 10.0)
    assert loads.tolist() == [1, 2, 3, 4]
    assert friction.tolist() == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(("build", "where"), [
    (lambda: SupportPoints(points=[[0, 0, 0]], friction=0.1), "points.at"),
    (lambda: SupportPoints(points=TRIANGLE, friction=[0.1, 0.2]), "points.friction"),
    (lambda: SupportPoints(points=TRIANGLE, friction=[0.1, 0.2, -1]), "points.friction[2]"),
    (lambda: SupportPoints(points=TRIANGLE, friction=0.1, loads=[1, 1, 1]), "points.loads"),
    (lambda: SupportPoints(points=[[0, 0]], friction=0.1, loads=[0.0]), "points.loads"),
    (lambda: SupportPoints(points=[[0, 0]], friction=0.1, loads=[-1.0]), "points.loads[0]"),
    (lambda: UniformPressure(friction=0.1, n_points=2), "uniform.n_points"),
    (lambda: UniformPressure(friction=0.1, n_points=3.5), "uniform.n_points"),
])  # fmt: skip
def test_a_support_that_cannot_be_is_refused(build, where):
    assert refused(build).where == where


def test_the_lever_of_even_pressure_under_a_disk():
    points, loads, _ = support_points(UniformPressure(friction=0.1), Disk(3.0), (0, 0), 1.0, 1.0)
    assert loads @ np.hypot(*points.T) == pytest.approx(2.0, rel=1e-3)
    assert loads.min() > 0
    assert 50 <= len(loads) <= 80


def test_the_lever_of_even_pressure_under_a_square():
    """Mean distance from the centre of a square of side 2 a: a (sqrt 2 + asinh 1) / 3."""
    exact = (sqrt(2) + asinh(1)) / 3
    errors = []
    for n_points in (64, 256, 1024):
        support = UniformPressure(friction=0.1, n_points=n_points)
        points, loads, _ = support_points(support, SQUARE, (0, 0), 1.0, 1.0)
        errors.append(abs(loads @ np.hypot(*points.T) - exact) / exact)
        assert len(loads) == n_points
    assert errors[0] < 0.012
    assert errors[2] < errors[0] / 12  # the centroid rule is of order two in the cell size


@pytest.mark.parametrize("shape", [SQUARE, ELL, Disk(1.3)])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.1, -0.05)])
def test_tilted_pressure_balances_the_weight(shape, offset):
    com = shape.centroid + offset
    total, lever = balance(UniformPressure(friction=0.1), shape, com)
    assert total == pytest.approx(1.0, abs=1e-14)
    assert lever == pytest.approx([0, 0], abs=1e-14)


def test_a_tilt_with_negative_pressure_is_refused():
    with pytest.raises(InvalidInput, match="negative at one end"):
        support_points(UniformPressure(friction=0.1), SQUARE, (0.8, 0.0), 1.0, 1.0)


def test_no_support_has_no_points_and_an_ellipsoid_none_to_give():
    points, loads, friction = support_points(NoSupport(), SQUARE, (0, 0), 1.0, 1.0)
    assert points.shape == (0, 2)
    assert loads.shape == friction.shape == (0,)
    with pytest.raises(InvalidInput, match="Ellipsoid"):
        support_points(Ellipsoid(force=1, torque=1), SQUARE, (0, 0), 1.0, 1.0)
