"""Points under a footprint: cells that tile it, and a grid whose loads may be estimated."""

from __future__ import annotations

from functools import lru_cache
from math import pi
from typing import Final

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray

from fixel.model.fields import inner_share
from fixel.model.shape import Disk, Polygon, Shape
from fixel.typing import FloatArray

# Outlines with more corners than this count as smooth curves.
MAX_CORNERS: Final = 12
# Polygons with more corners are divided by a grid, since every corner is that of a triangle else.
MAX_FAN_CORNERS: Final = 128
COARSER: Final = 1.02  # factor of the pitch of the grid, until it has few enough cells
# Shapes whose cells are kept, and triangles whose division is.
MAX_KEPT: Final = 64
# Points of the outer and of the inner ring under a smooth outline.
SMOOTH_RINGS: Final = (10, 6)
# Sizes of the two rings relative to the outline, about its centroid. The exact value is irrelevant:
# on real pushes 0.85 to 0.98 gave the same errors (docs/how-to/benchmark-on-real-pushes.md).
OUTER: Final = 0.93
INNER: Final = 0.48


@lru_cache(MAX_KEPT)
def cells(shape: Shape, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Compute centroids (n, 2) of about `n_points` cells that tile a shape, and shares of the area.

    Centroids are in the frame of the shape [m]; shares (n,) are positive with sum 1 [-]. The
    weighted mean of the points is the centroid of the shape, to rounding. The arrays are read-only,
    since the cells of the latest shapes are kept: bodies are often built again.
    """
    if isinstance(shape, Disk):
        points, share = _disk_cells(shape, n_points)
    elif len(shape.vertices) > MAX_FAN_CORNERS:
        points, share = _grid_cells(shape, n_points)
    else:
        points, share = _polygon_cells(shape, n_points)
    points.flags.writeable = share.flags.writeable = False
    return points, share


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
        (ax, ay), (bx, by) = (triangle[1:] - triangle[0]).tolist()
        area = 0.5 * abs(ax * by - ay * bx)
        per_side = max(1, round((n_points * area / polygon.area) ** 0.5))
        points.append(_similar_cells(per_side) @ triangle)
        areas.append(np.full(per_side**2, area / per_side**2))
    share = np.concatenate(areas)
    share /= share.sum()
    found = np.concatenate(points)
    return found + (polygon.centroid - share @ found), share


def _grid_cells(polygon: Polygon, n_points: int) -> tuple[FloatArray, FloatArray]:
    """Cut a polygon by a square grid about its centroid, with at most `n_points` cells."""
    outline = shapely.Polygon(polygon.vertices - polygon.centroid)
    shapely.prepare(outline)
    far = float(np.hypot(*(polygon.vertices - polygon.centroid).T).max())
    pitch = (polygon.area / n_points) ** 0.5
    while True:
        reach = int(np.ceil(far / pitch))
        left = pitch * np.arange(-reach, reach)
        x, y = (axis.reshape(-1) for axis in np.meshgrid(left, left))
        boxes = shapely.box(x, y, x + pitch, y + pitch)
        boxes = boxes[shapely.intersects(outline, boxes)]
        if len(boxes) <= max(n_points, 4):
            break
        pitch *= COARSER
    parts = shapely.intersection(outline, boxes)
    area = shapely.area(parts)
    parts, area = parts[area > 0.0], area[area > 0.0]
    share = area / area.sum()
    found = shapely.get_coordinates(shapely.centroid(parts))
    return found + (polygon.centroid - share @ found), share


def _fans(polygon: Polygon) -> list[FloatArray]:
    """Return triangles (3, 2) that tile a polygon."""
    triangles = []
    for vertices, _ in polygon.pieces:
        centre = polygon.centroid if polygon.is_convex else Polygon(vertices).centroid
        following = np.roll(vertices, -1, axis=0)
        triangles += [np.array([centre, a, b]) for a, b in zip(vertices, following, strict=True)]
    return triangles


@lru_cache(MAX_KEPT)
def _similar_cells(per_side: int) -> FloatArray:
    """Barycentric centroids (per_side^2, 3) of the equal triangles that tile one."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(per_side) for j in range(per_side - i)]
    inverted = [(i + 2 / 3, j + 2 / 3) for i in range(per_side) for j in range(per_side - i - 1)]
    first, second = np.array(upright + inverted).T / per_side
    return np.column_stack((1.0 - first - second, first, second))


def support_grid(
    shape: Shape, *, outer: float = OUTER, inner: float = INNER
) -> tuple[FloatArray, NDArray[np.str_]]:
    """Create support points (n, 2) on two scaled outlines and at the centroid [m].

    Return also the part (n,) of the outline that each represents: `corner`, `edge`, `ring` of a
    smooth one, or `inside`.

    For outlines with corners these are all corners and the middles of the edges of the outer copy,
    and the corners of the inner one. For smooth ones they are evenly spaced, with those of the
    inner copy half a step on. Points outside an outline that is not convex are left out.
    """
    for name, size in (("outer", outer), ("inner", inner)):
        inner_share(size, f"net.{name}")
    centre = shape.centroid
    smooth = isinstance(shape, Disk) or len(shape.outline) > MAX_CORNERS
    if smooth:
        rings = {
            "ring": _evenly(shape, outer, SMOOTH_RINGS[0], 0.0),
            "inside": _evenly(shape, inner, SMOOTH_RINGS[1], 0.5),
        }
    else:
        corners = centre + outer * (shape.outline - centre)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
        rings = {
            "corner": corners,
            "edge": middles,
            "inside": centre + inner * (shape.outline - centre),
        }
    rings["inside"] = np.concatenate((rings["inside"], centre[None]))
    points = np.concatenate(list(rings.values()))
    part = np.concatenate([np.full(len(ring), name) for name, ring in rings.items()])
    inside = shapely.intersects_xy(shapely.Polygon(shape.outline), points[:, 0], points[:, 1])
    return points[inside], part[inside]


def _evenly(shape: Shape, size: float, n: int, lead: float) -> FloatArray:
    """Points (n, 2) evenly spaced along a scaled copy of an outline, offset by `lead` steps."""
    outline = shapely.Polygon(shape.outline)
    copy = shapely.affinity.scale(outline, size, size, origin=tuple(shape.centroid.tolist()))
    along = (np.arange(n) + lead) / n
    points = shapely.line_interpolate_point(copy.exterior, along, normalized=True)
    return np.asarray(shapely.get_coordinates(points))
