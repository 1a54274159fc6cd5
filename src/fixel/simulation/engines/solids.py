"""Outlines as solids of three dimensions, and a body as one on feet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fixel.simulation.engines.task import PlainBody, PlainOutline
from fixel.typing import FloatArray

FOOT = 0.002  # [m] radius of a foot
HEAVY = 1e7  # [kg], [kg m^2]: a pusher that nothing slows down
LIGHT = 1e-3  # [kg] of a body whose mass is in its feet; engines want some
SQUARE = 1e-9  # cosine below which a corner is a right angle


class PieceSolid(NamedTuple):
    """Prism or ball, whose middle is in the plane z = 0 of its body."""

    kind: str  # "box", "mesh" or "disc"
    at: tuple[float, float, float]  # x, y, theta in the frame of the body [m, m, rad]
    size: tuple[float, float]  # length and width of a box; radius of a disc, twice [m]
    corners: FloatArray  # (k, 2) of the piece [m], counter-clockwise


class FootedBody(NamedTuple):
    """Body whose weight is on feet, which carry the loads of its support points."""

    points: FloatArray  # (n, 2) places of the feet [m]
    masses: FloatArray  # (n,) [kg]
    friction: FloatArray  # (n,)
    arms: FloatArray  # (n,) largest torque over largest force of an ellipsoid [m]; 0 for points
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
    of 1.
    """
    loaded = np.flatnonzero(own.loads * own.friction > 0.0)
    points, masses = own.points[loaded], own.loads[loaded] / gravity
    return FootedBody(
        points,
        masses,
        own.friction[loaded],
        own.arms[loaded],
        max(own.mass - float(masses.sum()), LIGHT),
        max(own.inertia - float(masses @ (points**2).sum(axis=1)), 1e-9),
    )


def excess_inertia(own: PlainBody, gravity: float) -> list[str]:
    """Return by how much feet with mass make the moment of inertia too large; empty for none."""
    feet = footed(own, gravity)
    inertia = float(feet.masses @ (feet.points**2).sum(axis=1))
    if inertia <= own.inertia:
        return []
    return [
        f"the moment of inertia {own.inertia:.3g} kg m^2: masses on the support points have"
        f" {inertia:.3g} kg m^2"
    ]


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
