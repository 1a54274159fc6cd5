"""Stored maps at any threshold: their cells, verdicts and suggested experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.cells import CellAxis, Cells
from fixel.domain.claim import COLOURS, TRUSTED, CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.evidence import value_of
from fixel.errors import InvalidInput, JobRefused, NotStored
from fixel.web.values import Answer, Finite
from fixel.workflows.analysis import StoredAnalysis, find_analysis
from fixel.workflows.domain.evidence import DomainEvidence, load_evidence
from fixel.workflows.domain.fits import ProjectRequest
from fixel.workflows.domain.mapping import claimed, map_of
from fixel.workflows.domain.run import DOMAIN

MAX_GROUPS: Final = 40
MAX_CELLS: Final = 40_000  # of all groups
# Class, sign and meaning of each colour, in the order of `COLOURS`; signs tell what colours tell.
MAP_KEY: Final = (
    ("trusted", "✓", "trusted: errors stay within the threshold"),
    ("doubtful", "?", "doubtful: too few experiments"),
    ("not-trusted", "✕", "not trusted: errors exceed the threshold"),
    ("no-data", "", "no experiment"),
    ("predicted", "◌", "no experiment; predicted from other cells"),
)


class AxisTicks(Answer):
    """An axis of the map."""

    name: str
    unit: str = Field(description="unit of the tick labels")
    ticks: list[str]


class DomainPanel(Answer):
    """A strip along one axis, or a grid over two."""

    across: AxisTicks
    up: AxisTicks | None
    rows: list[list[int]] = Field(description="indices of the cells, by row from the bottom")


class MapPoint(Answer):
    """An experiment that was held out."""

    id: int
    key: str
    group: int
    cell: int
    error: Finite = Field(
        description="error in the unit of the threshold; null if the simulation failed"
    )


class MapDocument(Answer):
    """A map for every threshold: its cells and what lies in them."""

    name: str
    title: str
    unit: str = Field(description="unit of thresholds and errors: mm, or empty for relative errors")
    low: float = Field(description="smallest useful threshold; errors below it are noise")
    high: float
    groups: list[str] = Field(description="names of the groups, one map for each")
    panels: list[DomainPanel]
    texts: list[str] = Field(description="description of each cell")
    centre: int = Field(description="index of the nominal cell")
    points: list[MapPoint]
    remarks: list[str] = Field(description="sentences about experiments and maps left out")
    simulated: bool


class ThresholdMap(Answer):
    """A map at one threshold."""

    colours: list[str]
    colour: list[list[int]] = Field(description="index into `colours` by group and cell")
    chance: list[list[Finite]] = Field(
        description="probability that at least the share of the claim of new experiments stays "
        "within the threshold"
    )
    percent: list[list[int | None]] = Field(description="the same as text for people")
    inside: list[list[int]] = Field(description="1 for cells in the domain D(tau), else 0")
    figures: list[tuple[str, str]] = Field(description="counts of cells, with their titles")
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
    """Stored map with its evidence.

    Attributes
    ----------
    kept : StoredAnalysis
    gathered : DomainEvidence
    domain : DomainMap
    n_aside : int
        Number of experiments left out, since they were offset along something else.
    """

    kept: StoredAnalysis
    gathered: DomainEvidence
    domain: DomainMap
    n_aside: int


def find_map(project: Project, name: str) -> StoredAnalysis:
    """Return a stored map by the name of its folder."""
    one = find_analysis(project, name, "domain")
    if one is None:
        raise NotStored(f"map {name!r}", hint="make one with: fixel domain")
    return one


def load_view(project: Project, records: Store, name: str, created: str) -> MapView:
    """Return a stored map; its surface is fitted again if it was too large to be stored.

    Parameters
    ----------
    project : Project
    records : Store
    name : str
        Name of its folder.
    created : str
        Time of creation, for the cache of this function.

    Raises
    ------
    NotStored
        There is no such analysis.
    JobRefused
        Its held-out errors are gone, or an earlier version has made it.
    """
    one = find_map(project, name)
    again = f"compute the map again: {one.analysis.command or 'fixel domain'}"
    if not one.analysis.request:
        raise JobRefused("an earlier version of fixel has made this map", hint=again)
    asked = DOMAIN.request(one.analysis.request)
    gathered = load_evidence(
        ProjectRequest(project, records, asked), str(one.analysis.numbers["evidence"])
    )
    if gathered is None:
        raise JobRefused(
            "the errors of this map are no longer stored, or the project has changed", hint=again
        )
    return MapView(one, gathered, *map_of(gathered, asked, one.arrays))


def document(view: MapView) -> MapDocument:
    """Return what a page needs to draw a map at any threshold.

    Raises
    ------
    InvalidInput
        It has too many cells for a page.
    """
    domain, found = view.domain, view.gathered.found
    cells, groups = domain.cells, domain.groups[:MAX_GROUPS]
    if len(cells) * len(groups) > MAX_CELLS:
        raise InvalidInput("axis", found="more cells than this page can show", expected="fewer")
    low, high = domain.usual_thresholds[[0, -1]].tolist()
    floor, remarks = found["floor_mm"], []
    if floor is not None:
        remarks.append(f"Measurement noise: {floor:.2g} mm ({found['floor_from']}).")
        low = max(low, floor) if domain.measure == "absolute" else low
    high = max(high, 1.1 * low)
    if n := view.n_aside:
        remarks.append(
            f"{n} experiments are skipped: their offset is along a coordinate without an axis."
        )
    if n := len(domain.groups) - len(groups):
        remarks.append(f"{n} more maps cannot be shown here.")
    return MapDocument(
        name=view.kept.folder.name,
        title=view.kept.analysis.title,
        unit="mm" if domain.measure == "absolute" else "",
        low=low,
        high=high,
        groups=list(groups),
        panels=_panels(cells),
        texts=[cells.text(c) for c in range(len(cells))],
        centre=cells.nominal,
        points=_points(domain),
        remarks=remarks,
        simulated=not view.gathered.is_real,
    )


def at_threshold(view: MapView, claim: Claim, folder: Path) -> ThresholdMap:
    """Evaluate a map of the project in a folder at the threshold of a claim."""
    domain = view.domain
    verdicts = domain.verdicts(claim)
    colour = [[COLOURS.index(verdict.colour) for verdict in own] for own in verdicts]
    inside = []
    for own in verdicts[:MAX_GROUPS]:
        connected = set(domain.cells.component([v.colour == TRUSTED for v in own]))
        inside.append([int(c in connected) for c in range(len(domain.cells))])
    count = [sum(own.count(k) for own in colour) for k in range(len(COLOURS))]
    figures = [(f"{MAP_KEY[k][1]} {COLOURS[k]}", str(count[k])) for k in range(3)]
    low, high = (end(sum(own) for own in inside) for end in (min, max))
    size = f"{low}" if low == high else f"{low} to {high}"
    return ThresholdMap(
        colours=list(COLOURS),
        colour=colour[:MAX_GROUPS],
        chance=[[round(v.confidence, 4) for v in own] for own in verdicts[:MAX_GROUPS]],
        percent=[[_percent(v, claim) for v in own] for own in verdicts[:MAX_GROUPS]],
        inside=inside,
        figures=[
            *figures,
            ("no experiment", str(sum(count[3:]))),
            ("cells in D(τ)", f"{size} of {len(domain.cells)}"),
        ],
        command=DOMAIN.command(claimed(DOMAIN.request(view.kept.analysis.request), claim), folder),
    )


def _percent(verdict: CellVerdict, claim: Claim) -> int | None:
    """Return a probability in per cent; one below a confidence is not rounded up to it."""
    if not np.isfinite(verdict.confidence):
        return None
    percent = int(100.0 * verdict.confidence + 0.5)
    below = verdict.confidence < claim.confidence and percent >= 100.0 * claim.confidence - 1e-9
    return percent - int(below)


def suggested(view: MapView, claim: Claim, most: int = 3) -> list[SuggestedExperiment]:
    """Propose the most informative experiments."""
    found = view.domain.proposals(claim, most)
    return [
        SuggestedExperiment(
            group=one.group,
            cell=one.cell,
            where=one.where,
            place=view.domain.cells.values(one.cell),
            bits=one.bits,
            reason=one.reason,
        )
        for one in found
    ]


def _points(domain: DomainMap) -> list[MapPoint]:
    """Held-out errors in the unit of the threshold: mm, or a share above the own best."""
    evidence, number = domain.evidence, {group: g for g, group in enumerate(domain.groups)}
    return [
        MapPoint(
            id=evidence.ids[k],
            key=evidence.keys[k],
            group=number[evidence.group[k]],
            cell=cell,
            error=value_of(score, domain.measure) if np.isfinite(score) else score,
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
    if not cells.is_strips:
        across, up = cells.axes
        grid = [[number[i, j] for i in range(len(across))] for j in range(len(up))]
        return [DomainPanel(across=_ticks(across), up=_ticks(up), rows=grid)]
    centre = cells.index[cells.nominal]
    strips = [
        [number[(*centre[:a], k, *centre[a + 1 :])] for k in range(len(axis))]
        for a, axis in enumerate(cells.axes)
    ]
    return [
        DomainPanel(across=_ticks(axis), up=None, rows=[strip])
        for axis, strip in zip(cells.axes, strips, strict=True)
    ]


def _ticks(axis: CellAxis) -> AxisTicks:
    return AxisTicks(name=axis.name, unit=axis.unit, ticks=[axis.text(k) for k in range(len(axis))])
