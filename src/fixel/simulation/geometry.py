"""Distance between two shapes for Python, with the kernels of the compiled loop."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.kernels.gap import BACK, measure_gaps
from fixel.model.fields import instance, vector
from fixel.model.shape import Disk, Piece, Polygon, Shape, following
from fixel.typing import BoolArray, FloatArray, IntArray

# Sine of the turn below which a corner is straight. With smaller values the edges on both sides of
# the corner tie by rounding; larger values change the outline.
STRAIGHT = 1e-11

# Outlines with more corners than this are simplified for contacts.
MAX_CORNERS: Final = 64
# How far a simplified outline is from the full one, at most [m]; and the same in sizes of the part.
MAX_OFFSET: Final = 10e-6
MAX_RELATIVE_OFFSET: Final = 1e-4
MAX_KEPT: Final = 64  # simplified outlines that are stored
POSE: Final = "x [m], y [m], angle [rad]"


@dataclass(frozen=True, slots=True)
class Gap:
    """Signed distance of two shapes with normal and witness points.

    Attributes
    ----------
    distance : float
        Signed distance of the outlines [m]. Negative in overlap: for convex shapes the least
        translation that separates them, for others the deepest overlap of their convex pieces.
    normal : (2,) float64
        Unit vector from the second shape into the first, world axes [-]: the direction in which the
        first moves away.
    witness_a, witness_b : (2,) float64
        Nearest points of the outlines [m]; ``witness_a - witness_b`` is `distance` times `normal`.
    """

    distance: float
    normal: FloatArray
    witness_a: FloatArray
    witness_b: FloatArray


class PackedShapes(NamedTuple):
    """Concatenated convex pieces of several shapes, as for `measure_gaps`."""

    vertex: FloatArray  # (n_vertex, 2) in the shapes' frames
    edge_real: IntArray  # (n_vertex,) 1 where the edge from this vertex has contacts; see gap.py
    piece_start: IntArray  # (n_piece + 1,)
    piece_radius: FloatArray  # (n_piece,) of disks, else zero
    shape_start: IntArray  # (n_shape + 1,)

    def scaled(self) -> tuple[float, PackedShapes]:
        """Return a size [m], and the shapes in units of it.

        Their sizes are then of order one, as the kernels' tolerances require.
        """
        size = float(max(np.abs(self.vertex).max(), self.piece_radius.max()))
        return size, self._replace(vertex=self.vertex / size, piece_radius=self.piece_radius / size)


def gap(shape_a: Shape, pose_a: ArrayLike, shape_b: Shape, pose_b: ArrayLike) -> Gap:
    """Compute the signed distance between two shapes.

    Parameters
    ----------
    shape_a, shape_b : Polygon or Disk
    pose_a, pose_b : (3,) array_like
        Poses of the shapes' frames in the world [m, m, rad].

    Returns
    -------
    Gap
        Exact to rounding, relative to the size of the shapes and their distance.

    Raises
    ------
    InvalidInput
        An argument is no shape, or a pose is not three finite numbers.

    Examples
    --------
    >>> from fixel.model.shape import Disk
    >>> gap(Disk(0.5), (2.0, 0.0, 0.0), Disk(1.0), (0.0, 0.0, 0.0)).distance
    0.5
    """
    first, second = vector(pose_a, "pose_a", POSE), vector(pose_b, "pose_b", POSE)
    for where, shape in (("shape_a", shape_a), ("shape_b", shape_b)):
        instance(shape, Polygon | Disk, where, "a Polygon or a Disk")
    # Scaled about the second shape.
    size, scaled = pack_shapes((shape_a, shape_b)).scaled()
    origin = second[:2]
    apart = np.array([[*(first[:2] - origin) / size, first[2]]])
    about = np.array([[0.0, 0.0, second[2]]])
    found = measure_gaps(*scaled, np.array([0]), np.array([1]), apart, about)[0]
    distance, normal = size * float(found[0]), found[1:3].copy()
    middle = origin + size * found[3:]
    half = 0.5 * distance * normal
    return Gap(distance, normal, middle + half, middle - half)


def pack_shapes(shapes: Iterable[Shape]) -> PackedShapes:
    """Concatenate the convex pieces of shapes; a disk is one vertex with a radius."""
    shapes = tuple(shapes)
    pieces = [_extended(shape) for shape in shapes]
    all_pieces = [piece for of_shape in pieces for piece in of_shape]
    radii = [shape.radius if isinstance(shape, Disk) else 0.0 for shape in shapes]
    counts = [len(of_shape) for of_shape in pieces]
    return PackedShapes(
        vertex=np.concatenate([corners for corners, _ in all_pieces]),
        edge_real=np.concatenate([real for _, real in all_pieces]).astype(np.int64),
        piece_start=_offsets([len(corners) for corners, _ in all_pieces]),
        piece_radius=np.repeat(radii, counts),
        shape_start=_offsets(counts),
    )


def contact_outline(shape: Shape) -> Shape:
    """Simplify an outline of more than `MAX_CORNERS` corners for contacts.

    Returns a polygon on some of the corners, at every point within `outline_tolerance` of the full
    outline, and vice versa; or the shape itself, where it has few corners or its edges would cross.
    """
    if isinstance(shape, Disk) or len(shape.vertices) <= MAX_CORNERS:
        return shape
    return _simplified(shape) or shape


@functools.lru_cache(MAX_KEPT)
def _simplified(shape: Polygon) -> Polygon | None:
    kept = _sparse(shape.vertices, outline_tolerance(shape))
    if not 3 <= len(kept) < len(shape.vertices):
        return None
    try:
        return Polygon(kept)
    except InvalidInput:  # both sides of a slit may cross
        return None


def outline_tolerance(shape: Polygon) -> float:
    """Largest distance of the outline for contacts from that of the shape [m]."""
    size = float(np.ptp(shape.vertices, axis=0).max())
    return min(MAX_OFFSET, MAX_RELATIVE_OFFSET * size)


def _sparse(vertices: FloatArray, tolerance: float) -> FloatArray:
    """Choose corners of a closed outline such that each new edge is within a distance of all
    corners that it replaces; it then is of the whole chain, whose ends it shares.

    From the corner farthest from the mean, each edge is made as long as possible.
    """
    away = vertices - vertices.mean(axis=0)
    first = int(np.argmax((away**2).sum(axis=1)))
    closed = np.roll(vertices, -first, axis=0)
    closed = np.concatenate((closed, closed[:1]))
    kept, end = [0], 1
    while end < len(closed) - 1:
        edge = closed[end + 1] - closed[kept[-1]]
        chain = closed[kept[-1] + 1 : end + 1] - closed[kept[-1]]
        along = np.clip(chain @ edge / max(float(edge @ edge), np.finfo(float).tiny), 0.0, 1.0)
        if np.hypot(*(chain - along[:, None] * edge).T).max() > tolerance:
            kept.append(end)
        end += 1
    return closed[kept]


def contact_pieces(shape: Shape) -> tuple[Piece, ...]:
    """Return the pieces of a shape for the contact kernels.

    A piece has strictly convex, counter-clockwise vertices (k, 2) [m], and (k,) bool: whether the
    edge from a vertex to the next one has contacts. A disk is its centre alone.

    Where an edge of the outline continues straight as a seam between pieces (in an L, under the
    upright), both become one edge with contacts. Only a point deep in the neighbouring piece meets
    the part that was a seam, while two edges on one line would alternate, by rounding, as the
    nearest.
    """
    if isinstance(shape, Disk):
        return ((np.zeros((1, 2)), np.ones(1, dtype=np.bool_)),)
    return tuple(_without_straight_corners(*piece) for piece in shape.pieces)


def _extended(shape: Shape) -> tuple[tuple[FloatArray, IntArray | BoolArray], ...]:
    """Extend edges of pieces past the reflex corners of an outline, into the neighbouring piece.

    A corner of another body that slides along one edge into a notch then meets the other in its
    middle, not at an end that it passes by rounding.
    """
    pieces = contact_pieces(shape)
    if isinstance(shape, Disk) or len(pieces) == 1:
        return pieces
    outline = shape.vertices
    notches = {tuple(corner) for corner in outline[_turn(outline) < 0.0]}
    inside = shapely.Polygon(outline).buffer(STRAIGHT * float(np.ptp(outline)))
    extended = []
    for given, on_outline in pieces:
        corners, real = given, on_outline.astype(np.int64)
        for k in np.flatnonzero(on_outline != np.roll(on_outline, 1)):
            begins = bool(on_outline[k - 1])  # the seam, where the edge ends
            other = k - 1 if begins else (k + 1) % len(given)
            longer, both = np.array(corners), (corners[other] != given[other]).any()
            step = BACK / (1.0 - (1 + both) * BACK) * (given[k] - given[other])
            longer[k] = given[k] + step
            longer[other] = given[other] - both * step
            fits = tuple(given[k]) in notches and bool((_turn(longer) > 0.0).all())
            if fits and inside.covers(shapely.Polygon(longer)):
                corners = longer
                real[k if begins else k - 1] -= 1 if begins else 2
        extended.append((corners, real))
    return tuple(extended)


def _turn(corners: FloatArray) -> FloatArray:
    """Cross product (n,) of the edges that meet at each corner (n, 2); 0 for straight ones."""
    after = following(corners) - corners
    before = np.concatenate((after[-1:], after[:-1]))
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    straight = STRAIGHT * np.hypot(*before.T) * np.hypot(*after.T)
    return np.asarray(np.where(np.abs(turn) > straight, turn, 0.0))


def _without_straight_corners(corners: FloatArray, on_outline: NDArray[np.bool_]) -> Piece:
    """Remove straight and reflex corners, repeatedly: a corner may be one between the rest."""
    kept = np.flatnonzero(_turn(corners) > 0.0)
    if len(kept) == len(corners) or len(kept) < 3:  # the latter: a sliver without real corners
        return corners, on_outline
    # A new edge consists of all the old ones up to the next remaining corner.
    starts = np.logical_or.reduceat(np.roll(on_outline, -kept[0]), kept - kept[0])
    return _without_straight_corners(corners[kept], starts)


def _offsets(lengths: list[int]) -> IntArray:
    return np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
