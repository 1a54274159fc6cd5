"""Tracking of a probe's needle, which enters over the border and ends in a blunt tip."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.model import Shape
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray, opencv
from fixel.vision.tracking.base import PartObservation, PartPrediction
from fixel.vision.tracking.loops import find_edges

STATIONS: Final = 24  # places along the needle at which its two sides are measured
NEAREST, FARTHEST = 5.0, 75.0  # [px] distances of these from the tip
SIDE_REACH: Final = 5.0  # [px] from the expected side
REACH_TIP: Final = 12.0  # [px] from the expected tip
ACROSS: Final = (-1.0, 0.0, 1.0)  # [px] offsets from the axis at which the end is measured
TOUCHING: Final = 1.0  # [px] gaps below this cannot be seen: blur fills them
MIN_STATIONS: Final = 8  # stations that must be visible
MAX_RESIDUAL: Final = 0.6  # [px]
BRIGHT: Final = 0.6  # of the contrast at the sides, least contrast of the end


class NeedleShape(NamedTuple):
    """Direction and width of a needle, nearly the same in all frames."""

    axis: FloatArray  # (2,) direction in the picture, towards the tip [-]
    half: float  # half the width at the tip [px]
    taper: float  # its growth with the distance from there [-]


@dataclass(slots=True, kw_only=True)
class NeedleFollower:
    """Follower of the tip of a probe.

    The axis is fitted to both sides of the needle. The tip is the end of dark along it or, where
    the needle meets the part without a gap, the outline of the part.
    """

    camera: Camera
    name: str
    shape: Shape  # shape of the pusher, whose foremost point is the tip
    height: float  # height above the plane [m]
    _needle: NeedleShape | None = None
    _prediction: PartPrediction = field(default_factory=PartPrediction)

    def see(
        self, frame: Frame, part: FloatArray | None, dark: NDArray[np.uint8] | None
    ) -> PartObservation:
        """Measure the probe in a frame.

        `part` (n, 2) is the outline of the part in the picture [px]; `dark` is a mask of the dark
        pixels outside of it, in which to search for the probe.
        """
        sight = self._prediction.follow(
            frame.time, lambda pose: self._followed(frame, self._tip_of(pose), part)
        )
        if sight is not None and sight.pose is not None:
            return sight
        if dark is None:
            return PartObservation(reason=f"the tip of {self.name} is not visible")
        start = self._found(dark)
        if start is None:
            return PartObservation(reason=f"no {self.name} reaches into the picture")
        return self._followed(frame, start, part)

    def _followed(self, frame: Frame, tip: FloatArray, part: FloatArray | None) -> PartObservation:
        needle = self._needle
        assert needle is not None
        residual = math.inf
        scatter = np.zeros(2)
        for _ in range(2):
            sides = _sides(frame.luma, needle, tip)
            if sides is None:
                return PartObservation(reason=f"too little of the needle of {self.name} is visible")
            shift, tilt, residual, spread, contrast = sides
            across = np.array([-needle.axis[1], needle.axis[0]])
            axis = needle.axis + tilt * across
            needle = needle._replace(axis=axis / np.hypot(*axis))
            tip = tip + shift * across
            along = _end(frame.luma, needle, tip, part, self._front(needle), contrast)
            if along is None:
                return PartObservation(
                    reason=f"the end of the needle of {self.name} is not visible"
                )
            tip = tip + along * needle.axis
            scatter = np.array([max(residual, 0.05) * spread, max(residual, 0.05)])
        if residual > MAX_RESIDUAL:
            return PartObservation(reason=f"sides of the needle scatter by {residual:.2f} px")
        scale = self.camera.metres_per_pixel(self.height)
        pose = np.append(self.camera.on_plane(tip, self.height) - self._ahead(needle, tip), 0.0)
        self._prediction.seen(frame.time, pose)
        self._needle = needle
        return PartObservation(
            pose=pose,
            residual=residual,
            scale=scale,
            sd=np.array([scatter[1] * scale, scatter[1] * scale, 0.0]),
            marks=STATIONS,
            share=1.0,
        )

    def _ahead(self, needle: NeedleShape, tip: FloatArray) -> FloatArray:
        """Vector (2,) from the pusher's origin to its foremost point, in the world [m]."""
        behind, at = self.camera.on_plane(np.array([tip - 20.0 * needle.axis, tip]), self.height)
        direction = (at - behind) / np.hypot(*(at - behind))
        return np.asarray(float((self.shape.outline @ direction).max()) * direction)

    def _front(self, needle: NeedleShape) -> FloatArray:
        """Points (n, 2) of the pusher's front, along the axis and across, from the tip [px]."""
        scale = self.camera.metres_per_pixel(self.height)
        tip = self.camera.project_at(np.zeros(2), self.height)
        ahead = self.camera.on_plane(tip + 20.0 * needle.axis, self.height)
        along = ahead / np.hypot(*ahead)
        aside = np.array([along[1], -along[0]])  # the picture is mirrored
        outline = np.column_stack((self.shape.outline @ along, self.shape.outline @ aside)) / scale
        outline[:, 0] -= outline[:, 0].max()
        return np.asarray(outline[outline[:, 0] > -0.5 * np.ptp(outline[:, 1])])

    def _tip_of(self, pose: FloatArray) -> FloatArray:
        assert self._needle is not None
        rough = self.camera.project_at(pose[:2], self.height)
        return self.camera.project_at(pose[:2] + self._ahead(self._needle, rough), self.height)

    def _found(self, dark: NDArray[np.uint8]) -> FloatArray | None:
        """Find the tip (2,) [px] roughly, as the farthest point of the dark area at the border."""
        cv2 = opencv()
        n, labels, boxes, _ = cv2.connectedComponentsWithStats(dark)
        height, width = dark.shape
        left, top = boxes[:, 0], boxes[:, 1]
        right, bottom = left + boxes[:, 2], top + boxes[:, 3]
        at_border = (left == 0) | (top == 0) | (right == width) | (bottom == height)
        own = [k for k in range(1, n) if at_border[k] and boxes[k][4] > 50]
        if not own:
            return None
        mask = labels == max(own, key=lambda k: int(boxes[k][4]))
        rows, columns = np.nonzero(mask)
        border = (rows == 0) | (columns == 0) | (rows == height - 1) | (columns == width - 1)
        root = np.array([columns[border].mean(), rows[border].mean()])
        far = int(np.argmax(np.hypot(columns - root[0], rows - root[1])))
        tip = np.array([columns[far], rows[far]], dtype=np.float64)
        axis = (tip - root) / np.hypot(*(tip - root))
        pixels = np.column_stack((columns, rows))
        behind = (tip - pixels) @ axis
        near = behind < FARTHEST
        aside = (pixels - tip) @ np.array([-axis[1], axis[0]])
        tip = tip + np.median(aside[behind < 10.0]) * np.array([-axis[1], axis[0]])
        # Width against distance from the tip, from the number of pixels.
        count, edges = np.histogram(behind[near], bins=np.arange(2.0, FARTHEST, 4.0))
        taper, half = np.polyfit(0.5 * (edges[1:] + edges[:-1]), count / 8.0, 1)
        self._needle = NeedleShape(axis, max(float(half), 1.0), max(float(taper), 0.0))
        return np.asarray(tip)


def _sides(
    picture: Gray, needle: NeedleShape, tip: FloatArray
) -> tuple[float, float, float, float, float] | None:
    """Fit shift and tilt of the axis; return also residual [px], leverage at the tip, contrast."""
    behind = np.linspace(NEAREST, FARTHEST, STATIONS)
    height, width = picture.shape
    middle = tip - behind[:, None] * needle.axis
    inside = ((middle > 2.0) & (middle < (width - 3.0, height - 3.0))).all(1)
    behind, middle = behind[inside], middle[inside]
    if len(behind) < MIN_STATIONS:
        return None
    across = np.array([-needle.axis[1], needle.axis[0]])
    half = (needle.half + needle.taper * behind)[:, None]
    pixel = np.concatenate((middle + half * across, middle - half * across))
    normal = np.concatenate((np.tile(across, (len(middle), 1)), np.tile(-across, (len(middle), 1))))
    found, clear = find_edges(picture, pixel, normal, SIDE_REACH)
    offset, dark, bright = found.T
    n = len(middle)
    both = clear[:n] & clear[n:]
    if both.sum() < MIN_STATIONS:
        return None
    centre = 0.5 * (offset[:n] - offset[n:])
    for _ in range(3):
        slope, shift = np.polyfit(behind[both], centre[both], 1)
        rest = centre - (shift + slope * behind)
        kept = both & (np.abs(rest) < 3.0 * max(1.48 * np.median(np.abs(rest[both])), 0.05))
        if kept.sum() < MIN_STATIONS:
            return None
        both = kept
    residual = float(np.sqrt(np.mean(rest[both] ** 2)))
    contrast = float(np.median((bright - dark)[clear]))
    x = behind[both]
    leverage = math.sqrt(1.0 / len(x) + x.mean() ** 2 / float(((x - x.mean()) ** 2).sum()))
    return float(shift), -float(slope), residual, leverage, contrast


def _end(
    picture: Gray,
    needle: NeedleShape,
    tip: FloatArray,
    part: FloatArray | None,
    front: FloatArray,
    contrast: float,
) -> float | None:
    """Offset of the end from the expected tip along the axis [px]; None where it is not visible."""
    across = np.array([-needle.axis[1], needle.axis[0]])
    pixel = tip + np.array(ACROSS)[:, None] * across
    found, clear = find_edges(picture, pixel, np.tile(needle.axis, (len(pixel), 1)), REACH_TIP)
    offset, dark, bright = found.T
    open_ = clear & (bright - dark > BRIGHT * contrast)
    # A blunt end touches a slanting side away from its middle: use the pusher's outline.
    walls = [_wall(part, tip + a * needle.axis + c * across, needle.axis) for a, c in front]
    met = [wall for wall in walls if wall is not None]
    wall = min(met) if met else None
    if open_.all():
        free = float(np.mean(offset))
        if wall is None or free < wall - TOUCHING:
            return free
    if wall is not None and abs(wall) < REACH_TIP:
        return wall
    return None


def _wall(part: FloatArray | None, tip: FloatArray, axis: FloatArray) -> float | None:
    """Distance along the axis from the tip to the intersection with an outline [px]."""
    if part is None:
        return None
    start = tip - 2.0 * REACH_TIP * axis
    a, b = part, np.roll(part, -1, axis=0)
    edge = b - a
    cross = axis[0] * edge[:, 1] - axis[1] * edge[:, 0]
    cross = np.where(np.abs(cross) < 1e-12, np.inf, cross)
    to = a - start
    along = (to[:, 0] * edge[:, 1] - to[:, 1] * edge[:, 0]) / cross
    share = (to[:, 0] * axis[1] - to[:, 1] * axis[0]) / cross
    hit = np.isfinite(cross) & (along > 0.0) & (share >= 0.0) & (share <= 1.0)
    return float(along[hit].min()) - 2.0 * REACH_TIP if hit.any() else None
