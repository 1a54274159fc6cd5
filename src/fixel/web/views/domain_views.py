"""Stored maps under other thresholds at once, and along other axes after a while.

The fits of the cross-validation are not repeated: held-out errors are read from the stored
analysis. The variation of errors over other axes is fitted again, which takes from a second to
minutes, in a process of its own that is shared by clients and stopped when unused.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np
from pydantic import Field

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.cells import CellAxis, Cells
from fixel.domain.claim import COLOURS, TRUSTED, Claim
from fixel.domain.domain import DomainMap, default_threshold
from fixel.domain.evidence import Measure, value_of
from fixel.errors import FixelError, InvalidInput, JobRefused, NotStored
from fixel.web.values import Answer, Finite
from fixel.web.views.background_fits import BackgroundFit, Fits
from fixel.workflows.analysis import StoredAnalysis, load_with_errors
from fixel.workflows.domain.evidence import DomainEvidence, gathered_before, mark_of
from fixel.workflows.domain.request import DomainRequest, asked_again, command_of
from fixel.workflows.domain.run import is_fitted, refuse_axes, spread_out

MAX_MAPS: Final = 12  # in memory
PATIENCE: Final = 2.0  # [s] that a request for a map waits for it
MAX_GROUPS: Final = 40
MAX_CELLS: Final = 40_000  # of all groups
MAX_ON_AXIS: Final = 60  # values of a text that can be an axis


class MapAxis(Answer):
    """A coordinate the map may go over."""

    name: str
    distinct: int


class AxisTicks(Answer):
    """An axis of the map."""

    name: str
    unit: str = Field(description="unit of the tick labels")
    ticks: list[str]


class DomainPanel(Answer):
    """A strip along one axis, or a grid over two."""

    across: AxisTicks
    up: AxisTicks | None
    cells: list[list[int]] = Field(description="indices of the cells, by row from the bottom")


class MapPoint(Answer):
    """An experiment that was held out."""

    id: int
    key: str
    group: int
    cell: int
    error: Finite = Field(
        description="error in the unit of the threshold; null if the simulation failed"
    )
    fold: int


class MapDocument(Answer):
    """A map for every threshold: its cells and what lies in them."""

    name: str
    title: str
    measure: Measure
    unit: str = Field(description="unit of thresholds and errors: mm, or empty for relative errors")
    low: float = Field(description="smallest useful threshold; errors below it are noise")
    high: float
    threshold: float = Field(description="initial threshold")
    level: float
    confidence: float
    floor_mm: float | None = Field(description="error due to measurement noise alone [mm]")
    floor_from: str
    calibration: int | None
    groups: list[str] = Field(description="names of the groups, one map for each")
    omitted: int = Field(description="number of maps that are not included")
    panels: list[DomainPanel]
    texts: list[str] = Field(description="description of each cell")
    nominal: int = Field(description="index of the nominal cell")
    counts: list[list[int]] = Field(description="number of experiments by group and cell")
    points: list[MapPoint]
    axes: list[MapAxis]
    chosen: list[str] = Field(description="axes of this map")
    aside: int = Field(
        description="number of skipped experiments, whose offset is along a "
        "coordinate that is not an axis"
    )
    simulated: bool


class ThresholdMap(Answer):
    """A map at one threshold."""

    threshold: float
    words: str
    level: float
    confidence: float
    colours: list[str]
    colour: list[list[int]] = Field(description="index into `colours` by group and cell")
    chance: list[list[Finite]] = Field(
        description="probability that at least a share `level` of new experiments stays within "
        "the threshold"
    )
    inside: list[list[int]] = Field(description="1 for cells in the domain D(tau), else 0")
    count: dict[str, int]
    sizes: list[int] = Field(description="number of cells in D(tau) by group")
    command: str


class SuggestedExperiment(Answer):
    """An experiment that would teach much."""

    group: str
    cell: int
    where: str
    place: dict[str, str | float] = Field(description="values on the axes, in SI units")
    bits: float = Field(description="expected information [bit]")
    reason: str


class MapView(NamedTuple):
    """Map for every threshold.

    Attributes
    ----------
    kept : StoredAnalysis
    asked : DomainRequest
    gathered : DomainEvidence
    domain : DomainMap
    aside : int
        Number of experiments left out, since they were offset along something else.
    """

    kept: StoredAnalysis
    asked: DomainRequest
    gathered: DomainEvidence
    domain: DomainMap
    aside: int

    @property
    def thresholds(self) -> tuple[float, float]:
        """Smallest and largest useful threshold."""
        usual = self.domain.usual_thresholds
        low, high = float(usual[0]), float(usual[-1])
        floor = self.gathered.floor_mm
        if self.domain.measure == "absolute" and floor is not None:
            low = max(low, floor)
        return low, max(high, 1.1 * low)

    @property
    def usual_threshold(self) -> float:
        """Threshold that is shown first."""
        asked = self.asked.threshold
        if asked is not None and self.asked.measure == self.kept.analysis.question["measure"]:
            return asked
        return default_threshold(self.domain.evidence, self.domain.measure)


Key = tuple[str, ...]


@final
class DomainViews:
    """Stored maps of a project.

    Parameters
    ----------
    project : Project
    store : Store
    """

    def __init__(self, project: Project, store: Store) -> None:
        self._project = project
        self._store = store
        self._views: OrderedDict[Key, MapView] = OrderedDict()
        self._fits: Fits[Key, tuple[DomainMap, int]] = Fits(_spread_out)
        self._lock = threading.Lock()  # protects the views; nothing is computed while it is locked

    def maps(self) -> tuple[list[StoredAnalysis], list[FixelError]]:
        """Return the maps, newest first, and the errors of unreadable ones."""
        return load_with_errors(self._project, "domain")

    def view(
        self, name: str, axes: tuple[str, ...] = (), measure: Measure | None = None
    ) -> MapView:
        """Return a map along some axes; by default those it was made for.

        Raises
        ------
        NotStored
            There is no such analysis.
        JobRefused
            Its held-out errors are gone, or it is still being fitted to these axes.
        InvalidInput
            Axes or a measure that the experiments do not allow.
        """
        found = self._looked_up(name, axes, measure)
        if isinstance(found, BackgroundFit):
            found.ended.wait(PATIENCE)
            found = self._looked_up(name, axes, measure)
        if isinstance(found, BackgroundFit):
            raise JobRefused(
                f"the map is being fitted to these axes since {found.seconds:.0f} s",
                hint="repeat the request later",
            )
        return found

    def fit(
        self, name: str, axes: tuple[str, ...] = (), measure: Measure | None = None
    ) -> float | None:
        """Return the time for which a map has been fitted [s]; None if it is finished.

        Begins the fit if necessary. Raises as `view` does.
        """
        found = self._looked_up(name, axes, measure)
        return found.seconds if isinstance(found, BackgroundFit) else None

    def stop(self, name: str, axes: tuple[str, ...] = (), measure: Measure | None = None) -> None:
        """Stop the fit of a map, if there is one."""
        self._fits.stop(self._key(self._named(name), axes, measure))

    def _named(self, name: str) -> StoredAnalysis:
        one = next((one for one in self.maps()[0] if one.folder.name == name), None)
        if one is None:
            raise NotStored(f"map {name!r}", hint="make one with: fixel domain")
        return one

    def _key(self, one: StoredAnalysis, axes: tuple[str, ...], measure: Measure | None) -> Key:
        return (one.folder.name, one.analysis.created, *axes, measure or "")

    def _looked_up(
        self, name: str, axes: tuple[str, ...], measure: Measure | None
    ) -> MapView | BackgroundFit:
        """Return a finished map, or its running fit, which all requests share."""
        one = self._named(name)
        key = self._key(one, axes, measure)
        fit = self._fits.joined(key)
        if fit is not None:
            return fit
        with self._lock:  # after the fits: a finished fit becomes a view before it is removed there
            if key in self._views:
                self._views.move_to_end(key)
                return self._views[key]
        return self._begun(key, one, axes, measure)

    def _begun(
        self, key: Key, one: StoredAnalysis, axes: tuple[str, ...], measure: Measure | None
    ) -> MapView | BackgroundFit:
        asked = asked_again(one.analysis.question)
        changed = bool(axes) or (measure or asked.measure) != asked.measure
        if axes:
            asked = replace(asked, axes=axes, nominal={k: v for k, v in asked.nominal.items()
                                                       if k in axes})  # fmt: skip
        if measure is not None and measure != asked.measure:
            asked = replace(asked, measure=measure, threshold=None)
        gathered = self._gathered(one, asked)
        known = {} if changed else one.arrays

        def put(answer: tuple[DomainMap, int]) -> MapView:
            return self._put(key, MapView(one, asked, gathered, *answer))

        if is_fitted(known):
            return put(spread_out(gathered, asked, known))
        refuse_axes(gathered, asked)
        return self._fits.begun(key, (gathered, asked), put)

    def _gathered(self, one: StoredAnalysis, asked: DomainRequest) -> DomainEvidence:
        newest = next(iter(one.analysis.calibrations), None)
        mark = str(one.analysis.numbers.get("evidence", "")) or mark_of(self._store, asked, newest)
        gathered = gathered_before(self._project, self._store, asked, mark)
        if gathered is None:
            raise JobRefused(
                "the errors of this map are no longer stored, or the project has changed",
                hint=f"compute the map again: {one.analysis.command or 'fixel domain'}",
            )
        return gathered

    def _put(self, key: Key, view: MapView) -> MapView:
        with self._lock:
            self._views[key] = view
            while len(self._views) > MAX_MAPS:
                self._views.popitem(last=False)
        return view


def _spread_out(question: tuple[DomainEvidence, DomainRequest]) -> tuple[DomainMap, int]:
    return spread_out(*question)


def document(view: MapView) -> MapDocument:
    """Return what a page needs to draw a map at any threshold.

    Raises
    ------
    InvalidInput
        It has too many cells for a page.
    """
    domain, question = view.domain, view.kept.analysis.question
    cells, groups = domain.cells, domain.groups[:MAX_GROUPS]
    if len(cells) * len(groups) > MAX_CELLS:
        raise InvalidInput("axis", found="more cells than this page can show", expected="fewer")
    low, high = view.thresholds
    return MapDocument(
        name=view.kept.folder.name,
        title=view.kept.analysis.title,
        measure=domain.measure,
        unit="mm" if domain.measure == "absolute" else "",
        low=low,
        high=high,
        threshold=min(max(view.usual_threshold, low), high),
        level=float(question["level"]),
        confidence=float(question["confidence"]),
        floor_mm=view.gathered.floor_mm,
        floor_from=view.gathered.floor_from,
        calibration=view.gathered.calibration,
        groups=list(groups),
        omitted=len(domain.groups) - len(groups),
        panels=_panels(cells),
        texts=[cells.text(c) for c in range(len(cells))],
        nominal=cells.nominal,
        counts=domain.counts[:MAX_GROUPS].tolist(),
        points=_points(view),
        axes=_axes_offered(view),
        chosen=[axis.name for axis in cells.axes],
        aside=view.aside,
        simulated=not view.gathered.is_real,
    )


def claim_of(view: MapView, threshold: float | None, level: float, confidence: float) -> Claim:
    """Return the claim that a map is to be judged by; by default at its usual threshold."""
    return Claim(
        threshold=view.usual_threshold if threshold is None else threshold,
        measure=view.domain.measure,
        level=level,
        confidence=confidence,
    )


def at_threshold(view: MapView, claim: Claim, folder: Path) -> ThresholdMap:
    """Evaluate a map of the project in a folder at the threshold of a claim."""
    domain = view.domain
    verdicts = domain.verdicts(claim)
    colour = [[COLOURS.index(verdict.colour) for verdict in own] for own in verdicts]
    cells = range(len(domain.cells))
    inside = []
    for own in verdicts[:MAX_GROUPS]:
        connected = set(domain.cells.component([v.colour == TRUSTED for v in own]))
        inside.append([int(c in connected) for c in cells])
    return ThresholdMap(
        threshold=claim.threshold,
        words=claim.text(),
        level=claim.level,
        confidence=claim.confidence,
        colours=list(COLOURS),
        colour=colour[:MAX_GROUPS],
        chance=[[round(v.confidence, 4) for v in own] for own in verdicts[:MAX_GROUPS]],
        inside=inside,
        count={name: sum(own.count(k) for own in colour) for k, name in enumerate(COLOURS)},
        sizes=[sum(own) for own in inside],
        command=command_of(folder, view.asked, claim),
    )


def suggested(view: MapView, claim: Claim, most: int = 3) -> list[SuggestedExperiment]:
    """Propose the most informative experiments."""
    cells = view.domain.cells
    return [
        SuggestedExperiment(
            group=one.group,
            cell=one.cell,
            where=one.where,
            place={
                axis.name: axis.labels[k] if axis.is_text else axis.centres[k]
                for axis, k in zip(cells.axes, cells.index[one.cell], strict=True)
            },
            bits=one.bits,
            reason=one.reason,
        )
        for one in view.domain.proposals(claim, most)
    ]


def _axes_offered(view: MapView) -> list[MapAxis]:
    """Return coordinates that differ among the experiments and can be an axis."""
    found = []
    for name, column in sorted(view.gathered.evidence.coordinates.items()):
        values = {value for value in column if value is not None}
        text = any(isinstance(value, str) for value in values)
        if len(values) > 1 and not (text and len(values) > MAX_ON_AXIS):
            found.append(MapAxis(name=name, distinct=len(values)))
    return found


def _points(view: MapView) -> list[MapPoint]:
    """Held-out errors in the unit of the threshold: mm, or a share above the own best."""
    domain, evidence = view.domain, view.domain.evidence
    number = {group: g for g, group in enumerate(domain.groups)}
    return [
        MapPoint(
            id=evidence.ids[k],
            key=evidence.keys[k],
            group=number[evidence.group[k]],
            cell=cell,
            error=value_of(score, domain.measure) if np.isfinite(score) else score,
            fold=int(evidence.fold[k]),
        )
        for k, (cell, score) in enumerate(
            zip(domain.place.tolist(), domain.scores.tolist(), strict=True)
        )
        if cell >= 0 and not np.isnan(score)
    ]


def _panels(cells: Cells) -> list[DomainPanel]:
    """One strip per axis through the nominal if experiments differ along one at a time; else one
    grid."""
    number = {index: c for c, index in enumerate(cells.index)}
    if not is_strips(cells):
        across, up = cells.axes
        grid = [[number[i, j] for i in range(len(across))] for j in range(len(up))]
        return [DomainPanel(across=_ticks(across), up=_ticks(up), cells=grid)]
    centre = cells.index[cells.nominal]
    strips = [
        [number[(*centre[:a], k, *centre[a + 1 :])] for k in range(len(axis))]
        for a, axis in enumerate(cells.axes)
    ]
    return [
        DomainPanel(across=_ticks(axis), up=None, cells=[strip])
        for axis, strip in zip(cells.axes, strips, strict=True)
    ]


def is_strips(cells: Cells) -> bool:
    """Whether each axis is shown by itself."""
    return cells.arms or len(cells.axes) == 1


def _ticks(axis: CellAxis) -> AxisTicks:
    return AxisTicks(name=axis.name, unit=axis.unit, ticks=[axis.text(k) for k in range(len(axis))])
