"""Pushes of a part that can be made: contacts around its outline, in several directions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import Body, Disk, LineDrive, Pusher, Scene
from fixel.model.fields import non_negative, positive

GAP: Final = 1e-4  # from the tip to the outline at the start [m]
DIRECTIONS: Final = (-20.0, 0.0, 20.0)  # of the push from the inward normal [deg]


def push_candidates(
    part: Body | Scene,
    *,
    radius: float = 5e-3,
    travel: float = 50e-3,
    speed: float = 20e-3,
    friction: float = 0.25,
    contacts: int = 24,
) -> list[Scene]:
    """Return straight pushes of a part with a round tip, from contacts all around its outline.

    Parameters
    ----------
    part : Body or Scene
        Part at its start pose; a scene with one part and at most one pusher, whose tip is used.
    radius : float
        Radius of the tip [m].
    travel : float
        Length of each push [m].
    speed : float
        Speed of the tip [m/s].
    friction : float
        Friction of the tip on the part [-].
    contacts : int
        Number of contacts, evenly spaced along the outline; each is pushed along the inward normal
        and at 20 degrees to either side.

    Returns
    -------
    list of Scene

    Raises
    ------
    InvalidInput
        A length is not positive, or the scene has several parts.

    Examples
    --------
    >>> from fixel import Body, Polygon, UniformPressure
    >>> square = Polygon([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)])
    >>> part = Body("square", square, mass=0.8, support=UniformPressure(friction=0.3))
    >>> len(push_candidates(part, contacts=8))
    24
    """
    if isinstance(part, Scene):
        scene = part
        if len(scene.bodies) != 1:
            raise InvalidInput("part", found=f"{len(scene.bodies)} bodies", expected="one part")
        body = scene.bodies[0]
        tip = scene.pushers[0] if scene.pushers else None
        if tip is not None and isinstance(tip.shape, Disk):
            radius, friction = tip.shape.radius, tip.friction
    else:
        body = part
        scene = Scene(bodies=(body,), duration=1.0)
    positive(radius, "radius", "m"), positive(travel, "travel", "m")
    positive(speed, "speed", "m/s"), non_negative(friction, "friction")
    if contacts < 1:
        raise InvalidInput("contacts", found=contacts, expected="1 or more")
    outline = shapely.Polygon(body.shape.outline)
    c, s = math.cos(body.pose[2]), math.sin(body.pose[2])
    turn = np.array([[c, -s], [s, c]])
    found = []
    for share in (np.arange(contacts) + 0.5) / contacts:
        point, normal = _contact(outline, float(share))
        at = body.pose[:2] + turn @ (point + (radius + GAP) * normal)
        for angle in DIRECTIONS:
            a = math.radians(angle)
            inward = -turn @ normal
            way = (
                math.cos(a) * inward[0] - math.sin(a) * inward[1],
                math.sin(a) * inward[0] + math.cos(a) * inward[1],
            )
            pusher = Pusher(
                name="tip",
                shape=Disk(radius),
                pose=(*at, 0.0),
                drive=LineDrive(direction=way, speed=speed, travel=travel),
                friction=friction,
            )
            found.append(replace(scene, pushers=(pusher,), duration=travel / speed))
    return found


def _contact(outline: shapely.Polygon, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a point at a share of the way around an outline, and its outward normal."""
    ring = outline.exterior
    step = 1e-4
    at, after = (
        shapely.get_coordinates(ring.interpolate((share + d) % 1.0, normalized=True))[0]
        for d in (0.0, step)
    )
    along = (after - at) / np.hypot(*(after - at))
    outward = np.array([along[1], -along[0]]) * (1.0 if ring.is_ccw else -1.0)
    return at, outward
