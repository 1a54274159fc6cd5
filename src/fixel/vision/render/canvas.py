"""Window of a picture on which polygons are painted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.typing import FloatArray
from fixel.vision.render.fill import cover_most, paint

FloatPicture = NDArray[np.float32]


class PictureWindow(NamedTuple):
    """Window of a picture: first column and row, number of columns and rows [px]."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices of the rows and columns of the whole picture."""
        return (
            slice(self.top, self.top + self.height),
            slice(self.left, self.left + self.width),
        )

    def joined(self, other: PictureWindow) -> PictureWindow:
        """Return the smallest window that contains both; an empty one adds nothing."""
        if not self.width or not self.height:
            return other
        if not other.width or not other.height:
            return self
        left, top = min(self.left, other.left), min(self.top, other.top)
        right = max(self.left + self.width, other.left + other.width)
        bottom = max(self.top + self.height, other.top + other.height)
        return PictureWindow(left, top, right - left, bottom - top)

    def grown(self, margin: int, size: tuple[int, int]) -> PictureWindow:
        """Enlarge the window by a margin, within a picture of (width, height)."""
        left, top = max(self.left - margin, 0), max(self.top - margin, 0)
        right = min(self.left + self.width + margin, size[0])
        bottom = min(self.top + self.height + margin, size[1])
        return PictureWindow(left, top, max(right - left, 0), max(bottom - top, 0))

    def meets(self, other: PictureWindow) -> bool:
        """Whether two windows overlap."""
        return (
            self.left < other.left + other.width
            and other.left < self.left + self.width
            and self.top < other.top + other.height
            and other.top < self.top + self.height
        )


def window_of(points: FloatArray, size: tuple[int, int]) -> PictureWindow:
    """Return the window that polygons (n, 2) [px] can touch in a picture of (width, height)."""
    low, high = np.floor(points.min(axis=0)) - 1.0, np.ceil(points.max(axis=0)) + 1.0
    left, top = (int(x) for x in np.clip(low, 0, size))
    right, bottom = (int(x) for x in np.clip(high + 1.0, 0, size))
    return PictureWindow(left, top, right - left, bottom - top)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Grain:
    """Texture that multiplies a colour.

    Attributes
    ----------
    values : (2^k, 2^k) float32
        Values of the texture, which repeats without a seam.
    from_pixel : (2, 3) float64
        Map from (u, v, 1) to column and row of the texture.
    """

    values: FloatPicture
    from_pixel: FloatArray


PLAIN = Grain(np.ones((1, 1), np.float32), np.zeros((2, 3)))


@final
@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """Polygons of one colour, ready to be painted.

    Attributes
    ----------
    points : (n, 2) float64
        Corners of all polygons [px].
    starts : (k + 1,) int64
        Index of the first corner of each polygon, and n.
    colour : (3,) float64
        Blue, green, red, from 0 to 255.
    grain : Grain
    window : PictureWindow
        Window of the whole picture that the polygons can touch.
    """

    points: FloatArray
    starts: NDArray[np.int64]
    colour: FloatArray
    window: PictureWindow
    grain: Grain = PLAIN


@final
@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """Window of a picture, with grey levels proportional to light."""

    window: PictureWindow
    picture: FloatPicture
    cover: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        room = np.zeros((self.window.height, self.window.width + 2))
        object.__setattr__(self, "cover", room)

    def paint(self, stroke: Stroke, shade: FloatPicture) -> None:
        """Paint a stroke with its colour multiplied by `shade` (h, w)."""
        if not stroke.window.meets(self.window):
            return
        _paint(
            stroke.points,
            stroke.starts,
            self.window.left,
            self.window.top,
            self.picture,
            self.cover,
            stroke.colour,
            shade,
            stroke.grain.values,
            stroke.grain.from_pixel,
        )


def cover(mask: FloatPicture, room: FloatArray, points: FloatArray) -> None:
    """Raise a mask (h, w) to the share of each pixel that a polygon (n, 2) [px] covers."""
    _cover_most(points, np.array([0, len(points)]), 0, 0, mask, room)


# The kernels take any real arrays, but are annotated for float64.
_paint: Any = paint
_cover_most: Any = cover_most
