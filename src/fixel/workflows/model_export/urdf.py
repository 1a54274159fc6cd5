"""The body of a task in URDF: outline, inertia, and a foot at each support point."""

from __future__ import annotations

from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

from fixel.simulation.engines.plane import harmonic_partner
from fixel.simulation.engines.solids import (
    FOOT,
    PieceSolid,
    excess_inertia,
    footed,
    prism_obj,
    solids,
)
from fixel.simulation.engines.task import PlainTask

HEIGHT = 0.02  # [m] of the body


def urdf(task: PlainTask, name: str) -> tuple[str, Mapping[str, str], list[str]]:
    """Return the body as URDF, the meshes that it needs, and what of the task it lacks.

    Each foot is a ball that slides vertically and has the mass that its point carries. Coefficients
    of feet are tags of their own: for Drake, which combines them with that of a floor by the
    harmonic mean, they are such that a floor of 1 results in the point's; for Gazebo, which takes
    the smaller of two, they are the point's.

    Parameters
    ----------
    task : PlainTask
    name : str
        Name of the robot.
    """
    # No foot has a torque, as an ellipsoid has.
    own = task.body._replace(friction=task.body.friction * (task.body.arms == 0.0))
    feet = footed(own, task.gravity)
    meshes: dict[str, str] = {}
    shapes = "".join(_shape(k, solid, meshes) for k, solid in enumerate(solids(own.outline)))
    text = (
        f'<?xml version="1.0"?>\n<robot name={quoteattr(name)} xmlns:drake="drake.mit.edu">\n'
        f'<link name="object">\n{_inertial(feet.mass, feet.inertia)}{shapes}</link>\n'
    )
    masses, friction = feet.masses.tolist(), feet.friction.tolist()
    text += "".join(map(_foot, range(len(masses)), feet.points.tolist(), masses, friction))
    return text + "</robot>\n", meshes, excess_inertia(own, task.gravity) + _lost(task)


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


def _shape(k: int, solid: PieceSolid, meshes: dict[str, str]) -> str:
    length, width = solid.size
    x, y, theta = solid.at
    if solid.kind == "disc":
        geometry = f'<cylinder radius="{length!r}" length="{HEIGHT!r}"/>'
    elif solid.kind == "box":
        geometry = f'<box size="{length!r} {width!r} {HEIGHT!r}"/>'
    else:
        meshes[f"object_{k}.obj"] = prism_obj(solid.corners, HEIGHT)
        geometry = f'<mesh filename="object_{k}.obj"/>'
    # The frame of the body is at the middle of a foot, the bottom of the body just above the floor.
    own = f'<origin xyz="{x!r} {y!r} {HEIGHT / 2!r}" rpy="0 0 {theta!r}"/>'
    inside = f"{own}<geometry>{geometry}</geometry>"
    return f"<visual>{inside}</visual>\n<collision>{inside}</collision>\n"


def _inertial(mass: float, inertia: float) -> str:
    return (
        f'<inertial><mass value="{mass!r}"/><inertia ixx="{inertia!r}" iyy="{inertia!r}" '
        f'izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/></inertial>\n'
    )


def _foot(k: int, at: list[float], mass: float, friction: float) -> str:
    x, y = at
    drake = harmonic_partner(friction)
    return (
        f'<link name="foot{k}">\n{_inertial(mass, mass * 1e-6)}'
        f'<collision><geometry><sphere radius="{FOOT!r}"/></geometry>'
        f'<drake:proximity_properties><drake:mu_static value="{drake!r}"/>'
        f'<drake:mu_dynamic value="{drake!r}"/></drake:proximity_properties></collision></link>\n'
        f'<joint name="foot{k}_slide" type="prismatic"><parent link="object"/>'
        f'<child link="foot{k}"/><origin xyz="{x!r} {y!r} 0"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.01" upper="0.01" effort="0" velocity="1"/></joint>\n'
        f'<gazebo reference="foot{k}"><mu1>{friction!r}</mu1><mu2>{friction!r}</mu2></gazebo>\n'
    )
