"""Where the pusher really was, from how far it seems to be from the object it touches.

A tracker and a robot have a frame each. Where the shift between them is unknown, a tip that touches
the object seems to be a millimetre away from it on one side, and a millimetre inside on the other.
No physics is needed to find the shift.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model import Disk, Shape
from fixel.model.fields import positive
from fixel.typing import BoolArray, FloatArray

# Gaps beyond this are of pushers that have left the object [m].
LARGEST_GAP: Final = 2.5e-3
# What gaps scatter by once the frames agree [m]; beyond, a gap counts less and less.
SCATTER: Final = 0.25e-3
# Iterations of reweighting; the shift settles to a micrometre in about ten.
ROUNDS: Final = 50
# After so many rounds, gaps beyond three times the scatter, and this [m], count no more.
WARM_UP: Final = 4
MIN_CUT: Final = 0.8e-3


class Registration(NamedTuple):
    """Shift from where the pusher was recorded to where it was, in the world."""

    shift: FloatArray  # (2,) [m]: `registration_x`, `registration_y`
    n_touching: int  # poses that were taken for contact
    scatter_before: float  # median absolute gap of these, as recorded [m]
    scatter_after: float  # and with the pusher moved [m]


def gaps_and_normals(
    shape: Shape, radius: float, pose: FloatArray, tip: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distance of round tips from an outline, and the direction in which it grows.

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
        Negative in overlap [m].
    normal : (n, 2) float64
        Outward, in the world [-].
    """
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    dx, dy = (tip - pose[:, :2]).T
    local = np.column_stack((c * dx + s * dy, c * dy - s * dx))
    if isinstance(shape, Disk):
        distance, away = np.hypot(*local.T) - shape.radius, local
    else:
        distance, away = _from_polygon(shape.outline, local)
    length = np.hypot(*away.T)[:, None]
    nx, ny = np.divide(away, length, out=np.zeros_like(away), where=length > 0.0).T
    return distance - radius, np.column_stack((c * nx - s * ny, s * nx + c * ny))


def _from_polygon(outline: FloatArray, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (n,), and vectors (n, 2) that point outward."""
    polygon = shapely.Polygon(outline)
    points = shapely.points(point)
    along = shapely.line_locate_point(polygon.exterior, points)
    nearest = shapely.get_coordinates(shapely.line_interpolate_point(polygon.exterior, along))
    sign = np.where(shapely.contains(polygon, points), -1.0, 1.0)
    away = sign[:, None] * (point - nearest)
    return sign * np.hypot(*away.T), away


def registration_from_gaps(
    shape: Shape,
    radius: float,
    pose: FloatArray,
    tip: FloatArray,
    *,
    prior: ArrayLike = (0.0, 0.0),
    prior_sd: float = 1e-3,
) -> Registration:
    """The shift of a round tip that brings it into contact with the object.

    Solves gap + normal . shift = 0 over all poses, robustly: a tip that has slid off the object
    says nothing, and counts nothing once it is seen to be away.

    Parameters
    ----------
    shape, radius, pose, tip
        As for `gaps_and_normals`; poses at which the tip mostly touches, such as ends of pushes.
    prior : (2,) array_like
        Shift to be expected [m].
    prior_sd : float
        Standard deviation about it [m]. It settles what few poses, or poses that were all pushed
        from one side, leave open.

    Source
    ------
    Iterated reweighting: Holland & Welsch (1977), with the weight of soft L1.
    """
    positive(prior_sd, "prior_sd", "m")
    gap, normal = gaps_and_normals(shape, radius, pose, tip)
    near = np.abs(gap) < LARGEST_GAP
    if not near.any():
        raise InvalidInput(
            "registration",
            found="no tip near the object",
            expected=f"gaps below {LARGEST_GAP * 1e3:g} mm, at the ends of pushes",
        )
    expected = np.asarray(prior, np.float64)
    shift, used = np.array(expected), near
    for k in range(ROUNDS):
        rest = gap + normal @ shift
        used = near if k < WARM_UP else _touching(rest)
        weight = used / np.sqrt(1.0 + (rest / SCATTER) ** 2)
        rows = np.vstack((normal * weight[:, None], np.eye(2) * SCATTER / prior_sd))
        right = np.concatenate((-gap * weight, expected * SCATTER / prior_sd))
        shift = np.asarray(np.linalg.lstsq(rows, right)[0], np.float64)
    rest = gap + normal @ shift
    return Registration(
        shift,
        int(used.sum()),
        float(np.median(np.abs(gap[used]))),
        float(np.median(np.abs(rest[used]))),
    )


def _touching(rest: FloatArray) -> BoolArray:
    near = np.abs(rest) < LARGEST_GAP
    scatter = 1.48 * np.median(np.abs(rest[near])) if near.any() else 0.0
    return np.asarray(np.abs(rest) < max(MIN_CUT, 3.0 * float(scatter)))
