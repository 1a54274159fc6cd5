"""Edge detection in a picture, accurate to a few hundredths of a pixel.

The expected place of an edge is known from the previous frame. Brightness is read along the normal,
and the edge is the centre of its rise. Blur, defocus and noise do not bias this estimate, in
contrast to the refinement of corners.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fixel.typing import BoolArray, FloatArray
from fixel.vision.frame import Gray
from fixel.vision.tracking.loops import edges_along


class EdgeLine(NamedTuple):
    """Expected places of edges.

    Attributes
    ----------
    pixel : (n, 2) float64
        Points on the edge [px].
    normal : (n, 2) float64
        Unit vectors from the dark side to the bright one.
    """

    pixel: FloatArray
    normal: FloatArray


class EdgePoints(NamedTuple):
    """Edges found at expected places.

    Attributes
    ----------
    offset : (n,) float64
        Offset of the edge along its normal [px].
    dark, bright : (n,) float64
        Brightness near the edge, on either side.
    clear : (n,) bool
        Whether there is an edge, well within reach.
    """

    offset: FloatArray
    dark: FloatArray
    bright: FloatArray
    clear: BoolArray


def find_edges(picture: Gray, line: EdgeLine, reach: float) -> EdgePoints:
    """Find edges along their normals.

    Parameters
    ----------
    picture : (height, width) uint8
    line : EdgeLine
        Expected places.
    reach : float
        Largest distance from the expected places [px].
    """
    n = len(line.pixel)
    found = np.empty((n, 3))
    clear = np.empty(n, dtype=np.bool_)
    edges_along(picture, line.pixel, line.normal, reach, found, clear)
    return EdgePoints(found[:, 0], found[:, 1], found[:, 2], clear)
