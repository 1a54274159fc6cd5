"""From a film to trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Scene
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import AbstractFollower, AbstractTracking, Sighting, Thing
from fixel.vision.tracking.checks import (
    UNWATCHED,
    PlateWatch,
    bad_light,
    refuse_flipped,
    refuse_moved,
    refuse_size,
    registered,
)
from fixel.vision.tracking.fixels import FixelFinder
from fixel.vision.tracking.judge import judged
from fixel.vision.tracking.silhouette import Silhouette
from fixel.vision.tracking.stickers import Stickers
from fixel.vision.tracking.tags import Tags
from fixel.vision.tracking.tracked import Tracked

METHODS: Final[Mapping[str, AbstractTracking]] = {
    method.name: method for method in (Tags(), Stickers(), Silhouette())
}
AUTO: Final = "auto"

FIXELS_EVERY: Final = 15  # frames


def track(
    frames: Iterable[Frame],
    rig: Rig,
    scene: Scene | None = None,
    *,
    method: str | AbstractTracking = AUTO,
    register: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Tracked:
    """Find the parts of a rig in all frames of a film.

    Parameters
    ----------
    frames : iterable of Frame
        In order of time.
    rig : Rig
    scene : Scene, optional
        Outlines for silhouettes, and about where fixels stand.
    method : str or AbstractTracking
        `auto` takes tags where a part has any, else stickers, else its outline.
    register : bool
        Find the camera's place anew, from the tags on the plate.
    progress : callable, optional
        Called with the number of frames done.

    Raises
    ------
    InvalidInput
        Pictures of another size than the rig's camera, mirrored or turned ones, a camera that was
        moved, a part that shows in no frame, or no frame at all.
    """
    things = {} if scene is None else things_of(scene)
    followers: list[AbstractFollower] = []
    finder: FixelFinder | None = None
    plate = PlateWatch(rig)
    sightings: dict[str, list[Sighting]] = {}
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
            refuse_flipped(rig, frame.luma)
        plate.see(frame, index)
        if finder is not None and index % FIXELS_EVERY == 0 and plate.in_place:
            finder.see(frame)
        if progress is not None:
            progress(index + 1)
    if first is None:
        raise InvalidInput("video", found="no frames", expected="at least one")
    _refuse_unseen(sightings, first)
    time = np.array(times)
    doubted = plate.doubted(time)
    return Tracked(
        method=method if isinstance(method, str) else method.name,
        rig=rig,
        time=time,
        parts={name: judged(name, time, sightings[name], doubted) for name in names},
        fixels=finder.found() if finder is not None else (),
        remarks=(*remarks, *plate.remarks),
    )


def things_of(scene: Scene) -> dict[str, Thing]:
    """Bodies and pushers, by name."""
    bodies: dict[str, Thing] = {body.name: body for body in scene.bodies}
    return bodies | {pusher.name: pusher for pusher in scene.pushers}


def _checked(rig: Rig, frame: Frame, *, register: bool) -> tuple[Rig, list[str]]:
    """The rig, with its camera where it is now."""
    refuse_size(rig, frame)
    if not register:
        watched = refuse_moved(rig, frame) or not rig.plate
        return rig, [] if watched else [UNWATCHED]
    camera = registered(rig, frame)
    shift = float(np.hypot(*(camera.position - rig.camera.position)[:2]))
    remark = f"the camera was registered anew from the plate's tags, {shift * 1e3:.1f} mm away"
    return replace(rig, camera=camera), [remark]


def followers_of(
    rig: Rig, things: Mapping[str, Thing], method: str | AbstractTracking
) -> tuple[tuple[str, ...], list[AbstractFollower]]:
    """Which parts are followed, and by what."""
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
            found="no part that could be followed",
            expected=f"a part with what is looked for: {needs}",
            hint="describe its marks in the rig file, or choose another --method",
        )
    return tuple(names), followers


def _chosen(method: str | AbstractTracking) -> AbstractTracking:
    if not isinstance(method, str):
        return method
    if method not in METHODS:
        raise InvalidInput("method", found=repr(method), expected=", ".join((AUTO, *METHODS)))
    return METHODS[method]


def _refuse_unseen(sightings: Mapping[str, list[Sighting]], first: Frame) -> None:
    for name, own in sightings.items():
        if any(sight.pose is not None for sight in own):
            continue
        reasons = [sight.reason for sight in own]
        raise InvalidInput(
            f"part {name!r}",
            found=f"it in none of {len(own)} frames: {max(set(reasons), key=reasons.count)}",
            expected="a part that shows",
            hint=bad_light(first) or "is this the rig the film was taken with?",
        )
