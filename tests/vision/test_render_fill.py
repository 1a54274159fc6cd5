"""Exact shares of pixels: areas, clipping, neighbours that share an edge."""

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st

from fixel.vision.render.canvas import FilledPolygons, PictureWindow, cover, painter, window_of

WIDTH, HEIGHT = 24, 18


def shares(points):
    mask = np.zeros((HEIGHT, WIDTH), np.float32)
    room = np.zeros((HEIGHT, WIDTH + 2))
    cover(mask, room, np.asarray(points, float))
    assert not room.any()  # left as it was found
    return mask


@given(
    st.lists(st.tuples(st.floats(-9, 33), st.floats(-9, 27)), min_size=3, max_size=3, unique=True)
)
def test_a_triangle_covers_its_own_area_wherever_it_is(corners):
    inside = shapely.Polygon(corners).intersection(
        shapely.box(-0.5, -0.5, WIDTH - 0.5, HEIGHT - 0.5)
    )
    assert shares(corners).sum() == pytest.approx(inside.area, abs=2e-3)


def test_each_pixel_gets_the_share_that_shapely_finds():
    corners = [(2.2, 1.1), (20.7, 4.4), (15.3, 15.9), (9.9, 8.8), (3.1, 13.2)]
    polygon = shapely.Polygon(corners)
    found = shares(corners)
    for row in range(HEIGHT):
        for column in range(WIDTH):
            pixel = shapely.box(column - 0.5, row - 0.5, column + 0.5, row + 0.5)
            assert found[row, column] == pytest.approx(polygon.intersection(pixel).area, abs=1e-6)


def test_pixel_zero_has_its_middle_at_the_origin():
    assert shares([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])[0, 0] == pytest.approx(1.0)
    assert shares([(0.0, -0.5), (0.5, -0.5), (0.5, 0.5), (0.0, 0.5)])[0, 0] == pytest.approx(0.5)


def test_neighbours_of_one_stroke_leave_no_seam():
    left = [(3.3, 2.2), (10.4, 3.1), (9.2, 12.7), (2.9, 11.1)]
    right = [(10.4, 3.1), (17.0, 2.0), (16.1, 14.0), (9.2, 12.7)]
    points = np.array(left + right)
    window = PictureWindow(0, 0, WIDTH, HEIGHT)
    picture = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    paint = painter(window, picture)
    stroke = FilledPolygons(
        points, np.array([0, 4, 8]), np.full(3, 200.0), window_of(points, (WIDTH, HEIGHT))
    )
    paint(stroke, np.ones((HEIGHT, WIDTH), np.float32))

    together = shapely.Polygon(left).union(shapely.Polygon(right))
    assert picture[..., 0].sum() == pytest.approx(200.0 * together.area, rel=1e-5)
    assert picture[7, 9, 0] == pytest.approx(200.0, abs=1e-3)
