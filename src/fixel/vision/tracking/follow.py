"""Tracking of all parts in a film."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Scene
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig, Tag
from fixel.vision.plane_errors import pose_covariance
from fixel.vision.tracking.base import AbstractFollower, AbstractTracking, PartObservation, Thing
from fixel.vision.tracking.checks import (
    UNWATCHED,
    PlateWatch,
    bad_light,
    check_camera_place,
    check_orientation,
    check_size,
    registered,
)
from fixel.vision.tracking.fixels import FixelFinder
from fixel.vision.tracking.judge import judged, stamp_scatter
from fixel.vision.tracking.silhouette import Silhouette
from fixel.vision.tracking.stickers import Stickers
from fixel.vision.tracking.tag_reader import other_families, tag_corners
from fixel.vision.tracking.tags import Tags
from fixel.vision.tracking.tracked import FilmTracks, PartTrack

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
    """Find the parts of a rig in all frames of a film.

    Parameters
    ----------
    frames : iterable of Frame
        Frames in order of time.
    rig : Rig
    scene : Scene, optional
        Scene with outlines for silhouettes, and approximate places of fixels.
    method : str or AbstractTracking
        Tracking method; `auto` uses tags where a part has any, else stickers, else its outline.
    register : bool
        Whether to determine the camera's place from the tags on the plate.
    progress : callable, optional
        Called with the number of frames done.

    Raises
    ------
    InvalidInput
        Pictures have another size than the rig's camera, are mirrored or turned; the camera was
        moved; a part is visible in no frame; or there are no frames.
    """
    things = {} if scene is None else things_of(scene)
    followers: list[AbstractFollower] = []
    finder: FixelFinder | None = None
    plate = PlateWatch(rig)
    sightings: dict[str, list[PartObservation]] = {}
    times: list[float] = []
    first: Frame | None = None
    remarks: list[str] = []
    names: tuple[str, ...] = ()
    for index, frame in enumerate(frames):
        if first is None:
            first = frame
            rig, remarks = _checked(rig, frame, register=register)
            plate = PlateWatch(rig)
            names, followers = followers_of(rig, things, method)
            sightings = {name: [] for name in names}
            finder = FixelFinder(rig, scene.fixels) if scene is not None else None
        times.append(frame.time)
        for follower in followers:
            for name, sight in follower.see(frame).items():
                sightings[name].append(sight)
        if index == 0 and any(own[0].pose is None for own in sightings.values()):
            check_orientation(rig, frame.luma)
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
    scatter = float(np.median(stamp_scatter(time)))
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
    check_size(rig, frame)
    if not register:
        watched = check_camera_place(rig, frame) or not rig.plate
        return rig, [] if watched else [UNWATCHED]
    found = registered(rig, frame)
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
    if method not in METHODS:
        raise InvalidInput("method", found=repr(method), expected=", ".join((AUTO, *METHODS)))
    return METHODS[method]


def _refuse_unseen(rig: Rig, sightings: Mapping[str, list[PartObservation]], first: Frame) -> None:
    for name, own in sightings.items():
        if any(sight.pose is not None for sight in own):
            continue
        reasons = [sight.reason for sight in own]
        families = {mark.family for mark in rig.parts[name].marks if isinstance(mark, Tag)}
        others = other_families(first.luma, families) if families else ""
        there = f"; the first frame shows {others}" if others else ""
        raise InvalidInput(
            f"part {name!r}",
            found=f"it in none of {len(own)} frames: {max(set(reasons), key=reasons.count)}{there}",
            expected="a visible part",
            hint=bad_light(first) or "check that the film was recorded with this rig",
        )
