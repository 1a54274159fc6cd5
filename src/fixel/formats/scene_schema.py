"""Schema of scene files: keys, kinds of value, units."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field

from fixel.errors import InvalidInput
from fixel.formats.records import (
    FileRecord,
    Fraction,
    KeyPath,
    NoneRecord,
    NonNegative,
    Number,
    Point,
    Positive,
    Triple,
    description_at,
    record_at,
    validated,
    written,
)

MAX_KEYS = 1000  # maximum number of keys in one mapping; scenes have about ten

Waypoint = Annotated[list[Number], Field(min_length=4, max_length=4)]

# Placeholder in a template for a value that only the user knows.
FILL_IN: Final = "FILL_IN"


def _one_of(*forms: str) -> dict[str, Any]:
    return {"oneOf": [{"required": [form]} for form in forms]}


class ShapeRecord(FileRecord):
    """Shape, in exactly one form."""

    model_config = ConfigDict(json_schema_extra=_one_of("polygon", "disk"))
    polygon: list[Point] | None = Field(None, description="corners x, y of a polygon [m]")
    disk: Positive | None = Field(None, description="radius of a disk [m]")


class TripodRecord(FileRecord):
    radius: Positive = Field(description="distance of the points from the centre of mass [m]")
    friction: NonNegative = Field(description="friction coefficient against the plane")
    angle: Number = Field(0.0, description="direction of the first point, from body x [rad]")


class PointsRecord(FileRecord):
    at: list[Point] = Field(description="positions of the points in the frame of the shape [m]")
    friction: NonNegative | list[NonNegative] = Field(
        description="friction coefficient of all points or of each"
    )
    loads: list[NonNegative] | None = Field(None, description="normal force at each point [N]")


class UniformRecord(FileRecord):
    friction: NonNegative = Field(description="friction coefficient against the plane")
    n_points: int = Field(
        64, ge=3, le=100_000, description="approximate number of quadrature points"
    )


class EllipsoidRecord(FileRecord):
    force: Positive = Field(description="largest friction force [N]")
    torque: Positive = Field(description="largest friction torque [N m]")
    centre: Point = Field([0.0, 0.0], description="centre of friction in the shape's frame [m]")


class SupportRecord(FileRecord):
    """Support of a body, in exactly one form."""

    model_config = ConfigDict(
        json_schema_extra=_one_of("tripod", "points", "uniform", "ellipsoid", "none")
    )
    tripod: TripodRecord | None = Field(None, description="three points about the centre of mass")
    points: PointsRecord | None = Field(None, description="support at given points")
    uniform: UniformRecord | None = Field(None, description="uniform pressure over the footprint")
    ellipsoid: EllipsoidRecord | None = Field(None, description="ellipsoidal limit surface")
    none: NoneRecord | None = Field(None, description="no friction with the plane")


class SpringRecord(FileRecord):
    stiffness: Positive = Field(description="spring constant [N/m]")
    anchor: Point = Field(description="end of the spring in the world [m]")


class BodyRecord(FileRecord):
    name: str
    shape: ShapeRecord
    mass: Positive = Field(description="mass [kg]")
    inertia: Positive | None = Field(
        None, description="moment of inertia about the centre of mass [kg m^2]"
    )
    centre_of_mass: Point | None = Field(
        None, description="centre of mass in the frame of the shape [m]"
    )
    pose: Triple = Field(
        description="pose of the shape's frame at t = 0: x [m], y [m], angle [rad]"
    )
    velocity: Triple = Field(
        [0.0] * 3, description="velocity at t = 0: vx [m/s], vy [m/s], omega [rad/s]"
    )
    support: SupportRecord | None = Field(None, description="support of the body on the plane")
    force: Triple = Field([0.0] * 3, description="constant wrench: fx [N], fy [N], tau [N m]")
    spring: SpringRecord | None = Field(
        None, description="spring that pulls the centre of mass to a point"
    )


class DriveRecord(FileRecord):
    """Drive of a pusher: either a direction with a speed, or waypoints."""

    model_config = ConfigDict(json_schema_extra=_one_of("direction", "waypoints"))
    direction: Point | None = Field(None, description="direction of the motion in world axes")
    speed: NonNegative | None = Field(None, description="speed of the motion [m/s]")
    travel: NonNegative | None = Field(None, description="distance after which the drive stops [m]")
    waypoints: list[Waypoint] | None = Field(
        None, description="poses of the motion: t [s], x [m], y [m], angle [rad]"
    )
    force_limit: Positive | None = Field(None, description="force at which the drive stalls [N]")


class PusherRecord(FileRecord):
    name: str
    shape: ShapeRecord
    pose: Triple | None = Field(None, description="pose at t = 0: x [m], y [m], angle [rad]")
    drive: DriveRecord
    friction: NonNegative = Field(description="friction coefficient against every free body")
    restitution: Fraction = Field(
        0.0, description="coefficient of restitution against every free body"
    )


class FixelRecord(FileRecord):
    name: str
    shape: ShapeRecord
    pose: Triple = Field(description="pose: x [m], y [m], angle [rad]")
    friction: NonNegative = Field(description="friction coefficient against every free body")
    restitution: Fraction = Field(
        0.0, description="coefficient of restitution against every free body"
    )


class PairRecord(FileRecord):
    pair: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        description="names of the two bodies; * and ? match as in a shell"
    )
    friction: NonNegative = Field(description="friction coefficient of the pair")
    restitution: Fraction | None = Field(None, description="coefficient of restitution of the pair")


class FrictionMapRecord(FileRecord):
    origin: Point = Field(description="world position of node [0, 0] [m]")
    cell: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="distance between neighbouring nodes along x and y [m]"
    )
    factor: list[list[Positive]] = Field(description="friction multiplier at each node, row by row")


class PlaneRecord(FileRecord):
    anisotropy: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        [1.0, 1.0], description="friction factors along the principal axis and across it"
    )
    axis: Number = Field(0.0, description="angle of the first principal axis from world x [rad]")
    friction_map: FrictionMapRecord | None = Field(
        None, description="friction multiplier that depends on the position"
    )


class SceneRecord(FileRecord):
    """Content of a scene file."""

    fixel: Literal[1] = Field(1, description="version of the format")
    gravity: NonNegative = Field(9.81, description="gravitational acceleration [m/s^2]")
    duration: Positive = Field(description="simulated time [s]")
    motion: Literal["dynamic", "quasistatic", "first-order"] = "dynamic"
    step: Positive | None = Field(None, description="time step [s]; by default the stepper chooses")
    output_interval: Positive | None = Field(
        None, description="time between two samples of the trajectory [s]; by default every step"
    )
    support_directions: Annotated[int, Field(ge=4)] | None = Field(
        None,
        description="number of directions of linearised friction; exact friction disc by default",
    )
    plane: PlaneRecord | None = Field(
        None, description="friction of the plane, if it depends on direction or position"
    )
    bodies: list[BodyRecord] = Field(description="free bodies")
    pushers: list[PusherRecord] = Field([], description="driven bodies")
    fixels: list[FixelRecord] = Field([], description="fixed bodies")
    contact_friction: list[PairRecord] = Field(
        [], description="friction of named pairs, which overrides the default"
    )


def scene_record(raw: Any) -> SceneRecord:
    """Validate every key and kind of value in the raw content of a scene file.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    _refuse_many_keys(raw)
    try:
        return validated(SceneRecord, raw, "scene")
    except InvalidInput:
        if left := list(_placeholders(raw)):
            raise _unfilled(left) from None
        raise


def _refuse_many_keys(raw: Any, where: str = "scene") -> None:
    """Reject huge mappings, before validation creates an error for each of their keys."""
    if isinstance(raw, dict) and len(raw) > MAX_KEYS:
        raise InvalidInput(where, found=f"{len(raw)} keys", expected=f"at most {MAX_KEYS}")
    for value in raw.values() if isinstance(raw, dict) else raw if isinstance(raw, list) else ():
        if isinstance(value, dict | list):
            _refuse_many_keys(value, where)


def _placeholders(raw: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the paths of placeholders that are left from a template."""
    if raw == FILL_IN:
        yield path
    entries = (
        raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    )
    for key, value in entries:
        yield from _placeholders(value, (*path, key))


def _unfilled(left: list[KeyPath]) -> InvalidInput:
    first, record = left[0], record_at(SceneRecord, left[0])
    forms = [f"{{{k}: {v.description}}}" for k, v in record.model_fields.items()] if record else []
    also = ", ".join(written(path) for path in left[1:])
    value = description_at(SceneRecord, first) or "see the scene file"
    return InvalidInput(
        written(first),
        found=f"the placeholder {FILL_IN}",
        expected=" or ".join(forms) or f"a value: {value}",
        hint=f"{FILL_IN} also remains at {also}" if also else None,
    )
