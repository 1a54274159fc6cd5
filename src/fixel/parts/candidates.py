"""Pushes of a part that can be made: contacts around its outline, in several directions."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import Body, Disk, LineDrive, Pusher, Scene, placed
from fixel.model.fields import instance, non_negative, positive

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
        and at 20 degrees to either side. Contacts that the tip cannot reach are left out: in a
        narrow notch, or behind a fixel.

    Returns
    -------
    list of Scene

    Raises
    ------
    InvalidInput
        A length is not positive, the scene has several parts or pushers, its pusher is not round,
        or the tip fits nowhere.

    Examples
    --------
    >>> from fixel import Body, Polygon, UniformPressure
    >>> square = Polygon([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)])
    >>> part = Body("square", square, mass=0.8, support=UniformPressure(friction=0.3))
    >>> len(push_candidates(part, contacts=8))
    24
    """
    scene = _scene_of(part)
    for tip in scene.pushers:
        radius, friction = float(getattr(tip.shape, "radius", radius)), tip.friction
    positive(radius, "radius", "m"), positive(travel, "travel", "m")
    positive(speed, "speed", "m/s"), non_negative(friction, "friction")
    if contacts < 1:
        raise InvalidInput("contacts", found=contacts, expected="1 or more")
    body = scene.bodies[0]
    neighbours = [placed(own.shape.outline, own.pose) for own in scene.fixels]
    outline = shapely.Polygon(placed(body.shape.outline, body.pose))
    obstacles = shapely.union_all([outline, *map(shapely.Polygon, neighbours)])
    found = []
    for share in (np.arange(contacts) + 0.5) / contacts:
        point, normal = _contact(outline, float(share))
        at = point + (radius + GAP) * normal
        if shapely.distance(obstacles, shapely.Point(at)) < radius:
            continue
        for angle in np.radians(DIRECTIONS).tolist():
            c, s = math.cos(angle), math.sin(angle)
            drive = LineDrive(
                direction=-np.array([[c, -s], [s, c]]) @ normal, speed=speed, travel=travel
            )
            shape = Disk(radius)
            pusher = Pusher("tip", shape, pose=(*at, 0.0), drive=drive, friction=friction)
            found.append(replace(scene, pushers=(pusher,), duration=travel / speed))
    if not found:
        raise InvalidInput(
            "radius",
            found=f"{1e3 * radius:.3g} mm",
            expected="a tip that fits next to the part",
            hint="use a smaller radius or more contacts",
        )
    return found


def _scene_of(part: Body | Scene) -> Scene:
    """Return a scene with one part and at most one round pusher; reject others."""
    if isinstance(part, Body):
        return Scene(bodies=(part,), duration=1.0)
    instance(part, Scene, "part", "a Body or a Scene")
    if len(part.bodies) != 1 or len(part.pushers) > 1:
        found = f"{len(part.bodies)} bodies and {len(part.pushers)} pushers"
        raise InvalidInput("part", found=found, expected="one part and at most one pusher")
    if not all(isinstance(tip.shape, Disk) for tip in part.pushers):
        raise InvalidInput("part", found="a pusher that is not round", expected="a disk")
    return part


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
