"""How a finished search went: its iterations and its starts, from what it evaluated.

A search told the same errors asks for the same points. So points and errors are all that is kept
of it: told them again, it says where its iterations began and where each start ended.
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
    """A search that was gone through again."""

    begins: IntArray  # (n_iteration,) first evaluation of each; none where they are not known
    ends: list[Best]  # of each start, where there were several
    evaluations: list[int]  # of each start


UNKNOWN: Final = SearchHistory(np.zeros(0, np.int64), [], [])

# Mads asks for one point at a time, in another process; least squares wants residuals, not errors.
RETRACED: Final = {optimiser.name for optimiser in OPTIMISERS} - {Mads.name}


def retraced(
    request: CalibrationRequest, trace: Trace, box: SearchBox, feasible: Feasible
) -> SearchHistory:
    """Go through a search again, without evaluating anything.

    Parameters
    ----------
    request : CalibrationRequest
        That the search was made with.
    trace : Trace
    box : SearchBox
        With the start it had.
    feasible : callable
        As it had.
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
    """Where each question begins; None where the search asks for anything else."""
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
