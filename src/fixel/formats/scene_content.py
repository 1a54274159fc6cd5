"""Conversion of the model to the keys of a scene file."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np

from fixel.model import (
    Body,
    Disk,
    Drive,
    Ellipsoid,
    Fixel,
    NoSupport,
    PairFriction,
    PathDrive,
    Plane,
    Pusher,
    Scene,
    Shape,
    Support,
    SupportPoints,
    Tripod,
    UniformPressure,
)


def scene_content(scene: Scene) -> dict[str, Any]:
    """Return a scene as the keys of a scene file, mostly without defaults."""
    return _without_none(
        {
            "gravity": scene.gravity,
            "duration": scene.duration,
            "support_directions": scene.support_directions,
            "plane": _plane_dict(scene.plane),
            "bodies": [_body_dict(body) for body in scene.bodies],
            "pushers": [_pusher_dict(pusher) for pusher in scene.pushers] or None,
            "fixels": [_obstacle_dict(fixel) for fixel in scene.fixels] or None,
            "contact_friction": [_pair_dict(pair) for pair in scene.contact_friction] or None,
        }
    )


def _body_dict(body: Body) -> dict[str, Any]:
    spring = body.spring
    return _without_none(
        {
            "name": body.name,
            "shape": _shape_dict(body.shape),
            "mass": body.mass,
            "inertia": body.inertia,
            "centre_of_mass": _list(body.centre_of_mass),
            "pose": _list(body.pose),
            "velocity": _list(body.velocity) if body.velocity.any() else None,
            "support": _support_dict(body.support),
            "force": _list(body.force) if body.force.any() else None,
            "spring": spring and {"stiffness": spring.stiffness, "anchor": _list(spring.anchor)},
        }
    )


def _pusher_dict(pusher: Pusher) -> dict[str, Any]:
    obstacle = _obstacle_dict(pusher)
    return {**obstacle, "drive": _drive_dict(pusher.drive)}


def _obstacle_dict(obstacle: Pusher | Fixel) -> dict[str, Any]:
    return _without_none(
        {
            "name": obstacle.name,
            "shape": _shape_dict(obstacle.shape),
            "pose": _list(obstacle.pose),
            "friction": obstacle.friction,
            "restitution": obstacle.restitution or None,
        }
    )


def _shape_dict(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Disk):
        return {"disk": shape.radius}
    return {"polygon": _list(shape.vertices)}


def _support_dict(support: Support) -> dict[str, Any]:
    match support:
        case Tripod():
            return {
                "tripod": {
                    "radius": support.radius,
                    "friction": support.friction,
                    "angle": support.angle,
                }
            }
        case SupportPoints():
            friction = np.asarray(support.friction).tolist()
            at, loads = _list(support.points), _list(support.loads)
            return {"points": _without_none({"at": at, "friction": friction, "loads": loads})}
        case UniformPressure():
            return {"uniform": {"friction": support.friction, "n_points": support.n_points}}
        case Ellipsoid():
            return {
                "ellipsoid": {
                    "force": support.force,
                    "torque": support.torque,
                    "centre": _list(support.centre),
                }
            }
        case NoSupport():
            return {"none": {}}


def _drive_dict(drive: Drive) -> dict[str, Any]:
    if isinstance(drive, PathDrive):
        form: dict[str, Any] = {"waypoints": _list(drive.waypoints)}
    else:
        travel = None if drive.travel == inf else drive.travel
        form = {"direction": _list(drive.direction), "speed": drive.speed, "travel": travel}
    return _without_none({**form, "force_limit": drive.force_limit})


def _pair_dict(pair: PairFriction) -> dict[str, Any]:
    return _without_none(
        {"pair": list(pair.pair), "friction": pair.friction, "restitution": pair.restitution}
    )


def _plane_dict(plane: Plane) -> dict[str, Any] | None:
    if plane == Plane():
        return None
    grid = plane.friction_map
    friction_map = grid and {
        "origin": _list(grid.origin),
        "cell": _list(grid.cell),
        "factor": _list(grid.factor),
    }
    return _without_none(
        {
            "anisotropy": _list(plane.anisotropy),
            "axis": plane.axis,
            "friction_map": friction_map,
        }
    )


def _without_none(record: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in record.items() if value is not None}


def _list(array: Any) -> Any:
    return None if array is None else np.asarray(array).tolist()
