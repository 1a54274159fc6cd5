"""Chipmunk, by its Python package pymunk: impulses by projected Gauss-Seidel, two dimensions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
import pymunk

from fixel.model.engine_parameters import CHIPMUNK, ParameterInfo
from fixel.simulation.engines.contract import AbstractPhysicsEngine
from fixel.simulation.engines.task import PlainOutline, PlainTask, planar_refusal, steps_of
from fixel.typing import FloatArray

UNIT = 1000.0  # of length to the metre: slop and bias of the engine are made for such sizes


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Chipmunk(AbstractPhysicsEngine):
    """Engine pymunk.

    Every support point is a pivot to the ground that yields at its largest friction force.

    Parameters
    ----------
    step : float
        Time step [s].
    iterations : int
        Iterations of the solver in each step.
    slop : float
        Overlap that is allowed [m].
    inertia_factor : float
        Factor of the moment of inertia: a remedy for contacts that the engine solves one after
        another, and no property of the body.
    """

    name: ClassVar[str] = "pymunk"
    parameters: ClassVar[Mapping[str, ParameterInfo]] = CHIPMUNK
    at_bench_size: ClassVar[bool] = True

    step: float = 1e-3
    iterations: int = 10
    slop: float = 1e-7
    inertia_factor: float = 1.0

    @property
    def version(self) -> str:
        return str(pymunk.version)

    def refusal(self, task: PlainTask) -> str:
        return planar_refusal(task)

    def simulate(self, task: PlainTask) -> FloatArray:
        space = pymunk.Space()  # a new one each time: contacts of the last one would be remembered
        space.gravity = (0.0, 0.0)
        space.iterations = self.iterations
        space.collision_slop = self.slop * UNIT
        space.collision_bias = 0.0  # an overlap is gone after one step
        own = task.body
        body = pymunk.Body(own.mass, own.inertia * self.inertia_factor * UNIT**2)
        body.position = _point(own.start[:2])
        body.angle = float(own.start[2])
        body.velocity = _point(own.velocity[:2])
        body.angular_velocity = float(own.velocity[2])
        space.add(body, *_shapes(body, own.outline, 1.0))  # coefficients of a pair are multiplied
        for place, limit in zip(own.points, own.loads * own.friction, strict=True):
            pivot = pymunk.PivotJoint(space.static_body, body, (0.0, 0.0), _point(place))
            pivot.max_bias = 0.0  # friction resists velocity and never pulls back
            pivot.max_force = float(limit) * UNIT
            space.add(pivot)
        for fixel in task.fixels:
            post = pymunk.Body(body_type=pymunk.Body.STATIC)
            post.position = _point(fixel.pose[:2])
            post.angle = float(fixel.pose[2])
            space.add(post, *_shapes(post, fixel.outline, fixel.friction))
        head = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        if task.pusher is not None:
            x, y, theta = task.pusher.path[0, 1:].tolist()
            head.position, head.angle = _point((x, y)), theta
            space.add(head, *_shapes(head, task.pusher.outline, task.pusher.friction))
        found = []
        for segment, n, step in steps_of(task, self.step):
            head.velocity = _point(segment.velocity[:2])
            head.angular_velocity = float(segment.velocity[2])
            for _ in range(n):
                space.step(step)
            if segment.sample:
                found.append((body.position.x / UNIT, body.position.y / UNIT, body.angle))
        return np.array(found)


def _shapes(body: pymunk.Body, outline: PlainOutline, friction: float) -> list[Any]:
    if outline.radius > 0.0:
        shapes = [pymunk.Circle(body, outline.radius * UNIT, _point(outline.pieces[0][0]))]
    else:
        shapes = [pymunk.Poly(body, [_point(v) for v in piece]) for piece in outline.pieces]
    for shape in shapes:
        shape.friction = friction
    return shapes


def _point(xy: Any) -> tuple[float, float]:
    return float(xy[0]) * UNIT, float(xy[1]) * UNIT
