"""Entry for Python: gaps of many pairs of shapes.

Simulations do not use them; they find contacts with `contacts.find_contacts`.
"""

import math

import numpy as np

from fixel.kernels.arrays import N_PLACE
from fixel.kernels.gap import COINCIDENT, contact_pair
from fixel.kernels.jit import entry, kernel
from fixel.typing import FloatArray, IntArray


@entry
def measure_gaps(
    vertex: FloatArray,
    edge_real: IntArray,
    piece_start: IntArray,
    piece_radius: FloatArray,
    shape_start: IntArray,
    first: IntArray,
    second: IntArray,
    first_pose: FloatArray,
    second_pose: FloatArray,
) -> FloatArray:
    """Compute gap, normal and contact point of many pairs of shapes.

    Parameters
    ----------
    vertex, edge_real, piece_start, piece_radius
        Convex pieces in their shapes' frames, as in `arrays.Model`.
    shape_start : (n_shape + 1,) int64
        Shape i owns the pieces from ``shape_start[i]`` to ``shape_start[i + 1]``.
    first, second : (n,) int64
        Indices of the shapes of each pair.
    first_pose, second_pose : (n, 3) float64
        Poses of the shapes.

    Returns
    -------
    (n, 5) float64
        Gap, normal x, y (from the second shape into the first), and the point x, y half way between
        the witnesses.

    Notes
    -----
    For overlapping shapes that are not convex, this is the deepest contact of their pieces.
    """
    n = first.size
    found = np.empty((n, 5))
    world = np.empty((2 * vertex.shape[0], 2))
    # A shape may be paired with itself, so each side of a pair uses its own half of the scratch.
    half = vertex.shape[0]
    real = np.concatenate((edge_real, edge_real))
    whole = np.ones_like(real)
    place = np.empty((2, N_PLACE))
    key = np.empty(2, np.int64)
    for i in range(n):
        a = first[i]
        b = second[i]
        _place_shape(vertex, piece_start, shape_start, a, first_pose[i], world, 0)
        _place_shape(vertex, piece_start, shape_start, b, second_pose[i], world, half)
        found[i, 0] = math.inf
        _nearest_pieces(
            world, real, piece_start, piece_radius, shape_start, a, b, half, place, key, found[i]
        )
        if (
            found[i, 0] > -COINCIDENT
            and shape_start[a + 1] - shape_start[a] + shape_start[b + 1] - shape_start[b] > 2
        ):
            # No contact on the outline overlaps. One shape may lie within the other, on a seam.
            gap = found[i, 0]
            found[i, 0] = -COINCIDENT
            _nearest_pieces(
                world, whole, piece_start, piece_radius, shape_start, a, b, half, place, key,
                found[i],
            )  # fmt: skip
            if found[i, 0] == -COINCIDENT:
                found[i, 0] = gap
    return found


@kernel
def _place_shape(
    vertex: FloatArray,
    piece_start: IntArray,
    shape_start: IntArray,
    shape: int,
    pose: FloatArray,
    world: FloatArray,
    offset: int,
) -> None:
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    for i in range(piece_start[shape_start[shape]], piece_start[shape_start[shape + 1]]):
        world[offset + i, 0] = pose[0] + c * vertex[i, 0] - s * vertex[i, 1]
        world[offset + i, 1] = pose[1] + s * vertex[i, 0] + c * vertex[i, 1]


@kernel
def _nearest_pieces(
    world: FloatArray,
    real: IntArray,
    piece_start: IntArray,
    piece_radius: FloatArray,
    shape_start: IntArray,
    a: int,
    b: int,
    half: int,
    place: FloatArray,
    key: IntArray,
    found: FloatArray,
) -> None:
    """Write the contact of least gap of two shapes into `found`, if below the gap there."""
    for p in range(shape_start[a], shape_start[a + 1]):
        for q in range(shape_start[b], shape_start[b + 1]):
            n = contact_pair(
                world, real,
                piece_start[p], piece_start[p + 1], piece_radius[p],
                half + piece_start[q], half + piece_start[q + 1], piece_radius[q],
                found[0], place, key, 0,
            )  # fmt: skip
            if n > 0:
                for k in range(5):
                    found[k] = place[0, k]
