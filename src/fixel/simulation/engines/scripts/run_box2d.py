"""Run `model.json` in Box2D: `python run.py > poses.csv`. Needs the package Box2D 2.3.

Every support point is a friction joint to the ground that yields at its largest friction force.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import Box2D

from fixel.simulation.engines.scripts.drive import Poses, pusher_path, run, segments


def simulate(model: dict[str, Any]) -> Poses:
    """Return the poses of the body at the times of the model."""
    own, choices = model["body"], model["choices"]
    unit, iterations = choices["unit"], choices["iterations"]  # of length to the metre
    world = Box2D.b2World(gravity=(0.0, 0.0), doSleep=False)
    world.continuousPhysics = False
    ground = world.CreateStaticBody()
    body = world.CreateDynamicBody(
        position=scaled(own["start"], unit),
        angle=own["start"][2],
        linearVelocity=scaled(own["velocity"], unit),
        angularVelocity=own["velocity"][2],
    )
    # The engine takes the square root of the product of two coefficients.
    add(body, own["outline"], 1.0, unit)
    inertia = own["inertia"] * choices["inertia_factor"] * unit**2
    body.massData = Box2D.b2MassData(mass=own["mass"], center=(0.0, 0.0), I=inertia)
    for place, load, friction in zip(own["points"], own["loads"], own["friction"], strict=True):
        world.CreateFrictionJoint(
            bodyA=ground,
            bodyB=body,
            localAnchorA=(0.0, 0.0),
            localAnchorB=scaled(place, unit),
            maxForce=load * friction * unit,
            maxTorque=0.0,
            collideConnected=True,
        )
    for fixel in model["fixels"]:
        x, y, theta = fixel["pose"]
        post = world.CreateStaticBody(position=scaled((x, y), unit), angle=theta)
        add(post, fixel["outline"], fixel["friction"] ** 2, unit)
    _, x, y, theta = pusher_path(model)[0]
    head = world.CreateKinematicBody(position=scaled((x, y), unit), angle=theta)
    if model["pusher"]:
        add(head, model["pusher"]["outline"], model["pusher"]["friction"] ** 2, unit)
    found: Poses = []
    for n, step, velocity, wanted in segments(model):
        head.linearVelocity, head.angularVelocity = scaled(velocity, unit), velocity[2]
        for _ in range(n):
            world.Step(step, iterations, iterations)
        if wanted:
            found.append((body.position[0] / unit, body.position[1] / unit, body.angle))
    return found


def add(body: Any, outline: dict[str, Any], friction: float, unit: float) -> None:
    """Add the convex pieces of an outline, or its disc."""
    more = {"density": 1.0, "friction": friction}
    if outline["radius"] > 0.0:
        centre = scaled(outline["pieces"][0][0], unit)
        body.CreateCircleFixture(pos=centre, radius=outline["radius"] * unit, **more)
        return
    for piece in outline["pieces"]:
        body.CreatePolygonFixture(vertices=[scaled(v, unit) for v in piece], **more)


def scaled(xy: Sequence[float], unit: float) -> tuple[float, float]:
    return xy[0] * unit, xy[1] * unit


if __name__ == "__main__":
    run(simulate)
