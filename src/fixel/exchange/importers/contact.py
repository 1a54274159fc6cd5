"""A measured pusher beside a measured object: how far apart, and out of each other."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import shapely

from fixel.exchange.datasets.base import FloatArray
from fixel.model import Disk, Flag, Shape

# Registration errors up to here are taken back by moving the pusher to contact; with larger ones
# nobody knows where it was [m].
LARGEST_CORRECTION: Final = 3e-3

# Left between the shapes after a correction, against rounding [m].
CLEARANCE: Final = 1e-9


def moved_to_contact(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far a round tip must move, along the normal, to lie outside an outline.

    Exact for convex outlines.

    Parameters
    ----------
    shape : Shape
        Of the object.
    radius : float
        Of the tip [m].
    pose : (n, 3) float64
        Of the object [m, m, rad].
    tip : (n, 2) float64
        Centre of the tip [m].

    Returns
    -------
    gap : (n,) float64
        From the surface of the tip to the outline as measured, negative in overlap [m].
    offset : (n, 2) float64
        In the world [m]; zero for tips outside.
    """
    distance, outward = _from_outline(shape, pose, tip)
    gap = distance - radius
    length = np.where(gap < 0.0, CLEARANCE - gap, 0.0)
    return gap, length[:, None] * outward


def corrected_path(path: FloatArray, offset: FloatArray, fade: float = math.inf) -> FloatArray:
    """A path whose start is moved; the correction fades to nothing, so that its end is as measured.

    Parameters
    ----------
    path : (n, 4) float64
        Time [s], pose [m, m, rad].
    offset : (2,) float64
        Of the start [m].
    fade : float
        Over how long [s]; at most over the whole path.
    """
    time = path[:, 0] - path[0, 0]
    over = min(fade, float(time[-1])) if len(time) > 1 else 0.0
    share = np.clip(1.0 - time / over, 0.0, 1.0) if over > 0.0 else np.ones(len(time))
    moved = path.copy()
    moved[:, 1:3] += share[:, None] * offset
    return moved


def correction_flag(gap: float) -> Flag:
    """What to say of a pusher that was moved to contact."""
    detail = f"in the scene, which it starts {-gap * 1e3:.3g} mm in"
    return Flag("pusher-moved-to-contact", detail, fault=False)


def _from_outline(
    shape: Shape, pose: FloatArray, point: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,) [m] and outward directions (n, 2) in the world."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    dx, dy = (point - pose[:, :2]).T
    local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
    if isinstance(shape, Disk):
        away = local
        distance = np.hypot(*local.T) - shape.radius
        sign: FloatArray = np.ones(len(local))
    else:
        outline = shapely.Polygon(shape.outline)
        points = shapely.points(local)
        along = shapely.line_locate_point(outline.exterior, points)
        nearest = shapely.get_coordinates(shapely.line_interpolate_point(outline.exterior, along))
        away = local - nearest
        sign = np.where(shapely.contains(outline, points), -1.0, 1.0)
        distance = sign * np.hypot(*away.T)
    length = np.hypot(*away.T)[:, None]
    normal = sign[:, None] * np.divide(away, length, out=np.zeros_like(away), where=length > 0.0)
    nx, ny = normal.T
    return distance, np.column_stack((c * nx - s * ny, s * nx + c * ny))
