"""Distinct parameter sets that fit almost equally well."""

from __future__ import annotations

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


def find_solutions(
    points: ArrayLike, errors: ArrayLike, scale: ArrayLike, threshold: float, distance: float = 1.0
) -> tuple[Solution, ...]:
    """Return the clusters of points (k, n) whose error is within a threshold of the smallest.

    Points are results of several starts, or all that were evaluated, with errors (k,), inf for
    failures. `distance` is the smallest gap between two clusters, in scales (n,) of the box. Points
    of a valley are one cluster, however long it is, if neighbours are closer than this. The best
    cluster is the first; there is none if all points failed.
    """
    table, values = np.asarray(points, np.float64), np.asarray(errors, np.float64)
    widths = np.asarray(scale, np.float64)
    if table.ndim != 2 or values.shape != table.shape[:1] or widths.shape != table.shape[1:]:
        found = f"shapes {table.shape}, {values.shape} and {widths.shape}"
        raise InvalidInput("solutions", found=found, expected="(k, n), (k,) and (n,)")
    limit = non_negative(threshold, "threshold")
    gap = positive(distance, "distance", "scales")
    order = np.argsort(np.where(np.isnan(values), np.inf, values), kind="stable")
    order = order[np.isfinite(values[order])]
    if not len(order):
        return ()
    order = order[values[order] <= values[order[0]] + limit][:MAX_SOLUTIONS]
    labels = _clusters(table[order] / widths, gap)
    return tuple(
        _solution(table, values, order[labels == label]) for label in dict.fromkeys(labels.tolist())
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
