"""Schema of scene files: the classes of the model, and what files state otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field

from fixel.errors import InvalidInput
from fixel.formats.records import (
    FileRecord,
    KeyPath,
    NonNegative,
    Number,
    Point,
    Positive,
    choice_of,
    content,
    description_at,
    made,
    record_at,
    record_of,
    use_record,
    validated,
    written,
)
from fixel.model import (
    Body,
    Disk,
    Drive,
    Ellipsoid,
    Fixel,
    FrictionMap,
    LineDrive,
    NoSupport,
    PairFriction,
    PathDrive,
    Plane,
    Polygon,
    Pusher,
    Scene,
    Shape,
    Spring,
    Support,
    SupportPoints,
    Tripod,
    UniformPressure,
)

MAX_KEYS = 1000  # maximum number of keys in one mapping; scenes have about ten

Waypoint = Annotated[list[Number], Field(min_length=4, max_length=4)]
Pair = Annotated[list[Positive], Field(min_length=2, max_length=2)]

# Placeholder in a template for a value that only the user knows.
FILL_IN: Final = "FILL_IN"


def _drive(**given: Any) -> Drive:
    forms = [form for form in ("direction", "waypoints") if form in given]
    if len(forms) != 1:
        found = " and ".join(forms) or None
        raise InvalidInput("drive", found=found, expected="exactly one of direction, waypoints")
    if forms == ["direction"]:
        if "speed" not in given:
            raise InvalidInput("drive.speed", found=None, expected="a speed [m/s]")
        return LineDrive(**given)
    for key in ("speed", "travel"):
        if key in given:
            found = f"a {key} in addition to waypoints"
            raise InvalidInput(f"drive.{key}", found=found, expected="only waypoints")
    return PathDrive(**given)


class DriveRecord(FileRecord):
    """Drive of a pusher: either a direction with a speed, or waypoints."""

    model_config = ConfigDict(
        json_schema_extra={"oneOf": [{"required": ["direction"]}, {"required": ["waypoints"]}]}
    )
    makes, word = staticmethod(_drive), "drive"

    direction: Point | None = Field(None, description="direction of the motion in world axes")
    speed: NonNegative | None = Field(None, description="speed of the motion [m/s]")
    travel: NonNegative | None = Field(None, description="distance after which the drive stops [m]")
    waypoints: list[Waypoint] | None = Field(
        None, description="poses of the motion: t [s], x [m], y [m], angle [rad]"
    )
    force_limit: Positive | None = Field(None, description="force at which the drive stalls [N]")


use_record(DriveRecord, LineDrive, PathDrive, Drive)
ShapeRecord: Any = choice_of("ShapeRecord", Shape, polygon=Polygon, disk=Disk)
NoneRecord: Any = record_of(NoSupport, "none")
TripodRecord: Any = record_of(Tripod, "tripod")
PointsRecord: Any = record_of(
    SupportPoints,
    "points",
    names={"points": "at"},
    friction=NonNegative | list[NonNegative],
    loads=list[NonNegative],
)
UniformRecord: Any = record_of(
    UniformPressure, "uniform", n_points=Annotated[int, Field(ge=3, le=100_000)]
)
record_of(Ellipsoid, "ellipsoid")
SupportRecord: Any = choice_of(
    "SupportRecord",
    Support,
    tripod=Tripod,
    points=SupportPoints,
    uniform=UniformPressure,
    ellipsoid=Ellipsoid,
    none=NoSupport,
)
record_of(Spring, "spring")
record_of(Body, "body", required=["pose"])
record_of(Pusher, "pusher", required=["drive"])
record_of(Fixel, "fixel")
record_of(PairFriction, "contact_friction")
record_of(FrictionMap, "friction_map", cell=Pair, factor=list[list[Positive]])
record_of(Plane, "plane", anisotropy=Pair)
SceneRecord: Any = record_of(
    Scene,
    "",
    first=["fixel", "gravity", "duration"],
    required=["duration"],
    support_directions=Annotated[int, Field(ge=4)],
    more={
        "fixel": (Literal[1], Field(1, description="version of the format")),
        "motion": (Literal["dynamic", "quasistatic", "first-order"], "dynamic"),
        "step": (
            Positive | None,
            Field(None, description="time step [s]; by default the stepper chooses"),
        ),
        "output_interval": (
            Positive | None,
            Field(
                None,
                description="time between two samples of the trajectory [s]; by default every step",
            ),
        ),
    },
)


def scene_of(record: Any) -> Scene:
    """Build the scene that a validated record describes; errors have the path of their key."""
    scene: Scene = made(record)
    return scene


def scene_content(scene: Scene) -> dict[str, Any]:
    """Return a scene as the keys of a scene file, mostly without defaults."""
    found: dict[str, Any] = content(scene)
    return found


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
