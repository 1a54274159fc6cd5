"""Convex pieces of outlines as solids of three dimensions, for URDF."""

from __future__ import annotations

from typing import NamedTuple

from fixel.simulation.engines.prisms import rectangle
from fixel.simulation.engines.task import PlainOutline
from fixel.typing import FloatArray


class PieceSolid(NamedTuple):
    """Prism or ball, whose middle is in the plane z = 0 of its body."""

    kind: str  # "box", "mesh" or "disc"
    at: tuple[float, float, float]  # x, y, theta in the frame of the body [m, m, rad]
    size: tuple[float, float]  # length and width of a box; radius of a disc, twice [m]
    corners: FloatArray  # (k, 2) of the piece [m]


def solids(outline: PlainOutline) -> list[PieceSolid]:
    """Return the solids of an outline."""
    found = []
    for piece in outline.pieces:
        box = rectangle(piece)
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
