"""Maps of the accuracy of one parameter set, and D(tau), the domain of applicability.

Theory: docs/theory/domain.md. Source of the question: RPI thesis, section 6 and appendix C.6;
here on held-out experiments, with a confidence, and without extrapolation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np

from fixel.calibration.known_pushes import KnownPushes, push_target, texts_of, with_dataset
from fixel.calibration.mixed import numbered
from fixel.calibration.objective import ANGLE_SCALE
from fixel.domain.cells import CellAxis, Cells, coordinates_of, label_of, refuse_missing
from fixel.domain.claim import (
    COLOURS,
    DOUBTFUL,
    NO_DATA,
    NOT_TRUSTED,
    PREDICTED,
    TRUSTED,
    Applicability,
    CellVerdict,
    Claim,
)
from fixel.domain.evidence import HeldOutErrors, Measure, value_of
from fixel.domain.next_experiment import Proposal, proposals, untried
from fixel.domain.surface import CellObservations, Surface, fit_surface
from fixel.errors import InvalidInput, counted
from fixel.model import Experiment, Probability, Scene
from fixel.model.fields import frozen
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import BoolArray, FloatArray, IntArray

_WORDS: Final[Mapping[str, str]] = {
    TRUSTED: TRUSTED,
    DOUBTFUL: DOUBTFUL,
    NOT_TRUSTED: NOT_TRUSTED,
    NO_DATA: "without data",
    PREDICTED: "with an error bound only",
}

TESTS: Final = 10  # parts of the experiments, each tested in the map of the others
MIN_EXPERIMENTS: Final = 6  # minimum number to estimate the scatter of errors


@final
@dataclass(frozen=True, repr=False, eq=False)
class DomainMap(Result):
    """Map of the cells for each group of experiments.

    Made by `fixel.map_domain`. Errors are root mean squares of position and angle, with a radian
    as long as in the error that was calibrated: 35 mm, unless that was changed.

    Parameters
    ----------
    evidence : HeldOutErrors
        All experiments, also those in no cell.
    cells : Cells
    groups : tuple of str
        Groups, one per map.
    place : (n,) int
        Cell of every experiment; -1 for none.
    measure : str
    surface : Surface
    predicted_mm : (n_group, n_cell) float64, optional
        Predicted error bounds for cells without experiments; nan for none.
    claim : Claim, optional
        Threshold, share and confidence of the verdicts.
    facets : tuple of str
        Conditions with a map for each of their values.
    known : KnownPushes, optional
        Parts, surfaces, laboratories, sides and speeds of the experiments.
    source, question : mapping
        Plain content of the evidence and of the options, with which a project stores the map.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(6, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> trust = fixel.map_domain(
    ...     pushes, space, axes=["side"], threshold=2e-3, folds=2, progress=False
    ... )
    >>> trust.at(pushes[0]).nearby
    3
    """

    evidence: HeldOutErrors
    cells: Cells
    groups: tuple[str, ...]
    place: IntArray
    measure: Measure
    surface: Surface
    predicted_mm: FloatArray | None = None
    claim: Claim | None = None
    facets: tuple[str, ...] = ()
    known: KnownPushes | None = None
    source: Mapping[str, Any] = field(default_factory=dict, compare=False)
    question: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def claimed(self) -> Claim:
        """Claim of the map; by default that at twice the median error."""
        default = default_threshold(self.evidence, self.measure)
        return self.claim or Claim(threshold=default, measure=self.measure)

    @property
    def held_out(self) -> dict[str, float]:
        """Held-out error of each experiment, root mean square [m]; inf for a failed simulation."""
        errors = 1e-3 * np.sqrt(self.evidence.error_mm2)
        return dict(zip(self.evidence.keys, errors.tolist(), strict=True))

    @property
    def next_experiment(self) -> Proposal | None:
        """Experiment that is expected to settle most of the map; None if all of it is settled."""
        return next(iter(self.proposals(self.claimed, 1)), None)

    def proposals(
        self, claim: Claim, most: int = 5, verdicts: list[list[CellVerdict]] | None = None
    ) -> list[Proposal]:
        """Return the most informative experiments over all groups, the best first.

        Parameters
        ----------
        claim : Claim
        most : int
            Maximum number of proposals.
        verdicts : list of list of CellVerdict, optional
            Verdicts of the claim, if already computed.
        """
        verdicts = self.verdicts(claim) if verdicts is None else verdicts
        inside = self.domains(claim)
        return proposals(self.cells, self.groups, self.surface, claim, verdicts, inside, most)

    def within(self, threshold: float) -> DomainMap:
        """Return the same map with another threshold, without new fits.

        Parameters
        ----------
        threshold : float
            Largest allowed error [m], or share above the own best for a relative map.
        """
        factor = 1e3 if self.measure == "absolute" else 1.0
        return replace(self, claim=replace(self.claimed, threshold=factor * threshold))

    def at(self, scene: Scene | Experiment, **conditions: str | float) -> Applicability:
        """Return the verdict of the map on a push; without data for what no experiment has.

        Parameters
        ----------
        scene : Scene or Experiment
        **conditions
            Conditions that a bare scene does not have, such as `surface="abs"` [SI].

        Returns
        -------
        Applicability

        Raises
        ------
        InvalidInput
            A coordinate of the map is missing.
        """
        target = with_dataset(push_target(scene, conditions))
        own = coordinates_of(target)
        names = (*(axis.name for axis in self.cells.axes), *self.facets)
        columns = {name: self.evidence.column(name) for name in names}
        known = {k: next(own for own in column if own is not None) for k, column in columns.items()}
        refuse_missing(own, conditions, known)
        claim = self.claimed
        group = label_of(own, self.facets)
        place = tuple(axis.nearest(own[axis.name]) for axis in self.cells.axes)
        where = ", ".join(
            f"{axis.title} = {axis.shown(value)} {axis.unit}".rstrip()
            if isinstance(value := own[axis.name], float)
            else f"{axis.title} = {value}"
            for axis in self.cells.axes
        )
        unseen = () if self.known is None else self.known.unseen(target)
        texts = texts_of(unseen)
        if any(new.is_given for new in unseen):
            return Applicability(NO_DATA, None, 0, texts[0], where, texts)
        if group not in self.groups:
            return Applicability(NO_DATA, None, 0, f"no experiments with {group}", where, texts)
        if place not in self.cells.index:
            return Applicability(NO_DATA, None, 0, "outside the experiments", where, texts)
        g, c = self.groups.index(group), self.cells.index.index(place)
        verdict = self.verdicts(claim)[g][c]
        scores = self.scores[self.members[g][c]]
        n = len(scores)
        chance = None
        if n:
            chance = Probability.of(int((scores <= claim.score).sum()), n, claim.confidence)
        return Applicability(verdict.colour, chance, n, verdict.reason, self.cells.text(c), texts)

    def _summary(self) -> Summary:
        claim, counts = self.claimed, self.colours(self.claimed)
        n, folds = len(self.evidence), len(set(self.evidence.fold.tolist()))
        words = ", ".join(f"{counts[c]} {_WORDS[c]}" for c in COLOURS if counts[c])
        best = self.next_experiment
        weight = f"1 rad counts as {self.source.get('scale_mm', 1e3 * ANGLE_SCALE):g} mm"
        notes = [f"{words} of {sum(counts.values())} cells; {weight}"]
        if best is not None:
            group = f"{best.group}: " if best.group else ""
            notes.append(f"most informative next experiment: {group}{best.where} ({best.reason})")
        seen, verdicts = self.statistic(claim.level), self.verdicts(claim)
        head: tuple[Column | str, ...] = (
            "map",
            *self._axis_columns(),
            "pushes",
            Column("error", "mm", _common_decimals(seen[self.counts > 0], 3)),
            "verdict",
        )
        rows = [
            (group or "all", *self._place(c), int(self.counts[g, c]),
             float(seen[g, c]), verdicts[g][c].colour)
            for g, group in enumerate(self.groups)
            for c in range(len(self.cells))
            if self.counts[g, c]
        ]  # fmt: skip
        share = f"{100.0 * claim.level:g} % of new pushes"
        return Summary(
            f"DomainMap: error <= {claim.text()} in {share}"
            f" (held out, {folds} folds, {n} experiments)",
            [Table(head, rows)],
            notes,
            {
                "confidence": f"{claim.confidence:g}",
                "axes": ", ".join(a.name for a in self.cells.axes),
            },
        )

    def _axis_columns(self) -> list[Column]:
        return [
            Column(axis.title, axis.unit)
            if axis.is_text
            else Column(
                axis.title, axis.unit, _common_decimals(axis.factor * np.array(axis.centres), 4)
            )
            for axis in self.cells.axes
        ]

    def _place(self, c: int) -> list[str | float]:
        return [
            axis.labels[k] if axis.is_text else axis.factor * axis.centres[k]
            for axis, k in zip(self.cells.axes, self.cells.index[c], strict=True)
        ]

    def colours(self, claim: Claim) -> dict[str, int]:
        """Number of cells of each colour, over all maps."""
        every = [verdict.colour for own in self.verdicts(claim) for verdict in own]
        return {colour: every.count(colour) for colour in COLOURS}

    @cached_property
    def scores(self) -> FloatArray:
        """Scores (n,) of all experiments."""
        return self.evidence.scores(self.measure)

    @cached_property
    def members(self) -> list[list[IntArray]]:
        """Indices of the experiments with held-out errors in each cell of each map."""
        known = ~np.isnan(self.scores)
        found = []
        for group in self.groups:
            own = known & (np.array(self.evidence.group) == group)
            found.append([np.flatnonzero(own & (self.place == k)) for k in range(len(self.cells))])
        return found

    @cached_property
    def counts(self) -> IntArray:
        """Number of members (n_group, n_cell) of the cells."""
        return np.array([[len(cell) for cell in own] for own in self.members])

    def confidence(self, claim: Claim) -> FloatArray:
        """Return the probability (n_group, n_cell) of the claim; nan without data.

        Computed by counting if a cell has enough members for a claim, else from the surface.
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
        """Return the quantile (n_group, n_cell) of the members' errors at `level`, in the unit of
        the measure; the largest of few. nan without data, inf for a failed simulation."""
        if level in self._statistics:
            return self._statistics[level]
        found = np.full(self.counts.shape, np.nan)
        for g, own in enumerate(self.members):
            for c, rows in enumerate(own):
                if len(rows):
                    score = _quantile(self.scores[rows], level)
                    found[g, c] = value_of(score, self.measure) if np.isfinite(score) else np.inf
        return self._statistics.setdefault(level, frozen(found))

    @cached_property
    def _statistics(self) -> dict[float, FloatArray]:
        return {}

    def verdicts(self, claim: Claim) -> list[list[CellVerdict]]:
        """Return the verdict of every cell of every map."""
        confidence, statistic = self.confidence(claim), self.statistic(claim.level)
        least = self.required_confidence(claim)
        return [
            [
                self._verdict(claim, g, c, float(confidence[g, c]), float(statistic[g, c]), least)
                for c in range(len(self.cells))
            ]
            for g in range(len(self.groups))
        ]

    def required_confidence(self, claim: Claim, groups: Sequence[str] | None = None) -> float:
        """Return the confidence from which cells are trusted: that of the claim, or a higher one.

        Cells are trusted because their errors were small, some of them by chance. Therefore each
        experiment is tested in the map without it: of those in cells that are trusted there, the
        share of the claim must stay within the threshold. The confidence is raised until they do;
        it is infinite if no confidence is high enough.

        Parameters
        ----------
        claim : Claim
        groups : sequence of str, optional
            Maps whose experiments are tested; all by default.
        """
        which = np.isin(self.groups, list(self.groups if groups is None else groups))
        found = [
            self._tested(claim, rows[which[self._group[rows]]], others)
            for rows, others in self._without
        ]
        if not found:
            return claim.confidence
        sure, good = (np.concatenate(own) for own in zip(*found, strict=True))
        order = np.argsort(-sure, kind="stable")
        sure, bad = sure[order], np.cumsum(~good[order])
        enough = bad <= (1.0 - claim.level) * np.arange(1, len(bad) + 1) + 1e-9
        enough &= np.append(sure[1:] < sure[:-1], True)  # equal confidences are accepted together
        if not len(sure) or enough[-1]:
            return claim.confidence
        return float(sure[enough].min(initial=np.inf))

    def _tested(
        self, claim: Claim, rows: IntArray, others: DomainMap
    ) -> tuple[FloatArray, BoolArray]:
        """Return confidences (m,) of the cells of some experiments in a map without these, where
        it trusts them, and whether their errors (m,) are within the threshold."""
        at = (self._group[rows], self.place[rows])
        sure = others.confidence(claim)[at]
        trusted = (others.statistic(claim.level)[at] <= claim.threshold) & (
            sure >= claim.confidence
        )
        return sure[trusted], (self.scores[rows] <= claim.score)[trusted]

    @cached_property
    def _group(self) -> IntArray:
        return numbered(self.evidence.group)

    @cached_property
    def _without(self) -> list[tuple[IntArray, DomainMap]]:
        """Parts of the experiments, each with the map of the others."""
        usable = (self.place >= 0) & ~np.isnan(self.scores)
        part = np.random.default_rng(0).permutation(len(self.evidence)) % TESTS
        found = []
        for k in range(TESTS):
            others, own = usable & (part != k), np.flatnonzero(usable & (part == k))
            if others.any() and len(own):
                seen = _seen(self.place, self._group, self.scores, others)
                surface = self.surface.of_other(self.cells.places, seen)
                place = np.where(others, self.place, -1)
                made = replace(self, place=place, surface=surface, predicted_mm=None)
                found.append((own, made))
        return found

    def _verdict(
        self, claim: Claim, g: int, c: int, sure: float, seen: float, least: float
    ) -> CellVerdict:
        n = int(self.counts[g, c])
        if n == 0:
            return self._without_data(claim, g, c)
        said = f"{counted(n, 'experiment')}, {claim.text(seen)}"
        below = seen <= claim.threshold
        if below and sure >= least:
            return CellVerdict(TRUSTED, sure, f"{said}; probability {100.0 * sure:.0f} %")
        if not below and sure <= 1.0 - claim.confidence:
            return CellVerdict(
                NOT_TRUSTED, sure, f"{said}; probability {100.0 * (1.0 - sure):.0f} %"
            )
        if below and sure <= 1.0 - claim.confidence:
            why = "neighbouring cells disagree"
        elif below and sure >= claim.confidence:
            why = "in other cells as certain as this one, too many errors exceed the threshold"
        elif below:
            why = f"too few experiments, probability {100.0 * sure:.0f} %"
        else:
            why = "above the threshold, with insufficient probability"
        return CellVerdict(DOUBTFUL, sure, f"{said}; {why}")

    def _without_data(self, claim: Claim, g: int, c: int) -> CellVerdict:
        bound = np.nan if self.predicted_mm is None else float(self.predicted_mm[g, c])
        if bound <= claim.threshold:
            return CellVerdict(PREDICTED, np.nan, f"no experiment; error bound {claim.text(bound)}")
        return CellVerdict(
            NO_DATA, np.nan, self._untried[self.groups[g]][c] or "no experiment in this cell"
        )

    @cached_property
    def _untried(self) -> dict[str, list[str]]:
        return untried(self.evidence, self.cells)

    def domains(self, claim: Claim) -> list[list[int]]:
        """Return D(tau) of every map: the trusted cells that are connected to the nominal one."""
        return [
            self.cells.component([verdict.colour == TRUSTED for verdict in own])
            for own in self.verdicts(claim)
        ]

    def extents(self, claim: Claim) -> list[dict[str, tuple[str, str] | None]]:
        """Return the first and last cell of D(tau) along each axis through the nominal cell."""
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
        """Return the number of cells (n_group, n_threshold) in D(tau)."""
        sizes = [
            [len(domain) for domain in self.domains(replace(claim, threshold=tau))]
            for tau in thresholds
        ]
        return np.array(sizes, np.float64).T

    @property
    def usual_thresholds(self) -> FloatArray:
        """Default thresholds of a curve of D(tau), ascending."""
        good = self.scores[np.isfinite(self.scores)]
        low, high = np.quantile(good, [0.02, 0.98])
        ends = (low - 0.2, high + 0.9)
        values = [value_of(float(score), self.measure) for score in np.linspace(*ends, 40)]
        return np.array([value for value in values if value > 0.0])


def _reach(
    inside: set[tuple[int, ...]], centre: tuple[int, ...], a: int, axis: CellAxis
) -> tuple[str, str] | None:
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
    """Return the smallest score that a share `level` of the scores does not exceed."""
    ordered = np.sort(scores)
    return float(ordered[min(len(ordered) - 1, math.ceil(level * len(ordered) - 1e-9) - 1)])


def default_threshold(evidence: HeldOutErrors, measure: Measure = "absolute") -> float:
    """Return the default threshold: twice the median error, to two digits."""
    scores = evidence.scores(measure)
    good = scores[np.isfinite(scores)]
    if not len(good):
        raise InvalidInput("evidence", found="no error", expected="at least one error")
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
    """Assign experiments to cells, and fit a surface of errors over them.

    A surface of the same evidence in the same cells saves the fit, which takes seconds. Raise
    `InvalidInput` for too few experiments for any claim.
    """
    groups = tuple(dict.fromkeys(evidence.group))
    place = cells.find(evidence)
    scores = evidence.scores(measure)
    group = numbered(evidence.group)
    usable = (place >= 0) & ~np.isnan(scores)
    if int(usable.sum()) < MIN_EXPERIMENTS:
        notes = next((note for note in evidence.notes if note), "")
        raise InvalidInput(
            "experiments",
            found=f"{int(usable.sum())} with held-out errors in the map"
            + (f" ({notes})" if notes else ""),
            expected=f"at least {MIN_EXPERIMENTS} for a domain map",
            hint="add experiments, or select more of them",
        )
    if surface is None:
        seen = _seen(place, group, scores, usable)
        surface = fit_surface(cells.places, len(groups), seen, seed)
    return DomainMap(evidence, cells, groups, place, measure, surface, predicted_mm)


def _common_decimals(values: FloatArray, digits: int) -> str:
    """Format with equal decimals for all values, as many as the digits of the largest need."""
    known = values[np.isfinite(values)]
    largest = float(np.abs(known).max(initial=0.0))
    if largest == 0.0:
        return f".{digits}g"
    most = min(max(digits - 1 - math.floor(math.log10(largest)), 0), 6)
    exact = (np.allclose(known, known.round(n), rtol=0.0, atol=1e-9) for n in range(most))
    return f".{next((n for n, equal in enumerate(exact) if equal), most)}f"


def _seen(
    place: IntArray, group: IntArray, scores: FloatArray, usable: BoolArray
) -> CellObservations:
    """Return counts, means and squares of the cells with members.

    A failed simulation counts as three times the largest error.
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
