"""Random number generators by purpose, and probabilities with their intervals."""

from __future__ import annotations

import hashlib
import math
from typing import NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.fields import inner_share, whole


def stream(seed: int, *purpose: str) -> np.random.Generator:
    """Create a generator for one purpose, independent of the order of runs and of threads.

    Streams of different purposes, such as `"run", "square-07"`, differ. Seeds are not negative.
    """
    # Python's own hash of a string differs between processes.
    digest = hashlib.sha256("\0".join(purpose).encode()).digest()
    return np.random.default_rng(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))


class Probability(NamedTuple):
    """Estimated probability with its confidence interval.

    Attributes
    ----------
    value : float
        Share of the n cases in which the event occurred [-].
    low, high : float
        Ends of its confidence interval [-].
    n : int
        Number of independent cases.

    Examples
    --------
    >>> Probability.of(93, 100)
    0.93 (0.86 to 0.97, n = 100)
    """

    value: float
    low: float
    high: float
    n: int

    @classmethod
    def of(cls, good: int, n: int, level: float = 0.95) -> Probability:
        """Estimate a probability from `good` of n cases, with its interval of a confidence level.

        Source
        ------
        Clopper & Pearson (1934), Biometrika 26, 404-413: exact, so never too narrow.
        """
        from scipy.special import betaincinv

        inner_share(level, "level")
        if not 0 <= whole(good, "good", 0) <= whole(n, "n"):
            raise InvalidInput("cases", found=f"{good} of {n}", expected="cases among these")
        tail = 0.5 * (1.0 - level)
        low = float(betaincinv(good, n - good + 1, tail)) if good else 0.0
        high = float(betaincinv(good + 1, n - good, 1.0 - tail)) if good < n else 1.0
        return cls(good / n, low, high, n)

    def __repr__(self) -> str:
        digits = min(max(2, -math.floor(math.log10(0.5 * (self.high - self.low)))), 6)
        value, low, high = (f"{x:.{digits}f}" for x in self[:3])
        return f"{value} ({low} to {high}, n = {self.n})"
