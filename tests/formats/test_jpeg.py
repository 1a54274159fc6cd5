"""Decoding of JPEG pictures: the same pixels by OpenCV and Pillow, or a refusal."""

import io
import sys
from contextlib import suppress

import numpy as np
import pytest
from PIL import Image

from fixel.errors import InvalidInput
from fixel.formats.recording_video import brightness, decoded, jpeg_frame, jpeg_of
from fixel.vision.frame import Frame

SIZE = (139, 85)


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
    "progressive": {"progressive": True},
    "restarts": {"quality": 90, "subsampling": 0, "restart_marker_blocks": 3},
    "a restart a row": {"quality": 75, "subsampling": 2, "restart_marker_rows": 1},
}


@pytest.mark.parametrize("mode", ["RGB", "L"])
@pytest.mark.parametrize("kind", KINDS)
def test_pixels_are_those_of_pillow(kind, mode):
    data = jpeg(mode, **KINDS[kind])
    frame = jpeg_frame(0.0, data, SIZE)
    assert (frame.luma == brightness(data)).all()
    assert (frame.picture == decoded(data)).all()


def test_without_opencv_pillow_decodes(monkeypatch):
    data = jpeg()
    fast = jpeg_frame(0.0, data, SIZE)
    expected = fast.luma, fast.picture
    monkeypatch.setitem(sys.modules, "cv2", None)
    slow = jpeg_frame(0.0, data, SIZE)
    assert (slow.luma == expected[0]).all()
    assert (slow.picture == expected[1]).all()


def test_a_turned_camera_does_not_turn_the_pixels():
    turned = Image.Exif()
    turned[0x0112] = 6
    data = jpeg(exif=turned)
    assert (jpeg_frame(0.0, data, SIZE).picture == decoded(data)).all()


def test_spoilt_data_are_refused_or_read_as_they_are():
    """No crash and no wait, whatever bits were lost; a truncated picture is refused."""
    data = jpeg_of(picture())
    random = np.random.default_rng(3)
    for _ in range(150):
        bad = bytearray(data)
        for place in random.integers(2, len(bad), random.integers(1, 40)):
            bad[place] = random.integers(0, 256)
        frame = jpeg_frame(0.0, bytes(bad[: random.integers(len(bad) // 2, len(bad))]), SIZE)
        with suppress(InvalidInput):
            assert frame.luma.dtype == np.uint8
    for part in (data[: len(data) // 2], b"", b"no picture" + data[-2:]):
        with pytest.raises(InvalidInput, match="damaged"):
            _ = jpeg_frame(0.0, part, SIZE).luma


def test_a_frame_knows_its_size_before_it_is_decoded():
    assert jpeg_frame(0.0, b"", SIZE).size == SIZE
    assert Frame(0.0, decoded(jpeg())).size == SIZE
    with pytest.raises(TypeError, match="decode"):
        Frame(0.0)
