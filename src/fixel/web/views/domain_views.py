"""Stored maps at any threshold: their cells, verdicts and suggested experiments."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.domain.cells import CellAxis, Cells
from fixel.domain.claim import COLOURS, TRUSTED, CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.evidence import value_of
from fixel.errors import InvalidInput, JobRefused, refused_value
from fixel.web.values import Answer, Finite, Number, several
from fixel.workflows.analysis import StoredAnalysis, find_analysis
from fixel.workflows.domain.evidence import DomainEvidence, ProjectRequest, load_evidence
from fixel.workflows.domain.mapping import claimed, map_of
from fixel.workflows.domain.run import DOMAIN

MAX_GROUPS: Final = 40
MAX_CELLS: Final = 40_000  # of all groups
AT_ONCE: Final = 500  # cells of all groups for which suggestions come with the page
STEPS: Final = 1000  # of the slider of thresholds
# Class, sign and meaning of each colour, in the order of `COLOURS`; signs tell what colours tell.
MAP_KEY: Final = (
    ("trusted p100", "✓", "trusted: errors stay within the threshold"),
    ("doubtful p50", "?", "doubtful: too few experiments"),
    ("not-trusted p0", "✕", "not trusted: errors exceed the threshold"),
    ("no-data", "", "no experiment"),
    ("predicted", "◌", "no experiment; predicted from other cells"),
)


class AxisTicks(Answer):
    """An axis of the map."""

    name: str
    unit: str = Field(description="unit of the tick labels")
    label: str = Field(description="name and unit for people")
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
    error: Finite = Field(
        description="error in the unit of the threshold; null if the simulation failed"
    )
    within: bool = Field(description="whether the error is at most the threshold")


class MapCell(Answer):
    """A cell of the map of one group, at the threshold of a claim."""

    where: str
    colour: str
    chance: Finite = Field(
        description="probability that at least the share of the claim of new experiments stays "
        "within the threshold"
    )
    percent: int | None = Field(description="the same as text for people")
    inside: bool = Field(description="whether the cell is in the domain D(tau)")
    experiments: list[MapPoint] = Field(description="held-out experiments, largest error first")


class MapDocument(Answer):
    """A map at the threshold of a claim."""

    name: str
    title: str
    claim: Claim
    unit: str = Field(description="unit of thresholds and errors: mm, or empty for relative errors")
    low: float = Field(description="smallest useful threshold; errors below it are noise")
    high: float
    groups: list[str] = Field(description="names of the groups, one map for each")
    panels: list[DomainPanel]
    centre: int = Field(description="index of the nominal cell")
    verdicts: list[list[MapCell]] = Field(description="verdicts on cells, by group and index")
    figures: list[tuple[str, str]] = Field(description="counts of cells, with their titles")
    remarks: list[str] = Field(description="sentences about experiments and maps left out")
    simulated: bool
    command: str

    @property
    def slider(self) -> int:
        """Place of the threshold between the lowest and the highest one, on a logarithmic scale."""
        share = np.log(self.claim.threshold / self.low) / np.log(self.high / self.low)
        return round(STEPS * float(share))


class ClaimQuery(BaseModel):
    """Claim that a map is checked for; by default the one that it was made for."""

    threshold: Number | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="threshold [mm], or as a share above the smallest error of the experiment",
    )
    level: Number | None = Field(None, gt=0.0, lt=1.0)
    confidence: Number | None = Field(None, gt=0.5, lt=1.0)

    def claim(self, view: MapView) -> Claim:
        """Return the claim for a map."""
        return replace(view.domain.claimed, **self.model_dump(exclude_none=True))


class SuggestedExperiment(Answer):
    """An experiment that would teach much."""

    group: str
    cell: int
    where: str
    place: dict[str, str | float] = Field(description="values on the axes, in SI units")
    bits: float = Field(description="expected information [bit]")
    reason: str


class MapView(NamedTuple):
    """Stored map with its evidence."""

    kept: StoredAnalysis
    gathered: DomainEvidence
    domain: DomainMap
    n_aside: int  # number of experiments left out, as they were offset along something else


def load_view(project: Project, records: Store, name: str, created: str) -> MapView:
    """Return the map stored in the folder of a name.

    Its surface is fitted again if it was too large to be stored. The time of creation is for the
    cache of this function. Raise `NotStored` without such an analysis, and `JobRefused` if its
    held-out errors are gone or an earlier version has made it.
    """
    one = find_analysis(project, name, "domain")
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


def document(view: MapView, claim: Claim, folder: Path) -> MapDocument:
    """Return a map of the project in a folder at the threshold of a claim.

    A map with too many cells for a page raises `InvalidInput`.
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
    if n := view.n_aside:
        remarks.append(
            f"Skipped {several(n, 'experiment')}: offset along a coordinate without an axis."
        )
    if n := len(domain.groups) - len(groups):
        remarks.append(f"{several(n, 'more map')} cannot be shown here.")
    verdicts = domain.verdicts(claim)
    inside = [cells.component([v.colour == TRUSTED for v in own]) for own in verdicts]
    lying = _points(domain, claim)
    return MapDocument(
        name=view.kept.folder.name,
        title=view.kept.analysis.title,
        claim=claim,
        unit="mm" if domain.measure == "absolute" else "",
        low=low,
        high=max(high, 1.1 * low),
        groups=list(groups),
        panels=_panels(cells),
        centre=cells.nominal,
        verdicts=[
            [
                MapCell(
                    where=cells.text(c),
                    colour=verdict.colour,
                    chance=round(verdict.confidence, 4),
                    percent=_percent(verdict, claim),
                    inside=c in set_inside,
                    experiments=lying[group, c],
                )
                for c, verdict in enumerate(own)
            ]
            for group, own, set_inside in zip(groups, verdicts, map(set, inside), strict=False)
        ],
        figures=_figures([v.colour for own in verdicts for v in own], inside, len(cells)),
        remarks=remarks,
        simulated=not view.gathered.is_real,
        command=DOMAIN.command(claimed(DOMAIN.request(view.kept.analysis.request), claim), folder),
    )


def _figures(
    colours: Sequence[str], inside: Sequence[Sequence[int]], n: int
) -> list[tuple[str, str]]:
    """Return counts of cells with their titles."""
    count = [colours.count(colour) for colour in COLOURS]
    low, high = min(map(len, inside)), max(map(len, inside))
    size = f"{low}" if low == high else f"{low} to {high}"
    return [
        *((f"{MAP_KEY[k][1]} {COLOURS[k]}", str(count[k])) for k in range(3)),
        ("no experiment", str(sum(count[3:]))),
        ("cells in D(τ)", f"{size} of {n}"),
    ]


def _percent(verdict: CellVerdict, claim: Claim) -> int | None:
    """Return a probability in per cent; one below a confidence is not rounded up to it."""
    if not np.isfinite(verdict.confidence):
        return None
    percent = int(100.0 * verdict.confidence + 0.5)
    below = verdict.confidence < claim.confidence and percent >= 100.0 * claim.confidence - 1e-9
    return percent - int(below)


def suggested(view: MapView, claim: Claim) -> list[SuggestedExperiment]:
    """Propose the most informative experiments."""
    found = view.domain.proposals(claim, 3)
    return [
        SuggestedExperiment(place=view.domain.cells.values(one.cell), **one._asdict())
        for one in found
    ]


def _points(domain: DomainMap, claim: Claim) -> dict[tuple[str, int], list[MapPoint]]:
    """Held-out errors by group and cell in the unit of the threshold: mm, or a share above the own
    best."""
    evidence, found = domain.evidence, defaultdict(list)
    scores = zip(domain.place.tolist(), domain.scores.tolist(), strict=True)
    known = [(k, cell, s) for k, (cell, s) in enumerate(scores) if cell >= 0 and not np.isnan(s)]
    for k, cell, score in sorted(known, key=lambda one: -one[2]):
        error = value_of(score, domain.measure) if np.isfinite(score) else score
        point = MapPoint(
            id=evidence.ids[k],
            key=evidence.keys[k],
            error=error,
            within=bool(error <= claim.threshold),
        )
        found[evidence.group[k], cell].append(point)
    return found


def _panels(cells: Cells) -> list[DomainPanel]:
    """One strip per axis through the nominal if experiments differ along one at a time; else one
    grid."""
    if not cells.is_strips:
        across, up = cells.axes
        return [DomainPanel(across=_ticks(across), up=_ticks(up), rows=cells.grid(0, 1).tolist())]
    return [
        DomainPanel(across=_ticks(axis), up=None, rows=cells.grid(a, None).tolist())
        for a, axis in enumerate(cells.axes)
    ]


def _ticks(axis: CellAxis) -> AxisTicks:
    ticks = [axis.text(k) for k in range(len(axis))]
    return AxisTicks(name=axis.name, unit=axis.unit, label=axis.label, ticks=ticks)


def shown_map(view: MapView, query: Mapping[str, str], folder: Path) -> dict[str, Any]:
    """Return what the page shows of a map: at the threshold and for the cell of a query.

    Raise `InvalidInput` if no claim has such a threshold, or the map has too many cells for a page.
    """
    given = {name: query[name] for name in ClaimQuery.model_fields if query.get(name)}
    try:
        claim = ClaimQuery.model_validate(given).claim(view)
    except ValidationError as problem:
        raise refused_value(problem) from None
    drawn = document(view, claim, folder)
    # The cell that was clicked now, or else before.
    group, _, cell = (query.get("cell") or query.get("picked") or "").partition(" ")
    known = group.isdecimal() and cell.isdecimal() and int(group) < len(drawn.groups)
    at_once = len(drawn.verdicts) * len(drawn.verdicts[0]) <= AT_ONCE or bool(query.get("suggest"))
    return {
        "drawn": drawn,
        "picked": (int(group), int(cell)) if known and int(cell) < len(drawn.verdicts[0]) else None,
        "suggested": suggested(view, claim) if at_once else None,
    }
