"""Maps of where one parameter set can be trusted, and D(tau), the domain of applicability.

Theory: docs/theory/domain.md. Source of the question: RPI thesis, section 6 and
appendix C.6; here on held-out experiments, with a confidence, and never beyond evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, final

import numpy as np

from fixel.domain.cells import Cells
from fixel.domain.evidence import HeldOutErrors, Measure, threshold_score, value_of
from fixel.domain.promised_cells import untried
from fixel.domain.surface import CellObservations, Surface, fit_surface
from fixel.errors import InvalidInput
from fixel.typing import BoolArray, FloatArray, IntArray

# Colours of cells.
TRUSTED: Final = "trusted"
DOUBTFUL: Final = "doubtful"
NOT_TRUSTED: Final = "not trusted"
NO_DATA: Final = "no data"
PREDICTED: Final = "predicted"  # no data, but a bound from elsewhere says it is below
COLOURS: Final = (TRUSTED, DOUBTFUL, NOT_TRUSTED, NO_DATA, PREDICTED)

MIN_EXPERIMENTS: Final = 6  # below, not even the scatter of the errors is known


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """Claim that a trusted (blue) cell meets.

    Parameters
    ----------
    threshold : float
        tau: root mean square error [mm], or share above the own best E.
    measure : str
        `"absolute"` or `"relative"`.
    level : float
        Share of new members whose error has to stay below.
    confidence : float
        Probability at which that is said; of the contrary likewise.
    """

    threshold: float
    measure: Measure = "absolute"
    level: float = 0.9
    confidence: float = 0.95

    def __post_init__(self) -> None:
        threshold_score(self.threshold, self.measure)
        for name, least in (("level", 0.0), ("confidence", 0.5)):
            value = getattr(self, name)
            if not least < value < 1.0:
                found, expected = value, f"a number above {least:g} and below 1"
                raise InvalidInput(name, found=found, expected=expected)

    @property
    def score(self) -> float:
        """The threshold, as scores are."""
        return threshold_score(self.threshold, self.measure)

    @property
    def needed(self) -> int:
        """Members below tau in one cell that make the claim by counting alone."""
        return max(1, math.ceil(math.log1p(-self.confidence) / math.log(self.level)) - 1)

    def text(self, threshold: float | None = None) -> str:
        """The threshold in words."""
        value = self.threshold if threshold is None else threshold
        if self.measure == "absolute":
            return f"{value:.3g} mm"
        return f"{100.0 * value:.3g} % above the own best"


class CellVerdict(NamedTuple):
    """What is said of one cell."""

    colour: str
    confidence: float  # that the claim holds; nan without data
    reason: str


@final
@dataclass(frozen=True, eq=False)
class DomainMap:
    """One or more maps over the same cells.

    Parameters
    ----------
    evidence : HeldOutErrors
        All of it, also what lies in no cell.
    cells : Cells
    groups : tuple of str
        One a map.
    place : (n,) int
        Cell of every experiment; -1 for none.
    measure : str
    surface : Surface
    predicted_mm : (n_group, n_cell) float64, optional
        Bounds that something else promises for configurations nobody tried; nan for none.
    """

    evidence: HeldOutErrors
    cells: Cells
    groups: tuple[str, ...]
    place: IntArray
    measure: Measure
    surface: Surface
    predicted_mm: FloatArray | None = None

    @cached_property
    def scores(self) -> FloatArray:
        """(n,) of all experiments."""
        return self.evidence.scores(self.measure)

    @cached_property
    def members(self) -> list[list[IntArray]]:
        """Experiments with evidence in each cell of each map."""
        known = ~np.isnan(self.scores)
        found = []
        for group in self.groups:
            own = known & (np.array(self.evidence.group) == group)
            found.append([np.flatnonzero(own & (self.place == k)) for k in range(len(self.cells))])
        return found

    @cached_property
    def counts(self) -> IntArray:
        """(n_group, n_cell) members."""
        return np.array([[len(cell) for cell in own] for own in self.members])

    def confidence(self, claim: Claim) -> FloatArray:
        """(n_group, n_cell) that the claim holds; nan without data.

        By counting, where a cell has members enough for a claim by itself; else by the surface.
        """
        from scipy.special import betainc

        found = self.surface.below(claim.score, claim.level)
        for g, own in enumerate(self.members):
            for c, rows in enumerate(own):
                n = len(rows)
                if n == 0:
                    found[g, c] = np.nan
                elif n >= claim.needed:
                    good = int((self.scores[rows] <= claim.score).sum())
                    found[g, c] = 1.0 - float(betainc(good + 1.0, n - good + 1.0, claim.level))
        return found

    def statistic(self, level: float) -> FloatArray:
        """(n_group, n_cell) the members' error that a share `level` does not exceed, in the
        measure's unit; the largest of few. nan without data, inf where a simulation failed."""
        found = np.full(self.counts.shape, np.nan)
        for g, own in enumerate(self.members):
            for c, rows in enumerate(own):
                if len(rows):
                    score = _quantile(self.scores[rows], level)
                    found[g, c] = value_of(score, self.measure) if np.isfinite(score) else np.inf
        return found

    def verdicts(self, claim: Claim) -> list[list[CellVerdict]]:
        """Of every cell of every map."""
        confidence, statistic = self.confidence(claim), self.statistic(claim.level)
        return [
            [
                self._verdict(claim, g, c, float(confidence[g, c]), float(statistic[g, c]))
                for c in range(len(self.cells))
            ]
            for g in range(len(self.groups))
        ]

    def _verdict(self, claim: Claim, g: int, c: int, sure: float, seen: float) -> CellVerdict:
        n = int(self.counts[g, c])
        if n == 0:
            return self._without_data(claim, g, c)
        said = f"{n} member{'s' if n > 1 else ''}, {claim.text(seen)}"
        below = seen <= claim.threshold
        if below and sure >= claim.confidence:
            return CellVerdict(TRUSTED, sure, f"{said}; {100.0 * sure:.0f} % sure")
        if not below and sure <= 1.0 - claim.confidence:
            return CellVerdict(
                NOT_TRUSTED, sure, f"{said}; {100.0 * (1.0 - sure):.0f} % sure of that"
            )
        if below and sure <= 1.0 - claim.confidence:
            why = "its neighbours disagree"
        elif below:
            why = f"too little evidence, {100.0 * sure:.0f} % sure"
        else:
            why = "above the threshold, but not surely so"
        return CellVerdict(DOUBTFUL, sure, f"{said}; {why}")

    def _without_data(self, claim: Claim, g: int, c: int) -> CellVerdict:
        bound = np.nan if self.predicted_mm is None else float(self.predicted_mm[g, c])
        if bound <= claim.threshold:
            return CellVerdict(PREDICTED, np.nan, f"no experiment; promised {claim.text(bound)}")
        return CellVerdict(
            NO_DATA, np.nan, self._untried[self.groups[g]][c] or "no experiment here"
        )

    @cached_property
    def _untried(self) -> dict[str, list[str]]:
        return untried(self.evidence, self.cells)

    def domains(self, claim: Claim) -> list[list[int]]:
        """D(tau) of every map: trusted cells that are connected to the nominal."""
        return [
            self.cells.component([verdict.colour == TRUSTED for verdict in own])
            for own in self.verdicts(claim)
        ]

    def extents(self, claim: Claim) -> list[dict[str, tuple[str, str] | None]]:
        """How far D(tau) reaches along each axis through the nominal: first and last cell."""
        found = []
        for domain in self.domains(claim):
            inside = {self.cells.index[k] for k in domain}
            centre = self.cells.index[self.cells.nominal]
            found.append(
                {
                    axis.name: _reach(inside, centre, a, axis)
                    for a, axis in enumerate(self.cells.axes)
                }
            )
        return found

    def curve(self, claim: Claim, thresholds: Sequence[float]) -> FloatArray:
        """(n_group, n_threshold) cells in D(tau)."""
        sizes = [[len(domain) for domain in self.domains(_at(claim, tau))] for tau in thresholds]
        return np.array(sizes, np.float64).T

    @property
    def usual_thresholds(self) -> FloatArray:
        """Thresholds over which a curve of D(tau) is interesting, ascending."""
        good = self.scores[np.isfinite(self.scores)]
        low, high = np.quantile(good, [0.02, 0.98])
        ends = (low - 0.2, high + 0.9)
        values = [value_of(float(score), self.measure) for score in np.linspace(*ends, 40)]
        return np.array([value for value in values if value > 0.0])


def _at(claim: Claim, threshold: float) -> Claim:
    return Claim(
        threshold=threshold,
        measure=claim.measure,
        level=claim.level,
        confidence=claim.confidence,
    )


def _reach(
    inside: set[tuple[int, ...]], centre: tuple[int, ...], a: int, axis: object
) -> tuple[str, str] | None:
    from fixel.domain.cells import CellAxis

    assert isinstance(axis, CellAxis)
    if centre not in inside:
        return None
    if axis.is_text:
        own = [k for k in range(len(axis)) if (*centre[:a], k, *centre[a + 1 :]) in inside]
        return ", ".join(axis.text(k) for k in own), ""
    low = high = centre[a]
    while (*centre[:a], low - 1, *centre[a + 1 :]) in inside:
        low -= 1
    while (*centre[:a], high + 1, *centre[a + 1 :]) in inside:
        high += 1
    first = axis.edges[low] if axis.edges else axis.centres[low]
    last = axis.edges[high + 1] if axis.edges else axis.centres[high]
    return axis.shown(first), axis.shown(last)


def _quantile(scores: FloatArray, level: float) -> float:
    """The smallest score that a share `level` does not exceed."""
    ordered = np.sort(scores)
    return float(ordered[min(len(ordered) - 1, math.ceil(level * len(ordered) - 1e-9) - 1)])


def usual_threshold(evidence: HeldOutErrors, measure: Measure = "absolute") -> float:
    """Twice the median error, to two digits: where one looks first."""
    scores = evidence.scores(measure)
    good = scores[np.isfinite(scores)]
    if not len(good):
        raise InvalidInput("evidence", found="no error at all", expected="one at least")
    middle = value_of(float(np.median(good)), measure)
    return float(f"{2.0 * max(middle, 1e-3):.2g}")


def domain_map(
    evidence: HeldOutErrors,
    cells: Cells,
    measure: Measure = "absolute",
    seed: int = 0,
    predicted_mm: FloatArray | None = None,
    surface: Surface | None = None,
) -> DomainMap:
    """Put evidence into cells, and find out how errors vary over them.

    Parameters
    ----------
    evidence : HeldOutErrors
    cells : Cells
    measure : str
    seed : int
        Of the versions of the surface.
    predicted_mm : (n_group, n_cell) float64, optional
    surface : Surface, optional
        Of the same evidence in the same cells, where it is at hand: finding it takes seconds.

    Raises
    ------
    InvalidInput
        Too few experiments for any claim.
    """
    groups = tuple(dict.fromkeys(evidence.group))
    place = cells.find(evidence)
    scores = evidence.scores(measure)
    number = {group: g for g, group in enumerate(groups)}
    group = np.array([number[name] for name in evidence.group])
    usable = (place >= 0) & ~np.isnan(scores)
    if int(usable.sum()) < MIN_EXPERIMENTS:
        notes = next((note for note in evidence.notes if note), "")
        raise InvalidInput(
            "experiments",
            found=f"{int(usable.sum())} with held-out errors in the map"
            + (f" ({notes})" if notes else ""),
            expected=f"{MIN_EXPERIMENTS} at least for any claim",
            hint="make more, or leave out --where",
        )
    if surface is None:
        seen = _seen(place, group, scores, usable)
        surface = fit_surface(cells.places, len(groups), seen, seed)
    return DomainMap(evidence, cells, groups, place, measure, surface, predicted_mm)


def _seen(
    place: IntArray, group: IntArray, scores: FloatArray, usable: BoolArray
) -> CellObservations:
    """Counts, means and squares of the cells that have members.

    A failed simulation counts as three times the largest error: far above whatever matters.
    """
    finite = scores[usable & np.isfinite(scores)]
    most = float(finite.max()) + math.log(3.0) if len(finite) else 0.0
    score = np.where(np.isfinite(scores), scores, most)
    slots: dict[tuple[int, int], list[float]] = {}
    for k in np.flatnonzero(usable).tolist():
        slots.setdefault((int(group[k]), int(place[k])), []).append(float(score[k]))
    rows = sorted(slots.items())
    return CellObservations(
        np.array([g for (g, _), _ in rows]),
        np.array([c for (_, c), _ in rows]),
        np.array([len(own) for _, own in rows]),
        np.array([float(np.mean(own)) for _, own in rows]),
        np.array([float(np.var(own) * len(own)) for _, own in rows]),
    )
