"""The body of a task in URDF: outline, inertia, and a foot at each support point."""

from __future__ import annotations

from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

from fixel.simulation.engines.plane import harmonic_partner
from fixel.simulation.engines.solids import (
    FOOT,
    PieceSolid,
    footed,
    prism_obj,
    solids,
)
from fixel.simulation.engines.task import PlainTask, bench_units

HEIGHT = 0.02  # [m] of the body, if it has the size of a bench
REACH = 0.01  # [m] of the slide of a foot, likewise


def urdf(task: PlainTask, name: str) -> tuple[str, Mapping[str, str], list[str]]:
    """Return the body as URDF, the meshes that it needs, and what of the task it lacks.

    Each foot is a ball that slides vertically. Its mass is what its point carries, and lies at the
    centre of mass, so that mass and moment of inertia of all links are those of the body.
    Coefficients of feet are tags of their own: for Drake, which combines them with that of a floor
    by the harmonic mean, they are such that a floor of 1 results in the point's; for Gazebo, which
    takes the smaller of two, they are the point's.

    Parameters
    ----------
    task : PlainTask
    name : str
        Name of the robot.
    """
    # No foot has a torque, as an ellipsoid has.
    own = task.body._replace(friction=task.body.friction * (task.body.arms == 0.0))
    feet, unit = footed(own, task.gravity), bench_units(own).length
    meshes: dict[str, str] = {}
    shapes = "".join(
        _shape(k, solid, HEIGHT * unit, meshes) for k, solid in enumerate(solids(own.outline))
    )
    text = (
        f'<?xml version="1.0"?>\n<robot name={quoteattr(name)} xmlns:drake="drake.mit.edu">\n'
        f'<link name="object">\n{_inertial(feet.mass, feet.inertia)}{shapes}</link>\n'
    )
    masses, friction = feet.masses.tolist(), feet.friction.tolist()
    for k, place in enumerate(feet.points.tolist()):
        inertial = _inertial(masses[k], feet.foot_inertia, (-place[0], -place[1]))
        text += _foot(k, place, inertial, friction[k], unit)
    return text + "</robot>\n", meshes, _lost(task)


def _lost(task: PlainTask) -> list[str]:
    own = task.body
    friction = {task.pusher.friction} if task.pusher else set()
    friction |= {fixel.friction for fixel in task.fixels}
    lost = [f"{len(task.fixels)} fixels"] if task.fixels else []
    lost += ["the pusher and its drive"] if task.pusher else []
    if friction:
        values = ", ".join(f"{value:g}" for value in sorted(friction))
        lost.append(f"friction of the body against pusher and fixels: {values}")
    if (own.arms > 0.0).any():
        lost.append("the ellipsoidal limit surface of the support: there are no feet")
    x, y, theta = own.start.tolist()
    lost.append(f"the start pose of the centre of mass: {x:g} m, {y:g} m, {theta:g} rad")
    if own.velocity.any():
        lost.append("the start velocity")
    return lost


def _shape(k: int, solid: PieceSolid, height: float, meshes: dict[str, str]) -> str:
    length, width = solid.size
    x, y, theta = solid.at
    if solid.kind == "disc":
        geometry = f'<cylinder radius="{length!r}" length="{height!r}"/>'
    elif solid.kind == "box":
        geometry = f'<box size="{length!r} {width!r} {height!r}"/>'
    else:
        meshes[f"object_{k}.obj"] = prism_obj(solid.corners, height)
        geometry = f'<mesh filename="object_{k}.obj"/>'
    # The frame of the body is at the middle of a foot, the bottom of the body just above the floor.
    own = f'<origin xyz="{x!r} {y!r} {height / 2!r}" rpy="0 0 {theta!r}"/>'
    inside = f"{own}<geometry>{geometry}</geometry>"
    return f"<visual>{inside}</visual>\n<collision>{inside}</collision>\n"


def _inertial(mass: float, inertia: float, at: tuple[float, float] = (0.0, 0.0)) -> str:
    x, y = at
    return (
        f'<inertial><origin xyz="{x!r} {y!r} 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial>\n"
    )


def _foot(k: int, at: list[float], inertial: str, friction: float, unit: float) -> str:
    x, y = at
    drake, reach = harmonic_partner(friction), REACH * unit
    return (
        f'<link name="foot{k}">\n{inertial}'
        f'<collision><geometry><sphere radius="{FOOT * unit!r}"/></geometry>'
        f'<drake:proximity_properties><drake:mu_static value="{drake!r}"/>'
        f'<drake:mu_dynamic value="{drake!r}"/></drake:proximity_properties></collision></link>\n'
        f'<joint name="foot{k}_slide" type="prismatic"><parent link="object"/>'
        f'<child link="foot{k}"/><origin xyz="{x!r} {y!r} 0"/><axis xyz="0 0 1"/>'
        f'<limit lower="{-reach!r}" upper="{reach!r}" effort="0" velocity="1"/></joint>\n'
        f'<gazebo reference="foot{k}"><mu1>{friction!r}</mu1><mu2>{friction!r}</mu2></gazebo>\n'
    )
