"""pymunk, the Python face of Chipmunk: impulses by projected Gauss-Seidel, two dimensions."""

from __future__ import annotations

from typing import Any, NamedTuple

import pymunk

from benchmarks.peers.task import Task

name = "pymunk"
version = pymunk.version
variants: dict[str, dict[str, Any]] = {
    "10 iterations": {"iterations": 10},
    "100 iterations": {"iterations": 100},
}

UNIT = 1000.0  # of length, so many to the metre: the engine's slop and bias are made for such sizes
SLOP = 1e-4  # allowed overlap in those units


class World(NamedTuple):
    space: pymunk.Space
    body: pymunk.Body
    step: float
    steps: int


def build(task: Task, step: float, iterations: int) -> World:
    """Support friction: a pivot to the ground at each foot that yields at ``mu N``."""
    space = pymunk.Space()
    space.gravity = (0.0, 0.0)
    space.iterations = iterations
    space.collision_slop = SLOP
    space.collision_bias = 0.0  # an overlap is gone after one step
    body = pymunk.Body(task.mass, task.inertia * UNIT**2)
    body.position = _point(task.start[:2])
    body.angle = task.start[2]
    outline = pymunk.Poly(body, [_point(v) for v in task.vertices])
    outline.friction = 1.0  # coefficients of a pair are multiplied
    space.add(body, outline)
    for foot, load in zip(task.feet, task.loads, strict=True):
        pivot = pymunk.PivotJoint(space.static_body, body, (0.0, 0.0), _point(foot))
        pivot.max_bias = 0.0  # friction resists velocity and never pulls back
        pivot.max_force = task.mu_support * load * UNIT
        space.add(pivot)
    for peg in task.pegs:
        circle = pymunk.Circle(space.static_body, task.peg_radius * UNIT, _point(peg))
        circle.friction = task.mu_peg
        space.add(circle)
    head = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
    head.velocity = (task.speed * UNIT, 0.0)
    face = pymunk.Poly(head, [_point(v) for v in task.head])
    face.friction = task.mu_head
    space.add(head, face)
    return World(space, body, step, task.steps(step))


def run(world: World) -> tuple[float, float, float]:
    advance, step = world.space.step, world.step
    for _ in range(world.steps):
        advance(step)
    x, y = world.body.position
    return x / UNIT, y / UNIT, world.body.angle


def _point(xy: Any) -> tuple[float, float]:
    return float(xy[0]) * UNIT, float(xy[1]) * UNIT
