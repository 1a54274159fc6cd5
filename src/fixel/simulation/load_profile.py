"""Loads under a plate: balanced, from a few numbers, and on a table that is not flat.

A plate of which little is known stands on a net of points (`support_grid`). Four numbers describe
where it presses more. A tilt puts the centre of pressure exactly under the centre of mass: a rigid
plate at rest is in balance on any table. Without the balance, loads learned from other plates move
the centre of pressure by millimetres (docs/theory/new-parts.md).

A stiff plate on a warped board stands on other points when it is turned by a quarter. Body-fixed
loads cannot model that: on plywood, pushes of one plate contradict each other by millimetres unless
the table's part is separated (docs/theory/support.md, docs/how-to/benchmark-on-real-pushes.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import shapely

from fixel.errors import InvalidInput
from fixel.model import Shape, rotated
from fixel.model.support import support_grid, times_each
from fixel.typing import FloatArray

PROFILE_NAMES: Final = (
    "pressure_rim", "pressure_corner", "pressure_xy", "pressure_diagonal",
    "pressure_tilt_x", "pressure_tilt_y",
)  # fmt: skip
"""`pressure_rim`: more load (above 0) towards the rim; `pressure_corner`: at corners;
`pressure_xy`: far along the body's x rather than y; `pressure_diagonal`: the same between its
diagonals; `pressure_tilt_x`, `pressure_tilt_y`: more load than the balance needs towards larger
x or y. All dimensionless; all zero is the same load on every point, balanced."""

# Of the logarithm of a load before the balance: a factor of 150 up or down.
MAX_EXPONENT: Final = 5.0
STEPS: Final = 40  # of Newton's method; three or four are usual
TOLERANCE: Final = 1e-10  # of the centre of pressure, over the size of the plate

# Distance at which a bend of 1 changes a load by the factor exp(1/2), and a slope of 1 by e [m].
LENGTH: Final = 40e-3
# Of the exponent: a factor of seven up or down is already extreme.
MAX_TABLE_EXPONENT: Final = 2.0

TABLE_NAMES: Final = (
    "table_bend", "table_bend_xy", "table_bend_diagonal", "table_slope_x", "table_slope_y",
)  # fmt: skip
"""`table_bend`: more load (above 0) far from the centroid in all directions; `table_bend_xy`: more
along world x than along y; `table_bend_diagonal`: the same between the diagonals; `table_slope_x`,
`table_slope_y`: more load towards larger world x or y. All dimensionless."""


class LoadNet(NamedTuple):
    """Support points under an outline, in the units of the load profile."""

    points: FloatArray  # (n_point, 2) in the frame of the shape [m]
    place: FloatArray  # (n_point, 2) from the centroid, in radii of a disk of the same area [-]
    rim: FloatArray  # (n_point,) squared distance from the centroid, 1 at the rim of the hull [-]
    corner: FloatArray  # (n_point,) 1 at corners, 0 elsewhere

    @classmethod
    def of(cls, shape: Shape) -> LoadNet:
        """Return the net of support points of an outline."""
        points, part = support_grid(shape)
        centre = np.asarray(shape.centroid, np.float64)
        hull = shapely.get_coordinates(shapely.MultiPoint(shape.outline).convex_hull)[:-1]
        edge = np.roll(hull, -1, axis=0) - hull
        outward = np.column_stack((edge[:, 1], -edge[:, 0]))
        reach = np.einsum("ej,ej->e", outward, hull - centre)
        rim = ((points - centre) @ outward.T / reach).max(axis=1)
        place = (points - centre) / np.sqrt(shape.area / np.pi)
        return cls(points, place, rim**2, (part == "corner").astype(np.float64))

    def shares(
        self,
        values: Mapping[str, FloatArray],
        centre_of_mass: FloatArray,
        angle: FloatArray,
        centroid: FloatArray,
    ) -> FloatArray:
        """Return the shares (n, n_point) of the weight on the points.

        Parameters
        ----------
        values : mapping of name to (n,) float64
            Values of `PROFILE_NAMES` and `TABLE_NAMES`; missing ones are zero.
        centre_of_mass : (2,) float64
            In the frame of the shape [m].
        angle : (n,) float64
            Angle of the body on the table [rad].
        centroid : (2,) float64
            Of the outline [m].

        Raises
        ------
        InvalidInput
            The centre of mass is not above the points.
        """
        n = len(angle)
        rim, corner, along, diagonal, tilt_x, tilt_y = (
            values.get(name, np.zeros(n))[:, None] for name in PROFILE_NAMES
        )
        x, y = self.place.T
        exponent = rim * self.rim + corner * self.corner
        exponent = exponent + 0.5 * along * (x * x - y * y) + diagonal * x * y
        if any(name in values for name in TABLE_NAMES):
            exponent = exponent + table_exponent(self.points - centroid, angle, values)
        exponent = np.clip(exponent, -MAX_EXPONENT, MAX_EXPONENT)
        away = (self.points - centre_of_mass) / float(np.ptp(self.points, axis=0).max())
        exponent = exponent + times_each(balance(exponent, away), away.T)
        return _shares(exponent + tilt_x * x + tilt_y * y)


def balance(
    exponent: FloatArray, points: FloatArray, centre_at: FloatArray | None = None
) -> FloatArray:
    """Return the tilt (n, 2) that moves the centre of the loads exp(exponent + tilt . r).

    It is the change of the loads with the smallest relative entropy. Newton's method minimises
    log(sum(exp(exponent + tilt . r))), which is convex, with steps that are halved where needed.

    `exponent` (n, n_point) are logarithms of the loads, on `points` (n_point, 2) relative to the
    centre of mass, in units of about the size of the plate. The centres are moved to `centre_at`
    (n, 2) inside the hull of the points, by default to zero. Raises `InvalidInput` if zero is not
    inside.

    Source: Csiszar (1975), I-divergence geometry of probability distributions.
    """
    if centre_at is None and not can_balance(points):
        found = "a centre of mass that is not above the support points"
        expected = "a centre of mass inside their hull"
        hint = "give the support points of the body"
        raise InvalidInput("support", found=found, expected=expected, hint=hint)
    tilt = np.zeros((len(exponent), 2))
    height = _log_sum(exponent)
    for _ in range(STEPS):
        share = _shares(exponent + times_each(tilt, points.T))
        centre = times_each(share, points)
        away = centre if centre_at is None else centre - centre_at
        done = np.abs(away).max(axis=1) < TOLERANCE
        if done.all():
            break
        moment = np.einsum("np,pi,pj->nij", share, points, points)
        moment -= centre[:, :, None] * centre[:, None, :]
        moment += 1e-12 * np.eye(2)
        step = -np.linalg.solve(moment, away[:, :, None])[:, :, 0]
        step[done] = 0.0  # no row depends on others
        size = np.ones(len(tilt))
        for _ in range(30):
            trial = _log_sum(exponent + times_each(tilt + size[:, None] * step, points.T))
            if centre_at is not None:
                trial -= ((tilt + size[:, None] * step) * centre_at).sum(axis=1)
            worse = trial > height + 1e-4 * size * (away * step).sum(axis=1) + 1e-14
            if not worse.any():
                break
            size[worse] *= 0.5
        tilt = tilt + size[:, None] * step
        height = trial
    return tilt


def can_balance(points: FloatArray) -> bool:
    """Return whether positive loads on points (n_point, 2) can have their centre at zero."""
    hull = shapely.MultiPoint(points).convex_hull
    return bool(shapely.contains_properly(hull, shapely.Point(0.0, 0.0)))


def _shares(exponent: FloatArray) -> FloatArray:
    load = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return np.asarray(load / load.sum(axis=1, keepdims=True))


def _log_sum(exponent: FloatArray) -> FloatArray:
    top = exponent.max(axis=1)
    return np.asarray(top + np.log(np.exp(exponent - top[:, None]).sum(axis=1)))


def factors_on_table(
    points: FloatArray, angle: FloatArray, values: Mapping[str, FloatArray]
) -> FloatArray:
    """Compute factors (n, n_point) of the loads on support points.

    They are the exponential of a second-degree polynomial in world axes, about the centroid. The
    `points` (n_point, 2) are relative to the centroid, in the frame of the shape [m]. `angle` (n,)
    is that of the body on the table [rad]. Missing `values` (n,) of `TABLE_NAMES` are zero.
    """
    exponent = table_exponent(points, angle, values)
    return np.asarray(np.exp(np.clip(exponent, -MAX_TABLE_EXPONENT, MAX_TABLE_EXPONENT)))


def table_exponent(
    points: FloatArray, angle: FloatArray, values: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the logarithm (n, n_point) of `factors_on_table`, without its limits."""
    bend, bend_xy, bend_diagonal, slope_x, slope_y = (
        values.get(name, np.zeros(len(angle)))[:, None] for name in TABLE_NAMES
    )
    x, y = np.moveaxis(rotated(points / LENGTH, angle[:, None]), -1, 0)
    exponent = 0.5 * (bend * (x * x + y * y) + bend_xy * (x * x - y * y)) + bend_diagonal * x * y
    return np.asarray(exponent + slope_x * x + slope_y * y)
