"""Box2D 2.3: impulses by projected Gauss-Seidel, two dimensions, single precision."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, final

import numpy as np

from fixel.model.engine_parameters import BOX2D, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine
from fixel.simulation.engines.task import PlainOutline, PlainTask, planar_refusal, steps_of
from fixel.typing import FloatArray

with warnings.catch_warnings():
    # Its wrapper warns while it is loaded, and crashes where warnings are errors.
    warnings.simplefilter("ignore")
    library = import_module("Box2D")

MAX_CORNERS = 16  # of one polygon


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Box2D(AbstractPhysicsEngine):
    """Engine Box2D.

    Every support point is a friction joint to the ground that yields at its largest friction force.

    Parameters
    ----------
    step : float
        Time step [s].
    iterations : int
        Iterations of the solver in each step, for velocities and for positions.
    unit : float
        Number of length units in a metre: the engine's fixed slop of 0.005 units should be small
        against the body.
    inertia_factor : float
        Factor of the moment of inertia: a remedy for contacts that the engine solves one after
        another, and no property of the body.
    """

    name: ClassVar[str] = "box2d"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = BOX2D
    at_bench_size: ClassVar[bool] = True

    step: float = 2e-3
    iterations: int = 10
    unit: float = 100.0
    inertia_factor: float = 1.0

    @property
    def version(self) -> str:
        return str(library.__version__)

    def refusal(self, task: PlainTask) -> str:
        obstacles = [] if task.pusher is None else [task.pusher.outline]
        outlines = [task.body.outline, *obstacles, *(fixel.outline for fixel in task.fixels)]
        most = max(len(piece) for outline in outlines for piece in outline.pieces)
        if most > MAX_CORNERS:
            return f"a convex piece with {most} corners; it takes at most {MAX_CORNERS}"
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        unit, own = self.unit, task.body
        world = library.b2World(gravity=(0.0, 0.0), doSleep=False)
        world.continuousPhysics = False
        ground = world.CreateStaticBody()
        body = world.CreateDynamicBody(
            position=self._point(own.start[:2]),
            angle=float(own.start[2]),
            linearVelocity=self._point(own.velocity[:2]),
            angularVelocity=float(own.velocity[2]),
        )
        # The coefficient of a pair is the square root of the product.
        self._add(body, own.outline, 1.0)
        body.massData = library.b2MassData(
            mass=own.mass, center=(0.0, 0.0), I=own.inertia * self.inertia_factor * unit**2
        )
        for place, limit in zip(own.points, own.loads * own.friction, strict=True):
            world.CreateFrictionJoint(
                bodyA=ground,
                bodyB=body,
                localAnchorA=(0.0, 0.0),
                localAnchorB=self._point(place),
                maxForce=float(limit) * unit,
                maxTorque=0.0,
                collideConnected=True,
            )
        for fixel in task.fixels:
            post = world.CreateStaticBody(
                position=self._point(fixel.pose[:2]), angle=float(fixel.pose[2])
            )
            self._add(post, fixel.outline, fixel.friction**2)
        path = np.zeros((1, 4)) if task.pusher is None else task.pusher.path
        head = world.CreateKinematicBody(
            position=self._point(path[0, 1:3]), angle=float(path[0, 3])
        )
        if task.pusher is not None:
            self._add(head, task.pusher.outline, task.pusher.friction**2)
        found = []
        for segment, n, step in steps_of(task, self.step):
            head.linearVelocity = self._point(segment.velocity[:2])
            head.angularVelocity = float(segment.velocity[2])
            for _ in range(n):
                world.Step(step, self.iterations, self.iterations)
            if segment.sample:
                x, y = body.position
                found.append((x / unit, y / unit, body.angle))
        return np.array(found)

    def _add(self, body: Any, outline: PlainOutline, friction: float) -> None:
        if outline.radius > 0.0:
            centre = self._point(outline.pieces[0][0])
            body.CreateCircleFixture(
                pos=centre, radius=outline.radius * self.unit, density=1.0, friction=friction
            )
            return
        for piece in outline.pieces:
            body.CreatePolygonFixture(
                vertices=[self._point(v) for v in piece], density=1.0, friction=friction
            )

    def _point(self, xy: Any) -> tuple[float, float]:
        return float(xy[0]) * self.unit, float(xy[1]) * self.unit
