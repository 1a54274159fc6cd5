"""Detection of round stickers by colour, and measurement of their places."""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np

from fixel.kernels.jit import entry
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray, Picture
from fixel.vision.marks import Sticker
from fixel.vision.opencv import opencv
from fixel.vision.tracking.loops import box_of, optics_of, seen_at
from fixel.vision.tracking.outline import OutlineEdges, PoseFit, circle_edges, fit_pose

# Hues of colours [deg]. Light changes brightness most, then saturation, and hue least.
HUES: Final = {
    "red": 0.0,
    "orange": 25.0,
    "yellow": 52.0,
    "green": 125.0,
    "cyan": 182.0,
    "blue": 220.0,
    "magenta": 310.0,
}
HUE_SLACK: Final = 30.0  # [deg]
MIN_SATURATION: Final = 75  # of 255
MIN_BRIGHTNESS: Final = 35  # of 255
AREA: Final = (0.45, 1.8)  # of the expected area, for a sticker
ROUND: Final = 0.6  # least filling of its box, and ratio of the box's sides, for a disk
RIM: Final = 14.0  # [px] margin of the window around a sticker
CORE, RING = 0.55, (1.35, 1.75)  # of the radius: certainly inside, certainly outside
CONTRAST = 25.0  # of 255 between a sticker and its surroundings
COVERED, BARE = 215.0, 40.0  # brightness of pictures of coverage
MIN_INSIDE, MIN_AROUND = 4, 8  # pixels needed for a mean colour


def find_patches(
    picture: Picture,
    wanted: tuple[Sticker, ...],
    stickers: tuple[Sticker, ...],
    camera: Camera,
    corner: FloatArray,
) -> dict[str, list[FloatArray]]:
    """Find all patches that may be the wanted stickers: their middles (2,) [px], by colour.

    Parameters
    ----------
    picture : (height, width, 3) uint8
        A window of the camera's picture.
    wanted : tuple of Sticker
    stickers : tuple of Sticker
        All stickers of the rig; a pixel belongs to the one with the nearest hue.
    camera : Camera
    corner : (2,) float64
        Upper left corner of the window [px].
    """
    cv2 = opencv()
    hue, saturation, value = np.moveaxis(
        cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_BGR2HSV), -1, 0
    )
    coloured = (saturation >= MIN_SATURATION) & (value >= MIN_BRIGHTNESS)
    kind = _nearest_hue(tuple(sticker.colour for sticker in stickers))[hue]
    found: dict[str, list[FloatArray]] = {}
    for index, sticker in enumerate(stickers):
        if sticker not in wanted:
            continue
        mask = ((kind == index) & coloured).view(np.uint8)
        _, _, boxes, middles = cv2.connectedComponentsWithStats(mask, connectivity=8)
        _, _, wide, high, area = boxes[1:].T  # without the background
        full = np.pi * (sticker.diameter / 2.0 / camera.metres_per_pixel(sticker.height)) ** 2
        fits = (AREA[0] * full < area) & (area < AREA[1] * full)
        fits &= np.minimum(wide, high) >= ROUND * np.maximum(wide, high)
        fits &= area >= ROUND * wide * high
        found[sticker.colour] = list(middles[1:][fits] + corner)
    return found


def _nearest_hue(colours: tuple[str, ...]) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
    """Indices (256,) of the nearest colour for OpenCV's hues; -1 for none."""
    degrees = 2.0 * np.arange(256)[:, None]
    apart = np.abs((degrees - [HUES[c] for c in colours] + 180.0) % 360.0 - 180.0)
    return np.where(apart.min(1) <= HUE_SLACK, apart.argmin(1), -1).astype(np.int8)


def fit_sticker(
    frame: Frame, camera: Camera, sticker: Sticker, place: FloatArray, reach: float
) -> PoseFit | str:
    """Measure the place of a sticker from its edge.

    The colours of the sticker and its surroundings are read from the picture, so that the light
    does not matter. They give the share of every pixel that the sticker covers. A circle at the
    sticker's height, projected by the camera, is fitted to the edge of the covered area. This is
    exact under perspective, and works for a partly hidden sticker.

    Parameters
    ----------
    frame : Frame
    camera : Camera
    sticker : Sticker
    place : (2,) float64
        Expected place in the world [m].
    reach : float
        Largest distance from the expected place [px].

    Returns
    -------
    PoseFit, or a reason why there is none.
    """
    radius = sticker.diameter / 2.0
    edges = _rim(radius, sticker.height)
    in_pixels = _in_pixels(camera, edges, place)
    middle = seen_at(camera, place, sticker.height)
    window, corner = _window(frame, middle, RING[1] * in_pixels + RIM)
    if window is None:
        return f"the {sticker.colour} sticker is out of the picture"
    fit: PoseFit | None = None
    pose = np.append(place, 0.0)
    for look in (reach, 3.2):
        u, v = seen_at(camera, pose[:2], sticker.height)
        covered = np.empty(window.shape[:2], np.uint8)
        if not cover(window, u - corner[0], v - corner[1], in_pixels, covered):
            return f"the {sticker.colour} sticker is not visible"
        fit = fit_pose(
            covered, camera, edges, pose, reach=look, turns=False, rounds=2, corner=corner
        )
        if fit is None:
            return f"too little of the edge of the {sticker.colour} sticker is visible"
        moved = np.hypot(*(fit.pose - pose)[:2]) / radius
        pose = fit.pose
        if moved < 0.1:
            break
    return fit if fit is not None else ""


@functools.lru_cache(maxsize=32)
def _rim(radius: float, height: float) -> OutlineEdges:
    return circle_edges(radius, height, dark_inside=False, points=32)


def _in_pixels(camera: Camera, edges: OutlineEdges, place: FloatArray) -> float:
    """Mean radius in the picture of a circle at a place [px]."""
    box = np.empty((2, 2))
    if not box_of(optics_of(camera), edges.thing, np.append(place, 0.0), box):
        return 1.0
    return float(0.25 * (box[1] - box[0]).sum())


def _window(
    frame: Frame, middle: tuple[float, float], half: float
) -> tuple[Picture | None, tuple[int, int]]:
    width, height = frame.size
    left, top = (max(int(x), 0) for x in (middle[0] - half, middle[1] - half))
    right, bottom = min(int(middle[0] + half) + 1, width), min(int(middle[1] + half) + 1, height)
    if right - left < half or bottom - top < half:
        return None, (0, 0)
    # Always a copy: the loops would be recompiled for each memory layout.
    return np.array(frame.picture[top:bottom, left:right]), (left, top)


@entry
def cover(window: Picture, u: float, v: float, radius: float, covered: Gray) -> bool:
    """Write the coverage of each pixel by a sticker near (u, v) as a picture.

    Returns
    -------
    bool
        Whether a sticker is visible there.
    """
    height, width = covered.shape
    inside, around = np.zeros(3), np.zeros(3)
    n_inside = n_around = 0
    for y in range(height):
        for x in range(width):
            apart = math.hypot(x - u, y - v) / radius
            if apart < CORE:
                n_inside += 1
                for k in range(3):
                    inside[k] += window[y, x, k]
            elif RING[0] < apart < RING[1]:
                n_around += 1
                for k in range(3):
                    around[k] += window[y, x, k]
    if n_inside < MIN_INSIDE or n_around < MIN_AROUND:
        return False
    inside /= n_inside
    around /= n_around
    by = inside - around
    square = by[0] * by[0] + by[1] * by[1] + by[2] * by[2]
    if square < CONTRAST**2:
        return False
    by *= (COVERED - BARE) / square
    level = BARE - (by[0] * around[0] + by[1] * around[1] + by[2] * around[2])
    for y in range(height):
        for x in range(width):
            value = level
            for k in range(3):
                value += by[k] * window[y, x, k]
            covered[y, x] = int(min(max(value, 0.0), 255.0))
    return True
