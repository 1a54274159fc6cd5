"""Live localisation of parts and fixels, with checks of the camera's place."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, final

from fixel.errors import InvalidInput
from fixel.model import Scene
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import PartObservation
from fixel.vision.tracking.checks import (
    UNWATCHED,
    check_camera_place,
    check_orientation,
    check_size,
)
from fixel.vision.tracking.fixels import MIN_FRAMES, FixelFinder
from fixel.vision.tracking.follow import AUTO, followers_of, things_of

# Camera, plate and fixels rarely move and are checked once in this many frames.
NOW_AND_THEN: Final = 15


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FramePoses:
    """Poses and places in one frame."""

    parts: dict[str, PartObservation] = field(default_factory=dict)
    # Places of the fixels whose tops were found [m].
    fixels: dict[str, FloatArray] = field(default_factory=dict)
    problems: tuple[str, ...] = ()  # why the poses cannot be trusted
    remarks: tuple[str, ...] = ()  # further remarks


@final
class Locator:
    """Locator of parts and fixels in live pictures; frames without any raise nothing.

    Parameters
    ----------
    rig : Rig
    scene : Scene
        Scene with the outlines of parts and the approximate places of fixels.

    Attributes
    ----------
    names : tuple of str
        Parts of the scene to find.

    Raises
    ------
    InvalidInput
        The rig has markers for no part of the scene.
    """

    def __init__(self, rig: Rig, scene: Scene) -> None:
        things = things_of(scene)
        own = {name: part for name, part in rig.parts.items() if name in things}
        if not own:
            raise InvalidInput(
                f"rig {rig.name!r}",
                found="it has " + (", ".join(rig.parts) or "no part"),
                expected="a part of the scene: " + ", ".join(things),
                hint="use the names of the scene for the parts of the rig",
            )
        self.rig = rig
        self._scene = scene
        self.names, self._followers = followers_of(replace(rig, parts=own), things, AUTO)
        self._looks = 0
        self._standing = FramePoses()
        self._finder = FixelFinder(rig, scene.fixels)
        self._finds = 0

    def see(self, frame: Frame) -> FramePoses:
        """Locate parts and fixels in a frame."""
        try:
            check_size(self.rig, frame)
            parts = {
                name: sight
                for follower in self._followers
                for name, sight in follower.see(frame).items()
            }
        except InvalidInput as problem:
            return FramePoses(
                parts={name: PartObservation(reason="not searched for") for name in self.names},
                problems=(_told(problem),),
            )
        seen = any(sight.pose is not None for sight in parts.values())
        if self._looks % NOW_AND_THEN == 0 or self._finds < MIN_FRAMES:
            self._standing = self._what_stands(frame, seen)
        self._looks += 1
        return replace(self._standing, parts=parts)

    def _what_stands(self, frame: Frame, seen: bool) -> FramePoses:
        """Check camera and plate, and locate the fixels."""
        try:
            watched = check_camera_place(self.rig, frame)
            if not seen:
                check_orientation(self.rig, frame.luma)
        except InvalidInput as problem:
            return FramePoses(problems=(_told(problem),))
        remarks = (UNWATCHED,) if self.rig.plate and not watched else ()
        return FramePoses(fixels=self._fixels(frame), remarks=remarks)

    def _fixels(self, frame: Frame) -> dict[str, FloatArray]:
        """Places of fixels from the last few frames, as a fixel may be moved to another hole."""
        self._finder.see(frame)
        self._finds += 1
        if self._finds % MIN_FRAMES:
            return self._standing.fixels
        found = {fixel.name: fixel.place for fixel in self._finder.found()}
        self._finder = FixelFinder(self.rig, self._scene.fixels)
        return found


def _told(problem: InvalidInput) -> str:
    """Format an error and its hint as a sentence."""
    sentence = f"Found {problem.found}, expected {problem.expected}"
    return f"{sentence}; {problem.hint}" if problem.hint else sentence
