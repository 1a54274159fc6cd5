"""Quadrature points of a footprint."""

from __future__ import annotations

from math import pi

import numpy as np

from fixel.model.shape import Disk, Polygon, Shape
from fixel.typing import FloatArray


def cells(shape: Shape, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Compute centroids of small cells that tile a shape, and their shares of the area.

    The weighted mean of the points is the centroid of the shape, to rounding.

    Parameters
    ----------
    shape : Shape
        Footprint.
    n_points : int
        Approximate number of cells.

    Returns
    -------
    points : (n, 2) float64
        Centroids in the frame of the shape [m].
    share : (n,) float64
        Shares, positive with sum 1 [-].
    """
    if isinstance(shape, Disk):
        return _disk_cells(shape, n_points)
    return _polygon_cells(shape, n_points)


def _disk_cells(disk: Disk, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Place rings at the Gauss-Legendre nodes of r^2, each turned by half a point."""
    n_rings = max(1, round((n_points / 2.0) ** 0.5))
    per_ring = max(3, round(n_points / n_rings))
    node, weight = np.polynomial.legendre.leggauss(n_rings)
    radius = disk.radius * np.sqrt(0.5 * (node + 1.0))
    angle = (np.arange(per_ring) + 0.5 * np.arange(n_rings)[:, None]) * (2.0 * pi / per_ring)
    points = radius[:, None, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return points.reshape(-1, 2), np.repeat(0.5 * weight / per_ring, per_ring)


def _polygon_cells(polygon: Polygon, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Cut convex pieces into fans about their centroids, and these triangles into equal ones."""
    points, areas = [], []
    for triangle in _fans(polygon):
        area = _area(triangle)
        per_side = max(1, round((n_points * area / polygon.area) ** 0.5))
        points.append(_similar_cells(per_side) @ triangle)
        areas.append(np.full(per_side**2, area / per_side**2))
    share = np.concatenate(areas)
    share /= share.sum()
    found = np.concatenate(points)
    return found + (polygon.centroid - share @ found), share


def _fans(polygon: Polygon) -> list[FloatArray]:
    """Return triangles (3, 2) that tile a polygon."""
    triangles = []
    for vertices, _ in polygon.pieces:
        centre = Polygon(vertices).centroid
        following = np.roll(vertices, -1, axis=0)
        triangles += [np.array([centre, a, b]) for a, b in zip(vertices, following, strict=True)]
    return triangles


def _similar_cells(per_side: int) -> FloatArray:
    """Barycentric centroids (per_side^2, 3) of the equal triangles that tile one."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(per_side) for j in range(per_side - i)]
    inverted = [(i + 2 / 3, j + 2 / 3) for i in range(per_side) for j in range(per_side - i - 1)]
    first, second = np.array(upright + inverted).T / per_side
    return np.column_stack((1.0 - first - second, first, second))


def _area(triangle: FloatArray) -> float:
    (ax, ay), (bx, by) = (triangle[1:] - triangle[0]).tolist()
    return 0.5 * float(abs(ax * by - ay * bx))
