"""The set of nearly optimal solutions: a cheap look at what a calibration leaves open.

Every point that a search evaluated is kept. Those whose error is above the least by no more than
noise explains are all answers; where they lie apart, they are different ones. It costs nothing, but
it sees only where the search went: the posterior is the full answer.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.solutions import Solution, find_solutions
from fixel.errors import InvalidInput
from fixel.model.fields import fraction, non_negative
from fixel.typing import FloatArray

# Gap between clusters, as a share of the range of what was evaluated.
GAP: Final = 0.1


class NearOptimal(NamedTuple):
    """Points nearly as good as the best."""

    least: float  # error of the best
    rise: float  # above it that noise explains
    size: int  # points within
    low: FloatArray  # (n,) of all of them
    high: FloatArray  # (n,)
    clusters: tuple[Solution, ...]  # best first


def rise_of(least: float, count: float, unknowns: int, level: float = 0.95) -> float:
    """Rise of a mean squared error that noise explains, given the least one.

    Under normal noise of a size that the fit itself tells, the region of a level holds the points
    with (E - E_min) / E_min <= n / (N - n) F(n, N - n).

    Parameters
    ----------
    least : float
        E_min.
    count : float
        N independent measurements: numbers in the residuals over their correlation time.
    unknowns : int
        n.
    level : float

    Source
    ------
    Seber & Wild (1989), Nonlinear Regression, section 3.3.
    """
    from scipy.special import fdtri

    if not 0.0 < fraction(level, "level") < 1.0:
        raise InvalidInput("level", found=level, expected="a number between 0 and 1")
    freedom = max(1.0, count - unknowns)
    quantile = float(fdtri(unknowns, freedom, level))
    return non_negative(least, "least") * unknowns / freedom * quantile


def near_optimal(
    points: FloatArray, errors: FloatArray, rise: float, gap: float = GAP
) -> NearOptimal:
    """Points (k, n) whose error (k,) is within a rise of the least, and their clusters.

    Parameters
    ----------
    points : (k, n) float64
        All that a search evaluated.
    errors : (k,) float64
        inf where there is none.
    rise : float
        In the unit of the errors; see `rise_of`.
    gap : float
        Between clusters, as a share of the range of each parameter over all points.
    """
    good = np.isfinite(errors)
    if not good.any():
        raise InvalidInput("evaluations", found="none with an error", expected="one at least")
    least = float(errors[good].min())
    near = good & (errors <= least + non_negative(rise, "rise"))
    span = np.ptp(points[good], axis=0)
    scale = gap * np.where(span > 0.0, span, 1.0)
    clusters = find_solutions(points, errors, scale, rise)
    own = points[near]
    return NearOptimal(least, rise, int(near.sum()), own.min(axis=0), own.max(axis=0), clusters)
