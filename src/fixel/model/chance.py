"""Random number generators that depend on a seed and a purpose only."""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, *purpose: str) -> np.random.Generator:
    """Create a generator for one purpose, independent of the order of runs and of threads.

    Parameters
    ----------
    seed : int
        Seed, not negative.
    *purpose : str
        Purpose of the numbers: `"run"`, `"square-07"`. Streams of different purposes differ.
    """
    # Python's own hash of a string differs between processes.
    digest = hashlib.sha256("\0".join(purpose).encode()).digest()
    return np.random.default_rng(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))
