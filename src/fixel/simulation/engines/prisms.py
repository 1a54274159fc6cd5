"""Rectangles among the pieces of an outline, which engines of three dimensions treat as boxes."""

from __future__ import annotations

import numpy as np

from fixel.typing import FloatArray

SQUARE = 1e-9  # cosine below which a corner is a right angle


def rectangle(corners: FloatArray) -> tuple[float, float, float, float, float] | None:
    """Return centre x, y, angle, length and width of a rectangle; None for other polygons."""
    if len(corners) != 4:
        return None
    sides = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*sides.T)
    cosine = np.einsum("kj,kj->k", sides, np.roll(sides, -1, axis=0)) / (
        length * np.roll(length, -1)
    )
    if np.abs(cosine).max() > SQUARE:
        return None
    x, y = corners.mean(axis=0).tolist()
    angle = float(np.arctan2(sides[0, 1], sides[0, 0]))
    return x, y, angle, float(length[0]), float(length[1])
