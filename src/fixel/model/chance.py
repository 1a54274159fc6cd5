"""Random numbers that depend on what they are for, and on nothing else."""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, *purpose: str) -> np.random.Generator:
    """Random numbers of one purpose: the same in any order of runs and on any thread.

    Parameters
    ----------
    seed : int
        Of the whole bench, not negative.
    *purpose : str
        What they are for: `"run"`, `"square-07"`. Another purpose, other numbers.
    """
    # Python salts its own hash of a string anew in every process.
    digest = hashlib.sha256("\0".join(purpose).encode()).digest()
    return np.random.default_rng(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))
