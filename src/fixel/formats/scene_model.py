"""Conversion between scenes of the model and the records of scene files."""

from __future__ import annotations

from dataclasses import MISSING, fields
from math import inf
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats import scene_schema as schema
from fixel.formats.records import FileRecord, NoneRecord, built, only_form, within
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

# Keys of objects in a file: those of their record, which are also the names of their fields.
_RECORDS: Final[dict[type, type[FileRecord]]] = {
    Scene: schema.SceneRecord,
    Body: schema.BodyRecord,
    Spring: schema.SpringRecord,
    Pusher: schema.PusherRecord,
    LineDrive: schema.DriveRecord,
    PathDrive: schema.DriveRecord,
    Fixel: schema.FixelRecord,
    PairFriction: schema.PairRecord,
    Plane: schema.PlaneRecord,
    FrictionMap: schema.FrictionMapRecord,
    Tripod: schema.TripodRecord,
    SupportPoints: schema.PointsRecord,
    UniformPressure: schema.UniformRecord,
    Ellipsoid: schema.EllipsoidRecord,
    NoSupport: NoneRecord,
}
SUPPORTS: Final[dict[str, type[Support]]] = {
    "tripod": Tripod,
    "points": SupportPoints,
    "uniform": UniformPressure,
    "ellipsoid": Ellipsoid,
    "none": NoSupport,
}
# Keys that are not written for a default; files show all others.
_OMITTED: Final = frozenset(
    {"velocity", "force", "restitution", "plane", "pushers", "fixels", "contact_friction"}
)


def scene_of(record: schema.SceneRecord) -> Scene:
    """Build the scene that a validated record describes; errors have the path of their key."""
    pairs = enumerate(record.contact_friction)
    return Scene(
        bodies=tuple(_body(body, f"bodies[{k}]") for k, body in enumerate(record.bodies)),
        pushers=tuple(_pusher(pusher, f"pushers[{k}]") for k, pusher in enumerate(record.pushers)),
        fixels=tuple(_fixel(fixel, f"fixels[{k}]") for k, fixel in enumerate(record.fixels)),
        contact_friction=tuple(
            built(PairFriction, pair, f"contact_friction[{k}]", "contact_friction.")
            for k, pair in pairs
        ),
        plane=_plane(record.plane),
        gravity=record.gravity,
        duration=record.duration,
        support_directions=record.support_directions,
    )


def scene_content(scene: Scene) -> dict[str, Any]:
    """Return a scene as the keys of a scene file, mostly without defaults."""
    content: dict[str, Any] = plain_content(scene)
    return content


def support_of(record: FileRecord | None, path: str) -> Support:
    """Build a support from a record with one of the keys of `SUPPORTS`."""
    if record is None:
        return NoSupport()
    form = only_form(record, path)
    given = getattr(record, form)
    if form == "points":
        points = {"points": given.at, "friction": given.friction, "loads": given.loads}
        with within(path):
            return SupportPoints(**points)
    return built(SUPPORTS[form], given, path)


def shape_of(record: schema.ShapeRecord, path: str) -> Shape:
    """Build a polygon or a disk."""
    form = only_form(record, path)
    with within(path):
        return (Disk if form == "disk" else Polygon)(getattr(record, form))


def plain_content(value: Any) -> Any:
    """Convert objects of the model to dicts, lists and plain values, as in files."""
    if isinstance(value, Polygon):
        return {"polygon": value.vertices.tolist()}
    if isinstance(value, Disk):
        return {"disk": value.radius}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [plain_content(item) for item in value]
    if type(value) not in _RECORDS:
        return value
    content = _content(value)
    return {_form(value): content} if isinstance(value, Support) else content


def _content(value: Any) -> dict[str, Any]:
    content = {}
    defaults = {
        field.name: field.default if field.default_factory is MISSING else field.default_factory()
        for field in fields(value)
        if field.name in _OMITTED
    }
    for key in _RECORDS[type(value)].model_fields:
        item = getattr(value, "points" if key == "at" else key, None)
        if item is None or (key == "travel" and item == inf):
            continue
        if key not in defaults or np.any(item != defaults[key]):
            content[key] = plain_content(item)
    if "drive" in content:
        content["drive"] = content.pop("drive")  # last, since it may have many waypoints
    return content


def _form(support: Support) -> str:
    return next(form for form, kind in SUPPORTS.items() if isinstance(support, kind))


def _body(record: schema.BodyRecord, path: str) -> Body:
    support = record.support
    if support and support.model_fields_set == {"none"}:  # in YAML, `none:` has no value
        support = None
    return built(
        Body,
        record,
        path,
        f"body {record.name!r}.",
        shape=shape_of(record.shape, f"{path}.shape"),
        support=support_of(support, f"{path}.support"),
        spring=built(Spring, record.spring, path) if record.spring else None,
    )


def _pusher(record: schema.PusherRecord, path: str) -> Pusher:
    shape, drive = shape_of(record.shape, f"{path}.shape"), _drive(record.drive, path)
    return built(Pusher, record, path, f"pusher {record.name!r}.", shape=shape, drive=drive)


def _fixel(record: schema.FixelRecord, path: str) -> Fixel:
    shape = shape_of(record.shape, f"{path}.shape")
    return built(Fixel, record, path, f"fixel {record.name!r}.", shape=shape)


def _drive(record: schema.DriveRecord, path: str) -> Drive:
    form = only_form(record, f"{path}.drive", ("direction", "waypoints"))
    given = {key: value for key, value in record if value is not None}
    for key in ("speed", "travel"):
        if form == "waypoints" and key in given:
            raise InvalidInput(
                f"{path}.drive.{key}",
                found=f"a {key} in addition to waypoints",
                expected="only waypoints",
            )
    with within(path):
        if form == "waypoints":
            return PathDrive(**given)
        if record.speed is None:
            raise InvalidInput("drive.speed", found=None, expected="a speed [m/s]")
        return LineDrive(**given)


def _plane(record: schema.PlaneRecord | None) -> Plane:
    if record is None:
        return Plane()
    grid = record.friction_map
    friction_map = built(FrictionMap, grid, "plane") if grid else None
    return built(Plane, record, "plane", "plane.", friction_map=friction_map)
