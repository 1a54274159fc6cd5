"""Schema of scene files: keys, kinds of value, units.

It contains only what a text editor could check. Whether a polygon crosses itself or a body tips
over is checked in `fixel.model`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fixel.errors import InvalidInput

MAX_KEYS = 1000  # maximum number of keys in one mapping; scenes have about ten

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]
Point = Annotated[list[Number], Field(min_length=2, max_length=2)]
Triple = Annotated[list[Number], Field(min_length=3, max_length=3)]
Waypoint = Annotated[list[Number], Field(min_length=4, max_length=4)]
Path = tuple[str | int, ...]

# Placeholder in a template for a value that only the user knows.
FILL_IN: Final = "FILL_IN"


def _one_of(*forms: str) -> dict[str, Any]:
    return {"oneOf": [{"required": [form]} for form in forms]}


class SceneLevel(BaseModel):
    """Base of all records: rejects unknown keys, and numbers written as text."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ShapeRecord(SceneLevel):
    """Shape, in exactly one form."""

    model_config = ConfigDict(json_schema_extra=_one_of("polygon", "disk"))
    polygon: list[Point] | None = Field(None, description="corners x, y [m]")
    disk: Positive | None = Field(None, description="radius [m]")


class TripodRecord(SceneLevel):
    radius: Positive = Field(description="distance of the points from the centre of mass [m]")
    friction: NonNegative = Field(description="coefficient against the plane")
    angle: Number = Field(0.0, description="of the first point from body x [rad]")


class PointsRecord(SceneLevel):
    at: list[Point] = Field(description="points in the frame of the shape [m]")
    friction: NonNegative | list[NonNegative] = Field(description="coefficients against the plane")
    loads: list[NonNegative] | None = Field(None, description="normal force at each point [N]")


class UniformRecord(SceneLevel):
    friction: NonNegative = Field(description="coefficient against the plane")
    n_points: int = Field(64, ge=3, le=100_000, description="about how many quadrature points")


class EllipsoidRecord(SceneLevel):
    force: Positive = Field(description="largest friction force [N]")
    torque: Positive = Field(description="largest friction torque [N m]")
    centre: Point = Field([0.0, 0.0], description="centre of friction in the shape's frame [m]")


class NoneRecord(SceneLevel):
    """Record without keys."""


class SupportRecord(SceneLevel):
    """Support of a body, in exactly one form."""

    model_config = ConfigDict(
        json_schema_extra=_one_of("tripod", "points", "uniform", "ellipsoid", "none")
    )
    tripod: TripodRecord | None = Field(None, description="three points about the centre of mass")
    points: PointsRecord | None = Field(None, description="support at given points")
    uniform: UniformRecord | None = Field(None, description="even pressure over the footprint")
    ellipsoid: EllipsoidRecord | None = Field(None, description="ellipsoidal limit surface")
    none: NoneRecord | None = Field(None, description="no friction with the plane")


class SpringRecord(SceneLevel):
    stiffness: Positive = Field(description="[N/m]")
    anchor: Point = Field(description="in the world [m]")


class BodyRecord(SceneLevel):
    name: str
    shape: ShapeRecord
    mass: Positive = Field(description="[kg]")
    inertia: Positive | None = Field(None, description="about the centre of mass [kg m^2]")
    centre_of_mass: Point | None = Field(None, description="in the frame of the shape [m]")
    pose: Triple = Field(description="x [m], y [m], angle [rad] of the shape's frame at t = 0")
    velocity: Triple = Field([0.0] * 3, description="vx [m/s], vy [m/s], omega [rad/s]")
    support: SupportRecord | None = Field(None, description="how the body rests on the plane")
    force: Triple = Field([0.0] * 3, description="constant wrench fx [N], fy [N], tau [N m]")
    spring: SpringRecord | None = Field(None, description="pulls the centre of mass to a point")


class DriveRecord(SceneLevel):
    """Drive of a pusher: either a direction with a speed, or waypoints."""

    model_config = ConfigDict(json_schema_extra=_one_of("direction", "waypoints"))
    direction: Point | None = Field(None, description="of the motion, world axes")
    speed: NonNegative | None = Field(None, description="[m/s]")
    travel: NonNegative | None = Field(None, description="distance after which it stops [m]")
    waypoints: list[Waypoint] | None = Field(None, description="t [s], x [m], y [m], angle [rad]")
    force_limit: Positive | None = Field(None, description="at which the drive stalls [N]")


class PusherRecord(SceneLevel):
    name: str
    shape: ShapeRecord
    pose: Triple | None = Field(None, description="x [m], y [m], angle [rad] at t = 0")
    drive: DriveRecord
    friction: NonNegative = Field(description="coefficient against every free body")
    restitution: Fraction = Field(0.0, description="share of the approach speed given back")


class FixelRecord(SceneLevel):
    name: str
    shape: ShapeRecord
    pose: Triple = Field(description="x [m], y [m], angle [rad]")
    friction: NonNegative = Field(description="coefficient against every free body")
    restitution: Fraction = Field(0.0, description="share of the approach speed given back")


class PairRecord(SceneLevel):
    pair: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        description="two names; * and ? match as in a shell"
    )
    friction: NonNegative = Field(description="coefficient")
    restitution: Fraction | None = Field(None, description="share of the approach speed given back")


class FrictionMapRecord(SceneLevel):
    origin: Point = Field(description="world position of node [0, 0] [m]")
    cell: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="distance of neighbouring nodes along x and y [m]"
    )
    factor: list[list[Positive]] = Field(description="multiplier at each node, row by row")


class PlaneRecord(SceneLevel):
    anisotropy: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        [1.0, 1.0], description="factors along the axis and across it"
    )
    axis: Number = Field(0.0, description="angle of the first principal axis from world x [rad]")
    friction_map: FrictionMapRecord | None = Field(None, description="multiplier by place")


class SceneRecord(SceneLevel):
    """Content of a scene file."""

    fixel: Literal[1] = Field(1, description="version of the format")
    gravity: NonNegative = Field(9.81, description="[m/s^2]")
    duration: Positive = Field(description="[s]")
    motion: Literal["dynamic", "quasistatic", "first-order"] = "dynamic"
    step: Positive | None = Field(None, description="[s]; left out: the stepper's own choice")
    output_interval: Positive | None = Field(None, description="[s]; left out: every step")
    support_directions: Annotated[int, Field(ge=4)] | None = Field(
        None, description="of the linear form; left out: exact friction disc"
    )
    plane: PlaneRecord | None = Field(None, description="where it is not the same everywhere")
    bodies: list[BodyRecord] = Field(description="free bodies")
    pushers: list[PusherRecord] = Field([], description="driven bodies")
    fixels: list[FixelRecord] = Field([], description="fixed bodies")
    contact_friction: list[PairRecord] = Field([], description="overrides for named pairs")


def scene_record(raw: Any) -> SceneRecord:
    """Validate every key and kind of value in the raw content of a scene file.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.
    """
    _refuse_many_keys(raw)
    try:
        return SceneRecord.model_validate(raw)
    except ValidationError as problems:
        if left := list(_placeholders(raw)):
            raise _unfilled(left) from None
        raise _explained(problems, raw) from None


def _refuse_many_keys(raw: Any, where: str = "scene") -> None:
    """Reject huge mappings, before validation creates an error for each of their keys."""
    if isinstance(raw, dict) and len(raw) > MAX_KEYS:
        raise InvalidInput(where, found=f"{len(raw)} keys", expected=f"at most {MAX_KEYS}")
    for value in raw.values() if isinstance(raw, dict) else raw if isinstance(raw, list) else ():
        if isinstance(value, dict | list):
            _refuse_many_keys(value, where)


def record_at(path: Path) -> type[SceneLevel] | None:
    """Class of the record at a path; None if there is no record."""
    record: type[SceneLevel] | None = SceneRecord
    for key in path:
        if isinstance(key, str):
            field = record.model_fields.get(key) if record else None
            record = _record_in(field.annotation) if field else None
    return record


def empty_at(path: Path) -> dict[str, Any] | list[Any] | None:
    """Empty container to insert for a missing key: a list, a dict, or None for a value."""
    parent, key = record_at(path[:-1]), path[-1]
    field = parent.model_fields.get(str(key)) if parent else None
    if field and get_origin(field.annotation) is list:
        return []
    return {} if record_at(path) else None


def written(path: Path) -> str:
    """Format a path as `bodies[0].shape.polygon[2]`."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in path).removeprefix(".")


def unknown_key(path: Path, key: str) -> InvalidInput:
    """Error for a key that the record at a path does not have."""
    record = record_at(path)
    known = list(record.model_fields) if record else []
    close = difflib.get_close_matches(key, known, n=1)
    return InvalidInput(
        written((*path, key)),
        found="an unknown key",
        expected="one of " + ", ".join(known) if known else "no keys here",
        hint=f"did you mean {close[0]!r}?" if close else None,
    )


def _record_in(annotation: Any) -> type[SceneLevel] | None:
    if isinstance(annotation, type) and issubclass(annotation, SceneLevel):
        return annotation
    inner = (_record_in(argument) for argument in get_args(annotation))
    return next((record for record in inner if record), None)


def _placeholders(raw: Any, path: Path = ()) -> Iterator[Path]:
    """Yield the paths of placeholders that are left from a template."""
    if raw == FILL_IN:
        yield path
    entries = (
        raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    )
    for key, value in entries:
        yield from _placeholders(value, (*path, key))


def _unfilled(left: list[Path]) -> InvalidInput:
    first, record = left[0], record_at(left[0])
    forms = [f"{{{k}: {v.description}}}" for k, v in record.model_fields.items()] if record else []
    also = ", ".join(written(path) for path in left[1:])
    return InvalidInput(
        written(first),
        found=f"the placeholder {FILL_IN}",
        expected=" or ".join(forms) or f"a value: {_description(first) or 'see the scene file'}",
        hint=f"{FILL_IN} is left at {also} too" if also else None,
    )


def _explained(problems: ValidationError, raw: Any) -> InvalidInput:
    first = problems.errors(include_url=False)[0]
    kind, context = first["type"], first.get("ctx", {})
    path = _path(first["loc"], raw, kind)
    if kind == "extra_forbidden":
        return unknown_key(path[:-1], str(path[-1]))
    found = None if kind == "missing" else _shown(first["input"])
    expected = _expected(kind, context, first["msg"], path)
    return InvalidInput(written(path) or "scene", found=found, expected=expected)


def _path(location: tuple[int | str, ...], raw: Any, kind: str) -> Path:
    """Path of a pydantic location, without its names for the members of unions."""
    path: list[str | int] = []
    for depth, key in enumerate(location):
        is_last = depth == len(location) - 1
        if isinstance(raw, list) and isinstance(key, int) and key < len(raw):  # noqa: SIM114
            raw = raw[key]
        elif isinstance(raw, dict) and key in raw:
            raw = raw[key]
        elif not (is_last and kind == "missing"):
            continue
        path.append(key)
    return tuple(path)


def _expected(kind: str, context: dict[str, Any], message: str, path: Path) -> str:
    record = record_at(path)
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return "the keys " + ", ".join(record.model_fields if record else ())
    phrases = {
        "missing": "a value: this key is required",
        "float_type": "a number",
        "int_type": "a whole number",
        "finite_number": "a finite number",
        "string_type": "text",
        "list_type": "a list",
        "greater_than": "a number greater than {gt:g}",
        "greater_than_equal": "a number of at least {ge:g}",
        "less_than_equal": "a number of at most {le:g}",
        "too_short": "at least {min_length} entries",
        "too_long": "at most {max_length} entries",
        "literal_error": "{expected}",
    }
    phrase = phrases[kind].format(**context) if kind in phrases else message
    description = _description(path)
    return f"{phrase} ({description})" if description else phrase


def _description(path: Path) -> str | None:
    named = [k for k, key in enumerate(path) if isinstance(key, str)]
    record = record_at(path[: named[-1]]) if named else None
    field = record.model_fields.get(str(path[named[-1]])) if record else None
    return field.description if field else None


def _shown(value: Any) -> Any:
    return repr(value) if isinstance(value, str) else value
