"""What can be promised of experiments in the cells of a map, tried or not."""

from __future__ import annotations

import numpy as np

from fixel.applicability.cells import Cells
from fixel.applicability.evidence import Evidence
from fixel.applicability.promise import Promise, least_experiments
from fixel.kernels.arrays import FloatArray


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
    known = (place >= 0) & ~np.isnan(evidence.error_mm2)
    if int(known.sum()) < least_experiments(level):
        return None
    group = np.array(evidence.group)
    groups = list(dict.fromkeys(evidence.group))
    apart = len(groups) > 1
    promise = Promise.fit(
        cells.places[place[known]],
        np.sqrt(evidence.error_mm2[known]),
        group[known].tolist() if apart else None,
        level,
        seed,
    )
    n = len(cells)
    return np.array([promise.bounds(cells.places, [own] * n if apart else None) for own in groups])
