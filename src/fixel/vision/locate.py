"""Where everything lies now, frame by frame, and whether the camera can be believed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, final

from fixel.errors import InvalidInput
from fixel.model import Scene
from fixel.typing import FloatArray
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import Sighting
from fixel.vision.tracking.checks import UNWATCHED, refuse_flipped, refuse_moved, refuse_size
from fixel.vision.tracking.fixels import MIN_FRAMES, FixelFinder
from fixel.vision.tracking.follow import AUTO, followers_of, things_of

# What stays where it is, is looked at in so few frames: camera, plate and fixels.
NOW_AND_THEN: Final = 15


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FramePoses:
    """What one frame shows.

    Attributes
    ----------
    parts : dict of str to Sighting
        Of every part that is looked for.
    fixels : dict of str to (2,) float64
        Places of the fixels whose tops were found [m].
    problems : tuple of str
        Why nothing of this can be believed.
    remarks : tuple of str
        What else one should know.
    """

    parts: dict[str, Sighting] = field(default_factory=dict)
    fixels: dict[str, FloatArray] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


@final
class Locator:
    """Finds parts and fixels in a live picture, and goes on when there are none.

    Parameters
    ----------
    rig : Rig
    scene : Scene
        Tells outlines, and about where fixels stand.

    Attributes
    ----------
    names : tuple of str
        The parts of the scene that it looks for.

    Raises
    ------
    InvalidInput
        There is no part of the scene that the rig has marks for.
    """

    def __init__(self, rig: Rig, scene: Scene) -> None:
        things = things_of(scene)
        own = {name: part for name, part in rig.parts.items() if name in things}
        if not own:
            raise InvalidInput(
                f"rig {rig.name!r}",
                found="it knows " + (", ".join(rig.parts) or "no part"),
                expected="a part of the scene: " + ", ".join(things),
                hint="parts of a rig have the names they have in the scene",
            )
        self.rig = rig
        self._scene = scene
        self.names, self._followers = followers_of(replace(rig, parts=own), things, AUTO)
        self._looks = 0
        self._standing = FramePoses()
        self._finder = FixelFinder(rig, scene.fixels)
        self._finds = 0

    def see(self, frame: Frame) -> FramePoses:
        """Where everything is in this frame."""
        try:
            refuse_size(self.rig, frame)
            parts = {
                name: sight
                for follower in self._followers
                for name, sight in follower.see(frame).items()
            }
        except InvalidInput as problem:
            return FramePoses(
                parts={name: Sighting(reason="not looked for") for name in self.names},
                problems=(_told(problem),),
            )
        seen = any(sight.pose is not None for sight in parts.values())
        if self._looks % NOW_AND_THEN == 0 or self._finds < MIN_FRAMES:
            self._standing = self._what_stands(frame, seen)
        self._looks += 1
        return replace(self._standing, parts=parts)

    def _what_stands(self, frame: Frame, seen: bool) -> FramePoses:
        """Camera, plate and fixels."""
        try:
            watched = refuse_moved(self.rig, frame)
            if not seen:
                refuse_flipped(self.rig, frame.luma)
        except InvalidInput as problem:
            return FramePoses(problems=(_told(problem),))
        remarks = (UNWATCHED,) if self.rig.plate and not watched else ()
        return FramePoses(fixels=self._fixels(frame), remarks=remarks)

    def _fixels(self, frame: Frame) -> dict[str, FloatArray]:
        """Places out of the last few frames; a fixel may be moved to another hole meanwhile."""
        self._finder.see(frame)
        self._finds += 1
        if self._finds % MIN_FRAMES:
            return self._standing.fixels
        found = {fixel.name: fixel.place for fixel in self._finder.found()}
        self._finder = FixelFinder(self.rig, self._scene.fixels)
        return found


def _told(problem: InvalidInput) -> str:
    """What is wrong, and what to do."""
    sentence = f"Found {problem.found}, expected {problem.expected}"
    return f"{sentence}; {problem.hint}" if problem.hint else sentence
