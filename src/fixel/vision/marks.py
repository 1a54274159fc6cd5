"""What a camera looks for: tags and stickers, and where they sit on the parts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, final

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, instance, name_of, non_negative, positive, settle, vector
from fixel.typing import FloatArray
from fixel.vision.camera import Camera
from fixel.vision.measured_camera import MeasuredCamera

# Bit 0 is the blue coil, 1 the red, 2 the green one; the thesis's contact mode counts fixels from
# the other end: 4 for the first, 2, 1 for the third.
THESIS_BITS: Final = ("fixel-3", "fixel-2", "fixel-1")
FAMILIES: Final = ("apriltag-36h11", "aruco-4x4-50", "aruco-5x5-100")
COLOURS: Final = ("red", "orange", "yellow", "green", "cyan", "blue", "magenta")


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tag(Comparable):
    """A square tag with a number in it.

    Parameters
    ----------
    id : int
        Which of its family.
    size : float
        Side of its black square [m].
    pose : (3,) array_like
        Of its middle in the frame of the part it sits on; at angle 0 its upper side is along x,
        read with y up [m, m, rad].
    height : float
        Of its upper face above the plane [m].
    family : str
        One of `FAMILIES`.
    """

    id: int
    size: float
    pose: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    height: float
    family: str = FAMILIES[0]

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InvalidInput("tag.family", found=repr(self.family), expected=", ".join(FAMILIES))
        if isinstance(self.id, bool) or self.id < 0 or self.id != int(self.id):
            raise InvalidInput("tag.id", found=self.id, expected="a whole number of at least 0")
        settle(
            self,
            size=positive(self.size, "tag.size", "m"),
            pose=vector(self.pose, "tag.pose", "x [m], y [m], angle [rad]"),
            height=non_negative(self.height, "tag.height", "m"),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sticker(Comparable):
    """A round sticker of one colour.

    Parameters
    ----------
    colour : str
        One of `COLOURS`, alone of its colour in the picture.
    diameter : float
        [m].
    place : (2,) array_like
        Of its middle in the frame of the part it sits on [m].
    height : float
        Of its upper face above the plane [m].
    """

    colour: str
    diameter: float
    place: FloatArray
    height: float

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise InvalidInput(
                "sticker.colour", found=repr(self.colour), expected=", ".join(COLOURS)
            )
        settle(
            self,
            diameter=positive(self.diameter, "sticker.diameter", "m"),
            place=vector(self.place, "sticker.place", "x [m], y [m]"),
            height=non_negative(self.height, "sticker.height", "m"),
        )


Mark = Tag | Sticker


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedPart(Comparable):
    """A part of the scene as the camera knows it.

    Parameters
    ----------
    height : float
        Of its upper face above the plane [m].
    marks : tuple of Mark
        One tag, or two stickers, tell where a part lies; more are used together.
    """

    height: float
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        marks = tuple(self.marks)
        for index, mark in enumerate(marks):
            instance(mark, Mark, f"marks[{index}]", "a Tag or a Sticker")
        settle(self, height=positive(self.height, "part.height", "m"), marks=marks)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig(Comparable):
    """A camera over a plate, and how it tells the parts apart.

    Parameters
    ----------
    name : str
        Of the bench; recordings of another are refused.
    camera : Camera
    parts : dict of str to MarkedPart
        By the names the scene calls body and pusher.
    fixel_height : float
        Of the fixels above the plane [m].
    plate : tuple of Tag
        Tags fixed to the plate, at poses of the world: they tell whether the camera was moved.
    tactile : tuple of str
        The fixel behind each bit of the tactile byte, lowest first.
    position_tolerance, angle_tolerance : float
        How well parts must be placed before an experiment starts [m, rad].
    measured : MeasuredCamera, optional
        The same camera with the covariance of its errors; none where nothing is known of them.
    """

    name: str
    camera: Camera
    parts: dict[str, MarkedPart] = field(default_factory=dict)
    fixel_height: float = 0.05108
    plate: tuple[Tag, ...] = ()
    tactile: tuple[str, ...] = THESIS_BITS
    position_tolerance: float = 1e-3
    angle_tolerance: float = math.radians(1.0)
    measured: MeasuredCamera | None = None

    def __post_init__(self) -> None:
        name_of(self.name, "rig.name")
        instance(self.camera, Camera, "rig.camera", "a Camera")
        if self.measured is not None and self.measured.camera != self.camera:
            raise InvalidInput(
                "rig.measured", found="another camera", expected="the errors of rig.camera, or none"
            )
        settle(
            self,
            parts=dict(self.parts),
            fixel_height=positive(self.fixel_height, "rig.fixel_height", "m"),
            plate=tuple(self.plate),
            tactile=_bits(self.tactile),
            position_tolerance=positive(self.position_tolerance, "rig.position_tolerance", "m"),
            angle_tolerance=positive(self.angle_tolerance, "rig.angle_tolerance", "rad"),
        )
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
    """A tag or a colour that is there twice cannot be told from itself."""
    seen: dict[str, str] = {}
    everywhere = [(name, mark) for name, part in rig.parts.items() for mark in part.marks]
    for name, mark in [*everywhere, *(("the plate", tag) for tag in rig.plate)]:
        what = f"{mark.family} tag {mark.id}" if isinstance(mark, Tag) else f"{mark.colour} sticker"
        if what in seen:
            raise InvalidInput(
                "rig.parts",
                found=f"the {what} on {seen[what]} and on {name}",
                expected="marks that are there once, or the camera cannot tell them apart",
            )
        seen[what] = name
