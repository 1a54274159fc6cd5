"""Features of a predicted push that are known before it is made, for bounds on its error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from fixel.domain.features import simulated_features
from fixel.parts.fit import simulated
from fixel.parts.prior import NAMES, SupportPrior
from fixel.parts.pushes import PartPushes
from fixel.typing import BoolArray, FloatArray, IntArray

# How far the part moves and turns, and how much that depends on start, friction and centre of
# pressure. Features of the place or the part do not carry over to other parts.
USED: Final = ("distance", "turned_abs", "sensitiv", "bent", "lost")


def bound_features(
    pushes: PartPushes, which: IntArray, prior: SupportPrior
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return features (k, f) of pushes, their predicted ends (k, 3), and which converged (k,)."""
    ends, good = simulated(pushes, which, prior.best[None])
    best = dict(zip(NAMES, prior.best.tolist(), strict=True))

    def roll(own: IntArray, other: Mapping[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
        values = {name: np.full(len(own), x) for name, x in best.items()} | dict(other)
        found = pushes.simulate(which[own], values)
        return found.pose[:, None], found.good

    found = simulated_features(pushes.configurations(which), roll, best["mu_pusher"])
    used = [k for k, name in enumerate(found.names) if name.startswith(USED)]
    # Logarithms, with 0.1 mm or 0.1 mm / 35 mm added: trees do not mind, neighbours do.
    return np.log(np.abs(found.table[:, used]) + 1e-4), ends[0], good[0]
