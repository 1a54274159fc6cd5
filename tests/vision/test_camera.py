"""Cameras above the plane: places and pixels both ways, at every height."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.formats.rig_file import EXAMPLES, rig_of
from fixel.vision.camera import Camera
from fixel.vision.lens import Lens

LENS = Lens(image_size=(1280, 720), focal=(944.7, 952.7), centre=(644.7, 371.2),
            distortion=(0.0, -0.0536))  # fmt: skip


@given(
    height=st.floats(0.2, 2.0),
    part=st.floats(0.0, 0.6),
    turned=st.floats(-3.1, 3.1),
    tilted=st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)),
    above=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
@settings(max_examples=60)
def test_places_come_back(height, part, turned, tilted, above):
    camera = Camera.looking_down(LENS, height, above=above, turned=turned, tilted=tilted)
    pixels = np.random.default_rng(0).uniform((0, 0), (1279, 719), (20, 2))
    places = camera.on_plane(pixels, part * height)
    np.testing.assert_allclose(camera.project_at(places, part * height), pixels, atol=1e-6)


@pytest.mark.parametrize("name", EXAMPLES)
def test_homography_is_the_camera_at_one_height(name):
    camera = rig_of(name).camera
    height = 0.1 * camera.position[2]
    places = camera.on_plane(np.array([[10.0, 20.0], [300.0, 200.0]]), height)
    flat = np.column_stack([places, np.ones(2)]) @ camera.homography(height).T
    np.testing.assert_allclose(
        camera.lens.pixel(flat[:, :2] / flat[:, 2:]), camera.project_at(places, height), atol=1e-6
    )


def test_a_tilt_looks_towards_what_was_below_and_right():
    straight = Camera.looking_down(LENS, 0.5)
    below = Camera.looking_down(LENS, 0.5, tilted=(0.1, 0.0)).on_plane(LENS.centre)
    right = Camera.looking_down(LENS, 0.5, tilted=(0.0, 0.1)).on_plane(LENS.centre)
    assert straight.project_at(below, 0.0)[1] > LENS.centre[1] + 50
    assert straight.project_at(right, 0.0)[0] > LENS.centre[0] + 50


def test_pixels_above_the_horizon_and_heights_above_the_camera():
    camera = Camera.looking_down(LENS, 0.5, tilted=(1.4, 0.0))
    refused(camera.on_plane, [640.0, 719.0], match="horizon")
    refused(camera.on_plane, [640.0, 0.0], 0.6, match="below the camera")


def test_a_mirrored_frame_is_no_camera():
    with pytest.raises(InvalidInput, match="mirrored"):
        Camera(lens=LENS, rotation=np.diag([1.0, 1.0, -1.0]), translation=np.array([0, 0, 1.0]))
