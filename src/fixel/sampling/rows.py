"""Scenes of the rows of a plan: values that differ from a template, and rigid motions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import atan2, cos, inf, sin
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, unknown_name
from fixel.model import LineDrive, PathDrive, PlannedExperiment, Scene, placed
from fixel.model.scene import check_push

KEYS: Final = ("x_m", "y_m", "angle_rad", "offset_x_m", "offset_y_m", "offset_angle_rad")
DRIVE: Final = ("direction_rad", "travel_m", "speed_m_s")
CURVED: Final = 0.05  # of the travel: largest distance of a measured path from a straight line
ENDS: Final = 0.05  # of the travel: rest and jerks at both ends do not count for its speed


def row_scene(template: Scene, values: Mapping[str, float]) -> Scene:
    """Return the scene of one row of a plan: a template with other values.

    The template has one free body and one pusher, whose measured path becomes a straight drive.
    Values in SI units are those of the part (`x_m`, `offset_angle_rad`, ...), the pusher
    (`head_x_m`), a fixel (`fixel-1_x_m`) and the motion (`direction_rad`, `travel_m`, `speed_m_s`).
    Offsets are added to the pose: x along the motion of the head, y to its left, the angle about
    the centroid. The scene ends when the head has moved its new travel. Bodies that overlap, a
    value of nothing in the scene, and a head that does not move raise `InvalidInput`.
    """
    check_push(template)
    fixels = {f"{own.name}_": own for own in template.fixels}
    things: dict[str, Any] = {"": template.bodies[0], "head_": template.pushers[0]} | fixels
    known = (*DRIVE, *(f"{own}{key}" for own in things for key in KEYS))
    if unknown := [name for name in values if name not in known]:
        raise unknown_name(unknown[0], unknown[0], known)
    drive = _line(template, values)
    ahead = atan2(drive.direction[1], drive.direction[0])
    part, head, *others = (_at(*own, values, ahead) for own in things.items())
    same = drive == head.drive and template.duration
    return replace(
        template,
        bodies=(part,),
        pushers=(replace(head, drive=drive),),
        fixels=tuple(others),
        duration=template.duration if same else drive.travel / drive.speed,
    )


def moved(scene: Scene, place: ArrayLike) -> Scene:
    """Move a scene rigidly from an inner frame to the outer one, in which the inner has a pose."""
    place = np.asarray(place, dtype=np.float64)
    turn = (0.0, 0.0, float(place[2]))

    def at(own: Any) -> Any:
        new: dict[str, Any] = {"pose": [*placed(own.pose[:2], place), own.pose[2] + place[2]]}
        for name in ("velocity", "force"):
            if (vector := np.asarray(getattr(own, name, 0.0))).any():
                new[name] = [*placed(vector[:2], turn), vector[2]]
        drive = getattr(own, "drive", None)
        if isinstance(drive, LineDrive):
            new["drive"] = replace(drive, direction=placed(drive.direction, turn))
        elif isinstance(drive, PathDrive):
            path = np.add(drive.waypoints, (0.0, 0.0, 0.0, place[2]))
            path[:, 1:3] = placed(path[:, 1:3], place)
            new["drive"] = replace(drive, waypoints=path)
        if spring := getattr(own, "spring", None):
            new["spring"] = replace(spring, anchor=placed(spring.anchor, place))
        return replace(own, **new)

    kinds = ("bodies", "pushers", "fixels")
    new: dict[str, Any] = {kind: tuple(map(at, getattr(scene, kind))) for kind in kinds}
    return replace(scene, **new)


def moved_onto(scene: Scene, before: ArrayLike, after: ArrayLike) -> Scene:
    """Move a scene rigidly, so that what had the pose `before` (3,) has the pose `after`."""
    before, after = np.asarray(before, dtype=np.float64), np.asarray(after, dtype=np.float64)
    turn = after[2] - before[2]
    return moved(scene, [*(after[:2] - placed(before[:2], (0.0, 0.0, turn))), turn])


def about_part(
    rows: Iterable[PlannedExperiment], pose: ArrayLike | None = None
) -> tuple[PlannedExperiment, ...]:
    """Return the same pushes with the part always at the same pose.

    Each scene is moved rigidly: a drive with two axes pushes the part where it lies. Conditions
    that state a place on the table are left out.

    Parameters
    ----------
    pose : (3,) array_like, optional
        Pose of the part [m, m, rad]; by default that of the first row.

    Examples
    --------
    >>> from fixel.sampling import eight_push_plan
    >>> rows = about_part(eight_push_plan().experiments)
    >>> len({tuple(row.scene.bodies[0].pose) for row in rows})
    1
    """
    found = []
    for row in rows:
        part = row.scene.bodies[0]
        pose = part.pose if pose is None else np.asarray(pose, dtype=np.float64)
        scene = moved_onto(row.scene, part.pose, pose)
        bodies = (replace(scene.bodies[0], pose=pose), *scene.bodies[1:])  # without rounding
        conditions = {k: v for k, v in row.conditions.items() if not k.startswith("place_")}
        found.append(replace(row, scene=replace(scene, bodies=bodies), conditions=conditions))
    return tuple(found)


def _at(own: str, thing: Any, values: Mapping[str, float], ahead: float) -> Any:
    """Return a part, head or fixel with the pose that its values state."""
    given = {key: values[name] for key in KEYS if (name := f"{own}{key}") in values}
    if not given:
        return thing
    pose = np.array([given.get(key, old) for key, old in zip(KEYS, thing.pose, strict=False)])
    offset = [given.get(key, 0.0) for key in KEYS[3:]]
    turned = np.array([*pose[:2], pose[2] + offset[2]])
    centre = thing.shape.centroid
    turned[:2] += placed(centre, pose) - placed(centre, turned)
    turned[:2] += placed(offset[:2], (0.0, 0.0, ahead))
    return replace(thing, pose=turned)


def _line(scene: Scene, values: Mapping[str, float]) -> LineDrive:
    """Return the straight drive of the head with the values of a row."""
    head = scene.pushers[0]
    if head.is_template:
        raise InvalidInput("drive", found="a head without drive", expected="a straight drive")
    old = _straight(head.drive) if isinstance(head.drive, PathDrive) else head.drive
    speed = values.get("speed_m_s", old.speed)
    travel = values.get("travel_m", old.travel)
    if travel == inf and scene.duration:  # until the scene ends
        travel = speed * scene.duration
    if not (0.0 < travel < inf and speed > 0.0):
        found = f"{1e3 * travel:g} mm at {1e3 * speed:g} mm/s"
        raise InvalidInput("drive", found=found, expected="a travel and a speed greater than 0")
    angle = values.get("direction_rad")
    way = old.direction if angle is None else (cos(angle), sin(angle))
    return replace(old, direction=way, speed=speed, travel=travel)


def _straight(path: PathDrive) -> LineDrive:
    """Return the straight drive of a measured path; raise `InvalidInput` for a curved one."""
    time, place = path.waypoints[:, 0], path.waypoints[:, 1:3]
    way = place[-1] - place[0]
    travel = float(np.hypot(*way))
    if not travel:
        raise InvalidInput("drive", found="a head that ends where it began", expected="a push")
    along = (place - place[0]) @ way / travel
    aside = float(np.abs((place - place[0]) @ [-way[1], way[0]]).max() / travel)
    if aside > CURVED * travel:
        found = f"a path of the head that leaves its straight line by {1e3 * aside:.2g} mm"
        raise InvalidInput("drive", found=found, expected="a straight push")
    ends = np.array([ENDS, 1.0 - ENDS]) * travel
    (took,) = np.diff(np.interp(ends, np.maximum.accumulate(along), time))
    speed = float(np.diff(ends)[0] / took)
    return LineDrive(way, speed=speed, travel=travel, force_limit=path.force_limit)
