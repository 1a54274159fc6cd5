"""All parameter sets that explain the data nearly as well, and what their supports have in common.

Several supports move a part alike: what a push feels of a support is how far from the centre of
mass the load lies and in which direction it is spread. Comparing sets by these quantities tells
whether they are different answers or the same one.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import non_negative, positive
from fixel.typing import FloatArray

# Points compared with each other, at most, the best ones: their distances take 8 bytes a pair.
MAX_SOLUTIONS: Final = 2000


class Solution(NamedTuple):
    """A cluster of points that are nearly as good as the best."""

    point: FloatArray  # (n,) the best of them
    error: float
    size: int  # points in the cluster
    low: FloatArray  # (n,) least value of each parameter in the cluster
    high: FloatArray  # (n,)
    members: np.ndarray  # (size,) their rows among the points given, best first


class SupportFeatures(NamedTuple):
    """What a push can feel of a support; k of them."""

    mean_radius: FloatArray  # (k,) load-weighted mean distance from the centre of mass: torsional
    radii: FloatArray  # (k, 2) root mean square along the principal axes, the larger first
    angle: FloatArray  # (k,) of the larger axis, in (-pi/2, pi/2] [rad]
    centre: FloatArray  # (k, 2) centre of load, from the centre of mass
    share: FloatArray  # (k, n) of the load on each point


def find_solutions(
    points: ArrayLike,
    errors: ArrayLike,
    scale: ArrayLike,
    threshold: float,
    distance: float = 1.0,
) -> tuple[Solution, ...]:
    """The clusters among the points whose error is within a threshold of the least.

    Parameters
    ----------
    points : (k, n) array
        Results of several starts, or everything that was evaluated.
    errors : (k,) array
        Deviances or other errors; inf where a point failed.
    scale : (n,) array
        Of the box.
    threshold : float
        Rise of the error above the least.
    distance : float
        Gap that separates two clusters [scales]. Points of one valley are one cluster however long
        it is, if they lie closer than this to one another.

    Returns
    -------
    tuple of Solution
        Best first; empty if all points failed.
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
    """Load-weighted radii and axes of supports.

    Parameters
    ----------
    points : (k, n, 2) array
        Support points, in the frame of the body [m].
    loads : (k, n) array
        Non-negative, not all zero; only their ratios count. `model.support.triangle_shares` gives
        those of three points.
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
        raise InvalidInput("loads", found="negative or no load", expected="loads that press down")
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
    """(k,) labels; single linkage, so that a valley is not cut into pieces."""
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
