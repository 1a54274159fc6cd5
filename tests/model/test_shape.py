"""Polygons and disks: moments against shapely, orientation, refusals, convex pieces."""

from math import pi

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.model import Disk, Polygon, placed
from fixel.model.shape import is_convex

SQUARE = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
ELL = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]


@st.composite
def stars(draw):
    """Star-shaped polygons about the origin, from 4 micrometres to 4 metres across."""
    n = draw(st.integers(3, 24))
    size = draw(st.sampled_from([1e-6, 1e-3, 1.0]))
    radius = [draw(st.floats(0.2, 2.0)) for _ in range(n)]
    angle = np.arange(n) * (2 * pi / n) + draw(st.floats(0, 6.3))
    away = draw(st.sampled_from([0.0, 10.0]))
    return size * (
        away + np.array(radius)[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    )


def test_a_square_has_the_moments_of_a_square():
    square = Polygon(SQUARE)
    assert square.area == 4.0
    assert square.unit_inertia == pytest.approx(2 * 2**2 / 12, rel=1e-14)
    assert square.radius == pytest.approx(2**0.5)
    assert square.is_convex
    assert len(square.pieces) == 1
    assert square.pieces[0][1].all()


def test_clockwise_vertices_are_turned_round():
    assert Polygon(SQUARE[::-1]).area == 4.0
    assert Polygon(SQUARE[::-1]).centroid == pytest.approx([0, 0])


def test_repeated_closing_and_straight_vertices_are_taken_out():
    given = [SQUARE[0], SQUARE[0], [0, -1], *SQUARE[1:], SQUARE[0]]
    np.testing.assert_array_equal(Polygon(given).vertices, SQUARE)


def test_a_closing_vertex_on_a_straight_edge_is_taken_out():
    np.testing.assert_array_equal(Polygon([*SQUARE, [-1, 0.5]]).vertices, SQUARE)


@pytest.mark.parametrize(("vertices", "where", "words"), [
    ([[0, 0], [1, 1], [1, 0], [0, 1]], "polygon", "vertex 0 to 1 meets the edge from vertex 2"),
    ([[0, 0], [2, 0], [1, 0.5], [1, 0], [0, 1]], "polygon", "touches itself"),
    ([[0, 0], [2, 0], [1, 0]], "polygon", "no area"),
    ([[0, 0], [1, 0], [2, 0], [3, 0]], "polygon", "no area"),
    ([[0, 0], [1, 0], [1, 1], [1, 2], [1, 1]], "polygon", "itself"),
    ([[0, 0], [1, 0]], "polygon", "at least 3"),
    ([[0, 0], [1, 0], [0, 0], [0, 0]], "polygon", "at least 3"),
    ([[0, 0], [1, 0], [float("nan"), 1]], "polygon[2]", "finite"),
    ([[0, 0], [1, 0], [float("inf"), 1]], "polygon[2]", "finite"),
    ([], "polygon", "empty"),
    ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "polygon", "2 numbers"),
    ([[0, 0], [1]], "polygon", "2 numbers"),
    ("square", "polygon", "square"),
    ([[0, 0], [1e300, 0], [0, 1e300]], "polygon", "a size of 1e+300 m"),
    ([[0, 0], [1e-200, 0], [0, 1e-200]], "polygon", "a size of 1e-200 m"),
    ([[0, 0], [1, True], ["1", 0]], "polygon", "2 numbers"),
])  # fmt: skip
def test_a_polygon_that_cannot_be_is_refused(vertices, where, words):
    refusal = refused(Polygon, vertices)
    assert refusal.where == where
    assert words in str(refusal)


def test_a_star_drawn_in_one_line_is_refused():
    """It turns to the left at every corner, like a convex polygon, but twice around."""
    angle = np.arange(5) * (4 * pi / 5)
    refused(Polygon, np.column_stack((np.cos(angle), np.sin(angle))), match="crosses")


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=7))
def test_those_outlines_are_accepted_that_shapely_accepts(points):
    corners = [
        p for p, before in zip(points, points[-1:] + points[:-1], strict=True) if p != before
    ]
    try:
        Polygon(points)
    except InvalidInput:
        assert len(corners) < 3 or not shapely.Polygon(corners).is_valid
    else:
        assert shapely.Polygon(corners).is_valid


@pytest.mark.parametrize(
    "radius", [0.0, -1.0, 1e300, 1e-200, float("nan"), float("inf"), "1", True, None]
)
def test_a_disk_needs_a_positive_radius(radius):
    refused(Disk, radius, match="disk")


def test_a_disk_is_round():
    disk = Disk(2.0)
    assert disk.area == pytest.approx(4 * pi)
    assert disk.unit_inertia == 2.0
    assert np.hypot(*disk.outline.T) == pytest.approx(np.full(64, 2.0))
    assert disk.is_convex
    assert len(disk.pieces) == 1


def test_the_vertices_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        Polygon(SQUARE).vertices[0] = 3.0


def test_equal_shapes_are_equal():
    assert Polygon(SQUARE) == Polygon(np.array(SQUARE))
    assert hash(Polygon(SQUARE)) == hash(Polygon(SQUARE))
    assert Polygon(SQUARE) != Polygon(ELL)
    assert Disk(1.0) != Disk(2.0)
    assert Disk(1.0) != Polygon(SQUARE)


def test_points_are_placed_by_turning_then_moving():
    np.testing.assert_allclose(placed([[1.0, 0.0]], (2.0, 3.0, pi / 2)), [[2.0, 4.0]], atol=1e-15)


@given(stars())
def test_area_and_centroid_are_those_of_shapely(vertices):
    polygon, other = Polygon(vertices), shapely.Polygon(vertices)
    size = np.abs(vertices - vertices.mean(axis=0)).max()
    assert polygon.area == pytest.approx(other.area, rel=1e-9)
    assert polygon.centroid == pytest.approx([other.centroid.x, other.centroid.y], abs=1e-9 * size)


@given(stars())
def test_inertia_is_that_of_the_triangles_it_is_made_of(vertices):
    """Each triangle: its own second moment, (a^2 + b^2 + c^2) / 36 per area, and Steiner's part."""
    polygon = Polygon(vertices)
    total = 0.0
    for cell in shapely.constrained_delaunay_triangles(shapely.Polygon(vertices)).geoms:
        corners = np.array(cell.exterior.coords[:3])
        sides = np.sum((corners - np.roll(corners, 1, axis=0)) ** 2)
        away = np.sum((corners.mean(axis=0) - polygon.centroid) ** 2)
        total += cell.area * (sides / 36 + away)
    assert polygon.unit_inertia == pytest.approx(total / polygon.area, rel=1e-7)


@given(stars())
def test_pieces_are_convex_and_tile_the_polygon(vertices):
    polygon = Polygon(vertices)
    pieces = [Polygon(corners) for corners, _ in polygon.pieces]
    assert all(is_convex(corners) for corners, _ in polygon.pieces)
    assert sum(piece.area for piece in pieces) == pytest.approx(polygon.area, rel=1e-9)
    assert (len(pieces) == 1) == polygon.is_convex == is_convex(polygon.vertices)
    assert len(pieces) <= max(1, len(polygon.vertices) - 2)


@given(stars())
def test_the_edges_on_the_outline_are_those_of_the_polygon(vertices):
    polygon = Polygon(vertices)
    n = len(polygon.vertices)
    number = {tuple(v): k for k, v in enumerate(polygon.vertices.tolist())}
    seen = []
    for corners, on_outline in polygon.pieces:
        loop = [number[tuple(v)] for v in corners.tolist()]
        seen += [
            (i, j) for i, j, out in zip(loop, loop[1:] + loop[:1], on_outline, strict=True) if out
        ]
    assert sorted(seen) == [(k, (k + 1) % n) for k in range(n)]


def test_an_l_has_two_pieces():
    assert len(Polygon(ELL).pieces) == 2
