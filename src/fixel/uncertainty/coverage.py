"""Coverage of predicted bounds: the share of real outcomes inside the bounds of each level."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.typing import FloatArray

LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)


class CoverageCurve(NamedTuple):
    """Share of outcomes inside the bounds of each level."""

    levels: FloatArray  # (n,)
    held: FloatArray  # (n,)
    low: FloatArray  # (n,) 2.5 % point of the share, were the levels true
    high: FloatArray  # (n,) 97.5 %
    outcomes: int

    @property
    def largest_gap(self) -> float:
        """Largest difference between a level and the share of outcomes inside its bounds."""
        return float(np.abs(self.held - self.levels).max())


def coverage_curve(found: FloatArray, levels: tuple[float, ...] = LEVELS) -> CoverageCurve:
    """Return the coverage curve of outcomes.

    Each outcome is given by the level (n,) of the smallest bounds that contain it. The range `low`
    to `high` assumes independent outcomes.
    """
    from scipy.stats import binom

    own = np.asarray(found, np.float64)
    if own.ndim != 1 or not len(own) or not np.isfinite(own).all():
        raise InvalidInput("coverage", found="no outcomes", expected="one level an outcome")
    wanted = np.array(levels)
    held = np.array([float(np.mean(own <= level)) for level in levels])
    n = len(own)
    return CoverageCurve(
        wanted, held, binom.ppf(0.025, n, wanted) / n, binom.ppf(0.975, n, wanted) / n, n
    )
