"""Features of supports that affect a push.

Different supports can have the same effect on a push, which depends on the distance of the load
from the centre of mass and on the direction in which it is spread. Comparing sets by these
features shows whether they are really different.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.typing import FloatArray


class SupportFeatures(NamedTuple):
    """Features of k supports that affect a push."""

    mean_radius: FloatArray  # (k,) load-weighted mean distance from the centre of mass: torsional
    radii: FloatArray  # (k, 2) root mean square along the principal axes, the larger first
    angle: FloatArray  # (k,) angle of the larger axis, in (-pi/2, pi/2] [rad]
    centre: FloatArray  # (k, 2) centre of load, from the centre of mass
    share: FloatArray  # (k, n) share of the load on each point


def support_features(
    points: ArrayLike, loads: ArrayLike, com: ArrayLike = (0.0, 0.0)
) -> SupportFeatures:
    """Compute load-weighted radii and axes of supports.

    Parameters
    ----------
    points : (k, n, 2) array
        Support points, in the frame of the body [m].
    loads : (k, n) array
        Loads, non-negative and not all zero; only their ratios matter.
        `model.support.triangle_shares` returns those of three points.
    com : (2,) or (k, 2) array
        Centre of mass, in the same frame [m].

    Source
    ------
    ASME (2006), table 1: its two parameter sets, of different points and loads, have mean radii of
    695 and 723 um, principal radii of 698 x 61 and 736 x 10 um.
    """
    table, weight = np.asarray(points, np.float64), np.asarray(loads, np.float64)
    if table.ndim != 3 or table.shape[2] != 2 or weight.shape != table.shape[:2]:
        found = f"shapes {table.shape} and {weight.shape}"
        raise InvalidInput("support", found=found, expected="(k, n, 2) points and (k, n) loads")
    if not ((weight >= 0.0).all() and (weight.sum(axis=1) > 0.0).all()):
        raise InvalidInput("loads", found="a load of zero or less", expected="positive loads")
    share = weight / weight.sum(axis=1, keepdims=True)
    arms = table - np.broadcast_to(np.asarray(com, np.float64), (len(table), 2))[:, None, :]
    centre = np.einsum("kn,kni->ki", share, arms)
    spread = arms - centre[:, None, :]
    variances, axes = np.linalg.eigh(np.einsum("kn,kni,knj->kij", share, spread, spread))
    angle = np.arctan2(axes[:, 1, 1], axes[:, 0, 1])
    return SupportFeatures(
        mean_radius=np.asarray(np.sum(share * np.hypot(arms[..., 0], arms[..., 1]), axis=1)),
        radii=np.sqrt(np.maximum(variances[:, ::-1], 0.0)),
        angle=angle - math.pi * np.ceil(angle / math.pi - 0.5),
        centre=centre,
        share=share,
    )
