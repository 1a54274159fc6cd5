"""Removal of overlaps between a body and its neighbours that are due to start errors.

A body that rests against a pusher overlaps it for half of all start errors. This is impossible in
reality, so the body is moved out along the shortest way, without rotation.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.model import Shape
from fixel.model.overlap import Overlap, overlaps, turned
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray

ROUNDS: Final = 8  # moves out of one neighbour, perhaps into another
ROUNDING: Final = 1e-9  # overlap that still counts as touching, over the size of a body


class Neighbour(NamedTuple):
    """Fixel or pusher that a body may overlap."""

    name: str
    shape: Shape
    pose: FloatArray  # (3,)
    moved: FloatArray | None = None  # (n, 3) world motions that take it to its poses


def remove_overlap(
    shape: Shape, poses: FloatArray, neighbours: list[Neighbour], most: float
) -> tuple[FloatArray, list[str]]:
    """Move poses out of their neighbours.

    Parameters
    ----------
    shape : Shape
        Shape of the body.
    poses : (n, 3) float64
        Poses of the body [m, m, rad].
    neighbours : list of Neighbour
    most : float
        Largest distance by which a body may be moved [m].

    Returns
    -------
    (n, 3) float64
        Poses, moved where they overlapped.
    list of str
        Reason why a pose is impossible; empty otherwise.
    """
    moved = np.array(poses)
    reasons = [""] * len(poses)
    size = float(np.ptp(shape.outline, axis=0).max())
    inside = np.full(len(poses), -1)
    for _ in range(ROUNDS):
        deepest = np.full(len(poses), ROUNDING * size)
        inside[:] = -1
        way = np.zeros((len(poses), 2))
        for k, other in enumerate(neighbours):
            found = _overlaps(shape, moved, other)
            worse = found.depth > deepest
            deepest[worse], way[worse], inside[worse] = found.depth[worse], found.way[worse], k
        hit = inside >= 0
        if not hit.any():
            break
        moved[hit, :2] += deepest[hit, None] * way[hit]
    far = np.hypot(*(moved - poses)[:, :2].T) > most
    for k in np.flatnonzero(far | (inside >= 0)).tolist():
        name = neighbours[inside[k]].name if inside[k] >= 0 else "a neighbour"
        reasons[k] = f"starts inside {name}, and no free space is next to it"
    return moved, reasons


def _overlaps(shape: Shape, poses: FloatArray, other: Neighbour) -> Overlap:
    if other.moved is None:
        return overlaps(shape, poses, other.shape, other.pose)
    seen = composed(inverted(other.moved), poses)
    found = overlaps(shape, seen, other.shape, other.pose)
    c, s = np.cos(other.moved[:, 2]), np.sin(other.moved[:, 2])
    return Overlap(found.depth, turned(found.way, c, s))
