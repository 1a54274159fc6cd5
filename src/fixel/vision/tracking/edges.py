"""Edges in a picture, to a few hundredths of a pixel.

Where an edge is expected is known from the frame before. Brightness is read along its normal, and
the edge is put at the centre of its rise: an estimate that blur, defocus and noise do not push to
either side, as they do with the refinement of corners.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from fixel.kernels.arrays import FloatArray
from fixel.model.fields import BoolArray
from fixel.vision.frame import Gray

STEP: Final = 0.5  # [px] between readings along a normal
WINDOW: Final = 2.6  # [px] to either side of an edge that its rise is looked for in
SHIFTS: Final = 4  # of that window onto the centre of what is in it
BESIDE: Final = 2.5  # [px] from an edge to where its dark and its bright side are judged
LEAST_RISE: Final = 12.0  # of brightness, of 255, below which nothing is an edge


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


class Found(NamedTuple):
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


def read_profiles(picture: Gray, line: EdgeLine, reach: float) -> tuple[FloatArray, FloatArray]:
    """Brightness along normals.

    Returns
    -------
    place : (m,) float64
        Along the normal, from -reach to reach [px].
    profile : (n, m) float64
        Bilinear; beyond the picture, as at its border.
    """
    half = int(np.ceil(reach / STEP))
    place = STEP * np.arange(-half, half + 1, dtype=np.float64)
    at = line.pixel[:, :, None] + line.normal[:, :, None] * place
    profile = map_coordinates(
        picture, (at[:, 1], at[:, 0]), output=np.float64, order=1, mode="nearest", prefilter=False
    )
    return place, profile


def find_edges(picture: Gray, line: EdgeLine, reach: float) -> Found:
    """Where edges are along their normals.

    Parameters
    ----------
    picture : (height, width) uint8
    line : EdgeLine
        Where they are expected.
    reach : float
        How far from there they are looked for [px].
    """
    place, profile = read_profiles(picture, line, reach)
    rise = np.diff(profile, axis=1)
    middle = 0.5 * (place[1:] + place[:-1])
    start = middle[_strongest(rise)]
    centre, total = _centred(np.maximum(rise, 0.0), middle, start)
    inside = np.abs(centre) <= reach - 0.5 * WINDOW
    on_picture = _within(line.pixel, picture.shape, 1.0)
    edge = np.asarray(total > LEAST_RISE)
    dark, bright = (_level(profile, centre + side) for side in (-BESIDE, BESIDE))
    return Found(centre, dark, bright, edge & inside & on_picture)


def _level(profile: FloatArray, place: FloatArray) -> FloatArray:
    """(n,) brightness of profiles at places along them."""
    n, m = profile.shape
    index = np.clip(np.rint(place / STEP + (m - 1) / 2).astype(np.intp), 1, m - 2)
    row = np.arange(n)
    return np.asarray((profile[row, index - 1] + profile[row, index] + profile[row, index + 1]) / 3)


def _strongest(rise: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """(n,) where brightness rises fastest over a pixel."""
    smooth = rise.copy()
    smooth[:, 1:] += rise[:, :-1]
    smooth[:, :-1] += rise[:, 1:]
    return np.asarray(np.argmax(smooth, axis=1))


def _centred(
    rise: FloatArray, middle: FloatArray, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Centre of the rise in a window that is moved onto it, and the whole rise in there."""
    centre = start
    weight = rise
    for _ in range(SHIFTS):
        apart = (middle - centre[:, None]) / WINDOW
        weight = rise * np.maximum(1.0 - apart * apart, 0.0)
        total = weight.sum(axis=1)
        centre = np.where(total > 0.0, weight @ middle / np.maximum(total, 1e-9), centre)
    return centre, weight.sum(axis=1)


def _within(pixel: FloatArray, shape: tuple[int, ...], margin: float) -> BoolArray:
    height, width = shape[:2]
    u, v = pixel.T
    return np.asarray(
        (u >= margin) & (v >= margin) & (u <= width - 1 - margin) & (v <= height - 1 - margin)
    )
