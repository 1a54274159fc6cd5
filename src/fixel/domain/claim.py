"""Claims of a map of the domain of applicability, and the verdicts of its cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from fixel.domain.evidence import Measure, threshold_score
from fixel.errors import InvalidInput
from fixel.model import Probability

# Colours of cells.
TRUSTED: Final = "trusted"
DOUBTFUL: Final = "doubtful"
NOT_TRUSTED: Final = "not trusted"
NO_DATA: Final = "no data"
PREDICTED: Final = "predicted"  # no data, but a predicted bound below the threshold
COLOURS: Final = (TRUSTED, DOUBTFUL, NOT_TRUSTED, NO_DATA, PREDICTED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """Claim that is true for trusted (blue) cells."""

    threshold: float  # threshold tau: root mean square error [mm], or share above the own best E
    measure: Measure = "absolute"  # `"absolute"` or `"relative"`
    level: float = 0.9  # share of new members whose error must be below the threshold
    confidence: float = 0.95  # probability from which a cell counts as trusted, or as not trusted

    def __post_init__(self) -> None:
        threshold_score(self.threshold, self.measure)
        for name, least in (("level", 0.0), ("confidence", 0.5)):
            value = getattr(self, name)
            if not least < value < 1.0:
                found, expected = value, f"a number above {least:g} and below 1"
                raise InvalidInput(name, found=found, expected=expected)

    @property
    def score(self) -> float:
        """Score of the threshold."""
        return threshold_score(self.threshold, self.measure)

    @property
    def needed(self) -> int:
        """Number of members of a cell, all below tau, that prove the claim by counting alone."""
        return max(1, math.ceil(math.log1p(-self.confidence) / math.log(self.level)) - 1)

    def text(self, threshold: float | None = None) -> str:
        """Return a threshold as text; by default that of the claim."""
        value = self.threshold if threshold is None else threshold
        if self.measure == "absolute":
            return f"{value:.3g} mm"
        return f"{100.0 * value:.3g} % above the smallest error of the experiment"


class CellVerdict(NamedTuple):
    """Colour of one cell, with its confidence and reason."""

    colour: str
    confidence: float  # probability of the claim; nan without data
    reason: str


class Applicability(NamedTuple):
    """Answer of a map for one push."""

    # `"trusted"`, `"doubtful"`, `"not trusted"`, `"no data"`, or `"predicted"`: no experiment in
    # the cell, but an error bound below the threshold.
    verdict: str
    # Share of the held-out errors nearby that stay within the threshold, with its interval; None
    # without experiments nearby.
    probability: Probability | None
    nearby: int  # number of held-out experiments in the same cell
    reason: str
    cell: str  # cell of the map, with its coordinates
    # What is new about the push, or not given: part, surface, laboratory, side, speed, travel.
    unseen: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lines = [f"unseen: {text}" for text in self.unseen]
        chance = "" if self.probability is None else f"; within the threshold {self.probability!r}"
        return "\n".join([*lines, f"{self.verdict} ({self.cell}): {self.reason}{chance}"])
