"""Random feasible points of a box."""

from __future__ import annotations

import numpy as np

from fixel.calibration.optimiser import Feasible, SearchBox
from fixel.errors import InvalidInput
from fixel.typing import FloatArray

BATCH = 256  # points drawn at a time; a power of two, as the sequence requires
TRIES = 64 * BATCH


def feasible_points(
    box: SearchBox, count: int, seed: int = 0, feasible: Feasible | None = None
) -> FloatArray:
    """Return the first `count` feasible points of a scrambled Sobol' sequence over a box.

    Returns
    -------
    (k, n) float64
        At least one point, but fewer than `count` if `TRIES` points contain no more.

    Source
    ------
    Owen (1998), scrambled Sobol' points, as in SciPy.
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(d=box.n, scramble=True, seed=np.random.default_rng(seed))
    found = np.zeros((0, box.n))
    for _ in range(TRIES // BATCH):
        points = box.low + sequence.random(BATCH) * (box.high - box.low)
        points = np.clip(points, box.low, box.high)
        if feasible is not None:
            points = points[np.asarray(feasible(points), bool)]
        found = np.concatenate((found, points))
        if len(found) >= count:
            return found[:count]
    if not len(found):
        raise InvalidInput(
            "start",
            found=f"no feasible point among {TRIES} random ones",
            expected="bounds that hold points which can be simulated",
            hint="narrow the bounds around a parameter set that works",
        )
    return found
