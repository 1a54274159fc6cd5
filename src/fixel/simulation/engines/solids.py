"""Outlines as solids of three dimensions, and a body as one on feet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fixel.simulation.engines.task import PlainBody, PlainOutline
from fixel.typing import FloatArray

FOOT = 0.002  # [m] radius of a foot
HEAVY = 1e7  # [kg], [kg m^2]: a pusher that nothing slows down
REST = 1e-3  # share of the mass that is not in feet, and of the inertia that is: engines want some
SQUARE = 1e-9  # cosine below which a corner is a right angle


class PieceSolid(NamedTuple):
    """Prism or ball, whose middle is in the plane z = 0 of its body."""

    kind: str  # "box", "mesh" or "disc"
    at: tuple[float, float, float]  # x, y, theta in the frame of the body [m, m, rad]
    size: tuple[float, float]  # length and width of a box; radius of a disc, twice [m]
    corners: FloatArray  # (k, 2) of the piece [m], counter-clockwise


class FootedBody(NamedTuple):
    """Body whose weight is on feet, which carry the loads of its support points.

    A foot touches the floor at its point and slides vertically. Its mass is at the centre of mass
    of the body, so that mass and moment of inertia in the plane are those of the body.
    """

    points: FloatArray  # (n, 2) places of the feet [m]
    masses: FloatArray  # (n,) [kg]
    friction: FloatArray  # (n,)
    arms: FloatArray  # (n,) largest torque over largest force of an ellipsoid [m]; 0 for points
    foot_inertia: float  # [kg m^2] of one foot
    mass: float  # [kg] of the body without its feet
    inertia: float  # [kg m^2] of the body without its feet


def solids(outline: PlainOutline) -> list[PieceSolid]:
    """Return the solids of an outline."""
    found = []
    for piece in outline.pieces:
        box = _rectangle(piece)
        if outline.radius > 0.0:
            x, y = piece[0].tolist()
            solid = PieceSolid("disc", (x, y, 0.0), (outline.radius, outline.radius), piece)
        elif box is not None:
            solid = PieceSolid("box", box[:3], box[3:], piece)
        else:
            solid = PieceSolid("mesh", (0.0, 0.0, 0.0), (0.0, 0.0), piece)
        found.append(solid)
    return found


def prism_obj(corners: FloatArray, height: float) -> str:
    """Return a prism on convex corners (k, 2), half of it above the plane, as a Wavefront file."""
    k = len(corners)
    levels = [(x, y, z) for z in (-height / 2, height / 2) for x, y in corners.tolist()]
    faces = [list(range(k, 0, -1)), list(range(k + 1, 2 * k + 1))]
    faces += [[j + 1, (j + 1) % k + 1, (j + 1) % k + 1 + k, j + 1 + k] for j in range(k)]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in levels]
    lines += ["f " + " ".join(map(str, face)) for face in faces]
    return "\n".join(lines) + "\n"


def footed(own: PlainBody, gravity: float) -> FootedBody:
    """Return a body on feet, one at each support point with friction.

    An ellipsoid has no load of its own: its foot has the weight of its largest force, at a friction
    of 1. Feet that would weigh more than the body are lighter, and rougher by the same factor.
    """
    loaded = np.flatnonzero(own.loads * own.friction > 0.0)
    masses = own.loads[loaded] / gravity
    share = min(1.0, (1.0 - REST) * own.mass / float(masses.sum())) if len(loaded) else 1.0
    masses *= share
    return FootedBody(
        own.points[loaded],
        masses,
        own.friction[loaded] / share,
        own.arms[loaded],
        REST * own.inertia / max(1, len(loaded)),
        own.mass - float(masses.sum()),
        own.inertia * (1.0 - REST if len(loaded) else 1.0),
    )


def _rectangle(corners: FloatArray) -> tuple[float, float, float, float, float] | None:
    """Return centre x, y, angle, length and width of a rectangle; None for other polygons."""
    if len(corners) != 4:
        return None
    sides = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*sides.T)
    cosine = np.einsum("kj,kj->k", sides, np.roll(sides, -1, axis=0)) / (
        length * np.roll(length, -1)
    )
    if np.abs(cosine).max() > SQUARE:
        return None
    x, y = corners.mean(axis=0).tolist()
    angle = float(np.arctan2(sides[0, 1], sides[0, 0]))
    return x, y, angle, float(length[0]), float(length[1])
