"""Reconstruct the iterations and starts of a finished search from its evaluations.

A search that receives the same errors proposes the same points. Only points and errors are
therefore stored; replayed, they show where iterations began and where each start ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration import OPTIMISERS, Mads
from fixel.calibration.multi_start import MultiStartSearch
from fixel.calibration.optimiser import Best, Feasible, Search, SearchBox
from fixel.calibration.study import Trace
from fixel.typing import IntArray
from fixel.workflows.calibration.request import CalibrationRequest


class SearchHistory(NamedTuple):
    """Iterations and starts of a search that was replayed."""

    begins: IntArray  # (n_iteration,) first evaluation of each; empty if unknown
    ends: list[Best]  # best point of each start, if there were several
    evaluations: list[int]  # number of evaluations of each start


UNKNOWN: Final = SearchHistory(np.zeros(0, np.int64), [], [])

# Mads proposes one point at a time, in another process; least squares needs residuals, not errors.
RETRACED: Final = {optimiser.name for optimiser in OPTIMISERS} - {Mads.name}


def retraced(
    request: CalibrationRequest, trace: Trace, box: SearchBox, feasible: Feasible
) -> SearchHistory:
    """Replay a search from its evaluations, without a simulation.

    Parameters
    ----------
    request : CalibrationRequest
        Request of the calibration.
    trace : Trace
    box : SearchBox
        Bounds and start of the search.
    feasible : callable
        Constraint of the search: which points are feasible.
    """
    if request.optimiser.name not in RETRACED:
        return UNKNOWN
    search = request.made_optimiser.start(box, request.seed, feasible)
    begins = _told(search, trace)
    if begins is None:  # another version of the search
        return UNKNOWN
    starts: Sequence[Search] = search.searches if isinstance(search, MultiStartSearch) else ()
    return SearchHistory(
        np.array(begins, np.int64),
        [start.best for start in starts],
        [start.evaluations for start in starts],
    )


def _told(search: Search, trace: Trace) -> list[int] | None:
    """First evaluation of each iteration; None if the search proposes other points."""
    begins, at = [], 0
    while not search.done and at < len(trace.errors):
        points = search.ask()
        known = trace.points[at : at + len(points)]
        if known.shape != points.shape or not np.array_equal(known, points):
            return None
        search.tell(trace.errors[at : at + len(points)])
        begins.append(at)
        at += len(points)
    return begins if at == len(trace.errors) else None
