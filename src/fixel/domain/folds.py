"""Folds of experiments for cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import IntArray

FOLDS: Final = 5
MANY: Final = 2000  # experiments above which two folds are sufficient


def default_folds(n: int) -> int:
    """Return the default number of folds for n experiments."""
    return 2 if n > MANY else FOLDS


def folds_of(blocks: Sequence[str], strata: Sequence[str], folds: int, seed: int = 0) -> IntArray:
    """Distribute experiments over folds.

    Parameters
    ----------
    blocks : sequence of str
        Label of the block of each experiment. Blocks are held out as a whole: repetitions of one
        configuration, or a group.
    strata : sequence of str
        Label of the stratum, whose blocks are distributed over the folds as evenly as possible.
    folds : int
    seed : int
        Seed of the order within a stratum.

    Returns
    -------
    (n,) int

    Raises
    ------
    InvalidInput
        There are fewer than two folds, or fewer blocks than folds.
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
            # The count continues from the last stratum, so that small strata fill all folds evenly.
            place[own[k]] = at % folds
            at += 1
    return np.array([place[block] for block in blocks], np.int64)
