"""Outlines on pictures: where they are drawn, to fractions of a pixel."""

import math

import numpy as np
import pytest

from fixel.model import Disk, Polygon
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens
from fixel.vision.outlines import (
    bgr,
    draw_arrow,
    draw_outline,
    draw_words,
    outline_pixels,
    place_pixels,
)

LENS = Lens(
    image_size=(320, 180), focal=(236.0, 238.0), centre=(161.0, 93.0), distortion=(0.0, -0.0536)
)
CAMERA = Camera.looking_down(LENS, 0.516, above=(0.05, 0.02), turned=0.1)
SQUARE = Polygon([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])


def picture(level=0):
    return np.full((180, 320, 3), level, dtype=np.uint8)


def test_corners_are_where_the_camera_model_puts_them():
    pose = (0.06, 0.01, 0.3)
    pixels = outline_pixels(CAMERA, SQUARE, pose, 0.0254)
    c, s = math.cos(0.3), math.sin(0.3)
    corners = SQUARE.outline @ [[c, s], [-s, c]] + [0.06, 0.01]
    np.testing.assert_allclose(pixels[::8], CAMERA.project_at(corners, 0.0254), atol=1e-9)


def test_edges_bend_with_the_lens():
    strong = Lens(image_size=(320, 180), focal=(236, 238), centre=(161, 93), distortion=(-0.3,))
    pixels = outline_pixels(Camera.looking_down(strong, 0.516), SQUARE, (0.1, 0, 0), 0.0)
    a, middle, b = pixels[0], pixels[4], pixels[8]
    along, aside = b - a, middle - a
    assert abs(along[0] * aside[1] - along[1] * aside[0]) / np.hypot(*along) > 0.05


def test_a_higher_outline_is_larger():
    low, high = (np.ptp(outline_pixels(CAMERA, SQUARE, (0, 0, 0), h), axis=0) for h in (0, 0.05))
    assert (high > low * 1.05).all()


def test_what_is_far_outside_stays_outside():
    """A lens polynomial folds far places back into the picture; none may appear there."""
    folding = Lens(image_size=(320, 180), focal=(236, 238), centre=(161, 93), distortion=(-0.2,))
    camera = Camera.looking_down(folding, 0.516)
    assert folding.sees(folding.pixel([2.2, 0.0]))  # it does fold back
    for far in ((1.2, 0.0), (0.0, 30.0), (-9.0, 9.0)):
        assert not folding.sees(place_pixels(camera, far, 0.0))
        assert not folding.sees(outline_pixels(camera, Disk(0.005), (*far, 0.0), 0.0)).any()


def test_places_in_view_are_left_alone():
    places = np.random.default_rng(0).uniform((-0.03, -0.06), (0.13, 0.1), (50, 2))
    np.testing.assert_allclose(
        place_pixels(CAMERA, places, 0.02), CAMERA.project_at(places, 0.02), atol=1e-9
    )


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 0.75])
def test_lines_lie_at_fractions_of_a_pixel(shift):
    canvas = picture()
    draw_outline(
        canvas, [[20 + shift, 20], [20 + shift, 120]], (255,) * 3, closed=False, halo=False
    )
    row = canvas[70, :, 0].astype(float)
    assert (row * np.arange(320)).sum() / row.sum() == pytest.approx(20 + shift, abs=0.07)


def test_faint_lines_mix_with_what_is_there():
    canvas = picture(100)
    line = [[20, 20], [60, 20], [60, 60]]
    draw_outline(canvas, line, (200, 200, 200), strength=0.3, closed=False, halo=False)
    assert canvas[20, 40, 0] == pytest.approx(130, abs=1)
    assert canvas[100, 100, 0] == 100
    assert canvas.max() <= 131  # where the line meets itself it is no stronger


def test_dashes_leave_gaps():
    canvas = picture()
    line = [[20, 20], [220, 20]]
    draw_outline(canvas, line, (255,) * 3, dash=10, closed=False, halo=False)
    lit = (canvas[20, 20:220, 0] > 100).mean()
    assert 0.45 < lit < 0.75


def test_a_line_outside_the_picture_changes_nothing():
    canvas = picture()
    draw_outline(canvas, [[-90, -90], [-50, -90], [-50, -50]], (255,) * 3)
    draw_outline(canvas, [[500, 500], [520, 500], [520, 520]], (255,) * 3, strength=0.4)
    assert not canvas.any()


def test_arrows_and_words():
    canvas = picture()
    draw_arrow(canvas, (50, 50), (50, 50), (255,) * 3)
    assert not canvas.any()
    draw_arrow(canvas, (50, 50), (120, 50), (255,) * 3)
    assert canvas[50, 80].all()
    draw_words(canvas, "far to the right and below", (9000, 9000), (0, 255, 0))
    assert canvas[150:, :, 1].any()


def test_colours_as_in_the_web():
    assert bgr("#0072B2") == (0xB2, 0x72, 0x00)
