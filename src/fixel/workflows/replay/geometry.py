"""How far the tip of a pusher is from an outline."""

from __future__ import annotations

import numpy as np
import shapely

from fixel.model import Disk, Shape
from fixel.workflows.replay.report import FloatArray


def tip_gap(shape: Shape, radius: float, pose: FloatArray, tip: FloatArray) -> FloatArray:
    """Signed distance from the surface of a round tip to an outline, negative in overlap.

    Parameters
    ----------
    shape : Shape
    radius : float
        Of the tip [m].
    pose : (n, 3) float64
        Of the object [m, m, rad].
    tip : (n, 2) float64
        Centre of the tip [m].

    Returns
    -------
    (n,) float64
        [m]
    """
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    dx, dy = (tip - pose[:, :2]).T
    local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
    if isinstance(shape, Disk):
        distance = np.hypot(local[:, 0], local[:, 1]) - shape.radius
        return np.asarray(distance - radius, dtype=np.float64)
    outline = shapely.Polygon(shape.outline)
    points = shapely.points(local)
    distance = shapely.distance(outline.exterior, points)
    inside = shapely.contains(outline, points)
    return np.asarray(np.where(inside, -distance, distance) - radius, dtype=np.float64)
