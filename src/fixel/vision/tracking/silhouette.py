"""Tracking of outlines without markers against a bright field, as under a microscope."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.model import Disk, Shape
from fixel.model.shape import placed
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray, opencv
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import (
    AbstractFollower,
    AbstractTracking,
    PartObservation,
    PartPrediction,
    Thing,
    vague,
)
from fixel.vision.tracking.needle import NeedleFollower
from fixel.vision.tracking.outline import OutlineEdges, circle_edges, fit_spread

POINTS: Final = 160  # on an outline
CORNER: Final = 2.0  # [px] left out near corners, which are never sharp
OUTLINE_REACH: Final = 8.0  # [px] from the expected outline
REACH_FIRST: Final = 20.0  # [px] from the start by moments
MAX_RESIDUAL: Final = 0.7  # [px]
MIN_SHARE: Final = 0.3
DOUBTFUL: Final = 0.8  # of an outline: where less is visible, the part is searched for
ALIKE: Final = 0.1  # difference of shares [-] or residuals [px] at which poses fit alike
NEEDLE: Final = 0.3  # of the part's narrower side: thinner areas are taken for the probe
CONTRAST: Final = 25.0  # of 255 between part and field
AREA: Final = (0.6, 1.5)  # of the expected area, for the part


@final
@dataclass(frozen=True, slots=True)
class Silhouette(AbstractTracking):
    """Tracking of dark parts on a bright field by their outlines.

    A threshold separates dark from bright, an opening removes the needle of the probe, and an
    ellipse with the moments of the rest gives the start pose, as in the paper. Then the outline of
    the scene is fitted to the edge, to a fraction of a pixel; where the probe covers it, there is
    no edge. The dark area outside the part that reaches the border is the probe; its tip is fitted
    likewise, without rotation.

    Source
    ------
    The ASME 2006 paper, section on vision.
    """

    name: ClassVar[str] = "silhouette"
    needs: ClassVar[str] = "no markers, and an outline in the scene under its name"

    def parts(self, rig: Rig, things: Mapping[str, Thing]) -> tuple[str, ...]:
        """Parts without markers whose outline is known, largest first."""
        bare = [name for name in rig.parts if not rig.parts[name].marks and name in things]
        return tuple(sorted(bare, key=lambda name: -things[name].shape.area))

    def follow(self, rig: Rig, things: Mapping[str, Thing]) -> AbstractFollower:
        """Create a follower; see `AbstractTracking.follow`."""
        names = self.parts(rig, things)
        if len(names) > 2:
            found = f"{len(names)} parts without markers"
            expected = "a part and a probe, since more outlines cannot be distinguished"
            raise InvalidInput(f"rig {rig.name!r}", found=found, expected=expected)
        part, *probe = names
        return _OutlineFollower(rig, part, things[part], {name: things[name] for name in probe})


class _OutlineFollower(AbstractFollower):
    """Follower of the outline of a part, and of the needle of a probe, if there is one."""

    def __init__(self, rig: Rig, name: str, thing: Thing, probes: Mapping[str, Thing]) -> None:
        self._name = name
        self._probe: NeedleFollower | None = None
        for probe, own in probes.items():
            self._probe = NeedleFollower(
                camera=rig.camera, name=probe, shape=own.shape, height=rig.parts[probe].height
            )
        self._camera: Camera = rig.camera
        self._shape = thing.shape
        self._angle = float(thing.pose[2])
        self._height = rig.parts[name].height
        self._scale = rig.camera.metres_per_pixel(self._height)
        self._edges = outline_edges(thing.shape, self._height, CORNER * self._scale)
        self._prediction = PartPrediction()
        self._spread = 0.0

    def see(self, frame: Frame) -> dict[str, PartObservation]:
        part = self._followed(frame)
        dark: NDArray[np.uint8] | None = None
        if part.pose is None or part.share < DOUBTFUL:
            dark = _dark(frame.luma)
            part = self._found(frame, dark, part)
        if self._probe is None:
            return {self._name: part}
        outline = None
        if part.pose is not None:
            corners = placed(self._shape.outline, part.pose)
            outline = self._camera.project_at(corners, self._height)
        probe = self._probe.see(frame, outline, None)
        if probe.pose is None and outline is not None:
            dark = _dark(frame.luma) if dark is None else dark
            probe = self._probe.see(frame, outline, _without(dark, outline))
        return {self._name: part, self._probe.name: probe}

    def _followed(self, frame: Frame) -> PartObservation:
        sight = self._prediction.follow(
            frame.time, lambda pose: self._fitted(frame, pose, OUTLINE_REACH)
        )
        if sight is None:
            return PartObservation(reason="not found yet")
        if sight.pose is not None:
            self._prediction.seen(frame.time, sight.pose)
        return sight

    def _fitted(self, frame: Frame, pose: FloatArray, reach: float) -> PartObservation:
        fit = fit_spread(
            frame.luma, self._camera, self._edges, pose, reach=reach, last=self._spread, rounds=6
        )
        if fit is None or fit.share < MIN_SHARE:
            return PartObservation(reason=f"too little of the outline of {self._name} is visible")
        if fit.residual > MAX_RESIDUAL:
            return PartObservation(
                reason=f"the outline of {self._name} is off by {fit.residual:.2f} px"
            )
        if vague(fit.deviations, self._scale):
            return PartObservation(reason=f"too little of the outline of {self._name} is visible")
        self._spread = fit.spread
        return fit.observed(self._scale, fit.deviations, int(fit.used.sum()))

    def _found(
        self, frame: Frame, dark: NDArray[np.uint8], followed: PartObservation
    ) -> PartObservation:
        """Search the whole picture for a part that could not be followed well."""
        blob, reason = self._blob(dark)
        if blob is None:
            return PartObservation(reason=reason) if followed.pose is None else followed
        best = followed
        for start in self._starts(blob):
            sight = self._fitted(frame, start, REACH_FIRST)
            if sight.pose is not None and self._better(sight, best):
                best = sight
        if best is not followed or best.pose is None:
            self._prediction = PartPrediction()
        if best.pose is None:
            return PartObservation(reason="no region of the picture has its outline")
        if best is not followed:
            self._prediction.seen(frame.time, best.pose)
        return best

    def _better(self, sight: PartObservation, best: PartObservation) -> bool:
        """Whether a pose fits better, or equally well and is nearer to the scene's angle."""
        if best.pose is None or sight.pose is None:
            return best.pose is None
        gain = (sight.share - sight.residual) - (best.share - best.residual)
        if abs(gain) > ALIKE:
            return gain > 0.0
        off = [abs(float(wrapped(pose[2] - self._angle))) for pose in (sight.pose, best.pose)]
        return off[0] < off[1]

    def _blob(self, dark: NDArray[np.uint8]) -> tuple[NDArray[np.bool_] | None, str]:
        """Return the mask of the part without a needle, or None and the reason."""
        cv2 = opencv()
        outline = self._shape.outline
        narrow = float(min(cv2.minAreaRect(outline.astype(np.float32) / self._scale)[1]))
        size = max(int(NEEDLE * narrow), 1)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        opened = cv2.morphologyEx(dark, cv2.MORPH_OPEN, disc)
        n, labels, boxes, _ = cv2.connectedComponentsWithStats(opened)
        full = self._shape.area / self._scale**2
        own = [k for k in range(1, n) if AREA[0] * full < boxes[k][4] < AREA[1] * full]
        if not own:
            return None, f"no dark region of the size of {self._name} in the picture"
        if len(own) > 1:
            return None, f"{len(own)} dark regions of the size of {self._name} in the picture"
        return labels == own[0], ""

    def _starts(self, blob: NDArray[np.bool_]) -> list[FloatArray]:
        """Two start poses with the ellipse of a mask, half a turn apart."""
        rows, columns = np.nonzero(blob)
        step = max(len(rows) // 4000, 1)
        pixels = np.column_stack((columns, rows))[::step].astype(np.float64)
        seen = self._camera.on_plane(pixels, self._height)
        own = filled(self._shape, 4000)
        angle = _axis(seen) - _axis(own)
        starts = []
        for turn in (0.0, math.pi):
            pose = np.array([0.0, 0.0, angle + turn])
            pose[:2] = seen.mean(0) - placed(own.mean(0), pose)
            starts.append(pose)
        return starts


def outline_edges(shape: Shape, height: float, corner: float) -> OutlineEdges:
    """Create edges of an outline, dark inside, none within `corner` [m] of a corner."""
    if isinstance(shape, Disk):
        return circle_edges(shape.radius, height, dark_inside=True, points=POINTS)
    point, outward = _along(shape.outline, corner)
    return OutlineEdges(
        point=point,
        outward=outward,
        height=np.full(len(point), height),
        group=np.zeros(len(point), dtype=np.int64),
    )


def _along(outline: FloatArray, corner: float) -> tuple[FloatArray, FloatArray]:
    following = np.roll(outline, -1, axis=0)
    length = np.hypot(*(following - outline).T)
    points, outward = [], []
    for start, end, long in zip(outline, following, length, strict=True):
        left_out = min(corner, 0.3 * float(long))
        n = max(round(POINTS * float(long / length.sum())), 3)
        along = np.linspace(left_out, long - left_out, n)[:, None]
        direction = (end - start) / long
        points.append(start + along * direction)
        outward.append(np.tile([direction[1], -direction[0]], (n, 1)))
    return np.concatenate(points), np.concatenate(outward)


def filled(shape: Shape, about: int) -> FloatArray:
    """Points (n, 2) of a grid over a shape, approximately `about` of them [m]."""
    import shapely

    polygon = shapely.Polygon(shape.outline)
    low, high = shape.outline.min(0), shape.outline.max(0)
    step = math.sqrt(float(np.prod(high - low)) / about)
    x, y = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    inside = shapely.contains_xy(polygon, x.ravel(), y.ravel())
    return np.asarray(np.column_stack((x.ravel(), y.ravel()))[inside])


def _axis(points: FloatArray) -> float:
    """Angle of the long axis of the ellipse with the moments of points [rad]."""
    (xx, xy), (_, yy) = np.cov(points.T).tolist()
    return 0.5 * math.atan2(2.0 * xy, xx - yy)


def _dark(picture: Gray) -> NDArray[np.uint8]:
    """Mask dark pixels by Otsu's threshold (255); all 0 without contrast."""
    cv2 = opencv()
    contiguous = np.ascontiguousarray(picture)
    low, high = np.percentile(contiguous[::4, ::4], (1.0, 99.0))
    if high - low < CONTRAST:
        return np.zeros(picture.shape, dtype=np.uint8)
    _, mask = cv2.threshold(contiguous, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    return np.asarray(mask, dtype=np.uint8)


def _without(dark: NDArray[np.uint8], outline: FloatArray) -> NDArray[np.uint8]:
    """Remove the area inside an outline from a mask of dark pixels."""
    cv2 = opencv()
    rest = dark.copy()
    corners = np.rint(outline).astype(np.int32)
    cv2.fillPoly(rest, [corners], 0)
    cv2.polylines(rest, [corners], True, 0, thickness=5)
    return rest
