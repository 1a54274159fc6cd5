"""A net of support points under a footprint, to carry loads that a calibration finds."""

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

# Outlines with more corners than this are taken for smooth curves.
MAX_CORNERS: Final = 12
# Points of the outer and of the inner ring under a smooth outline.
SMOOTH_RINGS: Final = (10, 6)
# Sizes of the two rings, of the outline about its centroid. Where exactly is of no consequence: on
# real pushes 0.85 to 0.98 gave the same errors (docs/how-to/benchmark-on-real-pushes.md).
OUTER: Final = 0.93
INNER: Final = 0.48


class Net(NamedTuple):
    """Points under a footprint, and what part of it each stands for."""

    points: FloatArray  # (n, 2) in the frame of the shape [m]
    part: NDArray[np.str_]  # (n,) `corner`, `edge`, `ring` of a smooth outline, or `inside`


def support_net(shape: Shape, *, outer: float = OUTER, inner: float = INNER) -> Net:
    """Points on two scaled copies of the outline, and the centroid.

    With corners: all corners and the middles of the edges of the outer copy, the corners of the
    inner one. Without: evenly spaced points, those of the inner copy half a step on. Of outlines
    that are not convex, points outside are left out.

    Parameters
    ----------
    shape : Shape
    outer, inner : float
        Sizes of the copies, as fractions of the outline.

    Returns
    -------
    Net
        With points for `SupportPoints(points=...)`.
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
    """(n, 2) points evenly spaced along a scaled copy of an outline, the first `lead` steps on."""
    outline = shapely.Polygon(shape.outline)
    copy = shapely.affinity.scale(outline, size, size, origin=tuple(shape.centroid.tolist()))
    along = (np.arange(n) + lead) / n
    points = shapely.line_interpolate_point(copy.exterior, along, normalized=True)
    return np.asarray(shapely.get_coordinates(points))
