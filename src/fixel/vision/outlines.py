"""Outlines of parts in pixels, and drawing on pictures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fixel.model.shape import Shape, placed
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Picture, opencv
from fixel.vision.lens import Lens

Bgr = tuple[int, int, int]

# Pieces of an outline, so that its straight edges follow the distortion of the lens.
PIECES = 32
# Far beyond the corners of the picture a lens model is invalid and may fold back into it.
FIELD = 1.25  # [-] of the farthest corner
WIDEST = 20.0  # [-] a direction 87 degrees off the axis
SHALLOW = 1e-3  # [m] least depth at which a place is drawn
SUBPIXEL = 4  # [bit]
HALO: Bgr = (0, 0, 0)
HALO_STRENGTH = 0.45


def outline_pixels(camera: Camera, shape: Shape, pose: ArrayLike, height: float) -> FloatArray:
    """Project the outline of a shape at a pose (3,) and a height [m] to a closed line (n, 2) [px].

    Edges are in pieces that follow the distortion of the lens. Points far outside the picture are
    moved to the limit of the lens model.
    """
    corners = shape.outline
    following = np.roll(corners, -1, axis=0)
    pieces = -(-PIECES // len(corners))
    share = np.arange(pieces)[:, None, None] / pieces
    along = corners + share * (following - corners)
    line = placed(along.transpose(1, 0, 2).reshape(-1, 2), pose)
    return place_pixels(camera, line, height)


def place_pixels(camera: Camera, places: ArrayLike, height: float) -> FloatArray:
    """Project places (..., 2) [m] at a height [m] to pixels, limited to `_field` of the lens."""
    xy = np.asarray(places, dtype=np.float64)
    points = np.concatenate([xy, np.full((*xy.shape[:-1], 1), height)], axis=-1)
    seen = points @ camera.rotation.T + camera.translation
    direction = seen[..., :2] / np.maximum(seen[..., 2:], SHALLOW)
    reach = np.linalg.norm(direction, axis=-1, keepdims=True)
    most = _field(camera.lens)
    return camera.lens.pixel(direction * np.minimum(1.0, most / np.maximum(reach, most)))


@lru_cache(maxsize=16)
def _field(lens: Lens) -> float:
    """Largest valid direction of a lens model, as distance from the axis [-]."""
    width, height = lens.image_size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    farthest = np.linalg.norm((corners - lens.centre) / lens.focal, axis=-1).max()
    reach = np.linspace(0.0, WIDEST, 4001)
    seen = lens.distorted(np.column_stack([reach, np.zeros_like(reach)]))[:, 0]
    outside = (seen > FIELD * farthest) | (np.gradient(seen) <= 0.0)
    return float(reach[outside.argmax()]) if outside.any() else WIDEST


def draw_outline(
    picture: Picture,
    pixels: ArrayLike,
    colour: Bgr,
    *,
    width: int = 2,
    strength: float = 1.0,
    closed: bool = True,
    dash: float | None = None,
    halo: bool = True,
) -> None:
    """Draw a line between corners (n, 2) [px] into a picture (h, w, 3) uint8, in place.

    Opacity `strength` is from 0 to 1. `dash` is the length of dashes and of the gaps between them
    [px]. A `halo` is a dark rim that makes the line visible on bright ground.
    """
    line = np.asarray(pixels, dtype=np.float64)
    if closed:
        line = np.concatenate([line, line[:1]])
    strokes = [line] if dash is None else list(_dashes(line, dash))
    if halo:
        _stroke(picture, strokes, HALO, width + 2, HALO_STRENGTH * strength)
    _stroke(picture, strokes, colour, width, strength)


def draw_arrow(
    picture: Picture, start: ArrayLike, end: ArrayLike, colour: Bgr, *, width: int = 3
) -> None:
    """Draw an arrow from one pixel (2,) to another, unless it is shorter than a pixel."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    way = b - a
    length = float(np.linalg.norm(way))
    if length < 1.0:
        return
    barb = min(5.0 * width, 0.5 * length)
    back, aside = -barb * way / length, 0.6 * barb * np.array([-way[1], way[0]]) / length
    draw_outline(picture, [a, b], colour, width=width, closed=False)
    draw_outline(
        picture, [b + back + aside, b, b + back - aside], colour, width=width, closed=False
    )


def draw_words(
    picture: Picture, words: str, place: ArrayLike, colour: Bgr, *, size: float = 0.6
) -> None:
    """Write ASCII text with its lower left corner at a pixel (2,), moved into the picture."""
    cv2 = opencv()
    font, thick = cv2.FONT_HERSHEY_SIMPLEX, max(1, round(2.0 * size))
    (wide, tall), below = cv2.getTextSize(words, font, size, thick)
    u, v = np.asarray(place, dtype=np.float64)
    high, across = picture.shape[:2]
    at = (
        round(float(np.clip(u, 4, max(4, across - wide - 4)))),
        round(float(np.clip(v, tall + 4, max(tall + 4, high - below - 4)))),
    )
    cv2.putText(picture, words, at, font, size, HALO, thick + 3, cv2.LINE_AA)
    cv2.putText(picture, words, at, font, size, colour, thick, cv2.LINE_AA)


def bgr(colour: str) -> Bgr:
    """Convert a colour of the web, such as `"#0072B2"`, to blue, green, red."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return blue, green, red


def _stroke(
    picture: Picture, strokes: list[FloatArray], colour: Bgr, width: int, strength: float
) -> None:
    """Draw lines; faint ones are blended with the picture, each pixel once."""
    cv2 = opencv()
    whole = [np.round(stroke * 2**SUBPIXEL).astype(np.int32) for stroke in strokes]
    if strength >= 1.0:
        cv2.polylines(picture, whole, False, colour, width, cv2.LINE_AA, SUBPIXEL)
        return
    points = np.concatenate(strokes)
    low = np.floor(points.min(axis=0)).astype(int) - width - 2
    high = np.ceil(points.max(axis=0)).astype(int) + width + 3
    (left, top), (right, bottom) = np.maximum(low, 0), np.maximum(high, 0)
    part = picture[top:bottom, left:right]
    if not part.size:
        return
    drawn = part.copy()
    shift = np.array([left, top], dtype=np.int32) << SUBPIXEL
    cv2.polylines(drawn, [w - shift for w in whole], False, colour, width, cv2.LINE_AA, SUBPIXEL)
    part[:] = cv2.addWeighted(drawn, strength, part, 1.0 - strength, 0.0)


def _dashes(line: FloatArray, dash: float) -> Iterator[FloatArray]:
    """Yield every other piece of a line that is cut into pieces of length `dash` [px]."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    for start in np.arange(0.0, run[-1], 2.0 * dash):
        end = min(start + dash, run[-1])
        inside = run[(run > start) & (run < end)]
        at = np.concatenate([[start], inside, [end]])
        yield np.column_stack([np.interp(at, run, column) for column in line.T])
