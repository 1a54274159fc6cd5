"""Tracking of all parts in a film: parts and fixels frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model import Disk, Fixel, Scene
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig, Tag
from fixel.vision.plane_errors import pose_covariance
from fixel.vision.tracking import checks
from fixel.vision.tracking.base import (
    AbstractFollower,
    AbstractTracking,
    FilmTracks,
    FoundFixel,
    PartObservation,
    PartTrack,
    Thing,
)
from fixel.vision.tracking.judge import clock_scatter, judged
from fixel.vision.tracking.outline import OutlineEdges, PoseFit, circle_edges, fit_pose, window_of
from fixel.vision.tracking.silhouette import Silhouette
from fixel.vision.tracking.stickers import Stickers
from fixel.vision.tracking.tags import Tags, other_tags, tag_corners

METHODS: Final[Mapping[str, AbstractTracking]] = {
    method.name: method for method in (Tags(), Stickers(), Silhouette())
}
AUTO: Final = "auto"

FIXELS_EVERY: Final = 15  # frames
UNEVEN: Final = 3e-3  # [s] scatter of time stamps from which it is reported
KNOTS: Final = 9  # poses of a track at which the errors due to the camera are computed


def track(
    frames: Iterable[Frame],
    rig: Rig,
    scene: Scene | None = None,
    *,
    method: str | AbstractTracking = AUTO,
    register: bool = False,
    progress: Callable[[int], None] | None = None,
) -> FilmTracks:
    """Find the parts of a rig in all frames of a film, which are in order of time.

    The scene has outlines for silhouettes, and approximate places of fixels. The method `auto` uses
    tags where a part has any, else stickers, else its outline. With `register`, the camera's place
    is determined from the tags on the plate. `progress` is called with the number of frames done.

    Raise `InvalidInput` for pictures of another size than the rig's camera, mirrored or turned
    ones, a camera that was moved, a part that is visible in no frame, and a film without frames.
    """
    things = {} if scene is None else things_of(scene)
    followers: list[AbstractFollower] = []
    finder: FixelFinder | None = None
    plate = checks.PlateWatch(rig)
    sightings: dict[str, list[PartObservation]] = {}
    times: list[float] = []
    first: Frame | None = None
    remarks: list[str] = []
    names: tuple[str, ...] = ()
    for index, frame in enumerate(frames):
        if first is None:
            first = frame
            rig, remarks = _checked(rig, frame, register=register)
            plate = checks.PlateWatch(rig)
            names, followers = followers_of(rig, things, method)
            sightings = {name: [] for name in names}
            finder = FixelFinder(rig, scene.fixels) if scene is not None else None
        times.append(frame.time)
        for follower in followers:
            for name, sight in follower.see(frame).items():
                sightings[name].append(sight)
        if index == 0 and any(own[0].pose is None for own in sightings.values()):
            checks.check_orientation(rig, frame.luma)
        plate.see(frame, index)
        if finder is not None and index % FIXELS_EVERY == 0 and plate.in_place:
            finder.see(frame)
        if progress is not None:
            progress(index + 1)
    if first is None:
        raise InvalidInput("video", found="no frames", expected="at least one")
    _refuse_unseen(rig, sightings, first)
    time = np.array(times)
    doubted = plate.doubted(time)
    return FilmTracks(
        method=method if isinstance(method, str) else method.name,
        rig=rig,
        time=time,
        parts={
            name: _with_camera(rig, judged(name, time, sightings[name], doubted), things)
            for name in names
        },
        fixels=finder.found() if finder is not None else (),
        remarks=(*remarks, *plate.remarks, *_uneven(time)),
    )


def _with_camera(rig: Rig, part: PartTrack, things: Mapping[str, Thing]) -> PartTrack:
    """Add the uncertainty due to the camera's errors to a track."""
    rows = np.flatnonzero(part.good)
    points = _points_of(rig, part.name, things)
    if rig.measured is None or points is None or not len(rows):
        return part
    # These errors change slowly over the picture.
    knots = rows[np.unique(np.linspace(0, len(rows) - 1, KNOTS).round().astype(int))]
    height = rig.parts[part.name].height
    covariance = pose_covariance(rig.measured, part.pose[knots], points, height)
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    at = np.arange(len(part.time))
    every = np.column_stack([np.interp(at, knots, column) for column in sd.T])
    every[~part.seen] = np.nan
    return replace(part, camera_sd=every)


def _uneven(time: FloatArray) -> list[str]:
    """Return a remark if time stamps scatter much about an even frame rate."""
    scatter = float(np.median(clock_scatter(time)))
    if scatter < UNEVEN:
        return []
    return [
        f"uneven frames: their time stamps scatter by {1e3 * scatter:.0f} ms about an even rate; "
        "positions of a moving part are uncertain by its speed times this scatter"
    ]


def _points_of(rig: Rig, name: str, things: Mapping[str, Thing]) -> FloatArray | None:
    """Points (n, 2) by which a part is measured [m]: its markers, or else its outline."""
    points = [
        tag_corners(mark) if isinstance(mark, Tag) else mark.place[None]
        for mark in rig.parts[name].marks
    ]
    if points:
        return np.concatenate(points)
    return things[name].shape.outline if name in things else None


def things_of(scene: Scene) -> dict[str, Thing]:
    """Bodies and pushers of a scene by name."""
    bodies: dict[str, Thing] = {body.name: body for body in scene.bodies}
    return bodies | {pusher.name: pusher for pusher in scene.pushers}


def _checked(rig: Rig, frame: Frame, *, register: bool) -> tuple[Rig, list[str]]:
    """Check the first frame; return the rig, with its camera registered, and remarks."""
    checks.check_size(rig, frame)
    if not register:
        watched = checks.check_camera_place(rig, frame) or not rig.plate
        return rig, [] if watched else [checks.UNWATCHED]
    found = checks.registered(rig, frame)
    shift = float(np.hypot(*(found.camera.position - rig.camera.position)[:2]))
    remark = (
        "the camera pose was estimated again from the tags on the plate; it changed by "
        f"{shift * 1e3:.1f} mm"
    )
    return found, [remark]


def followers_of(
    rig: Rig, things: Mapping[str, Thing], method: str | AbstractTracking
) -> tuple[tuple[str, ...], list[AbstractFollower]]:
    """Choose the parts to follow, and create their followers."""
    members = list(METHODS.values()) if method == AUTO else [_chosen(method)]
    names: list[str] = []
    followers = []
    for member in members:
        left = {name: part for name, part in rig.parts.items() if name not in names}
        own = replace(rig, parts=left)
        found = member.parts(own, things)
        if found:
            followers.append(member.follow(own, things))
            names += found
    if not names:
        needs = "; ".join(f"for {member.name}, {member.needs}" for member in members)
        raise InvalidInput(
            f"rig {rig.name!r}",
            found="no part that could be tracked",
            expected=f"a part with what the method needs: {needs}",
            hint="describe its markers in the rig file, or choose another --method",
        )
    return tuple(names), followers


def _chosen(method: str | AbstractTracking) -> AbstractTracking:
    if not isinstance(method, str):
        return method
    check_name("method", method, (AUTO, *METHODS))
    return METHODS[method]


def _refuse_unseen(rig: Rig, sightings: Mapping[str, list[PartObservation]], first: Frame) -> None:
    for name, own in sightings.items():
        if any(sight.pose is not None for sight in own):
            continue
        reasons = [sight.reason for sight in own]
        marks = (*rig.plate, *(mark for part in rig.parts.values() for mark in part.marks))
        known = {(mark.family, mark.id) for mark in marks if isinstance(mark, Tag)}
        others = other_tags(first.luma, known)
        there = f"; the first frame shows {others}" if others else ""
        raise InvalidInput(
            f"part {name!r}",
            found=f"it in none of {len(own)} frames: {max(set(reasons), key=reasons.count)}{there}",
            expected="a visible part",
            hint=checks.bad_light(first) or "check that the film was recorded with this rig",
        )


REACH_FIRST: Final = 10.0  # [px] from its place in the scene
FIXEL_REACH: Final = 4.0
# Radii of visible rings as shares of the fixel's radius: a turned end has concentric rings. The
# radius of the clearest one is fitted with its place, since a wrong radius would bias the place
# where the side of the cylinder hides part of the ring.
RINGS: Final = (1.0, 0.92, 0.85, 0.78, 0.7, 0.62)
WIDEST, NARROWEST = 1.1, 0.5
LOOKS: Final = 4  # fits of a ring, each with the radius of the one before
SAME_RADIUS: Final = 0.02  # [px] change of radius at which the fits have converged
MIN_SHARE: Final = 0.45  # of a ring
MAX_RESIDUAL: Final = 0.5  # [px]
MIN_FRAMES: Final = 3  # least number of frames for a place

Ring = tuple[float, bool]  # share of the radius, and whether it is dark inside


class FixelFinder:
    """Measurement of fixels in some frames of a film.

    The clearest ring of the top, dark or bright inside, is chosen where a fixel is first seen. The
    edge of the cylinder's side differs from it, and is left out.
    """

    def __init__(self, rig: Rig, fixels: Sequence[Fixel]) -> None:
        self._camera = rig.camera
        self._height = rig.fixel_height
        self._scale = rig.camera.metres_per_pixel(rig.fixel_height)
        self._fixels = [fixel for fixel in fixels if isinstance(fixel.shape, Disk)]
        self._found: dict[str, list[FloatArray]] = {f.name: [] for f in self._fixels}
        self._rings: dict[str, Ring] = {}

    def see(self, frame: Frame) -> None:
        """Measure the visible fixels in a frame."""
        for fixel in self._fixels:
            places = self._found[fixel.name]
            if places:
                rings, start, reach = [self._rings[fixel.name]], places[-1], FIXEL_REACH
            else:
                rings = [(share, dark) for share in RINGS for dark in (True, False)]
                start, reach = fixel.pose[:2], REACH_FIRST
            fits = [self._fit(frame, fixel, ring, start, reach) for ring in rings]
            good = [fit for fit in fits if fit is not None]
            if good:
                fit, ring = max(good, key=lambda each: each[0].share - each[0].residual)
                self._rings[fixel.name] = ring
                places.append(fit.pose[:2])

    def _fit(
        self, frame: Frame, fixel: Fixel, ring: Ring, start: FloatArray, reach: float
    ) -> tuple[PoseFit, Ring] | None:
        """Fit place and radius of a ring; None where it is not clear."""
        assert isinstance(fixel.shape, Disk)
        share, dark = ring
        pose, fit = np.append(start, 0.0), None
        for _ in range(LOOKS):
            edges = circle_edges(share * fixel.shape.radius, self._height, dark_inside=dark)
            window = window_of(frame, self._camera, edges, pose, reach)
            if window is None:
                return None
            fit = fit_pose(
                window[0], self._camera, edges, pose, reach=reach, turns=False, corner=window[1]
            )
            if fit is None:
                return None
            wider = _wider(edges, fit) if dark else -_wider(edges, fit)
            share += wider * self._scale / fixel.shape.radius
            if not NARROWEST < share < WIDEST:
                return None
            pose, reach = fit.pose, FIXEL_REACH
            if abs(wider) < SAME_RADIUS:
                break
        if fit is None or fit.share < MIN_SHARE or fit.residual > MAX_RESIDUAL:
            return None
        return fit, (share, dark)

    def found(self) -> tuple[FoundFixel, ...]:
        """Return the fixels that were measured often enough."""
        result = []
        for name, places in self._found.items():
            if len(places) < MIN_FRAMES:
                continue
            place = np.median(places, axis=0)
            scatter = float(np.sqrt(np.mean(np.sum((np.array(places) - place) ** 2, axis=1))))
            result.append(FoundFixel(name=name, place=place, scatter=scatter, n=len(places)))
        return tuple(result)


def _wider(edges: OutlineEdges, fit: PoseFit) -> float:
    """Excess of the radius found over that of `edges`, for any middle [px]."""
    slope = np.column_stack((np.ones(len(edges.outward)), edges.outward))[fit.used]
    return float(np.linalg.lstsq(slope, fit.found[fit.used, 0], rcond=None)[0][0])


# Camera, plate and fixels rarely move and are checked once in this many frames.
NOW_AND_THEN: Final = 15


@dataclass(frozen=True, slots=True, kw_only=True)
class FramePoses:
    """Poses and places in one frame."""

    parts: dict[str, PartObservation] = field(default_factory=dict)
    # Places of the fixels whose tops were found [m].
    fixels: dict[str, FloatArray] = field(default_factory=dict)
    problems: tuple[str, ...] = ()  # why the poses cannot be trusted
    remarks: tuple[str, ...] = ()  # further remarks


class Locator:
    """Locator of parts and fixels in live pictures; frames without any raise nothing.

    The scene has the outlines of parts and the approximate places of fixels; `names` are its parts
    on the rig, at least one and those `needed`.
    """

    def __init__(self, rig: Rig, scene: Scene, needed: Sequence[str] = ()) -> None:
        things = things_of(scene)
        own = {name: part for name, part in rig.parts.items() if name in things}
        if (lacking := [name for name in needed if name not in own]) or not own:
            raise InvalidInput(
                f"rig {rig.name!r}",
                found=", ".join(rig.parts) or "no part",
                expected="a part of the scene: " + ", ".join(lacking or things),
                hint="use the names of the scene for the parts of the rig",
            )
        self.rig = rig
        self._near = scene.fixels
        self.names, self._followers = followers_of(replace(rig, parts=own), things, AUTO)
        self._looks = 0
        self._standing = FramePoses()
        self._finder = FixelFinder(rig, scene.fixels)
        self._finds = 0

    def expect(self, fixels: Sequence[Fixel]) -> None:
        """Search for the same fixels near other places, if these are out of reach of the old."""
        reach = FIXEL_REACH * self.rig.camera.metres_per_pixel(self.rig.fixel_height)
        apart = [new.pose[:2] - old.pose[:2] for new, old in zip(fixels, self._near, strict=True)]
        if apart and np.hypot(*np.transpose(apart)).max() > reach:
            self._near, self._finds = tuple(fixels), 0
            self._finder = FixelFinder(self.rig, self._near)

    def see(self, frame: Frame) -> FramePoses:
        """Locate parts and fixels in a frame."""
        try:
            checks.check_size(self.rig, frame)
            parts = {
                name: sight
                for follower in self._followers
                for name, sight in follower.see(frame).items()
            }
        except InvalidInput as problem:
            return FramePoses(
                parts={name: PartObservation(reason="not searched for") for name in self.names},
                problems=(_sentence(problem),),
            )
        seen = any(sight.pose is not None for sight in parts.values())
        if self._looks % NOW_AND_THEN == 0 or self._finds < MIN_FRAMES:
            self._standing = self._what_stands(frame, seen)
        self._looks += 1
        return replace(self._standing, parts=parts)

    def _what_stands(self, frame: Frame, seen: bool) -> FramePoses:
        """Check camera and plate, and locate the fixels."""
        try:
            watched = checks.check_camera_place(self.rig, frame)
            if not seen:
                checks.check_orientation(self.rig, frame.luma)
        except InvalidInput as problem:
            return FramePoses(problems=(_sentence(problem),))
        remarks = (checks.UNWATCHED,) if self.rig.plate and not watched else ()
        return FramePoses(fixels=self._fixels(frame), remarks=remarks)

    def _fixels(self, frame: Frame) -> dict[str, FloatArray]:
        """Places of fixels from the last few frames, as a fixel may be moved to another hole."""
        self._finder.see(frame)
        self._finds += 1
        if self._finds % MIN_FRAMES:
            return self._standing.fixels
        found = {fixel.name: fixel.place for fixel in self._finder.found()}
        self._finder = FixelFinder(self.rig, self._near)
        return found


def _sentence(problem: InvalidInput) -> str:
    """Format an error and its hint as a sentence."""
    sentence = f"Found {problem.found}, but fixel needs {problem.expected}"
    return f"{sentence}; {problem.hint}" if problem.hint else sentence
