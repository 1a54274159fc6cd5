"""Windows of JPEG pictures: the pixels that libjpeg makes of them, or a refusal like its own."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from fixel.errors import InvalidInput
from fixel.formats.jpeg import JpegPlanes, brightness, decoded, jpeg_of
from fixel.formats.jpeg_blocks import blocks_of
from fixel.vision.frame import Frame

SIZE = (139, 85)
WINDOWS = (
    (slice(0, 85), slice(0, 139)),
    (slice(13, 29), slice(40, 41)),
    (slice(70, 85), slice(120, 139)),
    (slice(8, 16), slice(16, 64)),
    (slice(20, 20), slice(3, 9)),
)


def picture(size=SIZE):
    """Patches, slopes and noise: all kinds of blocks, the longest codes among them."""
    random = np.random.default_rng(2)
    width, height = size
    coarse = random.integers(0, 256, (height // 12 + 1, width // 12 + 1, 3))
    patches = np.kron(coarse, np.ones((12, 12, 1)))[:height, :width]
    patches[:, : width // 3] += 60.0 * random.standard_normal((height, width // 3, 3))
    patches[:, -width // 4 :] = np.linspace(0, 255, height)[:, None, None]
    return np.clip(patches, 0, 255).astype(np.uint8)


def jpeg(mode="RGB", size=SIZE, **options):
    file = io.BytesIO()
    Image.fromarray(picture(size)).convert(mode).save(file, "JPEG", **options)
    return file.getvalue()


KINDS = {
    "as recorded": {"quality": 95, "subsampling": 0},
    "4:2:2": {"quality": 60, "subsampling": 1},
    "4:2:0": {"quality": 80, "subsampling": 2},
    "own codes": {"quality": 95, "subsampling": 0, "optimize": True},
    "without loss, nearly": {"quality": 100, "subsampling": 0},
    "coarse": {"quality": 5, "subsampling": 0},
    "restarts": {"quality": 90, "subsampling": 0, "restart_marker_blocks": 3},
    "a restart a row": {"quality": 75, "subsampling": 2, "restart_marker_rows": 1},
}


@pytest.mark.parametrize("mode", ["RGB", "L"])
@pytest.mark.parametrize("kind", KINDS)
def test_brightness_is_that_of_libjpeg(kind, mode):
    data = jpeg(mode, **KINDS[kind])
    blocks, whole = blocks_of(data), brightness(data)
    for rows, columns in WINDOWS[::-1]:  # the walk goes on from window to window
        assert (blocks.luma(rows, columns) == whole[rows, columns]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_colours_are_those_of_libjpeg(kind):
    data = jpeg(**KINDS[kind])
    blocks, whole = blocks_of(data), decoded(data)
    reduced = KINDS[kind].get("subsampling") != 0
    for rows, columns in WINDOWS:
        found = blocks.colour(rows, columns)
        assert found.shape == whole[rows, columns].shape
        if not reduced:
            assert (found == whole[rows, columns]).all()
        elif found.size > 200:  # it smooths colours of half the resolution, over their own noise
            assert np.abs(found.astype(float) - whole[rows, columns]).mean() < 25.0


def test_smooth_colours_of_half_the_resolution():
    file = io.BytesIO()
    v, u = np.mgrid[0:96, 0:96]
    Image.fromarray(np.stack([v + 60, 2 * u, 200 - v], -1).astype(np.uint8)).save(
        file, "JPEG", quality=95, subsampling=2
    )
    window = slice(10, 90), slice(7, 80)
    found = blocks_of(file.getvalue()).colour(*window)
    assert np.abs(found.astype(int) - decoded(file.getvalue())[window]).max() <= 4


def test_what_it_cannot_is_left_to_libjpeg():
    data = jpeg(progressive=True)
    assert blocks_of(data) is None
    window = slice(10, 20), slice(30, 50)
    planes = JpegPlanes(data, SIZE)
    assert (planes.luma_in(*window) == brightness(data)[window]).all()
    assert (planes.colour(*window) == decoded(data)[window]).all()
    cmyk = io.BytesIO()
    Image.fromarray(picture()).convert("CMYK").save(cmyk, "JPEG")
    assert blocks_of(cmyk.getvalue()) is None


def test_a_gray_picture_has_colours():
    data = jpeg("L")
    found = JpegPlanes(data, SIZE).colour(slice(5, 25), slice(9, 60))
    assert (found == decoded(data)[5:25, 9:60]).all()


def test_spoilt_data_are_refused_or_read_as_they_are():
    """No crash and no wait, whatever bits were lost; a cut picture is refused where it is cut."""
    data = jpeg_of(picture())
    random = np.random.default_rng(3)
    for _ in range(150):
        bad = bytearray(data)
        for place in random.integers(2, len(bad), random.integers(1, 40)):
            bad[place] = random.integers(0, 256)
        planes = JpegPlanes(bytes(bad[: random.integers(len(bad) // 2, len(bad))]), SIZE)
        try:
            window = planes.luma_in(slice(60, 85), slice(0, 139))
            assert window.dtype == np.uint8
        except InvalidInput:
            pass
    short = JpegPlanes(data[: len(data) // 2], SIZE)
    assert (short.luma_in(slice(0, 16), slice(0, 60)) == brightness(data)[:16, :60]).all()
    with pytest.raises(InvalidInput, match="spoilt"):
        short.luma_in(slice(60, 85), slice(0, 60))


def test_frames_take_windows_of_what_they_have():
    data = jpeg(subsampling=0)
    window = slice(10, 20), slice(30, 50)
    frame = Frame(0.0, planes=JpegPlanes(data, SIZE))
    assert frame.size == SIZE
    assert (frame.luma_in(*window) == frame.luma[window]).all()
    assert (frame.luma_in(*window) == brightness(data)[window]).all()
    assert (frame.colour(*window) == frame.picture[window]).all()
    pixels = Frame(0.0, decoded(data))
    assert pixels.size == SIZE
    assert (pixels.luma_in(*window) == pixels.luma[window]).all()
