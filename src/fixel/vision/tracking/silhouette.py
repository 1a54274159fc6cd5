"""Outlines against a bright field, as under the microscope: no marks at all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.kernels.arrays import FloatArray
from fixel.model import Disk, Shape
from fixel.model.shape import placed
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import (
    AbstractFollower,
    AbstractTracking,
    Prediction,
    Sighting,
    vague,
)
from fixel.vision.tracking.outline import Edges, fit_pose
from fixel.vision.tracking.tag_reader import opencv

POINTS: Final = 160  # on an outline
CORNER: Final = 2.0  # [px] beside a corner that is left out: corners are never sharp
REACH: Final = 8.0  # [px] from where an outline is expected
REACH_FIRST: Final = 20.0  # [px] from where moments put it
MOST_RESIDUAL: Final = 0.7  # [px]
LEAST_SHARE: Final = 0.3
NEEDLE: Final = 0.3  # of the part's narrower side: what is thinner is taken for the probe
CONTRAST: Final = 25.0  # of 255 between part and field
AREA: Final = (0.6, 1.5)  # of what it should be, for what might be the part
DARK = np.uint8


@final
@dataclass(frozen=True, slots=True)
class Silhouette(AbstractTracking):
    """Dark parts on a bright field, by their outlines.

    A threshold splits dark from bright, an opening takes off the needle of the probe, an ellipse
    with the moments of what is left gives the pose to start from, as in the paper. Then the
    outline of the scene is fitted to the edge itself, to a fraction of a pixel; where the probe
    covers it, it shows no edge, and counts for nothing. What is dark beside the part and reaches
    the border is the probe; its tip is fitted likewise, without turning.

    Source
    ------
    The ASME 2006 paper, section on vision.
    """

    name: ClassVar[str] = "silhouette"

    def parts(self, rig: Rig, shapes: Mapping[str, Shape]) -> tuple[str, ...]:
        """Those without marks whose outline is known; the larger one is the part."""
        bare = [name for name in rig.parts if not rig.parts[name].marks and name in shapes]
        return tuple(sorted(bare, key=lambda name: -shapes[name].area))

    def follow(self, rig: Rig, shapes: Mapping[str, Shape]) -> AbstractFollower:
        """Begin a film; see `AbstractTracking.follow`."""
        names = self.parts(rig, shapes)
        if not names:
            raise InvalidInput(
                f"rig {rig.name!r}",
                found="no part without marks whose outline the scene tells",
                expected="a part of the names in the scene",
                hint="names of parts in the rig file are those of bodies and pushers in the scene",
            )
        if len(names) > 2:
            raise InvalidInput(
                f"rig {rig.name!r}",
                found=f"{len(names)} parts without marks",
                expected="a part and a probe: more outlines cannot be told apart",
            )
        return _SilhouetteFollower(rig, {name: shapes[name] for name in names})


@final
class _SilhouetteFollower(AbstractFollower):
    def __init__(self, rig: Rig, shapes: Mapping[str, Shape]) -> None:
        part, *probe = shapes
        self._camera = rig.camera
        self._part = _Outlined(rig, part, shapes[part], turns=True)
        self._probe = _Outlined(rig, probe[0], shapes[probe[0]], turns=False) if probe else None

    def see(self, frame: Frame) -> dict[str, Sighting]:
        picture = frame.luma
        part = self._part.followed(frame)
        dark: NDArray[np.uint8] | None = None
        if part.pose is None:
            dark = _dark(picture)
            part = self._part.found(frame, dark)
        sights = {self._part.name: part}
        if self._probe is not None:
            probe = self._probe.followed(frame)
            if probe.pose is None and part.pose is not None:
                dark = _dark(picture) if dark is None else dark
                probe = self._probe.found_beside(frame, dark, self._part, part.pose)
            elif probe.pose is None:
                probe = Sighting(reason="where the part is was not found")
            sights[self._probe.name] = probe
        return sights


@final
class _Outlined:
    """One outline, from frame to frame."""

    def __init__(self, rig: Rig, name: str, shape: Shape, *, turns: bool) -> None:
        self.name = name
        self._camera: Camera = rig.camera
        self._shape = shape
        self._height = rig.parts[name].height
        self._turns = turns
        self._scale = rig.camera.metres_per_pixel(self._height)
        self._edges = outline_edges(shape, self._height, CORNER * self._scale)
        self._prediction = Prediction()

    def followed(self, frame: Frame) -> Sighting:
        expected = self._prediction.at(frame.time)
        if expected is None:
            return Sighting(reason="not found yet")
        return self._fitted(frame, expected, REACH)

    def _fitted(self, frame: Frame, pose: FloatArray, reach: float) -> Sighting:
        fit = fit_pose(
            frame.luma, self._camera, self._edges, pose, reach=reach, turns=self._turns, rounds=6
        )
        if fit is None or fit.share < LEAST_SHARE * (1.0 if self._turns else 0.5):
            return Sighting(reason=f"too little of the outline of {self.name} shows")
        if fit.residual > MOST_RESIDUAL:
            return Sighting(reason=f"the outline of {self.name} is off by {fit.residual:.2f} px")
        sd = np.sqrt(np.diag(fit.covariance))
        if vague(sd, self._scale):
            return Sighting(reason=f"too little of the outline of {self.name} shows")
        self._prediction.seen(frame.time, fit.pose)
        return Sighting(
            pose=fit.pose,
            residual=fit.residual,
            scale=self._scale,
            sd=sd,
            marks=int(fit.used.sum()),
            share=fit.share,
        )

    def found(self, frame: Frame, dark: NDArray[np.uint8]) -> Sighting:
        """The part, looked for in the whole picture."""
        blob, reason = self._blob(dark)
        if blob is None:
            return Sighting(reason=reason)
        best = Sighting(reason="nothing in the picture has its outline")
        for start in self._starts(blob):
            sight = self._fitted(frame, start, REACH_FIRST)
            if sight.pose is not None and (best.pose is None or _better(sight, best)):
                best = sight
        if best.pose is not None:  # trials have left their traces
            self._prediction = Prediction()
            self._prediction.seen(frame.time, best.pose)
        return best

    def _blob(self, dark: NDArray[np.uint8]) -> tuple[NDArray[np.bool_] | None, str]:
        """Pixels of the part, without those of a needle."""
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
            return None, f"nothing dark of the size of {self.name} in the picture"
        if len(own) > 1:
            return None, f"{len(own)} dark things of the size of {self.name} in the picture"
        return labels == own[0], ""

    def _starts(self, blob: NDArray[np.bool_]) -> list[FloatArray]:
        """Poses that give the outline the same ellipse: there are two, half a turn apart."""
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

    def found_beside(
        self, frame: Frame, dark: NDArray[np.uint8], part: _Outlined, pose: FloatArray
    ) -> Sighting:
        """The probe: what is dark, is not the part, and reaches the border."""
        cv2 = opencv()
        outline = self._camera.project_at(placed(part._shape.outline, pose), part._height)
        rest = dark.copy()
        corners = np.rint(outline).astype(np.int32)
        cv2.fillPoly(rest, [corners], 0)
        cv2.polylines(rest, [corners], True, 0, thickness=5)
        n, labels, boxes, _ = cv2.connectedComponentsWithStats(rest)
        height, width = rest.shape
        at_border = [
            k
            for k in range(1, n)
            if boxes[k][0] == 0
            or boxes[k][1] == 0
            or boxes[k][0] + boxes[k][2] == width
            or boxes[k][1] + boxes[k][3] == height
        ]
        if not at_border:
            return Sighting(reason="no probe reaches into the picture")
        probe = max(at_border, key=lambda k: int(boxes[k][4]))
        tip = _tip(labels == probe)
        centre = self._camera.on_plane(tip, self._height)
        back = self._camera.on_plane(_root(labels == probe), self._height)
        away = (centre - back) / max(float(np.hypot(*(centre - back))), 1e-12)
        size = self._shape.radius
        best = Sighting(reason="the tip of the probe does not show")
        for shift in (0.0, 0.5, 1.0):
            start = np.append(centre - shift * size * away, 0.0)
            sight = self._fitted(frame, start, REACH)
            if sight.pose is not None and (best.pose is None or _better(sight, best)):
                best = sight
        if best.pose is not None:
            self._prediction = Prediction()
            self._prediction.seen(frame.time, best.pose)
        return best


def outline_edges(shape: Shape, height: float, corner: float) -> Edges:
    """Points on an outline, dark inside, none within `corner` [m] of a corner."""
    if isinstance(shape, Disk):
        angle = 2.0 * np.pi * np.arange(POINTS) / POINTS
        outward = np.column_stack((np.cos(angle), np.sin(angle)))
        point = shape.radius * outward
    else:
        point, outward = _along(shape.outline, corner)
    return Edges(
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
    """(n, 2) points of a grid over a shape, about so many [m]."""
    import shapely

    polygon = shapely.Polygon(shape.outline)
    low, high = shape.outline.min(0), shape.outline.max(0)
    step = math.sqrt(float(np.prod(high - low)) / about)
    x, y = np.meshgrid(np.arange(low[0], high[0], step), np.arange(low[1], high[1], step))
    inside = shapely.contains_xy(polygon, x.ravel(), y.ravel())
    return np.column_stack((x.ravel(), y.ravel()))[inside]


def _axis(points: FloatArray) -> float:
    """Angle of the long axis of the ellipse with the moments of points [rad]."""
    (xx, xy), (_, yy) = np.cov(points.T).tolist()
    return 0.5 * math.atan2(2.0 * xy, xx - yy)


def _dark(picture: Gray) -> NDArray[np.uint8]:
    """255 where it is dark, by Otsu's threshold; nothing where it is all the same."""
    cv2 = opencv()
    contiguous = np.ascontiguousarray(picture)
    low, high = np.percentile(contiguous[::4, ::4], (1.0, 99.0))
    if high - low < CONTRAST:
        return np.zeros(picture.shape, dtype=DARK)
    _, mask = cv2.threshold(contiguous, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)
    return np.asarray(mask, dtype=DARK)


def _root(mask: NDArray[np.bool_]) -> FloatArray:
    """(2,) middle of where a thing leaves the picture [px]."""
    height, width = mask.shape
    rows, columns = np.nonzero(mask)
    border = (rows == 0) | (columns == 0) | (rows == height - 1) | (columns == width - 1)
    return np.array([columns[border].mean(), rows[border].mean()])


def _tip(mask: NDArray[np.bool_]) -> FloatArray:
    """(2,) its place farthest from there [px]."""
    rows, columns = np.nonzero(mask)
    root: Any = _root(mask)
    far = int(np.argmax(np.hypot(columns - root[0], rows - root[1])))
    return np.array([columns[far], rows[far]], dtype=np.float64)


def _better(a: Sighting, b: Sighting) -> bool:
    return a.share - a.residual > b.share - b.residual
