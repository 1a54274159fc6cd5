"""Conversion of tags and stickers to polygons."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.marks import Mark, Tag
from fixel.vision.opencv import opencv
from fixel.vision.render.solids import Ink, circle, polygon

DICTIONARIES: Final = {
    "apriltag-36h11": "DICT_APRILTAG_36h11",
    "aruco-4x4-50": "DICT_4X4_50",
    "aruco-5x5-100": "DICT_5X5_100",
}
QUIET: Final = 1.0  # width of the white margin in cells, which detectors need

PAPER: Final = np.array([222.0, 226.0, 228.0])
TONER: Final = np.array([30.0, 28.0, 27.0])
COLOUR_OF: Final[dict[str, tuple[float, float, float]]] = {
    "red": (42.0, 38.0, 205.0),
    "orange": (30.0, 120.0, 235.0),
    "yellow": (45.0, 215.0, 235.0),
    "green": (70.0, 165.0, 55.0),
    "cyan": (205.0, 190.0, 40.0),
    "blue": (185.0, 85.0, 35.0),
    "magenta": (165.0, 45.0, 205.0),
}


def inks(mark: Mark, pixel: float) -> tuple[Ink, ...]:
    """Return the coloured polygons of a marker, for a size of pixels of about `pixel` [m]."""
    if isinstance(mark, Tag):
        return _tag(mark, pixel)
    ring = circle(0.5 * mark.diameter, pixel, mark.place).points
    colour = np.array(COLOUR_OF[mark.colour])
    return (Ink(ring, np.array([0, len(ring)]), mark.height, colour),)


@cache
def tag_cells(family: str, number: int) -> NDArray[np.bool_]:
    """Return (n, n) bool: black cells of a tag with its border; rows from the upper side down."""
    cv2 = opencv()
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[family]))
    side = int(dictionary.markerSize) + 2
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, number, side) < 128)


def _tag(tag: Tag, pixel: float) -> tuple[Ink, Ink]:
    black = tag_cells(tag.family, tag.id)
    n = len(black)
    cell = tag.size / n
    half = 0.5 * tag.size + QUIET * cell
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    paper = polygon(corners, pixel).points
    row, column = np.nonzero(black)
    # Neighbours share their edges exactly, so that no paper is visible between them.
    left, top = cell * column - 0.5 * tag.size, 0.5 * tag.size - cell * row
    square = cell * np.array([[0.0, -1.0], [1.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    cells = (np.column_stack((left, top))[:, None] + square).reshape(-1, 2)
    return (
        _ink(paper, np.array([0, len(paper)]), tag, PAPER),
        _ink(cells, np.arange(0, len(cells) + 1, 4), tag, TONER),
    )


def _ink(points: FloatArray, starts: NDArray[np.int64], tag: Tag, colour: FloatArray) -> Ink:
    return Ink(placed(points, tag.pose), starts, tag.height, colour)
