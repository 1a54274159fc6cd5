"""Parts of a plan: objects, layouts of fixels, and the rig that all experiments share."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache
from math import pi, sin
from typing import Annotated, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Disk, NoSupport, Polygon, Shape, Support, fields, placed
from fixel.typing import FloatArray

MAX_SIDES: Final = 1000

MAX_PEGS: Final = 100
MOST_NUMBER: Final = 9999

Peg = tuple[float, float]


def plain_name(value: object, where: str, longest: int = 60) -> str:
    """Return a name that is valid in file names everywhere: letters, digits, `_` and `-`."""
    name = fields.name_of(value, where)
    if len(name) > longest or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        expected = f"at most {longest} characters of A-Z, a-z, 0-9, _ and -"
        raise InvalidInput(where, found=repr(name), expected=expected)
    return name


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RegularPolygon:
    """Regular polygon about the origin, with one side facing -x, towards the head.

    Parameters
    ----------
    sides : int
        Number of sides.
    side : float
        Length of one side [m].
    """

    sides: int
    side: Annotated[float, fields.Value(fields.positive, "m")]

    def __post_init__(self) -> None:
        if not 3 <= self.sides <= MAX_SIDES:
            raise InvalidInput(
                "regular.sides", found=self.sides, expected=f"a number from 3 to {MAX_SIDES}"
            )
        fields.check_fields(self, "regular")

    @property
    def circumradius(self) -> float:
        """Distance from the centre to a corner [m]."""
        return 0.5 * self.side / sin(pi / self.sides)

    @property
    def polygon(self) -> Polygon:
        """Polygon shape of the model."""
        return _regular(self)


@cache
def _regular(shape: RegularPolygon) -> Polygon:
    angle = pi + (2.0 * np.arange(shape.sides) + 1.0) * pi / shape.sides
    return Polygon(shape.circumradius * np.column_stack((np.cos(angle), np.sin(angle))))


Outline = Polygon | Disk | RegularPolygon


def shape_of(outline: Outline) -> Shape:
    """Return the shape of the model."""
    return outline.polygon if isinstance(outline, RegularPolygon) else outline


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedShape:
    """Object of a plan.

    Parameters
    ----------
    name : str
        Unique among the plan's objects; see `plain_name`.
    outline : Polygon, Disk or RegularPolygon
        Outline in the frame of the object.
    mass : float
        Mass of the object [kg].
    support : Support
        Support of the object on the plane.
    zone_start : float
        Distance from the head's initial centre to the fixel zone, along the motion [m].
    """

    name: str
    outline: Outline
    mass: Annotated[float, fields.Value(fields.positive, "kg")]
    zone_start: Annotated[float, fields.Value(fields.finite, "m")]
    support: Support = field(default_factory=NoSupport)

    def __post_init__(self) -> None:
        where = f"shape {plain_name(self.name, 'shape.name')!r}"
        fields.instance(self.outline, Outline, where, "a Polygon, a Disk or a RegularPolygon")
        fields.check_fields(self, where)

    @property
    def shape(self) -> Shape:
        """Return the shape of the model."""
        return shape_of(self.outline)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FixelLayout:
    """Positions of the fixels in their zone.

    Parameters
    ----------
    name : str
        Unique among the plan's layouts; see `plain_name`.
    pegs : tuple of (u, v)
        Positions in the unit square: u from the near to the far side along the motion, v from the
        right to the left side. Empty for an open plate.
    number : int, optional
        Number of the layout in a publication.
    """

    name: str
    pegs: tuple[Peg, ...]
    number: int | None = None

    def __post_init__(self) -> None:
        where = f"layout {plain_name(self.name, 'layout.name')!r}"
        for k, peg in enumerate(self.pegs):
            if not all(0.0 <= part <= 1.0 for part in peg):
                raise InvalidInput(
                    f"{where}.pegs[{k}]", found=list(peg), expected="u and v, each from 0 to 1"
                )
        if len(self.pegs) > MAX_PEGS:
            raise InvalidInput(
                f"{where}.pegs", found=f"{len(self.pegs)} pegs", expected=f"at most {MAX_PEGS}"
            )
        if self.number is not None and not 1 <= self.number <= MOST_NUMBER:
            raise InvalidInput(f"{where}.number", found=self.number, expected=f"1 to {MOST_NUMBER}")
        fields.settle(self, pegs=tuple((float(u), float(v)) for u, v in self.pegs))

    @property
    def title(self) -> str:
        """Name with the number, if there is one: `4 collinear-minus45`."""
        return self.name if self.number is None else f"{self.number} {self.name}"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingRig:
    """Apparatus of all experiments of a plan. The head starts at the origin and moves along +x.

    Parameters
    ----------
    head : Polygon, Disk or RegularPolygon
        Outline of the head in its own frame.
    speed : float
        Speed of the head [m/s].
    travel : float
        Distance that the head moves [m].
    force_limit : float, optional
        Force at which the drive stalls [N]; None for a rigid drive.
    head_friction, fixel_friction : float
        Nominal friction coefficients against the object [-].
    fixel_radius : float
        Radius of the fixels [m].
    zone_side : float
        Side of the square fixel zone, which is symmetric about the x axis [m].
    gap : float
        Distance along the motion from the head to the object in its nominal pose [m].
    angle : float
        Angle of the object in its nominal pose [rad].
    """

    head: Outline
    speed: Annotated[float, fields.Value(fields.positive, "m/s")]
    travel: Annotated[float, fields.Value(fields.positive, "m")]
    force_limit: Annotated[float | None, fields.Value(fields.positive, "N")] = None
    head_friction: Annotated[float, fields.Value(fields.non_negative)]
    fixel_friction: Annotated[float, fields.Value(fields.non_negative)]
    fixel_radius: Annotated[float, fields.Value(fields.positive, "m")]
    zone_side: Annotated[float, fields.Value(fields.positive, "m")]
    gap: Annotated[float, fields.Value(fields.finite, "m")]
    angle: Annotated[float, fields.Value(fields.finite, "rad")] = 0.0

    def __post_init__(self) -> None:
        fields.instance(self.head, Outline, "head.shape", "a Polygon, a Disk or a RegularPolygon")
        fields.check_fields(self, "rig")

    @property
    def duration(self) -> float:
        """Duration of one experiment, which ends when the head has moved its travel [s]."""
        return self.travel / self.speed

    def nominal_centroid(self, shape: Shape) -> FloatArray:
        """Return the centroid (2,) of an object in its nominal pose, straight ahead [m]."""
        face = float(shape_of(self.head).outline[:, 0].max())
        turned = placed(shape.outline - shape.centroid, (0.0, 0.0, self.angle))
        return np.array([face + self.gap - float(turned[:, 0].min()), 0.0])

    def peg_places(self, shape: PlannedShape, layout: FixelLayout) -> FloatArray:
        """Return the centres (n, 2) of the fixels of a layout [m]."""
        near_right = np.array([shape.zone_start, -0.5 * self.zone_side])
        pegs = np.array(layout.pegs, dtype=np.float64).reshape(-1, 2)
        return np.asarray(near_right + self.zone_side * pegs)
