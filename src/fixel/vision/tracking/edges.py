"""Edges in a picture, to a few hundredths of a pixel.

Where an edge is expected is known from the frame before. Brightness is read along its normal, and
the edge is put at the centre of its rise: an estimate that blur, defocus and noise do not push to
either side, as they do with the refinement of corners.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fixel.typing import BoolArray, FloatArray
from fixel.vision.frame import Gray
from fixel.vision.tracking.loops import edges_along


class EdgeLine(NamedTuple):
    """Places where an edge is expected.

    Attributes
    ----------
    pixel : (n, 2) float64
        On it [px].
    normal : (n, 2) float64
        From its dark side to its bright one, of length 1.
    """

    pixel: FloatArray
    normal: FloatArray


class EdgePoints(NamedTuple):
    """What was found there.

    Attributes
    ----------
    offset : (n,) float64
        Of the edge along its normal [px].
    dark, bright : (n,) float64
        Brightness a little to either side of it.
    clear : (n,) bool
        Whether there is an edge at all, well inside what was read.
    """

    offset: FloatArray
    dark: FloatArray
    bright: FloatArray
    clear: BoolArray


def find_edges(picture: Gray, line: EdgeLine, reach: float) -> EdgePoints:
    """Where edges are along their normals.

    Parameters
    ----------
    picture : (height, width) uint8
    line : EdgeLine
        Where they are expected.
    reach : float
        How far from there they are looked for [px].
    """
    n = len(line.pixel)
    found = np.empty((n, 3))
    clear = np.empty(n, dtype=np.bool_)
    edges_along(picture, line.pixel, line.normal, reach, found, clear)
    return EdgePoints(found[:, 0], found[:, 1], found[:, 2], clear)
