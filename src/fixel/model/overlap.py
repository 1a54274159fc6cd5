"""Overlaps and gaps of placed shapes, for checks and features; simulations do not use them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely

from fixel.model.shape import Disk, Shape, placed, rotated
from fixel.typing import FloatArray


class Overlap(NamedTuple):
    """Depth of the overlap of n placed bodies with another; negative for a gap."""

    depth: FloatArray  # (n,) [m]
    way: FloatArray  # (n, 2) direction of the shortest way out, in the world


def overlap_depth(a: Shape, pose_a: FloatArray, b: Shape, pose_b: FloatArray) -> float:
    """Compute the depth of overlap of two shapes at poses (3,) [m], zero or less if they are apart.

    Exact for overlapping convex shapes; for others the largest over pairs of their convex pieces.
    """
    return float(overlaps(a, pose_a[None], b, pose_b).depth[0])


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
        centre = rotated(pose[:2] - poses[:, :2], -poses[:, 2])
        found = _deepest([_disk(b.radius, centre, vertices) for vertices, _ in a.pieces])
        return Overlap(found.depth, -rotated(found.way, poses[:, 2]))
    return _deepest(
        [
            _polygons(poses[:, None, :2] + rotated(mine, poses[:, None, 2]), placed(other, pose))
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
    edge, normal = _edges(piece), _normals(piece)
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
    own = np.einsum("nki,nki->nk", (own_normals := _normals(mine)), mine)
    from_other = (normal * other).sum(axis=1) - (mine @ normal.T).min(axis=1)  # (n, m)
    from_mine = own - np.einsum("nki,mi->nkm", own_normals, other).min(axis=2)  # (n, k)
    depth = np.concatenate((from_other, from_mine), axis=1)
    ways = np.concatenate(
        (np.broadcast_to(normal, (len(mine), *normal.shape)), -own_normals), axis=1
    )
    least = depth.argmin(axis=1)
    rows = np.arange(len(mine))
    return Overlap(depth[rows, least], ways[rows, least])


def _normals(piece: FloatArray) -> FloatArray:
    """Return the outward normals of the edges of counter-clockwise polygons (..., k, 2)."""
    edge = _edges(piece)
    right = np.stack((edge[..., 1], -edge[..., 0]), axis=-1)
    return np.asarray(right / np.linalg.norm(edge, axis=-1, keepdims=True))


def _edges(piece: FloatArray) -> FloatArray:
    """Return the edges of polygons (..., k, 2), from each corner to the next."""
    return np.concatenate((piece[..., 1:, :], piece[..., :1, :]), axis=-2) - piece


def _unit(vector: FloatArray) -> FloatArray:
    length = np.hypot(vector[..., 0], vector[..., 1])[..., None]
    along_x = np.broadcast_to(np.array([1.0, 0.0]), vector.shape)
    return np.where(length > 0.0, vector / np.where(length > 0.0, length, 1.0), along_x)


def boxes(shapes: Sequence[Shape], poses: Sequence[FloatArray]) -> FloatArray:
    """Compute bounding boxes (n, 4) in the world: least x and y, largest x and y [m]."""
    return np.array([_box(shape, pose) for shape, pose in zip(shapes, poses, strict=True)])


def pairs_of_boxes(box: FloatArray, n_first: int) -> Iterator[tuple[int, int]]:
    """Yield pairs i < j of boxes that meet, with i among the first `n_first`."""
    for i in range(n_first):
        others = box[i + 1 :]
        meets = np.hstack((others[:, :2] <= box[i, 2:], others[:, 2:] >= box[i, :2])).all(axis=1)
        yield from ((i, i + 1 + int(j)) for j in np.flatnonzero(meets))


def _box(shape: Shape, pose: FloatArray) -> FloatArray:
    if isinstance(shape, Disk):
        return np.concatenate((pose[:2] - shape.radius, pose[:2] + shape.radius))
    corners = placed(shape.outline, pose)
    return np.concatenate((corners.min(axis=0), corners.max(axis=0)))


def gaps_and_normals(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the gaps (n,) between round tips and an outline, and the outward normals (n, 2).

    Poses (n, 3) of the object [m, m, rad] and centres (n, 2) of the tip [m] are in the world, and
    so are normals. Gaps [m] are negative for overlap. Exact for convex outlines.
    """
    local = rotated(tip - pose[:, :2], -pose[:, 2])
    if isinstance(shape, Disk):
        distance, away = np.hypot(*local.T) - shape.radius, local
    else:
        distance, away = _from_polygon(shape.outline, local)
    length = np.hypot(*away.T)[:, None]
    normal = np.divide(away, length, out=np.zeros_like(away), where=length > 0.0)
    return distance - radius, rotated(normal, pose[:, 2])


def _from_polygon(outline: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return signed distances (n,), and vectors (n, 2) that point outward."""
    polygon = shapely.Polygon(outline)
    points = shapely.points(point)
    along = shapely.line_locate_point(polygon.exterior, points)
    nearest = shapely.get_coordinates(shapely.line_interpolate_point(polygon.exterior, along))
    sign = np.where(shapely.contains(polygon, points), -1.0, 1.0)
    away = sign[:, None] * (point - nearest)
    return sign * np.hypot(*away.T), away
