"""Distinct parameter sets that fit almost equally well, and features of their supports.

Different supports can have the same effect on a push, which depends on the distance of the load
from the centre of mass and on the direction in which it is spread. Comparing sets by these
features shows whether they are really different.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import non_negative, positive
from fixel.typing import FloatArray

# Maximum number of compared points, the best ones: their distances take 8 bytes per pair.
MAX_SOLUTIONS: Final = 2000


class Solution(NamedTuple):
    """Cluster of points that are almost as good as the best."""

    point: FloatArray  # (n,) best point
    error: float
    size: int  # number of points
    low: FloatArray  # (n,) smallest value of each parameter in the cluster
    high: FloatArray  # (n,)
    members: np.ndarray  # (size,) row numbers of its points, best first


class SupportFeatures(NamedTuple):
    """Features of k supports that affect a push."""

    mean_radius: FloatArray  # (k,) load-weighted mean distance from the centre of mass: torsional
    radii: FloatArray  # (k, 2) root mean square along the principal axes, the larger first
    angle: FloatArray  # (k,) angle of the larger axis, in (-pi/2, pi/2] [rad]
    centre: FloatArray  # (k, 2) centre of load, from the centre of mass
    share: FloatArray  # (k, n) share of the load on each point


def find_solutions(
    points: ArrayLike, errors: ArrayLike, scale: ArrayLike, threshold: float, distance: float = 1.0
) -> tuple[Solution, ...]:
    """Return the clusters of points (k, n) whose error is within a threshold of the smallest.

    Points are results of several starts, or all that were evaluated, with errors (k,), inf for
    failures. `distance` is the smallest gap between two clusters, in scales (n,) of the box. Points
    of a valley are one cluster, however long it is, if neighbours are closer than this. The best
    cluster is the first; there is none if all points failed.
    """
    table, told = np.asarray(points, np.float64), np.asarray(errors, np.float64)
    widths = np.asarray(scale, np.float64)
    if table.ndim != 2 or told.shape != table.shape[:1] or widths.shape != table.shape[1:]:
        found = f"shapes {table.shape}, {told.shape} and {widths.shape}"
        raise InvalidInput("solutions", found=found, expected="(k, n), (k,) and (n,)")
    limit = non_negative(threshold, "threshold")
    gap = positive(distance, "distance", "scales")
    order = np.argsort(np.where(np.isnan(told), np.inf, told), kind="stable")
    order = order[np.isfinite(told[order])]
    if not len(order):
        return ()
    order = order[told[order] <= told[order[0]] + limit][:MAX_SOLUTIONS]
    labels = _clusters(table[order] / widths, gap)
    return tuple(
        _solution(table, told, order[labels == label]) for label in dict.fromkeys(labels.tolist())
    )


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


def _clusters(points: FloatArray, gap: float) -> np.ndarray:
    """Return cluster labels (k,) by single linkage, which does not divide valleys."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(points) < 2:
        return np.ones(len(points), np.int64)
    return np.asarray(fcluster(linkage(points, "single"), gap, "distance"))


def _solution(points: FloatArray, errors: FloatArray, members: np.ndarray) -> Solution:
    rows = points[members]
    return Solution(
        point=rows[0].copy(),
        error=float(errors[members[0]]),
        size=len(members),
        low=rows.min(axis=0),
        high=rows.max(axis=0),
        members=members,
    )
