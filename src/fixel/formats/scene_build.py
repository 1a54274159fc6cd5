"""Conversion of the records of a scene file to the model; errors have the path of their key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from typing import Any

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats import scene_schema as schema
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


def scene_of(record: schema.SceneRecord) -> Scene:
    """Build the scene that a validated record describes."""
    return Scene(
        bodies=tuple(_body(body, f"bodies[{k}]") for k, body in enumerate(record.bodies)),
        pushers=tuple(_pusher(pusher, f"pushers[{k}]") for k, pusher in enumerate(record.pushers)),
        fixels=tuple(_fixel(fixel, f"fixels[{k}]") for k, fixel in enumerate(record.fixels)),
        contact_friction=tuple(
            _pair(pair, f"contact_friction[{k}]") for k, pair in enumerate(record.contact_friction)
        ),
        plane=_plane(record.plane),
        gravity=record.gravity,
        duration=record.duration,
        support_directions=record.support_directions,
    )


def _body(record: schema.BodyRecord, path: str) -> Body:
    shape = _shape(record.shape, f"{path}.shape")
    support = _support(record.support, f"{path}.support")
    spring = _spring(record.spring, path)
    with _within(path, f"body {record.name!r}."):
        return Body(
            name=record.name,
            shape=shape,
            mass=record.mass,
            pose=np.array(record.pose),
            support=support,
            inertia=record.inertia,
            centre_of_mass=_array(record.centre_of_mass),
            velocity=np.array(record.velocity),
            force=np.array(record.force),
            spring=spring,
        )


def _spring(record: schema.SpringRecord | None, path: str) -> Spring | None:
    if record is None:
        return None
    with _within(path):
        return Spring(stiffness=record.stiffness, anchor=np.array(record.anchor))


def _pusher(record: schema.PusherRecord, path: str) -> Pusher:
    shape = _shape(record.shape, f"{path}.shape")
    drive = _drive(record.drive, path)
    with _within(path, f"pusher {record.name!r}."):
        return Pusher(
            name=record.name,
            shape=shape,
            pose=_array(record.pose),
            drive=drive,
            friction=record.friction,
            restitution=record.restitution,
        )


def _fixel(record: schema.FixelRecord, path: str) -> Fixel:
    shape = _shape(record.shape, f"{path}.shape")
    with _within(path, f"fixel {record.name!r}."):
        return Fixel(
            name=record.name,
            shape=shape,
            pose=np.array(record.pose),
            friction=record.friction,
            restitution=record.restitution,
        )


def _shape(record: schema.ShapeRecord, path: str) -> Shape:
    _only_form(record, ("polygon", "disk"), path)
    with _within(path):
        if record.disk is not None:
            return Disk(record.disk)
        return Polygon(record.polygon)  # type: ignore[arg-type]


def _support(record: schema.SupportRecord | None, path: str) -> Support:
    if record is None or record.model_fields_set == {"none"}:
        return NoSupport()
    _only_form(record, ("tripod", "points", "uniform", "ellipsoid", "none"), path)
    with _within(path):
        if record.tripod:
            return Tripod(**record.tripod.model_dump())
        if record.points:
            points = record.points
            return SupportPoints(
                points=np.array(points.at).reshape(-1, 2),
                friction=points.friction,  # type: ignore[arg-type]
                loads=_array(points.loads),
            )
        if record.uniform:
            return UniformPressure(**record.uniform.model_dump())
        if record.ellipsoid:
            return Ellipsoid(**record.ellipsoid.model_dump())
    return NoSupport()


def _drive(record: schema.DriveRecord, path: str) -> Drive:
    _only_form(record, ("direction", "waypoints"), f"{path}.drive")
    for key in ("speed", "travel"):
        if record.waypoints is not None and getattr(record, key) is not None:
            raise InvalidInput(
                f"{path}.drive.{key}", found=f"a {key} besides waypoints", expected="only waypoints"
            )
    with _within(path):
        if record.waypoints is not None:
            return PathDrive(
                waypoints=np.array(record.waypoints).reshape(-1, 4), force_limit=record.force_limit
            )
        if record.speed is None:
            raise InvalidInput("drive.speed", found=None, expected="a speed [m/s]")
        return LineDrive(
            direction=np.array(record.direction),
            speed=record.speed,
            travel=inf if record.travel is None else record.travel,
            force_limit=record.force_limit,
        )


def _pair(record: schema.PairRecord, path: str) -> PairFriction:
    first, second = record.pair
    with _within(path, "contact_friction."):
        return PairFriction(
            pair=(first, second), friction=record.friction, restitution=record.restitution
        )


def _plane(record: schema.PlaneRecord | None) -> Plane:
    if record is None:
        return Plane()
    grid = record.friction_map
    with _within("plane"):
        friction_map = FrictionMap(**grid.model_dump()) if grid else None
    with _within("plane", "plane."):
        return Plane(
            anisotropy=np.array(record.anisotropy),
            axis=record.axis,
            friction_map=friction_map,
        )


def _only_form(record: schema.SceneLevel, forms: Sequence[str], path: str) -> None:
    """Raise `InvalidInput` for a record with none of its forms, or more than one."""
    given = [form for form in forms if getattr(record, form) is not None]
    if len(given) != 1:
        raise InvalidInput(
            path,
            found=" and ".join(given) or None,
            expected="exactly one of " + ", ".join(forms),
        )


@contextmanager
def _within(path: str, prefix: str = "") -> Iterator[None]:
    """Report errors of the model at a key of the file."""
    try:
        yield
    except InvalidInput as problem:
        where = problem.where.removeprefix(prefix)
        raise InvalidInput(
            where, found=problem.found, expected=problem.expected, hint=problem.hint
        ).within(path) from None


def _array(values: Sequence[float] | None) -> Any:
    return None if values is None else np.array(values, dtype=np.float64)
