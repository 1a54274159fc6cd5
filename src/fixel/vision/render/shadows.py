"""Soft shadows on horizontal faces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.typing import FloatArray
from fixel.vision.opencv import opencv
from fixel.vision.render.canvas import FloatPicture, PictureWindow, cover, window_of
from fixel.vision.render.solids import PlacedSolid
from fixel.vision.render.virtual_camera import Projection

COARSE: Final = 4  # [px] per value; shadows are soft

# Offsets of shadows from points of the lamp and of the bright room, along x and y per unit of
# height, and shares of these points in the light.
_LAMP = [(0.42 + 0.16 * np.cos(a), -0.37 + 0.16 * np.sin(a)) for a in np.arange(5) * 0.4 * np.pi]
_ROOM = [(0.75 * np.cos(a), 0.75 * np.sin(a)) for a in 0.3 + np.arange(5) * 0.4 * np.pi]
RAYS: Final = np.array(_LAMP + _ROOM)
SHARES: Final = np.array([0.13] * 5 + [0.07] * 5)
SHADOW_REACH: Final = float(np.abs(RAYS).max())  # longest shadow per unit of height


def shadow_window(things: Sequence[PlacedSolid], eye: Projection) -> PictureWindow:
    """Window that the shadows of solids on the plane can touch."""
    window = PictureWindow(0, 0, 0, 0)
    for thing in things:
        high = thing.solid.high
        for piece in thing.footprint:
            low, top = (
                piece.min(axis=0) - SHADOW_REACH * high,
                piece.max(axis=0) + SHADOW_REACH * high,
            )
            corners = np.array([low, [top[0], low[1]], top, [low[0], top[1]]])
            window = window.joined(window_of(eye.project_at(corners, 0.0), eye.size))
    return window.grown(2 * COARSE, eye.size)


def shade(
    window: PictureWindow,
    level: float,
    casters: Sequence[PlacedSolid],
    eye: Projection,
    depth: float,
) -> FloatPicture | None:
    """Compute the light that shadows leave on a horizontal face, in a window of the picture.

    Parameters
    ----------
    window : PictureWindow
    level : float
        Height of the face above the plane [m].
    casters : sequence of PlacedSolid
        Solids that cast shadows; those below the face cast none.
    eye : Projection
    depth : float
        Share of the light that is missing in a full shadow [-].

    Returns
    -------
    (h, w) float32 or None
        Factors on the light; None without shadows.
    """
    hulls = [
        hull
        for thing in casters
        if depth > 0.0 and thing.solid.high > level + 1e-4
        for piece in thing.footprint
        for hull in _swept(piece, thing.solid.low, thing.solid.high, level, eye)
    ]
    if not hulls:
        return None
    # On the same grid for all windows, or shadows would flicker as windows move.
    left, top = window.left % COARSE, window.top % COARSE
    w, h = -(-(window.width + left) // COARSE), -(-(window.height + top) // COARSE)
    room = np.zeros((h, w + 2))
    lost: FloatPicture = np.zeros((h, w), np.float32)
    one: FloatPicture = np.empty((h, w), np.float32)
    met = False
    for ray, share in enumerate(SHARES):
        one[:] = 0.0
        for hull in hulls[ray :: len(RAYS)]:
            pixels = (hull + 0.5 - (window.left - left, window.top - top)) / COARSE - 0.5
            if (pixels.max(axis=0) > -1.0).all() and (pixels.min(axis=0) < (w, h)).all():
                cover(one, room, pixels)
                met = True
        lost += share * one
    if not met:
        return None
    cv2 = opencv()
    smooth = cv2.GaussianBlur(lost, (0, 0), 0.7)
    fine = cv2.resize(smooth, (w * COARSE, h * COARSE), interpolation=cv2.INTER_LINEAR)
    part = fine[top : top + window.height, left : left + window.width]
    return np.asarray(1.0 - np.float32(depth) * part)


def _swept(
    piece: FloatArray, low: float, high: float, level: float, eye: Projection
) -> list[FloatArray]:
    """Shadow of a convex piece for every ray, as convex polygons [px]."""
    cv2 = opencv()
    near, far = max(low - level, 0.0), high - level
    ends = np.concatenate((piece + near * RAYS[:, None], piece + far * RAYS[:, None]), axis=1)
    pixels = eye.project_at(ends, level).astype(np.float32)
    return [np.asarray(cv2.convexHull(ray)[:, 0], dtype=np.float64) for ray in pixels]
