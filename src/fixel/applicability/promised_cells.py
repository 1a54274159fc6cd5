"""What can be promised of experiments in the cells of a map, tried or not."""

from __future__ import annotations

import numpy as np

from fixel.applicability.cells import Cells
from fixel.applicability.evidence import Evidence
from fixel.applicability.promise import Promise, least_experiments
from fixel.kernels.arrays import FloatArray, IntArray


def promised_cells(
    evidence: Evidence, cells: Cells, level: float, seed: int = 0
) -> FloatArray | None:
    """(n_group, n_cell) bounds that new experiments stay within with a probability [mm].

    Root mean square errors; inf where nothing can be promised. None where there are too few
    experiments for any promise.

    Parameters
    ----------
    evidence : Evidence
    cells : Cells
    level : float
        The probability.
    seed : int
    """
    place = cells.find(evidence)
    known = np.flatnonzero((place >= 0) & ~np.isnan(evidence.error_mm2))
    groups = list(dict.fromkeys(evidence.group))
    group = np.array([groups.index(name) for name in evidence.group])
    # A cell nobody tried is like the next of the cells, not like one more repetition in one of
    # them: one experiment a cell judges it, and models have not seen another of the same cell.
    slots = {(int(group[k]), int(place[k])): k for k in reversed(known.tolist())}
    first = np.sort(np.fromiter(slots.values(), np.int64, len(slots)))
    bounds = _bounds(evidence, cells, place, known, level, seed)
    if bounds is None or len(first) == len(known):
        return bounds
    new = _bounds(evidence, cells, place, first, level, seed)
    tried = np.zeros(bounds.shape, bool)
    tried[tuple(zip(*slots, strict=True))] = True
    return np.where(tried, bounds, np.inf if new is None else new)


def _bounds(
    evidence: Evidence, cells: Cells, place: IntArray, rows: IntArray, level: float, seed: int
) -> FloatArray | None:
    """Of all cells, from some of the experiments; none from too few."""
    if len(rows) < least_experiments(level):
        return None
    groups = list(dict.fromkeys(evidence.group))
    apart = len(groups) > 1
    promise = Promise.fit(
        cells.places[place[rows]],
        np.sqrt(evidence.error_mm2[rows]),
        [evidence.group[k] for k in rows.tolist()] if apart else None,
        level,
        seed,
    )
    n = len(cells)
    return np.array([promise.bounds(cells.places, [own] * n if apart else None) for own in groups])
