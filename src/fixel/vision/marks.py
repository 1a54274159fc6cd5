"""Rig of a testbed: camera, tags and stickers, and their places on the parts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Final, final

from fixel.errors import InvalidInput
from fixel.model.bodies import POSE
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    instance,
    name_of,
    non_negative,
    positive,
    settle,
    vector,
)
from fixel.typing import FloatArray
from fixel.vision.camera import Camera, MeasuredCamera

# Bit 0 is the blue coil, 1 the red, 2 the green one. The thesis's contact mode has the reverse
# order: 4 for the first fixel, 2 for the second, 1 for the third.
THESIS_BITS: Final = ("fixel-3", "fixel-2", "fixel-1")
FAMILIES: Final = ("apriltag-36h11", "aruco-4x4-50", "aruco-5x5-100")
COLOURS: Final = ("red", "orange", "yellow", "green", "cyan", "blue", "magenta")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tag(Comparable):
    """Square tag that encodes a number.

    Parameters
    ----------
    id : int
        Number within its family.
    size : float
        Side of its black square [m].
    pose : (3,) array_like
        Pose of its middle in the frame of its part [m, m, rad]; at angle 0 its upper side is along
        x, with y up.
    height : float
        Height of its upper face above the plane [m].
    family : str
        Family of the tag, one of `FAMILIES`.
    """

    id: int
    size: Annotated[float, Value(positive, "m")]
    pose: Annotated[FloatArray, Value(vector, POSE)] = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    height: Annotated[float, Value(non_negative, "m")]
    family: str = FAMILIES[0]

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InvalidInput("tag.family", found=repr(self.family), expected=", ".join(FAMILIES))
        if isinstance(self.id, bool) or self.id < 0 or self.id != int(self.id):
            raise InvalidInput("tag.id", found=self.id, expected="a whole number of at least 0")
        check_fields(self, "tag")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sticker(Comparable):
    """Round sticker of one colour.

    Parameters
    ----------
    colour : str
        One of `COLOURS`, which no other sticker in the picture has.
    diameter : float
        Diameter of the sticker [m].
    place : (2,) array_like
        Place of its middle in the frame of its part [m].
    height : float
        Height of its upper face above the plane [m].
    """

    colour: str
    diameter: Annotated[float, Value(positive, "m")]
    place: Annotated[FloatArray, Value(vector, "x [m], y [m]")]
    height: Annotated[float, Value(non_negative, "m")]

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise InvalidInput(
                "sticker.colour", found=repr(self.colour), expected=", ".join(COLOURS)
            )
        check_fields(self, "sticker")


Mark = Tag | Sticker


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedPart(Comparable):
    """Part of the scene with its markers.

    Parameters
    ----------
    height : float
        Height of its upper face above the plane [m].
    marks : tuple of Mark
        Markers of the part. One tag or two stickers determine its pose; more are used together.
    """

    height: Annotated[float, Value(positive, "m")]
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        marks = tuple(self.marks)
        for index, mark in enumerate(marks):
            instance(mark, Mark, f"marks[{index}]", "a Tag or a Sticker")
        settle(self, marks=marks)
        check_fields(self, "part")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig(Comparable):
    """Camera over a plate, with the markers of parts and plate.

    Parameters
    ----------
    name : str
        Name of the testbed; recordings of another are rejected.
    camera : Camera
    parts : dict of str to MarkedPart
        Parts by the names of body and pusher in the scene.
    fixel_height : float
        Height of the fixels above the plane [m].
    plate : tuple of Tag
        Tags fixed to the plate, at poses in the world; they show whether the camera moved.
    tactile : tuple of str
        Fixel of each bit of the tactile byte, lowest first.
    position_tolerance, angle_tolerance : float
        Largest errors of the start poses of an experiment [m, rad].
    measured : MeasuredCamera, optional
        The same camera with the covariance of its errors; None where it is unknown.
    """

    name: str
    camera: Camera
    parts: dict[str, MarkedPart] = field(default_factory=dict)
    fixel_height: Annotated[float, Value(positive, "m")] = 0.05108
    plate: tuple[Tag, ...] = ()
    tactile: tuple[str, ...] = THESIS_BITS
    position_tolerance: Annotated[float, Value(positive, "m")] = 1e-3
    angle_tolerance: Annotated[float, Value(positive, "rad")] = math.radians(1.0)
    measured: MeasuredCamera | None = None

    def __post_init__(self) -> None:
        name_of(self.name, "rig.name")
        instance(self.camera, Camera, "rig.camera", "a Camera")
        if self.measured is not None and self.measured.camera != self.camera:
            raise InvalidInput(
                "rig.measured", found="another camera", expected="the errors of rig.camera, or none"
            )
        check_fields(self, "rig")
        parts, plate = dict(self.parts), tuple(self.plate)
        settle(self, parts=parts, plate=plate, tactile=_bits(self.tactile))
        for name, part in self.parts.items():
            instance(part, MarkedPart, f"rig.parts[{name_of(name, 'rig.parts')!r}]", "a MarkedPart")
        for index, tag in enumerate(self.plate):
            instance(tag, Tag, f"rig.plate[{index}]", "a Tag")
        _refuse_twins(self)


def _bits(fixels: tuple[str, ...]) -> tuple[str, ...]:
    names = tuple(name_of(fixel, "rig.tactile") for fixel in fixels)
    if len(names) > 8 or len(set(names)) < len(names):
        raise InvalidInput(
            "rig.tactile", found=list(names), expected="at most eight fixels, each once"
        )
    return names


def _refuse_twins(rig: Rig) -> None:
    """Raise if a tag or a colour occurs twice, as it could not be assigned to a part."""
    seen: dict[str, str] = {}
    everywhere = [(name, mark) for name, part in rig.parts.items() for mark in part.marks]
    for name, mark in [*everywhere, *(("the plate", tag) for tag in rig.plate)]:
        what = f"{mark.family} tag {mark.id}" if isinstance(mark, Tag) else f"{mark.colour} sticker"
        if what in seen:
            raise InvalidInput(
                "rig.parts",
                found=f"the {what} on {seen[what]} and on {name}",
                expected="each marker once, so that they can be distinguished",
            )
        seen[what] = name
