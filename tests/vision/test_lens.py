"""Lenses: both ways over the whole picture, and as OpenCV has it."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.fixtures import refused

from fixel.errors import InvalidInput
from fixel.vision.lens import Lens


def lens(size=(1280, 720), **others):
    usual = {"focal": (944.7, 952.7), "centre": (644.7, 371.2)}
    return Lens(image_size=size, **(usual | others))


def whole_picture(of, columns=81, rows=49):
    width, height = of.image_size
    u, v = np.linspace(-0.5, width - 0.5, columns), np.linspace(-0.5, height - 0.5, rows)
    return np.stack(np.meshgrid(u, v), axis=-1)


MODELS = {
    "thesis": lens(distortion=(0.0, -0.0536)),
    "none": lens(),
    "skewed": lens(skew=0.01, distortion=(-0.1, 0.02, 0.001, -0.002)),
    "barrel": lens(distortion=(-0.3, 0.1, 0.001, -0.0005, -0.01)),
    "pincushion": lens(distortion=(0.4, 0.3, 0.001, -0.0005, 0.1)),
    "rational": lens(distortion=(0.5, 0.1, 0.001, -0.002, 0.01, 0.6, 0.1, 0.02)),
    "fisheye": lens(fisheye=True, focal=(480.0, 481.0), distortion=(0.05, -0.01, 0.002, -0.001)),
    "microscope": lens((640, 480), focal=(188679.2, 188679.2), centre=(319.5, 239.5)),
}


@pytest.mark.parametrize("name", MODELS)
def test_pixels_come_back(name):
    model = MODELS[name]
    pixels = whole_picture(model)
    # The figure that was asked for is 1e-6 px.
    np.testing.assert_allclose(model.pixel(model.direction(pixels)), pixels, atol=1e-8)


@given(
    brown=st.lists(st.floats(-0.15, 0.15), min_size=2, max_size=2),
    aside=st.lists(st.floats(-0.01, 0.01), min_size=2, max_size=2),
    skew=st.floats(-0.05, 0.05),
    fisheye=st.booleans(),
)
@settings(max_examples=60)
def test_any_lens_comes_back_or_is_refused(brown, aside, skew, fisheye):
    model = lens(distortion=(*brown, *aside), skew=skew, fisheye=fisheye)
    pixels = whole_picture(model, 17, 11)
    try:
        there = model.direction(pixels)
    except InvalidInput:
        return
    np.testing.assert_allclose(model.pixel(there), pixels, atol=1e-6)


@pytest.mark.parametrize("name", ["thesis", "barrel", "pincushion", "rational", "fisheye"])
def test_pixels_are_those_of_opencv(name):
    model = MODELS[name]
    widest = 1.5 if model.fisheye else 0.5
    flat = np.random.default_rng(0).uniform(-widest, widest, (200, 2))
    solid = np.column_stack([flat, np.ones(200)])[:, None]
    matrix = np.array([[model.focal[0], 0, model.centre[0]], [0, model.focal[1], model.centre[1]],
                       [0, 0, 1.0]])  # fmt: skip
    project = cv2.fisheye.projectPoints if model.fisheye else cv2.projectPoints
    theirs, _ = project(solid, np.zeros(3), np.zeros(3), matrix, model.distortion)
    np.testing.assert_allclose(model.pixel(flat), theirs[:, 0], atol=1e-9)


def test_what_a_lens_folds_is_refused():
    # With k1 = -1 directions beyond 0.577 fold back; nothing is seen beyond 0.385.
    folded = lens(distortion=(-1.0,))
    near = folded.pixel([0.3, 0.0])
    np.testing.assert_allclose(folded.direction(near), [0.3, 0.0], atol=1e-12)
    with pytest.raises(InvalidInput, match="range of the lens model"):
        folded.direction((folded.centre[0] + 0.4 * 944.7, folded.centre[1]))


@pytest.mark.parametrize("pixel", [[np.nan, 0.0], [np.inf, 0.0]])
@pytest.mark.parametrize("name", ["thesis", "fisheye"])
def test_no_number_is_no_answer(pixel, name):
    refused(MODELS[name].direction, pixel)


@pytest.mark.parametrize(("change", "word"), [
    ({"focal": (0.0, 900.0)}, "above 0"),
    ({"distortion": (0.0,) * 8 + (1.0,)}, "at most 8"),
    ({"distortion": (np.nan,)}, "finite"),
    ({"image_size": (0, 10)}, "width and height"),
])  # fmt: skip
def test_lenses_that_cannot_be(change, word):
    usual = {"image_size": (64, 48), "focal": (50, 50), "centre": (32, 24)}
    refused(Lens, **usual | change, match=word)
