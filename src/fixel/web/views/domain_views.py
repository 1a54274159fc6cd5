"""Stored maps under other thresholds at once, and along other axes after a while.

The fits of the cross-validation are not repeated: held-out errors are read from the stored
analysis. The variation of errors over other axes is fitted again, which takes from a second to
minutes, in a process of its own that is shared by clients and stopped when unused.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.cells import CellAxis, Cells
from fixel.domain.domain import COLOURS, TRUSTED, Claim, DomainMap, default_threshold
from fixel.domain.evidence import HeldOutErrors, Measure, value_of
from fixel.domain.next_experiment import Proposal, proposals
from fixel.errors import FixelError, JobRefused, NotStored
from fixel.typing import FloatArray, IntArray
from fixel.web.views.background_fits import BackgroundFit, Fits
from fixel.workflows.analysis import StoredAnalysis, kept_and_not
from fixel.workflows.domain.evidence import DomainEvidence, gathered_before, mark_of
from fixel.workflows.domain.request import DomainRequest, asked_again
from fixel.workflows.domain.run import is_fitted, refuse_axes, spread_out

MAX_MAPS: Final = 12  # in memory
PATIENCE: Final = 2.0  # [s] that a request for a map waits for it
MAX_GROUPS: Final = 40
MAX_ON_AXIS: Final = 60  # values of a text that can be an axis


class MapAxis(NamedTuple):
    """Coordinate that can be an axis of the map."""

    name: str
    distinct: int


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
    table : list of list of list of int
        Cells of every strip or grid: panels, rows from below, columns.
    """

    kept: StoredAnalysis
    asked: DomainRequest
    gathered: DomainEvidence
    domain: DomainMap
    aside: int
    table: list[list[list[int]]]

    @property
    def cells(self) -> Cells:
        """Cells of the map."""
        return self.domain.cells

    @property
    def evidence(self) -> HeldOutErrors:
        """Held-out errors of the map."""
        return self.domain.evidence

    @property
    def is_strips(self) -> bool:
        """Whether each axis is shown by itself."""
        return self.cells.arms or len(self.cells.axes) == 1

    def axes_of(self, panel: int) -> tuple[CellAxis, CellAxis | None]:
        """Axes of one panel: across and up."""
        axes = self.cells.axes
        return (axes[panel], None) if self.is_strips else (axes[0], axes[1])

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
        return default_threshold(self.evidence, self.domain.measure)


class ThresholdMap(NamedTuple):
    """A map at one threshold.

    Attributes
    ----------
    claim : Claim
    chance : (n_group, n_cell) float64
        Probability that the claim holds; nan without data.
    colour : (n_group, n_cell) int
        Indices into `COLOURS`.
    inside : (n_group, n_cell) bool
        Whether a cell belongs to D(tau).
    counts : dict from colour to int
    """

    claim: Claim
    chance: FloatArray
    colour: IntArray
    inside: IntArray
    counts: dict[str, int]


Key = tuple[str, ...]


@final
class DomainDesk:
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
        return kept_and_not(self._project, "domain")

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
                f"the map is being fitted to these axes, for {found.seconds:.0f} s so far",
                hint="ask again in a while",
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
        if is_fitted(known):
            domain, aside = spread_out(gathered, asked, known)
            return self._put(
                key, MapView(one, asked, gathered, domain, aside, _table(domain.cells))
            )
        refuse_axes(gathered, asked)

        def put(answer: tuple[DomainMap, int]) -> None:
            domain, aside = answer
            self._put(key, MapView(one, asked, gathered, domain, aside, _table(domain.cells)))

        return self._fits.begun(key, (gathered, asked), put)

    def _gathered(self, one: StoredAnalysis, asked: DomainRequest) -> DomainEvidence:
        newest = next(iter(one.analysis.calibrations), None)
        mark = str(one.analysis.numbers.get("evidence", "")) or mark_of(self._store, asked, newest)
        gathered = gathered_before(self._project, self._store, asked, mark)
        if gathered is None:
            raise JobRefused(
                "the errors this map rests on are not kept any more, or the project has changed",
                hint=f"make it again with: {one.analysis.command or 'fixel domain'}",
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


def shown(view: MapView, threshold: float | None, level: float, confidence: float) -> ThresholdMap:
    """Evaluate a map at a threshold; by default its usual one."""
    domain = view.domain
    claim = Claim(
        threshold=view.usual_threshold if threshold is None else threshold,
        measure=domain.measure,
        level=level,
        confidence=confidence,
    )
    verdicts = domain.verdicts(claim)
    colours = [[COLOURS.index(verdict.colour) for verdict in own] for own in verdicts]
    chance = [[verdict.confidence for verdict in own] for own in verdicts]
    inside = np.zeros(domain.counts.shape, np.int64)
    for g, own in enumerate(verdicts):
        inside[g, domain.cells.component([v.colour == TRUSTED for v in own])] = 1
    every = np.array(colours)
    counts = {name: int((every == k).sum()) for k, name in enumerate(COLOURS)}
    return ThresholdMap(claim, np.array(chance), every, inside, counts)


def suggested(view: MapView, claim: Claim, most: int = 3) -> list[Proposal]:
    """Propose the most informative experiments."""
    return proposals(view.domain, claim, most)


def axes_offered(view: MapView) -> list[MapAxis]:
    """Return coordinates that differ among the experiments and can be an axis."""
    found = []
    for name, column in sorted(view.gathered.evidence.coordinates.items()):
        values = {value for value in column if value is not None}
        text = any(isinstance(value, str) for value in values)
        if len(values) > 1 and not (text and len(values) > MAX_ON_AXIS):
            found.append(MapAxis(name, len(values)))
    return found


def held_out_mm(view: MapView) -> FloatArray:
    """(n,) held-out errors in the unit of the threshold: mm, or a share above the own best."""
    scores = view.domain.scores
    return np.array([value_of(s, view.domain.measure) if np.isfinite(s) else s for s in scores])


def place_of(cells: Cells, c: int) -> dict[str, str | float]:
    """Values of a cell by axis [SI]."""
    return {
        axis.name: axis.labels[k] if axis.is_text else axis.centres[k]
        for axis, k in zip(cells.axes, cells.index[c], strict=True)
    }


def _table(cells: Cells) -> list[list[list[int]]]:
    """One strip per axis through the nominal if experiments differ along one at a time; else one
    grid, its rows from below."""
    number = {index: c for c, index in enumerate(cells.index)}
    if not (cells.arms or len(cells.axes) == 1):
        across, up = cells.axes
        return [[[number[i, j] for i in range(len(across))] for j in range(len(up))]]
    centre = cells.index[cells.nominal]
    return [
        [[number[(*centre[:a], k, *centre[a + 1 :])] for k in range(len(axis))]]
        for a, axis in enumerate(cells.axes)
    ]
