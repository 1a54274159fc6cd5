"""Tracking of parts by coloured stickers, as in the thesis."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar, Final, final

import numpy as np

from fixel.kernels.jit import entry
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray, Picture, opencv
from fixel.vision.marks import Rig, Sticker
from fixel.vision.tracking import base
from fixel.vision.tracking.loops import box_of, optics_of, seen_at
from fixel.vision.tracking.outline import OutlineEdges, PoseFit, circle_edges, fit_pose
from fixel.vision.tracking.tags import rigid

STICKER_REACH: Final = 6.0  # [px] from the expected sticker
APART: Final = 0.6e-3  # [m] at 0.55 mm per pixel: largest error of distances between stickers
MAX_RESIDUAL: Final = 0.7  # [px]
WIDER: Final = 20  # [px] added to the search margin around the last place
MIN_SHARE: Final = 0.35  # of a sticker's edge


@final
@dataclass(frozen=True, slots=True)
class Stickers(base.AbstractTracking):
    """Tracking by round stickers of one colour each, two or more per part.

    Stickers are found by hue and followed by their edges; see `fit_sticker`. Distances that
    differ from those in the rig show that another object was taken for a sticker.

    Source
    ------
    The thesis's appendix on tracking: two coloured stickers on object and actuator.
    """

    name: ClassVar[str] = "stickers"
    needs: ClassVar[str] = "two stickers, since one does not determine an angle"

    def parts(self, rig: Rig, things: Mapping[str, base.Thing]) -> tuple[str, ...]:
        """Parts with at least two stickers."""
        return tuple(name for name in rig.parts if len(_stickers(rig, name)) >= 2)

    def follow(self, rig: Rig, things: Mapping[str, base.Thing]) -> base.AbstractFollower:
        """Create a follower; see `AbstractTracking.follow`."""
        everything = tuple(sticker for name in rig.parts for sticker in _stickers(rig, name))
        return base.PartFollowers(
            {
                name: _StickeredPart(rig.camera, _stickers(rig, name), everything)
                for name in self.parts(rig, things)
            }
        )


def _stickers(rig: Rig, name: str) -> tuple[Sticker, ...]:
    return tuple(mark for mark in rig.parts[name].marks if isinstance(mark, Sticker))


class _StickeredPart(base.PartFollower):
    """Follower of one part from frame to frame."""

    def __init__(
        self, camera: Camera, own: tuple[Sticker, ...], everything: tuple[Sticker, ...]
    ) -> None:
        super().__init__()
        self._camera = camera
        self._own = own
        self._everything = everything
        self._scale = camera.metres_per_pixel(max(sticker.height for sticker in own))
        self._place = np.array([sticker.place for sticker in own])

    def _measured(self, frame: Frame, pose: FloatArray) -> base.PartObservation:
        return self._fitted(frame, placed(self._place, pose))

    def _searched(self, frame: Frame, followed: base.PartObservation) -> base.PartObservation:
        found, reason = self._found(frame)
        return base.PartObservation(reason=reason) if found is None else self._fitted(frame, found)

    def _fitted(self, frame: Frame, places: FloatArray) -> base.PartObservation:
        """Measure the pose from stickers near places (n, 2) [m]."""
        fits = [
            fit_sticker(frame, self._camera, sticker, place, STICKER_REACH)
            for sticker, place in zip(self._own, places, strict=True)
        ]
        missing = [fit for fit in fits if isinstance(fit, str)]
        good = [
            (k, fit)
            for k, fit in enumerate(fits)
            if not isinstance(fit, str) and fit.share >= MIN_SHARE and fit.residual <= MAX_RESIDUAL
        ]
        if len(good) < 2:
            return base.PartObservation(
                reason=missing[0] if missing else "its stickers are not round"
            )
        index = [k for k, _ in good]
        seen = np.array([fit.pose[:2] for _, fit in good])
        own = self._place[index]
        wrong = self._wrong_distance(index, own, seen)
        if wrong:
            return base.PartObservation(reason=wrong)
        pose = rigid(own, seen)
        sd = spread_of(seen, [fit.covariance[:2, :2] for _, fit in good])
        if base.vague(sd, self._scale):
            return base.PartObservation(
                reason="too little of its stickers is visible to estimate a pose"
            )
        off = np.hypot(*(placed(own, pose) - seen).T) / self._scale
        return base.PartObservation(
            pose=pose,
            residual=max(
                float(np.sqrt(np.mean(off**2))), float(np.mean([fit.residual for _, fit in good]))
            ),
            scale=self._scale,
            sd=sd,
            marks=len(good),
            share=float(np.mean([fit.share for _, fit in good])),
        )

    def _wrong_distance(self, index: list[int], own: FloatArray, seen: FloatArray) -> str:
        slack = APART * self._scale / base.USUAL_PIXEL
        for i, j in combinations(range(len(own)), 2):
            should = float(np.hypot(*(own[i] - own[j])))
            found = float(np.hypot(*(seen[i] - seen[j])))
            if abs(found - should) > slack:
                a, b = self._own[index[i]].colour, self._own[index[j]].colour
                return (
                    f"the {a} and {b} stickers are {found * 1e3:.2f} mm apart, "
                    f"not {should * 1e3:.2f} mm as in the rig"
                )
        return ""

    def _found(self, frame: Frame) -> tuple[FloatArray | None, str]:
        """Search for the stickers by colour; return places (n, 2) [m], or None and the reason."""
        rows, columns = self._where(frame)
        corner = np.array([columns.start or 0, rows.start or 0], dtype=np.float64)
        patches = find_patches(
            frame.picture[rows, columns], self._own, self._everything, self._camera, corner
        )
        places = []
        for sticker in self._own:
            candidates = patches[sticker.colour]
            if not candidates:
                return None, f"no {sticker.colour} sticker in the picture"
            if len(candidates) > 1:
                at = " and ".join(f"({u:.0f}, {v:.0f}) px" for u, v in candidates)
                return None, (
                    f"{len(candidates)} regions of the colour of the {sticker.colour} sticker, at "
                    f"{at}: remove or mask the others"
                )
            places.append(self._camera.on_plane(candidates[0], sticker.height))
        return np.array(places), ""

    def _where(self, frame: Frame) -> tuple[slice, slice]:
        last = self._search_near
        if last is None:
            return slice(None), slice(None)
        pixel = np.array(
            [
                self._camera.project_at(place, sticker.height)
                for place, sticker in zip(placed(self._place, last), self._own, strict=True)
            ]
        )
        width, height = frame.size
        margin = WIDER + self._search_margin
        low = np.maximum(pixel.min(0).astype(int) - margin, 0)
        high = np.minimum(pixel.max(0).astype(int) + margin, (width, height))
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def spread_of(seen: FloatArray, covariances: Sequence[FloatArray]) -> FloatArray:
    """Standard deviations (3,) of a pose from places (n, 2) and their covariances (2, 2)."""
    information = np.zeros((3, 3))
    for (x, y), covariance in zip(seen - seen.mean(0), covariances, strict=True):
        row = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        information += row.T @ np.linalg.inv(covariance) @ row
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


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

    The picture is a window of the camera's, whose upper left corner is `corner` (2,) [px]. A pixel
    belongs to the one of all stickers of the rig with the nearest hue.
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
    """Measure a sticker from its edge, near a place (2,) [m]; return a reason if that fails.

    The colours of the sticker and its surroundings are read from the picture, so that the light
    does not matter. They give the share of every pixel that the sticker covers. A circle at the
    sticker's height, projected by the camera, is fitted to the edge of the covered area. This is
    exact under perspective, and works for a partly hidden sticker. `reach` is the largest distance
    from the expected place [px].
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
    """Write the coverage of each pixel by a sticker near (u, v); return whether it is visible."""
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
