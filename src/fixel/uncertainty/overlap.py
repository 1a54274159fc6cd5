"""Removal of overlaps between a body and its neighbours that are due to start errors.

A body that rests against a pusher overlaps it for half of all start errors. This is impossible in
reality, so the body is moved out along the shortest way, without rotation.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.model import Disk, Shape, placed
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray

ROUNDS: Final = 8  # moves out of one neighbour, perhaps into another
ROUNDING: Final = 1e-9  # overlap that still counts as touching, over the size of a body


class Overlap(NamedTuple):
    """Depth of the overlap of n placed bodies with another; negative for a gap."""

    depth: FloatArray  # (n,) [m]
    way: FloatArray  # (n, 2) direction of the shortest way out, in the world


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
        reasons[k] = f"starts inside {name}, and has no room beside it"
    return moved, reasons


def _overlaps(shape: Shape, poses: FloatArray, other: Neighbour) -> Overlap:
    if other.moved is None:
        return overlaps(shape, poses, other.shape, other.pose)
    seen = composed(inverted(other.moved), poses)
    found = overlaps(shape, seen, other.shape, other.pose)
    c, s = np.cos(other.moved[:, 2]), np.sin(other.moved[:, 2])
    return Overlap(found.depth, _turned(found.way, c, s))


def overlaps(a: Shape, poses: FloatArray, b: Shape, pose: FloatArray) -> Overlap:
    """Return the overlap of a shape at poses (n, 3) with another at one pose (3,).

    Exact for convex shapes that overlap; for other shapes, that of their deepest convex pieces.
    """
    if isinstance(a, Disk) and isinstance(b, Disk):
        apart = poses[:, :2] - pose[:2]
        distance = np.hypot(*apart.T)
        return Overlap(a.radius + b.radius - distance, _unit(apart))
    if isinstance(a, Disk):
        pieces = [placed(vertices, pose) for vertices, _ in b.pieces]
        return _deepest([_disk(a.radius, poses[:, :2], piece) for piece in pieces])
    if isinstance(b, Disk):
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = (pose[:2] - poses[:, :2]).T
        centre = np.column_stack((c * x + s * y, c * y - s * x))
        found = _deepest([_disk(b.radius, centre, vertices) for vertices, _ in a.pieces])
        return Overlap(found.depth, -_turned(found.way, c, s))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return _deepest(
        [
            _polygons(poses[:, None, :2] + _turned(mine[None], c, s), placed(other, pose))
            for mine, _ in a.pieces
            for other, _ in b.pieces
        ]
    )


def _deepest(found: list[Overlap]) -> Overlap:
    depth = np.array([one.depth for one in found])
    which = depth.argmax(axis=0)
    rows = np.arange(depth.shape[1])
    return Overlap(depth[which, rows], np.array([one.way for one in found])[which, rows])


def _disk(radius: float, centre: FloatArray, piece: FloatArray) -> Overlap:
    """Return the overlap of disks with centres (n, 2) and one convex polygon (k, 2)."""
    edge = np.roll(piece, -1, axis=0) - piece
    normal = _normals(piece)
    from_corner = centre[:, None] - piece
    outside = np.einsum("nki,ki->nk", from_corner, normal)
    nearest_edge = outside.argmax(axis=1)
    rows = np.arange(len(centre))
    along = np.einsum("nki,ki->nk", from_corner, edge) / (edge**2).sum(axis=1)
    apart = from_corner - np.clip(along, 0.0, 1.0)[:, :, None] * edge
    distance = np.hypot(apart[..., 0], apart[..., 1])
    nearest = distance.argmin(axis=1)
    within = outside[rows, nearest_edge] <= 0.0
    depth = radius - np.where(within, outside[rows, nearest_edge], distance[rows, nearest])
    way = np.where(within[:, None], normal[nearest_edge], _unit(apart[rows, nearest]))
    return Overlap(depth, way)


def _polygons(mine: FloatArray, other: FloatArray) -> Overlap:
    """Return the overlap of convex polygons (n, k, 2) with another (m, 2), by edge normals."""
    normal = _normals(other)
    own = np.einsum("nki,nki->nk", (turned := _normals(mine)), mine)
    from_other = (normal * other).sum(axis=1) - (mine @ normal.T).min(axis=1)  # (n, m)
    from_mine = own - np.einsum("nki,mi->nkm", turned, other).min(axis=2)  # (n, k)
    depth = np.concatenate((from_other, from_mine), axis=1)
    ways = np.concatenate((np.broadcast_to(normal, (len(mine), *normal.shape)), -turned), axis=1)
    least = depth.argmin(axis=1)
    rows = np.arange(len(mine))
    return Overlap(depth[rows, least], ways[rows, least])


def _normals(piece: FloatArray) -> FloatArray:
    """Return the outward normals of the edges of counter-clockwise polygons (..., k, 2)."""
    edge = np.roll(piece, -1, axis=-2) - piece
    right = np.stack((edge[..., 1], -edge[..., 0]), axis=-1)
    return np.asarray(right / np.linalg.norm(edge, axis=-1, keepdims=True))


def _turned(vector: FloatArray, c: FloatArray, s: FloatArray) -> FloatArray:
    """Return vectors (n, ..., 2) rotated by n angles."""
    shape = (len(c), *([1] * (vector.ndim - 2)))
    c, s = c.reshape(shape), s.reshape(shape)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack((c * x - s * y, s * x + c * y), axis=-1)


def _unit(vector: FloatArray) -> FloatArray:
    length = np.hypot(vector[..., 0], vector[..., 1])[..., None]
    along_x = np.broadcast_to(np.array([1.0, 0.0]), vector.shape)
    return np.where(length > 0.0, vector / np.where(length > 0.0, length, 1.0), along_x)
