"""The grasp as plain numbers, taken from fixel's own scene, and what every peer must offer."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from fixel.model import LineDrive, Polygon, Scene, Tripod
from fixel.model.support import support_points
from fixel.testing.scenes import FIXEL_RADIUS, grasp
from fixel.typing import FloatArray


class Task(NamedTuple):
    """A body on three support points with given loads, a flat head at constant speed, and pegs."""

    vertices: FloatArray  # (n, 2) of the body, counter-clockwise, centre of mass at the origin [m]
    mass: float  # [kg]
    inertia: float  # [kg m^2]
    start: tuple[float, float, float]  # pose of the body [m, m, rad]
    feet: FloatArray  # (3, 2) support points in the body frame [m]
    loads: FloatArray  # (3,) on them [N]
    mu_support: float
    head: FloatArray  # (n, 2) corners of the head, in its frame [m]
    speed: float  # of the head, along x from the origin [m/s]
    mu_head: float
    pegs: FloatArray  # (n, 2) centres [m]
    peg_radius: float  # [m]
    mu_peg: float
    duration: float  # [s]

    def steps(self, step: float) -> int:
        return round(self.duration / step)


def slip_grasp() -> tuple[Scene, Task]:
    """The grasp that a rigid drive can finish: the square slides past the pegs and turns."""
    scene = grasp("slip", force_limit=None)
    return scene, task_of(scene)


def task_of(scene: Scene) -> Task:
    """The numbers of a grasp scene."""
    (body,) = scene.bodies
    (head,) = scene.pushers
    assert isinstance(body.shape, Polygon)
    assert isinstance(head.shape, Polygon)
    assert isinstance(body.support, Tripod)
    assert isinstance(head.drive, LineDrive)
    feet, loads, friction = support_points(
        body.support, body.shape, np.zeros(2), body.mass, scene.gravity
    )
    return Task(
        vertices=body.shape.vertices,
        mass=body.mass,
        inertia=body.moment_of_inertia,
        start=(float(body.pose[0]), float(body.pose[1]), float(body.pose[2])),
        feet=feet,
        loads=loads,
        mu_support=float(friction[0]),
        head=head.shape.vertices,
        speed=head.drive.speed,
        mu_head=head.friction,
        pegs=np.array([fixel.pose[:2] for fixel in scene.fixels]),
        peg_radius=FIXEL_RADIUS,
        mu_peg=scene.fixels[0].friction,
        duration=scene.duration,
    )


class Peer(Protocol):
    """One engine: `build` makes a world ready to run, `run` steps it to the end."""

    name: str
    version: str
    variants: dict[str, dict[str, Any]]  # settings worth trying; the fastest accurate one counts

    def build(self, task: Task, step: float, **settings: Any) -> Any: ...

    def run(self, world: Any) -> tuple[float, float, float]:
        """Final pose of the body [m, m, rad]."""
        ...
