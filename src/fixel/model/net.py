"""Support points under a footprint, whose loads a calibration may estimate."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.model.fields import finite
from fixel.model.shape import Disk, Shape
from fixel.typing import FloatArray

# Outlines with more corners than this count as smooth curves.
MAX_CORNERS: Final = 12
# Points of the outer and of the inner ring under a smooth outline.
SMOOTH_RINGS: Final = (10, 6)
# Sizes of the two rings relative to the outline, about its centroid. The exact value is irrelevant:
# on real pushes 0.85 to 0.98 gave the same errors (docs/how-to/benchmark-on-real-pushes.md).
OUTER: Final = 0.93
INNER: Final = 0.48


class Net(NamedTuple):
    """Points under a footprint, with the part of it that each represents."""

    points: FloatArray  # (n, 2) in the frame of the shape [m]
    part: NDArray[np.str_]  # (n,) `corner`, `edge`, `ring` of a smooth outline, or `inside`


def support_net(shape: Shape, *, outer: float = OUTER, inner: float = INNER) -> Net:
    """Create support points on two scaled copies of the outline, and at the centroid.

    For outlines with corners these are all corners and the middles of the edges of the outer copy,
    and the corners of the inner one. For smooth ones they are evenly spaced, with those of the
    inner copy half a step on. Points outside an outline that is not convex are left out.

    Parameters
    ----------
    shape : Shape
    outer, inner : float
        Sizes of the copies, as fractions of the outline.

    Returns
    -------
    Net
        Points for `SupportPoints(points=...)`, with their parts.
    """
    for name, size in (("outer", outer), ("inner", inner)):
        if not 0.0 < finite(size, f"net.{name}") < 1.0:
            raise InvalidInput(
                f"net.{name}", found=size, expected="a fraction between 0 and 1 of the outline"
            )
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
    return Net(points[inside], part[inside])


def _evenly(shape: Shape, size: float, n: int, lead: float) -> FloatArray:
    """Points (n, 2) evenly spaced along a scaled copy of an outline, offset by `lead` steps."""
    outline = shapely.Polygon(shape.outline)
    copy = shapely.affinity.scale(outline, size, size, origin=tuple(shape.centroid.tolist()))
    along = (np.arange(n) + lead) / n
    points = shapely.line_interpolate_point(copy.exterior, along, normalized=True)
    return np.asarray(shapely.get_coordinates(points))
