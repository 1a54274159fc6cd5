"""Frames of a film, with their times; the optional import of OpenCV."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput, MissingExtra

Picture = NDArray[np.uint8]
Gray = NDArray[np.uint8]

# Rec. 601, as in cameras and codecs of this size: blue, green, red.
LUMA = np.array([0.114, 0.587, 0.299])


class Frame:
    """Picture of a film with its time as recorded in the film [s].

    A picture (height, width, 3) uint8 has blue, green and red, rows from above. Without one,
    functions decode `colours`, or `luma` alone, of a picture of a `size` [px] on access: most of
    tracking needs no colours.
    """

    __slots__ = ("_colours", "_decode_luma", "_luma", "_picture", "size", "time")

    def __init__(
        self,
        time: float,
        picture: Picture | None = None,
        *,
        size: tuple[int, int] | None = None,
        colours: Callable[[], Picture] | None = None,
        luma: Callable[[], Gray] | None = None,
    ) -> None:
        if picture is not None:
            size = picture.shape[1], picture.shape[0]
        elif size is None or colours is None:
            raise TypeError("a frame needs a picture, or a size and a function to decode it")
        self.time = time
        self.size = size
        self._picture, self._colours = picture, colours
        self._luma: Gray | None = None
        self._decode_luma = luma

    @property
    def picture(self) -> Picture:
        """Pixels (height, width, 3) uint8: blue, green, red; rows from above."""
        if self._picture is None:
            assert self._colours is not None
            self._picture = self._colours()
        return self._picture

    @property
    def luma(self) -> Gray:
        """Brightness (height, width) uint8; its range may be that of television, 16 to 235."""
        if self._luma is None and self._decode_luma is not None:
            self._luma = self._decode_luma()
        elif self._luma is None:
            weighted = opencv().transform(self.picture.astype(np.float64), LUMA[None])
            self._luma = np.rint(weighted).astype(np.uint8)
        return self._luma

    def __repr__(self) -> str:
        width, height = self.size
        return f"Frame(time={self.time}, {width} x {height})"


def opencv() -> Any:
    """Return the package cv2; raise with the command to install it if missing."""
    try:
        import cv2
    except ImportError:
        raise MissingExtra("a camera or a board", "opencv-python", extra="vision") from None
    return cv2


def size_of(text: str | None) -> tuple[int, int] | None:
    """Parse `1280x720` to width and height [px]."""
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{0,4})[xX×]([1-9]\d{0,4})", text.strip())
    if not found:
        raise InvalidInput("size", found=repr(text), expected="WIDTHxHEIGHT, such as 1280x720")
    return int(found[1]), int(found[2])
