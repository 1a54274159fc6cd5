"""Decomposition of a simple polygon into convex pieces.

Constrained Delaunay triangles are merged as long as the union is convex.

Source
------
S. Hertel, K. Mehlhorn (1983), Fast triangulation of simple polygons: at most four times as many
pieces as the optimal decomposition.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from fixel.typing import BoolArray, FloatArray

Item = TypeVar("Item", bound=np.generic)
Piece = tuple[FloatArray, BoolArray]

# Share of the squared size below which a turn counts as straight. Smaller values cut polygons with
# almost collinear vertices into more pieces, larger ones let pieces be slightly non-convex.
STRAIGHT = 1e-12


def convex_pieces(vertices: FloatArray) -> tuple[Piece, ...]:
    """Decompose a simple polygon, a counter-clockwise outline (n, 2) [m], into convex pieces.

    Each has its vertices (k, 2), counter-clockwise, and a flag (k,) for each edge from vertex k to
    k + 1: whether it lies on the outline.
    """
    if is_convex(vertices):
        return (_piece(vertices, list(range(len(vertices)))),)
    size = float(np.ptp(vertices, axis=0).max())
    triangles = _triangles(vertices, size)
    attempts = [
        _merged(vertices, list(triangles), order, size) for order in _orders(vertices, triangles)
    ]
    return tuple(_piece(vertices, loop) for loop in min(attempts, key=len))


def following(rows: NDArray[Item]) -> NDArray[Item]:
    """Return the row after each, the first after the last, faster than `numpy.roll`."""
    return np.concatenate((rows[1:], rows[:1]))


def is_convex(vertices: FloatArray, size: float | None = None) -> bool:
    """Whether a counter-clockwise simple polygon turns left, or goes straight, at every vertex.

    `size` [m] scales the tolerance for straight; by default the larger side of the bounding box.
    """
    size = size or float(np.ptp(vertices, axis=0).max())
    after = following(vertices) - vertices
    before = np.concatenate((after[-1:], after[:-1]))
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return bool((turn >= -STRAIGHT * size**2).all())


def _piece(vertices: FloatArray, loop: list[int]) -> Piece:
    corners = np.array(vertices[loop])
    order = np.array(loop)
    on_outline = following(order) == (order + 1) % len(vertices)
    corners.flags.writeable = False
    on_outline.flags.writeable = False
    return corners, on_outline


def _triangles(vertices: FloatArray, size: float) -> list[list[int]]:
    """Vertex indices of constrained Delaunay triangles, each counter-clockwise."""
    scaled = (vertices - vertices.mean(axis=0)) / size
    number_of = {tuple(point): index for index, point in enumerate(scaled.tolist())}
    cells = shapely.constrained_delaunay_triangles(shapely.Polygon(scaled)).geoms
    triangles = []
    for cell in cells:
        a, b, c = (number_of[x, y] for x, y in cell.exterior.coords[:3])
        triangles.append([a, b, c] if _turn(scaled, a, b, c) > 0.0 else [a, c, b])
    return triangles


def _orders(vertices: FloatArray, triangles: list[list[int]]) -> Iterator[list[tuple[int, int]]]:
    """Yield the diagonals of a triangulation in a few orders; the best depends on the polygon."""
    edges = {edge for triangle in triangles for edge in _edges(triangle)}
    diagonals = sorted((i, j) for i, j in edges if i < j and (j, i) in edges)
    length = {(i, j): float(np.hypot(*(vertices[i] - vertices[j]))) for i, j in diagonals}
    for tied in (diagonals, diagonals[::-1]):
        yield tied
        yield sorted(tied, key=lambda edge: -length[edge])
        yield sorted(tied, key=lambda edge: length[edge])


def _merged(
    vertices: FloatArray, loops: list[list[int]], diagonals: list[tuple[int, int]], size: float
) -> list[list[int]]:
    """Merge loops by removing each diagonal between them if the union is convex."""
    owner = {edge: index for index, loop in enumerate(loops) for edge in _edges(loop)}
    for start, end in diagonals:
        left, right = owner[start, end], owner[end, start]
        union = _union(loops[left], loops[right], start, end)
        if is_convex(vertices[union], size):
            for edge in _edges(loops[right]):
                owner[edge] = left
            loops[left], loops[right] = union, []
    return [loop for loop in loops if loop]


def _union(left: list[int], right: list[int], start: int, end: int) -> list[int]:
    """Return the union of two loops that share an edge, `start` to `end` in the left one."""
    at = left.index(end)
    around_left = left[at:] + left[:at]  # from end to start
    at = right.index(start)
    around_right = right[at:] + right[:at]  # from start to end
    return around_left + around_right[1:-1]


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _turn(vertices: FloatArray, a: int, b: int, c: int) -> float:
    (x0, y0), (x1, y1), (x2, y2) = vertices[[a, b, c]].tolist()
    return float((x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1))
