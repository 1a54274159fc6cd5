"""Depth of overlap of two placed shapes, to check scenes; simulations do not use it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fixel.model.shape import Disk, Shape, placed
from fixel.typing import FloatArray


def overlap_depth(a: Shape, pose_a: FloatArray, b: Shape, pose_b: FloatArray) -> float:
    """Compute the depth of overlap of two shapes, zero or negative where they are apart.

    Exact for overlapping convex shapes; for others the largest over pairs of their convex pieces.

    Parameters
    ----------
    a, b : Shape
        Shapes in their own frames.
    pose_a, pose_b : (3,) float64
        Poses of these frames in the world [m, m, rad].

    Returns
    -------
    float
        Depth of the overlap [m].
    """
    if isinstance(a, Disk) and isinstance(b, Disk):
        return a.radius + b.radius - float(np.hypot(*(pose_a[:2] - pose_b[:2])))
    if isinstance(a, Disk):
        pieces = _placed_pieces(b, pose_b)
        return max(_disk_in_piece(a.radius, pose_a[:2], piece) for piece in pieces)
    if isinstance(b, Disk):
        return overlap_depth(b, pose_b, a, pose_a)
    return max(
        _piece_in_piece(first, second)
        for first in _placed_pieces(a, pose_a)
        for second in _placed_pieces(b, pose_b)
    )


def boxes(shapes: Sequence[Shape], poses: Sequence[FloatArray]) -> FloatArray:
    """Compute bounding boxes (n, 4) in the world: least x and y, largest x and y [m]."""
    return np.array([_box(shape, pose) for shape, pose in zip(shapes, poses, strict=True)])


def pairs_of_boxes(box: FloatArray, n_first: int) -> Iterator[tuple[int, int]]:
    """Yield pairs i < j of boxes that meet, with i among the first `n_first`."""
    for i in range(n_first):
        others = box[i + 1 :]
        meets = np.hstack((others[:, :2] <= box[i, 2:], others[:, 2:] >= box[i, :2])).all(axis=1)
        yield from ((i, i + 1 + int(j)) for j in np.flatnonzero(meets))


def _placed_pieces(shape: Shape, pose: FloatArray) -> list[FloatArray]:
    return [placed(vertices, pose) for vertices, _ in shape.pieces]


def _box(shape: Shape, pose: FloatArray) -> FloatArray:
    if isinstance(shape, Disk):
        return np.concatenate((pose[:2] - shape.radius, pose[:2] + shape.radius))
    corners = placed(shape.outline, pose)
    return np.concatenate((corners.min(axis=0), corners.max(axis=0)))


def _piece_in_piece(a: FloatArray, b: FloatArray) -> float:
    """Least overlap along the edge normals of two convex polygons."""
    return min(_depth_along_normals(a, b), _depth_along_normals(b, a))


def _depth_along_normals(a: FloatArray, b: FloatArray) -> float:
    normal = _outward_normals(a)
    offset = (normal * a).sum(axis=1)
    return float((offset - (normal @ b.T).min(axis=1)).min())


def _disk_in_piece(radius: float, centre: FloatArray, piece: FloatArray) -> float:
    """Radius minus the signed distance of the centre to a convex polygon."""
    edge = np.roll(piece, -1, axis=0) - piece
    outside = (_outward_normals(piece) * (centre - piece)).sum(axis=1)
    if (outside <= 0.0).all():
        return radius - float(outside.max())
    along = ((centre - piece) * edge).sum(axis=1) / (edge**2).sum(axis=1)
    nearest = piece + np.clip(along, 0.0, 1.0)[:, None] * edge
    return radius - float(np.hypot(*(centre - nearest).T).min())


def _outward_normals(piece: FloatArray) -> FloatArray:
    edge = np.roll(piece, -1, axis=0) - piece
    right = np.column_stack((edge[:, 1], -edge[:, 0]))
    return np.asarray(right / np.linalg.norm(edge, axis=1, keepdims=True))
