"""Set of nearly optimal points: a cheap estimate of the uncertainty after a calibration.

It contains the evaluated points of a search whose error exceeds the smallest by no more than noise
explains; separate clusters of them are different solutions. The set costs nothing, but covers
only the region that the search visited: the posterior is the complete result.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.solutions import Solution, find_solutions
from fixel.errors import InvalidInput
from fixel.model.fields import non_negative
from fixel.typing import FloatArray

# Gap between clusters, as a share of the range of the evaluated points.
GAP: Final = 0.1
LEVEL: Final = 0.95  # of the confidence region


class NearOptimal(NamedTuple):
    """Range and clusters of the nearly optimal points."""

    least: float  # smallest error
    rise: float  # rise above it that noise explains
    size: int  # number of points within the rise
    low: FloatArray  # (n,) smallest values of these points
    high: FloatArray  # (n,)
    clusters: tuple[Solution, ...]  # best first
    names: tuple[str, ...] = ()  # of the parameters


def rise_of(least: float, count: float, unknowns: int) -> float:
    """Return the rise of a mean squared error over its minimum that noise explains.

    For normal noise of a size estimated by the fit itself, the confidence region contains the
    points with (E - E_min) / E_min <= n / (N - n) F(n, N - n). `least` is E_min, and `unknowns` n.
    `count` is N, independent measurements: numbers in the residuals over their correlation time.

    Source
    ------
    Seber & Wild (1989), Nonlinear Regression, section 3.3.
    """
    from scipy.special import fdtri

    freedom = max(1.0, count - unknowns)
    quantile = float(fdtri(unknowns, freedom, LEVEL))
    return non_negative(least, "least") * unknowns / freedom * quantile


def near_optimal(
    points: FloatArray, errors: FloatArray, rise: float, names: tuple[str, ...] = ()
) -> NearOptimal:
    """Return the points whose error is within a rise of the smallest, and their clusters.

    Points (k, n) are all that a search has evaluated; errors (k,) are inf for failed evaluations.
    For the rise, see `rise_of`.
    """
    good = np.isfinite(errors)
    if not good.any():
        raise InvalidInput(
            "evaluations", found="no evaluation with an error", expected="at least one"
        )
    least = float(errors[good].min())
    near = good & (errors <= least + non_negative(rise, "rise"))
    span = np.ptp(points[good], axis=0)
    scale = GAP * np.where(span > 0.0, span, 1.0)
    clusters = find_solutions(points, errors, scale, rise)
    own = points[near]
    low, high = own.min(axis=0), own.max(axis=0)
    return NearOptimal(least, rise, int(near.sum()), low, high, clusters, names)
