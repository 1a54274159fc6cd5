"""Checks that a film matches its rig: size, orientation, light and place of the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.shape import placed
from fixel.typing import BoolArray, FloatArray
from fixel.vision.bundle import BundleFit, PointObservations, fit
from fixel.vision.camera import PLACE, Camera, MeasuredCamera
from fixel.vision.frame import Frame, Gray, Picture
from fixel.vision.marks import Rig, Tag, mirrored
from fixel.vision.plane_errors import place_covariance, radius95
from fixel.vision.tracking.outline import MIN_SCATTER, fit_pose, window_of
from fixel.vision.tracking.tags import find_tags, read_tags, tag_corners, tag_edges, tag_points

MOVED: Final = 1.5  # [px] largest offset of tags on the plate
CERTAIN: Final = 1.6  # times the radius of 95 %, four standard deviations
FOUND: Final = 15.0  # [px] largest offset of a plate tag that is roughly in place
ABOVE: Final = 0.03  # [m], approximate height of the markers
MIN_TAGS: Final = 3  # each gives three numbers for the six parameters of the camera's place
DARK, WHITE = 45.0, 234.0  # of brightness; video has 16 for black and 235 for white
PLATE_EVERY: Final = 15  # frames between two checks of the plate
UNWATCHED: Final = "No tag on the plate is visible, so motion of the camera cannot be detected"
VAGUE: Final = 0.5e-3  # [m] largest error of a registered camera at that height


def check_size(rig: Rig, frame: Frame) -> None:
    """Raise for pictures of another size than those of the rig's camera."""
    try:
        rig.camera.lens.for_pictures_of(frame.size)
    except InvalidInput as problem:
        raise problem.within(f"rig {rig.name!r}") from None


def bad_light(frame: Frame) -> str:
    """Return a remedy for a picture that is nearly all dark or white; empty for others."""
    level = np.percentile(frame.luma[::8, ::8], (50.0, 95.0))
    if level[1] < DARK:
        return f"95 of 100 pixels are darker than {level[1]:.0f} of 255: increase light or exposure"
    if level[0] > WHITE:
        return (
            f"half of all pixels are brighter than {level[0]:.0f} of 255: reduce light or exposure"
        )
    return ""


def check_orientation(rig: Rig, picture: Gray) -> None:
    """Raise for pictures whose tags are readable only in the mirrored picture."""
    tags = [m for part in rig.parts.values() for m in part.marks if isinstance(m, Tag)]
    tags += rig.plate
    if not tags:
        return
    wanted = {(tag.family, tag.id) for tag in tags}  # as `read_tags` has them
    families = {tag.family for tag in tags}
    if wanted & set(read_tags(picture, families)):
        return
    if wanted & set(read_tags(picture[:, ::-1], families)):
        raise mirrored("a mirrored picture, whose tags can be read only after mirroring")


class PlateWatch:
    """Monitor that checks regularly, and at the end of a film, whether the camera has moved."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        pixel = rig.camera.metres_per_pixel()
        limits = [moved_limit(rig, tag, MOVED * pixel) / pixel for tag in rig.plate]
        self._limit = max(limits, default=MOVED)  # [px]
        self._looks: list[tuple[float, float]] = []  # time [s] and offset [px]
        self._last: Frame | None = None

    def see(self, frame: Frame, index: int) -> None:
        """Process frame number `index` of the film."""
        self._last = frame
        if index % PLATE_EVERY == 0:
            self._look(frame)

    def doubted(self, time: FloatArray) -> BoolArray:
        """Return (n,) bool: times [s] for which the check before or after found a movement."""
        if self._last is not None and (not self._looks or self._looks[-1][0] < self._last.time):
            self._look(self._last)
        when, off = np.array(self._looks).reshape(-1, 2).T
        if not (off > self._limit).any():
            return np.zeros(len(time), dtype=bool)
        before = np.maximum(np.searchsorted(when, time, side="right") - 1, 0)
        after = np.minimum(np.searchsorted(when, time, side="left"), len(when) - 1)
        return np.asarray((off[before] > self._limit) | (off[after] > self._limit))

    @property
    def in_place(self) -> bool:
        """Whether the camera was in place at the last check."""
        return not self._looks or self._looks[-1][1] <= self._limit

    @property
    def remarks(self) -> list[str]:
        """First movement found, as a sentence, once all frames were processed."""
        return [
            f"camera or plate moved during the film: {off:.1f} px off at {when:.2f} s"
            for when, off in self._looks
            if off > self._limit
        ][:1]

    def _look(self, frame: Frame) -> None:
        edges = [_by_its_edges(self._rig, frame, tag) for tag in self._rig.plate]
        off = [each for each in edges if each is not None]
        if not off or np.median(off) > self._limit:  # else they need not be read
            off = [straight for straight, _ in _plate(self._rig, frame).values()]
        if off:
            self._looks.append((frame.time, float(np.median(off))))


def _plate(rig: Rig, frame: Frame) -> dict[int, tuple[float, float]]:
    """Offsets of readable plate tags from their places, by id, and their offsets if the picture
    is turned by half a turn [px]."""
    if not rig.plate:
        return {}
    found = read_tags(frame.luma, {tag.family for tag in rig.plate})
    last = np.array(rig.camera.lens.image_size) - 1.0
    offsets = {}
    for tag in rig.plate:
        quads = found.get((tag.family, tag.id), [])
        if not quads:
            continue
        should = rig.camera.project_at(tag_corners(tag), tag.height)
        rough, turned = (
            float(np.hypot(*(quad - should).mean(0))) for quad in (quads[0], last - quads[0])
        )
        exact = _by_its_edges(rig, frame, tag) if rough < FOUND else None
        offsets[tag.id] = rough if exact is None else exact, turned
    return offsets


def _by_its_edges(rig: Rig, frame: Frame, tag: Tag) -> float | None:
    """Offset of a plate tag from its place [px], accurate to a few hundredths."""
    edges, pose = tag_edges(tag, 0), np.zeros(3)
    window = window_of(frame, rig.camera, edges, pose, FOUND)
    if window is None:
        return None
    fit = fit_pose(window[0], rig.camera, edges, pose, reach=FOUND, turns=False, corner=window[1])
    if fit is None or fit.residual > 1.0:
        return None
    return float(np.hypot(*fit.pose[:2])) / rig.camera.metres_per_pixel()


def check_camera_place(rig: Rig, frame: Frame) -> bool:
    """Raise for pictures in which tags of the plate are not in their places.

    Return whether any of them is visible, without which a movement cannot be noticed.
    """
    offsets = _plate(rig, frame)
    if not offsets:
        return False
    pixel = rig.camera.metres_per_pixel()
    limits = {tag.id: moved_limit(rig, tag, MOVED * pixel) / pixel for tag in rig.plate}
    off = {id_: straight for id_, (straight, _) in offsets.items()}
    if max(turned for _, turned in offsets.values()) < FOUND < max(off.values()):
        found = "a picture turned by 180 degrees"
        expected = f"the picture in the orientation of rig {rig.name!r}"
        hint = "turn off rotation in the settings of the camera, or calibrate the plate again"
        raise InvalidInput("video", found=found, expected=expected, hint=hint)
    worst = max(off, key=lambda id_: off[id_] / limits[id_])
    if off[worst] > limits[worst]:
        raise InvalidInput(
            "camera",
            found=f"tag {worst} on the plate {off[worst] * pixel * 1e3:.1f} mm from its nominal "
            "position: the camera or the plate was moved",
            expected=f"at most {limits[worst] * pixel * 1e3:.1f} mm",
            hint="calibrate the plate again, or use --register to estimate the camera pose from "
            "these tags",
        )
    return True


def moved_limit(rig: Rig, tag: Tag, least: float) -> float:
    """Largest offset [m] of a plate tag for which camera and plate count as unmoved.

    An unmoved camera shows offsets due to the errors of its calibration. The limit combines
    `least` [m] with these errors, `CERTAIN` times the radius of 95 %.
    """
    if rig.measured is None:
        return least
    corners = rig.camera.project_at(tag_corners(tag), tag.height)
    covariance = place_covariance(rig.measured, corners, tag.height)
    return float(np.hypot(least, CERTAIN * radius95(covariance).max()))


def registered(rig: Rig, frame: Frame) -> Rig:
    """Return the rig with the camera's place determined from at least three tags of the plate."""
    found = read_tags(frame.luma, {tag.family for tag in rig.plate})
    rough = {
        tag: found[tag.family, tag.id][0] for tag in rig.plate if (tag.family, tag.id) in found
    }
    if len(rough) < MIN_TAGS:
        raise InvalidInput(
            "camera",
            found=f"{len(rough)} tags on the plate in the picture",
            expected=f"at least {MIN_TAGS} tags near the corners, to estimate the camera pose",
        )
    camera, _ = _placed(rig.camera, rough)
    exact = {tag: _by_edges(frame, camera, tag, rough[tag]) for tag in rough}
    camera, found_by = _placed(camera, exact)
    rest = float(np.sqrt(np.mean(found_by.residuals**2)))
    _refuse_vague(camera, found_by, max(rest, MIN_SCATTER))
    if rest > 1.0:
        raise InvalidInput(
            "camera",
            found=f"tags on the plate that are {rest:.1f} px off for every camera pose",
            expected="tags at the positions in the rig file",
            hint="one of them may have moved; calibrate the plate again",
        )
    if rig.measured is None:
        return replace(rig, camera=camera)
    from fixel.vision.place_camera import place_by_points

    names = [f"tag {tag.id}" for tag in exact for _ in range(4)]
    points, pixels = tag_points(exact)
    measured = place_by_points(rig.measured, points, pixels, names).camera
    return replace(rig, camera=measured.placed(), measured=measured)


def _by_edges(frame: Frame, camera: Camera, tag: Tag, rough: FloatArray) -> FloatArray:
    """Corners (4, 2) of a plate tag, accurate to a few hundredths of a pixel."""
    fit = fit_pose(frame.luma, camera, tag_edges(tag, 0), np.zeros(3), reach=5.0)
    if fit is None:
        return rough
    return camera.project_at(placed(tag_corners(tag), fit.pose), tag.height)


def _placed(camera: Camera, seen: Mapping[Tag, FloatArray]) -> tuple[Camera, BundleFit]:
    """Fit the camera's place to tags."""
    points, pixels = tag_points(seen)
    sight = PointObservations(points, pixels, np.zeros(len(points), dtype=np.intp))
    found = fit(camera.lens, (), camera.rotation[None], camera.translation[None], sight)
    place = {"rotation": found.rotations[0], "translation": found.translations[0]}
    return replace(camera, **place), found


def _refuse_vague(camera: Camera, found: BundleFit, scatter: float) -> None:
    """Raise if tags with this scatter [px] determine the camera too badly above the plate."""
    covariance = found.place_covariance[0] * (scatter / max(found.noise, 1e-12)) ** 2
    measured = MeasuredCamera(lens=camera.lens, camera=camera, names=PLACE, covariance=covariance)
    middle = (np.array(camera.lens.image_size) - 1.0) / 2.0
    off = float(np.sqrt(np.trace(place_covariance(measured, middle, ABOVE))))
    if off > VAGUE:
        raise InvalidInput(
            "camera",
            found=f"tags on the plate that determine positions to {off * 1e3:.1f} mm only",
            expected=f"tags far enough apart to determine them to {VAGUE * 1e3:.1f} mm",
            hint="put tags near all four corners of the picture, or calibrate the plate again",
        )


def tags_off(rig: Rig, picture: Picture) -> dict[int, float]:
    """Return the distances of the tags on the plate in a picture from their places [m]."""
    off = {}
    for index, pixels in find_tags(picture, rig.plate).items():
        tag = rig.plate[index]
        seen = rig.camera.on_plane(pixels, tag.height)
        off[tag.id] = float(np.hypot(*(seen - tag_corners(tag)).T).max())
    return off
