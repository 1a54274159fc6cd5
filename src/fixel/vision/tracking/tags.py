"""Tags: read in a picture by OpenCV, and tracked, once they are read, by their edges."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.shape import placed
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.frame import Frame, Gray, Picture, opencv
from fixel.vision.marks import KNOWN_FAMILIES, Rig, Tag, cells, dictionary_of, gray_of, mirrored
from fixel.vision.tracking import base
from fixel.vision.tracking.loops import cells_right, cells_shown, find_edges, optics_of
from fixel.vision.tracking.outline import OutlineEdges, PoseFit, fit_spread, window_of

MAX_NAMED: Final = 6  # tags per family
# Corners of a tag of side 1, in OpenCV's order: clockwise in the picture from the upper left.
CORNERS: Final = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])

TagName = tuple[str, int]
ALONG: Final = np.linspace(0.12, 0.88, 16)  # fractions of a side at which its edge is measured
EDGE_REACH: Final = 4.0  # [px] from the rough edge
MIN_ON_A_SIDE: Final = 6
POINTS: Final = 12  # on each side of a tag
FROM_CORNERS: Final = 0.08  # of a side, left out at either end: corners are rounded
TAG_REACH: Final = 7.0  # [px] from the expected tag
REACH_READ: Final = 5.0  # [px] from the tag as read
AGREES: Final = 0.72  # of the cells of a tag; half of them agree by chance
# For a tag that is half covered, and was seen a moment ago:
MIN_ON_SIDE: Final = 5  # edges on a side, and on an adjacent one
SHOWS: Final = 0.3  # of the contrast, largest deviation of a cell from black or white
MIN_SHOWN: Final = 0.3  # visible cells, as a share of all
AGREES_PARTLY: Final = 0.8  # of the visible cells
NEAR_BY: Final = 3.0  # [px] from the expected place
PARTLY: Final = 3.0  # factor on its standard deviations
CONTRAST: Final = 15.0  # of brightness between black and white cells
MAX_RESIDUAL: Final = 0.6  # [px]
WRONG_SIZE: Final = 0.06  # of its side, largest deviation of a tag from the rig


@final
@dataclass(frozen=True, slots=True)
class Tags(base.AbstractTracking):
    """Tracking by AprilTag or ArUco tags on the parts.

    One planar pose is fitted to all edges of all tags of a part, with the full camera model at the
    height of the tags. No pose comes from a single tag, so that none flips. Tags are read at the
    start of a film and after they were lost. In between, their edges are followed, and their cells
    are compared with the code in every frame.

    Sources
    -------
    E. Olson, "AprilTag: a robust and flexible visual fiducial system", ICRA 2011;
    S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable fiducial
    markers under occlusion", Pattern Recognition 47(6), 2014.
    """

    name: ClassVar[str] = "tags"
    needs: ClassVar[str] = "a tag"

    def parts(self, rig: Rig, things: Mapping[str, base.Thing]) -> tuple[str, ...]:
        """Parts with at least one tag."""
        return tuple(
            name for name, part in rig.parts.items() if any(isinstance(m, Tag) for m in part.marks)
        )

    def follow(self, rig: Rig, things: Mapping[str, base.Thing]) -> base.AbstractFollower:
        """Create a follower; see `AbstractTracking.follow`."""
        tags = {
            name: tuple(m for m in rig.parts[name].marks if isinstance(m, Tag))
            for name in self.parts(rig, things)
        }
        return base.PartFollowers(
            {name: _TaggedPart(rig.camera, name, own) for name, own in tags.items()}
        )


class _TaggedPart(base.PartFollower):
    """Follower of one part from frame to frame."""

    def __init__(self, camera: Camera, name: str, tags: Sequence[Tag]) -> None:
        super().__init__()
        self._camera = camera
        self._name = name
        self._tags = tuple(tags)
        self._edges = joined([tag_edges(tag, k) for k, tag in enumerate(tags)])
        # Middles (n, 2) of each tag's cells in the frame of the part [m], and which are white.
        own = [(tag, *cells(tag.family, tag.id)) for tag in tags]
        self._cells = tuple((on_tag(tag, middle), white) for tag, middle, white in own)
        self._families = {tag.family for tag in tags}
        self._scale = camera.metres_per_pixel(max(tag.height for tag in tags))
        self._spread = 0.0

    def _searched(self, frame: Frame, followed: base.PartObservation) -> base.PartObservation:
        read, reason = self._read(frame)
        if read is not None:
            return self._measured(frame, read, REACH_READ)
        if reason or self._prediction.pose is None:
            return base.PartObservation(reason=reason or f"no tag of {self._name} in the picture")
        return followed

    def _measured(
        self, frame: Frame, pose: FloatArray, reach: float = TAG_REACH
    ) -> base.PartObservation:
        window = window_of(frame, self._camera, self._edges, pose, reach)
        if window is None:
            return base.PartObservation(reason="its tags are out of the picture")
        picture, corner = window
        fit = fit_spread(
            picture, self._camera, self._edges, pose, reach=reach, last=self._spread, corner=corner
        )
        if fit is None:
            return base.PartObservation(reason="too few edges of its tags are visible")
        sd = fit.deviations
        agreeing = self._agreeing(picture, corner, fit)
        if not agreeing and self._prediction.fresh(frame.time) and self._near(fit, pose):
            agreeing = self._agreeing_partly(picture, corner, fit)
            sd *= PARTLY
        if not agreeing:
            return base.PartObservation(reason="the picture there does not decode as its tags")
        if fit.residual > MAX_RESIDUAL:
            reason = f"edges scatter by {fit.residual:.2f} px: check the sizes of the tags"
            return base.PartObservation(reason=reason)
        if base.vague(sd, self._scale):
            return base.PartObservation(
                reason="too little of its tags is visible to estimate a pose"
            )
        self._spread = fit.spread
        return fit.observed(self._scale, sd, agreeing)

    def _agreeing(self, picture: Gray, corner: tuple[int, int], fit: PoseFit) -> int:
        """Number of tags whose cells agree with their code at a fitted pose."""
        optics, origin = optics_of(self._camera), np.array(corner, dtype=np.float64)
        agreeing = 0
        for k, (tag, (middle, white)) in enumerate(zip(self._tags, self._cells, strict=True)):
            if fit.used[self._edges.group == k].any():
                share = cells_right(
                    picture, origin, optics, middle, tag.height, white, fit.pose, CONTRAST
                )
                agreeing += share >= AGREES
        return agreeing

    def _agreeing_partly(self, picture: Gray, corner: tuple[int, int], fit: PoseFit) -> int:
        """Number of tags, visible from two adjacent sides at least, that agree with their code."""
        optics, origin = optics_of(self._camera), np.array(corner, dtype=np.float64)
        agreeing = 0
        for k, (tag, (middle, white)) in enumerate(zip(self._tags, self._cells, strict=True)):
            used = fit.used & (self._edges.group == k)
            sides = used[self._edges.group == k].reshape(4, POINTS).sum(axis=1)
            if min(max(sides[0], sides[2]), max(sides[1], sides[3])) < MIN_ON_SIDE:
                continue
            dark, bright = (float(level) for level in np.median(fit.found[used, 1:], axis=0))
            slack = SHOWS * (bright - dark)
            right, shown = cells_shown(
                picture, origin, optics, middle, tag.height, white, fit.pose, dark, bright, slack
            )
            agreeing += shown >= MIN_SHOWN * len(white) and right >= AGREES_PARTLY * shown
        return agreeing

    def _near(self, fit: PoseFit, pose: FloatArray) -> bool:
        """Whether a fit is so near the expected pose that it must be the same part."""
        x, y, angle = fit.pose - pose
        off = np.hypot(x, y) + abs(angle) * max(tag.size for tag in self._tags)
        return bool(off < NEAR_BY * self._scale)

    def _read(self, frame: Frame) -> tuple[FloatArray | None, str]:
        """Estimate the pose roughly by reading tags; return None and the reason if it fails."""
        window, corner = self._window(frame)
        found = read_tags(window, self._families)
        own, seen = [], []
        for tag in self._tags:
            quads = found.get((tag.family, tag.id), [])
            if len(quads) > 1:
                return None, f"{tag.family} tag {tag.id} is in the picture {len(quads)} times"
            for quad in quads:
                own.append(tag_corners(tag))
                seen.append(self._camera.on_plane(quad + corner, tag.height))
                _refuse_size(self._name, tag, seen[-1])
        if not own:
            return None, ""
        return rigid(np.concatenate(own), np.concatenate(seen)), ""

    def _window(self, frame: Frame) -> tuple[Gray, FloatArray]:
        """Return the window to read: near the last place, and regularly the whole picture."""
        last = self._search_near
        if last is None:
            return frame.luma, np.zeros(2)
        corners = [
            self._camera.project_at(placed(tag_corners(tag), last), tag.height)
            for tag in self._tags
        ]
        margin = self._search_margin
        low = np.floor(np.min(np.concatenate(corners), axis=0)).astype(int) - margin
        high = np.ceil(np.max(np.concatenate(corners), axis=0)).astype(int) + margin
        width, height = frame.size
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        if right - left < base.MARGIN or bottom - top < base.MARGIN:
            return frame.luma, np.zeros(2)
        window = frame.luma[top:bottom, left:right]
        return window, np.array([left, top], dtype=np.float64)


def tag_edges(tag: Tag, group: int) -> OutlineEdges:
    """Create edges on the sides of a tag's black square."""
    along = np.linspace(FROM_CORNERS, 1.0 - FROM_CORNERS, POINTS)[:, None]
    sides = [
        corner + along * (following - corner)
        for corner, following in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True)
    ]
    outward = np.repeat(np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0], [-1.0, 0.0]]), POINTS, 0)
    point = on_tag(tag, np.concatenate(sides))
    turned = (on_tag(tag, outward) - tag.pose[:2]) / tag.size
    n = len(point)
    return OutlineEdges(
        point=point, outward=turned, height=np.full(n, tag.height), group=np.full(n, group)
    )


def joined(edges: Sequence[OutlineEdges]) -> OutlineEdges:
    """Concatenate the edges of a part."""
    names = ("point", "outward", "height", "group")
    return OutlineEdges(**{n: np.concatenate([getattr(e, n) for e in edges]) for n in names})


def rigid(own: FloatArray, seen: FloatArray) -> FloatArray:
    """Fit the pose (3,) that maps points (n, 2) of a part onto places (n, 2)."""
    a, b = own - own.mean(0), seen - seen.mean(0)
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    angle = math.atan2(cross, float((a * b).sum()))
    c, s = math.cos(angle), math.sin(angle)
    x, y = own.mean(0)
    return np.append(seen.mean(0) - (c * x - s * y, s * x + c * y), angle)


def _refuse_size(part: str, tag: Tag, corners: FloatArray) -> None:
    sides = np.hypot(*(corners - np.roll(corners, -1, axis=0)).T)
    mean = float(sides.mean())
    if abs(mean / tag.size - 1.0) > WRONG_SIZE and np.ptp(sides) < WRONG_SIZE * mean:
        raise InvalidInput(
            f"tag {tag.id} of {part}",
            found=f"a width of {mean * 1e3:.3g} mm in the picture",
            expected=f"{tag.size * 1e3:.3g} mm, as in the rig file",
            hint="check its size in the rig file, which is that of the black square, and its "
            "height",
        )


def read_tags(picture: Gray, families: set[str]) -> dict[TagName, list[FloatArray]]:
    """Read all tags in a picture: corners (4, 2) [px] by family and id.

    Corners are clockwise from the upper left of the tag, accurate to half a pixel. More than one
    set of corners for an id indicates a second tag with it.
    """
    found: dict[TagName, list[FloatArray]] = {}
    contiguous = np.ascontiguousarray(picture)
    for family in sorted(families):
        corners, ids, _ = _detector(family).detectMarkers(contiguous)
        for quad, id_ in zip(corners, () if ids is None else np.ravel(ids), strict=True):
            found.setdefault((family, int(id_)), []).append(quad.reshape(4, 2).astype(np.float64))
    return found


def other_tags(picture: Gray, known: set[TagName]) -> str:
    """Describe the tags in a picture that are not among known ones; empty where there are none."""
    by_family: dict[str, list[int]] = {}
    for family, id_ in sorted(set(read_tags(picture, set(KNOWN_FAMILIES))) - known):
        by_family.setdefault(family, []).append(id_)
    return "; ".join(
        f"{family} tag{'' if len(ids) == 1 else 's'} {', '.join(map(str, ids[:MAX_NAMED]))}"
        for family, ids in by_family.items()
    )


@functools.cache
def _detector(family: str) -> Any:
    cv2 = opencv()
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary_of(family), parameters)


def tag_corners(tag: Tag) -> FloatArray:
    """Corners (4, 2) of a tag in the frame of its part, in the order of `read_tags` [m]."""
    return on_tag(tag, CORNERS)


def on_tag(tag: Tag, points: FloatArray) -> FloatArray:
    """Convert points (n, 2) of a tag of side 1 to the frame of its part [m]."""
    return placed(tag.size * points, tag.pose)


def tag_points(seen: Mapping[Tag, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Corners of tags in the frame of their part (n, 3) [m], and in the picture (n, 2) [px]."""
    points = [np.column_stack((tag_corners(tag), np.full(4, tag.height))) for tag in seen]
    return np.concatenate(points), np.concatenate(list(seen.values()))


def find_tags(picture: Picture, tags: Sequence[Tag]) -> dict[int, FloatArray]:
    """Find tags; return corners (4, 2) [px] by index in `tags`, without those not found.

    A mirrored picture raises, and a tag that occurs twice.
    """
    gray = gray_of(picture)
    families = {tag.family for tag in tags}
    seen = read_tags(gray, families)
    found: dict[int, FloatArray] = {}
    for index, tag in enumerate(tags):
        places = seen.get((tag.family, tag.id), [])
        if len(places) > 1:
            raise InvalidInput(
                "picture",
                found=f"{tag.family} tag {tag.id} at two positions",
                expected="each tag once",
                hint="remove the second print",
            )
        corners = _sharpened(gray, places[0]) if places else None
        if corners is not None:
            found[index] = corners
    if not found:
        seen = read_tags(gray[:, ::-1], families)
        if any((tag.family, tag.id) in seen for tag in tags):
            raise mirrored("mirrored tags")
    return found


def _sharpened(gray: Gray, corners: FloatArray) -> FloatArray | None:
    """Refine corners to the crossings of lines through four edges; None if one is unclear.

    Tags are small enough for distortion within one to be negligible.
    """
    lines = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outwards = np.array([along[1], -along[0]])  # clockwise in the picture, black inside
        pixels = start + ALONG[:, None] * (end - start)
        found, clear = find_edges(gray, pixels, np.tile(outwards, (len(ALONG), 1)), EDGE_REACH)
        if clear.sum() < MIN_ON_A_SIDE:
            return None
        on_it = (pixels + found[:, :1] * outwards)[clear]
        middle = np.median(on_it, axis=0)
        off = (on_it - middle) @ outwards
        steady = np.abs(off - np.median(off)) < 1.0
        middle = on_it[steady].mean(axis=0)
        direction = np.linalg.svd(on_it[steady] - middle)[2][0]
        lines.append((middle, np.array([direction[1], -direction[0]])))
    sharp = np.empty((4, 2))
    for k in range(4):
        (p, n), (q, m) = lines[k - 1], lines[k]
        sharp[k] = np.linalg.solve(np.stack([n, m]), [n @ p, m @ q])
    return sharp
