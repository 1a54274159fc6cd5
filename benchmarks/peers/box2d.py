"""Box2D 2.3: impulses by projected Gauss-Seidel, two dimensions, single precision."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

from benchmarks.peers.task import Task

with warnings.catch_warnings():
    # Its wrapper warns while it is loaded, and crashes where warnings are errors.
    warnings.simplefilter("ignore")
    import Box2D

name = "Box2D"
version = Box2D.__version__
variants: dict[str, dict[str, Any]] = {
    "10 iterations": {"iterations": 10, "unit": 100.0},
    "50 iterations, finer unit": {"iterations": 50, "unit": 1000.0},
}


class World(NamedTuple):
    world: Box2D.b2World
    body: Any
    unit: float
    iterations: int
    step: float
    steps: int


def build(task: Task, step: float, iterations: int, unit: float) -> World:
    """Support friction: a friction joint to the ground at each foot that yields at ``mu N``.

    `unit` is the number of length units in a metre: the engine's fixed slop of 0.005 units should
    be small beside the square.
    """

    def point(xy: Any) -> tuple[float, float]:
        return float(xy[0]) * unit, float(xy[1]) * unit

    world = Box2D.b2World(gravity=(0.0, 0.0), doSleep=False)
    world.continuousPhysics = False
    ground = world.CreateStaticBody()
    body = world.CreateDynamicBody(position=point(task.start), angle=task.start[2])
    outline = body.CreatePolygonFixture(
        vertices=[point(v) for v in task.vertices],
        density=1.0,
        friction=1.0,  # the coefficient of a pair is the square root of the product
    )
    assert outline is not None
    body.massData = Box2D.b2MassData(mass=task.mass, center=(0.0, 0.0), I=task.inertia * unit**2)
    for foot, load in zip(task.feet, task.loads, strict=True):
        world.CreateFrictionJoint(
            bodyA=ground,
            bodyB=body,
            localAnchorA=(0.0, 0.0),
            localAnchorB=point(foot),
            maxForce=task.mu_support * float(load) * unit,
            maxTorque=0.0,
            collideConnected=True,
        )
    for peg in task.pegs:
        ground.CreateCircleFixture(
            pos=point(peg), radius=task.peg_radius * unit, friction=task.mu_peg**2
        )
    head = world.CreateKinematicBody(position=(0.0, 0.0))
    head.linearVelocity = (task.speed * unit, 0.0)
    head.CreatePolygonFixture(vertices=[point(v) for v in task.head], friction=task.mu_head**2)
    return World(world, body, unit, iterations, step, task.steps(step))


def run(world: World) -> tuple[float, float, float]:
    advance, step, iterations = world.world.Step, world.step, world.iterations
    for _ in range(world.steps):
        advance(step, iterations, iterations)
    x, y = world.body.position
    return x / world.unit, y / world.unit, world.body.angle
