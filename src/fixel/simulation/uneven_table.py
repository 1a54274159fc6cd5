"""Load under a plate that lies on an uneven table.

A stiff plate on a warped board stands on other points when it is turned by a quarter. Body-fixed
loads cannot model that: on plywood, pushes of one plate contradict each other by millimetres unless
the table's part is separated (docs/theory/support.md, docs/how-to/benchmark-on-real-pushes.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from fixel.typing import FloatArray

# Distance at which a bend of 1 changes a load by the factor exp(1/2), and a slope of 1 by e [m].
LENGTH: Final = 40e-3
# Of the exponent: a factor of seven up or down is already extreme.
MAX_EXPONENT: Final = 2.0

TABLE_NAMES: Final = (
    "table_bend",
    "table_bend_xy",
    "table_bend_diagonal",
    "table_slope_x",
    "table_slope_y",
)
"""`table_bend`: more load (above 0) far from the centroid in all directions; `table_bend_xy`: more
along world x than along y; `table_bend_diagonal`: the same between the diagonals; `table_slope_x`,
`table_slope_y`: more load towards larger world x or y. All dimensionless."""


def factors_on_table(
    points: FloatArray, angle: FloatArray, values: Mapping[str, FloatArray]
) -> FloatArray:
    """Compute factors (n, n_point) of the loads on support points.

    They are the exponential of a second-degree polynomial in world axes, about the centroid. The
    `points` (n_point, 2) are relative to the centroid, in the frame of the shape [m]. `angle` (n,)
    is that of the body on the table [rad]. Missing `values` (n,) of `TABLE_NAMES` are zero.
    """
    exponent = table_exponent(points, angle, values)
    return np.asarray(np.exp(np.clip(exponent, -MAX_EXPONENT, MAX_EXPONENT)))


def table_exponent(
    points: FloatArray, angle: FloatArray, values: Mapping[str, FloatArray]
) -> FloatArray:
    """Return the logarithm (n, n_point) of `factors_on_table`, without its limits."""
    nothing = np.zeros(len(angle))
    bend, bend_xy, bend_diagonal, slope_x, slope_y = (
        values.get(name, nothing)[:, None] for name in TABLE_NAMES
    )
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    u, v = (points / LENGTH).T
    x, y = c * u - s * v, s * u + c * v
    exponent = 0.5 * (bend * (x * x + y * y) + bend_xy * (x * x - y * y)) + bend_diagonal * x * y
    return np.asarray(exponent + slope_x * x + slope_y * y)
