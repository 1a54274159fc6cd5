"""JPEG pictures as they come from cameras."""

from __future__ import annotations

from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.vision.frame import Gray, Picture
from fixel.vision.outlines import vision_library

BEGIN: Final = b"\xff\xd8"
END: Final = b"\xff\xd9"
# Markers that say how large a picture is; the others of this range are tables.
_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
REDUCED: Final = 8


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of a whole JPEG picture; None where it is none."""
    if not data.startswith(BEGIN) or data.rfind(END) < 0:
        return None
    place = 2
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker in _SIZES:
            height = int.from_bytes(data[place + 5 : place + 7])
            return int.from_bytes(data[place + 7 : place + 9]), height
        place += 2 + int.from_bytes(data[place + 2 : place + 4])
    return None


def decoded(data: bytes) -> Picture:
    """(height, width, 3) uint8, blue, green, red."""
    return _decoded(data, vision_library().IMREAD_COLOR)


def decoded_small(data: bytes) -> Gray:
    """(height / 8, width / 8) uint8 of brightness: the decoder averages 8 x 8 pixels."""
    return _decoded(data, vision_library().IMREAD_REDUCED_GRAYSCALE_8)


def shrunk(picture: Picture | None) -> Gray:
    """The same of pixels."""
    assert picture is not None
    height, width = picture.shape[0] // REDUCED * REDUCED, picture.shape[1] // REDUCED * REDUCED
    green = picture[:height, :width, 1].reshape(
        height // REDUCED, REDUCED, width // REDUCED, REDUCED
    )
    return np.asarray(green.mean(axis=(1, 3)), dtype=np.uint8)


def _decoded(data: bytes, how: int) -> Picture:
    pixels = vision_library().imdecode(np.frombuffer(data, np.uint8), how) if data else None
    if pixels is None:
        raise InvalidInput("picture", found="JPEG data that cannot be decoded", expected="JPEG")
    return np.asarray(pixels, dtype=np.uint8)
