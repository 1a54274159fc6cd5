"""Which experiments are held out together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import IntArray

FOLDS: Final = 5
MANY: Final = 2000  # experiments from which on two folds are enough: either half says all there is


def usual_folds(n: int) -> int:
    """How many folds so many experiments get where nobody asks."""
    return 2 if n > MANY else FOLDS


def folds_of(blocks: Sequence[str], strata: Sequence[str], folds: int, seed: int = 0) -> IntArray:
    """Share experiments out among folds.

    Parameters
    ----------
    blocks : sequence of str
        Experiments of one block are held out together: repetitions of one configuration, or a
        group that is to be left out whole.
    strata : sequence of str
        Blocks of one stratum are spread over the folds as evenly as can be.
    folds : int
    seed : int
        Of the order within a stratum.

    Returns
    -------
    (n,) int

    Raises
    ------
    InvalidInput
        Fewer than two folds, or fewer blocks than folds.
    """
    first = dict(zip(reversed(blocks), reversed(strata), strict=True))
    if folds < 2:
        raise InvalidInput("--folds", found=folds, expected="2 at least")
    if len(first) < folds:
        raise InvalidInput(
            "experiments",
            found=f"{len(first)} configurations",
            expected=f"{folds} at least, as many as there are folds",
            hint="make more experiments, or ask for fewer folds: --folds 2",
        )
    rng = np.random.default_rng(seed)
    place: dict[str, int] = {}
    at = 0
    for stratum in sorted(set(first.values())):
        own = sorted(block for block, s in first.items() if s == stratum)
        for k in rng.permutation(len(own)).tolist():
            # Counting on from the last stratum: many small ones still fill all folds evenly.
            place[own[k]] = at % folds
            at += 1
    return np.array([place[block] for block in blocks], np.int64)
