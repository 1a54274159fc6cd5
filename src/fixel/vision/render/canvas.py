"""Windows of a picture on which polygons are painted, with exact coverage of every pixel.

A pixel (u, v) is the unit square around that place. Coverage is computed from signed areas: every
edge adds the area to its right, row by row, and a running sum along the row gives the coverage.
Without a grid of samples there is no bias: edges are exact to rounding.

Source: the accumulation buffers of R. Levien's font-rs (2015) and S. Barrett's stb_truetype 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.kernels.jit import entry, kernel
from fixel.typing import FloatArray, IntArray

FloatPicture = NDArray[np.float32]


@entry
def paint(
    points: FloatArray,
    starts: IntArray,
    left: int,
    top: int,
    picture: FloatArray,
    cover: FloatArray,
    colour: FloatArray,
    shade: FloatArray,
    grain: FloatArray,
    grain_from_pixel: FloatArray,
) -> None:
    """Paint k polygons with corners (n, 2) [px] over a picture (h, w, 3) float32, in place.

    Overlapping polygons add up, opposite orientations cancel. `starts` (k + 1,) has the first
    corner of each polygon, and n. `left` and `top` are the first column and row of this picture in
    the whole one [px]. `cover` (h, w + 2) is a workspace with zeros before and after. The colour
    has the factors `shade` (h, w) and `grain`, a texture (2^k, 2^k) at the columns and rows to
    which `grain_from_pixel` (2, 3) maps (u, v, 1).
    """
    h, w = picture.shape[0], picture.shape[1]
    first, last, begin, end = _bounds(points, left, top, h, w)
    _accumulate(points, starts, left, top, cover, h, w)
    size = grain.shape[0]
    wrap = size - 1
    for row in range(first, last):
        run = 0.0
        for column in range(begin, end):
            run += cover[row, column]
            cover[row, column] = 0.0
            share = min(abs(run), 1.0)
            if share > 1e-6:
                u = float(column + left)
                v = float(row + top)
                light = float(shade[row, column])
                if size > 1:
                    light *= _grain_at(grain, wrap, grain_from_pixel, u, v)
                for k in range(3):
                    below = float(picture[row, column, k])
                    picture[row, column, k] = below + share * (colour[k] * light - below)
        for column in range(end, w + 2):
            cover[row, column] = 0.0


@entry
def cover_most(
    points: FloatArray, starts: IntArray, left: int, top: int, mask: FloatArray, cover: FloatArray
) -> None:
    """Raise a mask (h, w) float32 to the share of each pixel that polygons cover; see `paint`."""
    h, w = mask.shape
    first, last, begin, end = _bounds(points, left, top, h, w)
    _accumulate(points, starts, left, top, cover, h, w)
    for row in range(first, last):
        run = 0.0
        for column in range(begin, end):
            run += cover[row, column]
            cover[row, column] = 0.0
            share = min(abs(run), 1.0)
            if share > mask[row, column]:
                mask[row, column] = share
        for column in range(end, w + 2):
            cover[row, column] = 0.0


@kernel
def _grain_at(
    grain: FloatArray, wrap: int, grain_from_pixel: FloatArray, u: float, v: float
) -> float:
    """Interpolate the grain at a pixel linearly."""
    x = grain_from_pixel[0, 0] * u + grain_from_pixel[0, 1] * v + grain_from_pixel[0, 2]
    y = grain_from_pixel[1, 0] * u + grain_from_pixel[1, 1] * v + grain_from_pixel[1, 2]
    i = math.floor(x)
    j = math.floor(y)
    p = x - i
    q = y - j
    i0 = i & wrap
    i1 = (i + 1) & wrap
    j0 = j & wrap
    j1 = (j + 1) & wrap
    above = (1.0 - p) * grain[j0, i0] + p * grain[j0, i1]
    under = (1.0 - p) * grain[j1, i0] + p * grain[j1, i1]
    return float((1.0 - q) * above + q * under)


@kernel
def _bounds(points: FloatArray, left: int, top: int, h: int, w: int) -> tuple[int, int, int, int]:
    """Rows and columns that polygons can touch: first row, end, first column, end."""
    low_u = low_v = 1e300
    high_u = high_v = -1e300
    for i in range(len(points)):
        low_u = min(low_u, points[i, 0])
        high_u = max(high_u, points[i, 0])
        low_v = min(low_v, points[i, 1])
        high_v = max(high_v, points[i, 1])
    first = int(min(max(low_v + 0.5 - top, 0.0), float(h)))
    last = int(min(max(high_v + 1.5 - top, 0.0), float(h)))
    begin = int(min(max(low_u + 0.5 - left, 0.0), float(w)))
    end = int(min(max(high_u + 2.5 - left, 0.0), float(w)))
    return first, last, begin, end


@kernel
def _accumulate(
    points: FloatArray, starts: IntArray, left: int, top: int, cover: FloatArray, h: int, w: int
) -> None:
    """Add all edges to the accumulation buffer."""
    for k in range(len(starts) - 1):
        begin = starts[k]
        end = starts[k + 1]
        for i in range(begin, end):
            j = i + 1 if i + 1 < end else begin
            _add_edge(
                points[i, 0] + 0.5 - left,
                points[i, 1] + 0.5 - top,
                points[j, 0] + 0.5 - left,
                points[j, 1] + 0.5 - top,
                cover,
                h,
                w,
            )


@kernel
def _add_edge(
    x0: float, y0: float, x1: float, y1: float, cover: FloatArray, h: int, w: int
) -> None:
    """Add the area to the right of one edge, positive where it goes down."""
    if y0 == y1:
        return
    sign = 1.0
    if y0 > y1:
        sign = -1.0
        x0, y0, x1, y1 = x1, y1, x0, y0
    slope = (x1 - x0) / (y1 - y0)
    first = int(max(math.floor(y0), 0.0))
    last = int(min(math.ceil(y1), float(h)))
    for row in range(first, last):
        upper = max(float(row), y0)
        lower = min(float(row + 1), y1)
        if lower <= upper:
            continue
        a = x0 + slope * (upper - y0)
        b = x0 + slope * (lower - y0)
        _add_within(min(a, b), max(a, b), sign * (lower - upper), cover, row, w)


@kernel
def _add_within(a: float, b: float, height: float, cover: FloatArray, row: int, w: int) -> None:
    """Add a piece of an edge from column a to b >= a within a row, clipped to the picture."""
    if b <= 0.0:
        cover[row, 0] += height
        return
    if a >= w:
        return
    length = b - a
    if a < 0.0:
        outside = height * (-a / length)
        cover[row, 0] += outside
        height -= outside
        a = 0.0
        length = b
    if b > w:
        height *= (w - a) / length
        b = float(w)
        length = b - a
    i = int(a)
    j = math.ceil(b)
    if j <= i + 1:
        beyond = 0.5 * (a + b) - i
        cover[row, i] += height * (1.0 - beyond)
        cover[row, i + 1] += height * beyond
        return
    # Area to the right of the piece, for each column that it crosses.
    per_column = height / length
    before = 0.0
    for column in range(i, j):
        low = max(a, float(column))
        high = min(b, float(column + 1))
        crossed = per_column * (high - low)
        within = crossed * (column + 1 - 0.5 * (low + high))
        cover[row, column] += before + within
        before = crossed - within
    cover[row, j] += before


class PictureWindow(NamedTuple):
    """Window of a picture: first column and row, number of columns and rows [px]."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices of the rows and columns of the whole picture."""
        return (slice(self.top, self.top + self.height), slice(self.left, self.left + self.width))

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


# Texture that multiplies a colour: its values, which repeat without a seam, and the map (2, 3) from
# (u, v, 1) to column and row of the values.
Texture = tuple[FloatPicture, FloatArray]
PLAIN: Texture = (np.ones((1, 1), np.float32), np.zeros((2, 3)))


class FilledPolygons(NamedTuple):
    """Polygons of one colour, ready to be painted."""

    points: FloatArray  # (n, 2) corners of all polygons [px]
    starts: NDArray[np.int64]  # (k + 1,) index of the first corner of each polygon, and n
    colour: FloatArray  # (3,) blue, green, red, from 0 to 255
    window: PictureWindow  # window of the whole picture that the polygons can touch
    grain: Texture = PLAIN


def filled_polygons(
    points: FloatArray,
    colour: FloatArray,
    size: tuple[int, int],
    starts: NDArray[np.int64] | None = None,
    grain: Texture = PLAIN,
) -> FilledPolygons:
    """Return polygons (n, 2) [px] ready to be painted in a picture of (width, height).

    Without `starts`, they are one polygon.
    """
    starts = np.array([0, len(points)]) if starts is None else starts
    return FilledPolygons(points, starts, colour, window_of(points, size), grain)


def painter(window: PictureWindow, picture: FloatPicture) -> Callable[..., None]:
    """Return a function that paints into a window of a picture, with levels proportional to light.

    It paints `FilledPolygons` with their colour multiplied by a shade (h, w), by default 1.
    """
    h, w = picture.shape[:2]
    room, full = np.zeros((h, w + 2)), np.ones((h, w), np.float32)

    def painted(stroke: FilledPolygons, shade: FloatPicture | None = None) -> None:
        if stroke.window.meets(window):
            shade = full if shade is None else shade
            place = stroke.points, stroke.starts, window.left, window.top
            _paint(*place, picture, room, stroke.colour, shade, *stroke.grain)

    return painted


def cover(mask: FloatPicture, room: FloatArray, points: FloatArray) -> None:
    """Raise a mask (h, w) to the share of each pixel that a polygon (n, 2) [px] covers."""
    _cover_most(points, np.array([0, len(points)]), 0, 0, mask, room)


# The kernels take any real arrays, but are annotated for float64.
_paint: Any = paint
_cover_most: Any = cover_most
