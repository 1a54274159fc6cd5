"""Run `model.json` in pymunk: `python run.py > poses.csv`. Needs pymunk 7 or newer.

Every support point is a pivot to the ground that yields at its largest friction force. Lengths are
millimetres inside, for which the defaults of the engine are made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pymunk

from fixel.simulation.engines.scripts.drive import Poses, pusher_path, run, segments

UNIT = 1000.0  # of length to the metre: slop and bias of the engine are made for such sizes


def simulate(model: dict[str, Any]) -> Poses:
    """Return the poses of the body at the times of the model."""
    own, choices = model["body"], model["choices"]
    space = pymunk.Space()  # a new one each time: contacts of the last one would be remembered
    space.gravity = (0.0, 0.0)
    space.iterations = choices["iterations"]
    space.collision_slop = choices["slop"] * UNIT
    space.collision_bias = 0.0  # an overlap is gone after one step
    body = pymunk.Body(own["mass"], own["inertia"] * choices["inertia_factor"] * UNIT**2)
    body.position, body.angle = scaled(own["start"]), own["start"][2]
    body.velocity, body.angular_velocity = scaled(own["velocity"]), own["velocity"][2]
    # The engine multiplies coefficients: 1 for the body leaves that of its partner.
    space.add(body, *shapes(body, own["outline"], 1.0))
    for place, load, friction in zip(own["points"], own["loads"], own["friction"], strict=True):
        pivot = pymunk.PivotJoint(space.static_body, body, (0.0, 0.0), scaled(place))
        pivot.max_bias = 0.0  # friction resists velocity and never pulls back
        pivot.max_force = load * friction * UNIT
        space.add(pivot)
    for fixel in model["fixels"]:
        post = pymunk.Body(body_type=pymunk.Body.STATIC)
        post.position, post.angle = scaled(fixel["pose"]), fixel["pose"][2]
        space.add(post, *shapes(post, fixel["outline"], fixel["friction"]))
    head = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
    if model["pusher"]:
        _, x, y, theta = pusher_path(model)[0]
        head.position, head.angle = scaled((x, y)), theta
        space.add(head, *shapes(head, model["pusher"]["outline"], model["pusher"]["friction"]))
    found: Poses = []
    for n, step, velocity, wanted in segments(model):
        head.velocity, head.angular_velocity = scaled(velocity), velocity[2]
        for _ in range(n):
            space.step(step)
        if wanted:
            found.append((body.position.x / UNIT, body.position.y / UNIT, body.angle))
    return found


def shapes(body: Any, outline: dict[str, Any], friction: float) -> list[Any]:
    """Return the convex pieces of an outline, or its disc."""
    pieces: list[Any] = [pymunk.Poly(body, [scaled(v) for v in own]) for own in outline["pieces"]]
    if outline["radius"] > 0.0:
        centre = scaled(outline["pieces"][0][0])
        pieces = [pymunk.Circle(body, outline["radius"] * UNIT, centre)]
    for piece in pieces:
        piece.friction = friction
    return pieces


def scaled(xy: Sequence[float]) -> tuple[float, float]:
    return xy[0] * UNIT, xy[1] * UNIT


if __name__ == "__main__":
    run(simulate)
