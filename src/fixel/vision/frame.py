"""Frames of a film, with their times."""

from __future__ import annotations

from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Gray = NDArray[np.uint8]

# Rec. 601, as in cameras and codecs of this size: blue, green, red.
LUMA = np.array([0.114, 0.587, 0.299])


class Planes(Protocol):
    """Decoded picture before conversion to colours."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""

    def luma(self) -> Gray:
        """Brightness (height, width), read-only."""

    def colour(self, rows: slice, columns: slice) -> Picture:
        """Colours (height, width, 3) of a window: blue, green, red."""


@final
class Frame:
    """Picture of a film with its time.

    Colours of a decoded frame are computed on access: most of tracking needs none, and the rest
    only small windows.

    Parameters
    ----------
    time : float
        Time of the frame as recorded in the film [s].
    picture : (height, width, 3) uint8, optional
        Pixels: blue, green, red; rows from above.
    planes : Planes, optional
        Decoded picture from which the pixels are computed, where `picture` is missing.
    """

    __slots__ = ("_luma", "_picture", "_planes", "time")

    def __init__(
        self, time: float, picture: Picture | None = None, *, planes: Planes | None = None
    ) -> None:
        if picture is None and planes is None:
            raise TypeError("a frame needs a picture, or planes to make it from")
        self.time = time
        self._picture = picture
        self._planes = planes
        self._luma: Gray | None = None

    @property
    def picture(self) -> Picture:
        """Pixels (height, width, 3) uint8: blue, green, red; rows from above."""
        if self._picture is None:
            assert self._planes is not None
            self._picture = self._planes.colour(slice(None), slice(None))
        return self._picture

    @property
    def luma(self) -> Gray:
        """Brightness (height, width) uint8; its range may be that of television, 16 to 235."""
        if self._luma is None:
            self._luma = self._planes.luma() if self._planes else _gray(self.picture)
        return self._luma

    def colour(self, rows: slice, columns: slice) -> Picture:
        """Colours (height, width, 3) uint8 of a window: blue, green, red."""
        if self._picture is None:
            assert self._planes is not None
            return self._planes.colour(rows, columns)
        return self._picture[rows, columns]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        if self._picture is None:
            assert self._planes is not None
            return self._planes.size
        height, width = self._picture.shape[:2]
        return width, height

    def __repr__(self) -> str:
        width, height = self.size
        return f"Frame(time={self.time}, {width} x {height})"


def _gray(picture: Picture) -> Gray:
    return np.asarray(np.rint(picture @ LUMA), dtype=np.uint8)
