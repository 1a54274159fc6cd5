"""JPEG pictures, as cameras send them and recordings store them."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.vision.frame import Frame, Gray, Picture

BEGIN: Final = b"\xff\xd8"
END: Final = b"\xff\xd9"
# Markers of segments with the picture's size; the others of this range are tables.
_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
QUALITY: Final = 95  # with colours at full resolution
REDUCED: Final = 8


def jpeg_of(picture: Picture) -> bytes:
    """Encode a picture as JPEG of high quality, with colours at full resolution."""
    from PIL import Image

    height, width = picture.shape[:2]
    whole = np.ascontiguousarray(picture)
    file = io.BytesIO()
    image = Image.frombuffer("RGB", (width, height), whole, "raw", "BGR", 0, 1)
    image.save(file, "JPEG", quality=QUALITY, subsampling=0)
    return file.getvalue()


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height [px] of a JPEG picture; None if it is truncated or no JPEG."""
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


def decoded(data: bytes, where: str = "picture") -> Picture:
    """Decode a JPEG picture: (height, width, 3) uint8, blue, green, red."""
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data), formats=["JPEG"]).convert("RGB")
        pixels = np.frombuffer(image.tobytes("raw", "BGR"), np.uint8)
    except (OSError, SyntaxError, ValueError) as problem:
        raise _spoilt(where, problem) from None
    return pixels.reshape(image.height, image.width, 3)


def brightness(data: bytes, reduced: int = 1, where: str = "picture") -> Gray:
    """Decode only the brightness of a JPEG picture, (height / reduced, width / reduced) uint8.

    Parameters
    ----------
    data : bytes
    reduced : int
        Factor by which width and height shrink: 1, 2, 4 or 8.
    where : str
        Name of the picture in errors.
    """
    from PIL import Image

    try:
        image = Image.open(io.BytesIO(data), formats=["JPEG"])
        image.draft("L", (image.width // reduced, image.height // reduced))
        return np.asarray(image.convert("L"), dtype=np.uint8)
    except (OSError, SyntaxError, ValueError) as problem:
        raise _spoilt(where, problem) from None


def shrunk(picture: Picture) -> Gray:
    """Brightness (height / 8, width / 8) uint8 of a picture: means of green over 8 x 8 pixels."""
    height, width = (side // REDUCED for side in picture.shape[:2])
    green = picture[: height * REDUCED, : width * REDUCED, 1]
    cells = green.reshape(height, REDUCED, width, REDUCED)
    return np.asarray(cells.mean(axis=(1, 3)), dtype=np.uint8)


def jpeg_frame(time: float, data: bytes, size: tuple[int, int], where: str = "picture") -> Frame:
    """Frame of a JPEG picture of (width, height) [px], decoded on access; `where` names it."""
    return Frame(
        time,
        size=size,
        colours=lambda: _fast(data, decoded, "IMREAD_COLOR", where),
        luma=lambda: _fast(data, brightness, "IMREAD_GRAYSCALE", where),
    )


def _fast(data: bytes, slow: Callable[..., Picture], mode: str, where: str) -> Picture:
    """Decode with OpenCV, which takes half the time for the same pixels, else with Pillow."""
    try:
        import cv2
    except ImportError:
        return slow(data, where=where)
    if data.rfind(END) < 0:  # OpenCV would return the rest of a truncated picture as grey
        raise _spoilt(where, "it is truncated")
    try:
        whole = cv2.imdecode(
            np.frombuffer(data, np.uint8), getattr(cv2, mode) | cv2.IMREAD_IGNORE_ORIENTATION
        )
    except cv2.error as problem:
        raise _spoilt(where, problem) from None
    if whole is None:
        raise _spoilt(where, "no picture")
    return np.asarray(whole, dtype=np.uint8)


def _spoilt(where: str, problem: object) -> InvalidInput:
    return InvalidInput(where, found=f"damaged JPEG data ({problem})", expected="JPEG")
