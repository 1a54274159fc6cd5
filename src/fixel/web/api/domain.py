"""Domain of applicability: stored maps at any threshold."""

from __future__ import annotations

import math
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from fixel.domain.domain import COLOURS
from fixel.errors import InvalidInput, NotStored
from fixel.web.api._values import RequestBody, Text
from fixel.web.views import job_list
from fixel.web.views.domain_views import (
    MAX_GROUPS,
    DomainDesk,
    MapView,
    axes_offered,
    held_out_mm,
    place_of,
    shown,
    suggested,
)
from fixel.workflows import jobs
from fixel.workflows.domain import job
from fixel.workflows.domain.request import DomainRequest, command_of

if TYPE_CHECKING:
    from fixel.domain.cells import CellAxis
    from fixel.web.project import ProjectContext
    from fixel.workflows.analysis import StoredAnalysis

Measure = Literal["absolute", "relative"]
Threshold = Annotated[
    float | None, Query(gt=0.0, le=1e6, description="[mm], or a share above the own best")
]
Level = Annotated[float, Query(gt=0.0, lt=1.0)]
Confidence = Annotated[float, Query(gt=0.5, lt=1.0)]
AxisNames = Annotated[
    list[Text] | None, Query(alias="axis", max_length=3, description="those it was made for, else")
]


class MapOut(BaseModel):
    """A kept map."""

    name: str
    title: str
    created_utc: str
    headline: list[str]
    warnings: list[str]
    command: str


class DomainJobOut(BaseModel):
    """A map that is being made."""

    name: str
    state: str
    ended: bool
    reason: str
    fits: int
    total: int = Field(description="0 where nobody knows yet")


class MapsOut(BaseModel):
    """All kept maps, the newest first."""

    maps: list[MapOut]
    jobs: list[DomainJobOut]
    unreadable: list[str] = Field(description="why other maps and jobs cannot be shown")
    command: str = Field(description="what to type for the first")


class StripOut(BaseModel):
    """An axis of the map."""

    name: str
    unit: str = Field(description="of the texts")
    ticks: list[str]


class PanelOut(BaseModel):
    """A strip along one axis, or a grid over two."""

    across: StripOut
    up: StripOut | None
    cells: list[list[int]] = Field(description="numbers of the cells, rows from below")


class PointOut(BaseModel):
    """An experiment that was held out."""

    id: int
    key: str
    group: int
    cell: int
    error: float | None = Field(description="in the unit of the threshold; none where it failed")
    fold: int


class MapAxisOut(BaseModel):
    """A coordinate the map may go over."""

    name: str
    distinct: int


class ViewOut(BaseModel):
    """A map for every threshold: its cells and what lies in them."""

    name: str
    title: str
    measure: Measure
    unit: str = Field(description="of thresholds and errors: mm, or empty for shares")
    low: float = Field(description="least threshold of use: below, noise")
    high: float
    threshold: float = Field(description="where one looks first")
    level: float
    confidence: float
    floor_mm: float | None = Field(description="what the measurement alone makes")
    floor_from: str
    calibration: int | None
    groups: list[str] = Field(description="a map each")
    omitted: int = Field(description="maps beyond these")
    panels: list[PanelOut]
    texts: list[str] = Field(description="of every cell")
    nominal: int = Field(description="number of a cell")
    counts: list[list[int]] = Field(description="experiments, by group and cell")
    points: list[PointOut]
    axes: list[MapAxisOut]
    chosen: list[str] = Field(description="axes of this map")
    aside: int = Field(description="experiments left out: offset along something that is no axis")
    simulated: bool


class ShownOut(BaseModel):
    """A map at one threshold."""

    threshold: float
    words: str
    level: float
    confidence: float
    colours: list[str]
    colour: list[list[int]] = Field(description="places in `colours`, by group and cell")
    chance: list[list[float | None]] = Field(
        description="probability that at least a share `level` of new experiments stays within"
    )
    inside: list[list[int]] = Field(description="1 in the domain D(tau)")
    count: dict[str, int]
    sizes: list[int] = Field(description="cells in D(tau), by group")
    command: str


class ProposalOut(BaseModel):
    """An experiment that would teach much."""

    group: str
    cell: int
    where: str
    place: dict[str, str | float] = Field(description="SI units")
    bits: float = Field(description="expected to settle")
    reason: str


class NextOut(BaseModel):
    """Experiments to try next."""

    proposals: list[ProposalOut]
    command: str


class FitOut(BaseModel):
    """Progress of the fit of a map."""

    ready: bool
    seconds: float = Field(description="for how long it has been fitted to these axes")


class DomainIn(RequestBody):
    """A map to make."""

    by: list[Annotated[Text, Field(min_length=1, max_length=80)]] = Field(
        default_factory=list, max_length=3, description="conditions with a map of their own each"
    )


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/domain`."""
    found = APIRouter(tags=["domain"])
    at_hand = DomainDesk(desk.project, desk.store)

    @found.get("/domain", summary="Kept maps")
    def maps() -> MapsOut:
        kept_ones, bad_maps = at_hand.maps()
        own_jobs, bad_jobs = job.jobs_of(desk.project)
        return MapsOut(
            maps=[_listed(one) for one in kept_ones],
            jobs=[_job(one) for one in own_jobs],
            unreadable=[str(problem) for problem in (*bad_maps, *bad_jobs)],
            command=_first_command(desk, ()),
        )

    @found.post("/domain", summary="Make a map, in a process of its own")
    def begin(wanted: DomainIn) -> DomainJobOut:
        asked = DomainRequest(by=tuple(wanted.by))
        with job_list.room(desk.project.folder):
            folder = job.begin(desk.project, asked, _first_command(desk, wanted.by))
        return _job(jobs.status_of(folder))

    @found.post("/domain/jobs/{name}/stop", summary="Stop making a map; its fits are kept")
    def stop(name: str) -> DomainJobOut:
        own_jobs, _ = job.jobs_of(desk.project)
        own = next((one for one in own_jobs if FilePath(one.folder).name == name), None)
        if own is None:
            raise NotStored(f"job {name!r}", hint="see the page Domain")
        return _job(jobs.cancel(FilePath(own.folder)))

    @found.get("/domain/{name}", summary="A map for every threshold")
    def view(name: str, axis: AxisNames = None, measure: Measure | None = None) -> ViewOut:
        return _view(at_hand.view(name, tuple(axis or ()), measure))

    @found.get(
        "/domain/{name}/fit",
        summary="Fit a map to other axes, or see whether that is done",
        description="In a process beside, once for all who ask. It ends when nobody has asked for "
        "two minutes. Until it is done, all else of the map is refused after two seconds.",
    )
    def fit(name: str, axis: AxisNames = None, measure: Measure | None = None) -> FitOut:
        seconds = at_hand.fit(name, tuple(axis or ()), measure)
        return FitOut(ready=seconds is None, seconds=seconds or 0.0)

    @found.post("/domain/{name}/fit/stop", summary="Stop fitting it", status_code=204)
    def stop_fit(name: str, axis: AxisNames = None, measure: Measure | None = None) -> None:
        at_hand.stop(name, tuple(axis or ()), measure)

    @found.get("/domain/{name}/map", summary="The map at a threshold")
    def at_threshold(
        name: str,
        axis: AxisNames = None,
        measure: Measure | None = None,
        threshold: Threshold = None,
        level: Level = 0.9,
        confidence: Confidence = 0.95,
    ) -> ShownOut:
        seen = at_hand.view(name, tuple(axis or ()), measure)
        answer = shown(seen, threshold, level, confidence)
        own = slice(0, MAX_GROUPS)
        return ShownOut(
            threshold=answer.claim.threshold,
            words=answer.claim.text(),
            level=level,
            confidence=confidence,
            colours=list(COLOURS),
            colour=answer.colour[own].tolist(),
            chance=[[_finite(round(c, 4)) for c in row] for row in answer.chance[own].tolist()],
            inside=answer.inside[own].tolist(),
            count=answer.counts,
            sizes=answer.inside[own].sum(axis=1).tolist(),
            command=command_of(desk.folder, seen.asked, answer.claim),
        )

    @found.get("/domain/{name}/next", summary="What to try next")
    def following(
        name: str,
        axis: AxisNames = None,
        measure: Measure | None = None,
        threshold: Threshold = None,
        level: Level = 0.9,
        confidence: Confidence = 0.95,
    ) -> NextOut:
        seen = at_hand.view(name, tuple(axis or ()), measure)
        claim = shown(seen, threshold, level, confidence).claim
        return NextOut(
            proposals=[
                ProposalOut(
                    group=one.group,
                    cell=one.cell,
                    where=one.where,
                    place=place_of(seen.cells, one.cell),
                    bits=one.bits,
                    reason=one.reason,
                )
                for one in suggested(seen, claim)
            ],
            command=command_of(desk.folder, seen.asked, claim),
        )

    return found


def _first_command(desk: ProjectContext, by: Any) -> str:
    import shlex

    words = ["fixel", "domain", "--project", str(desk.folder)]
    return shlex.join([*words, "--by", ",".join(by)] if by else words)


def _listed(one: StoredAnalysis) -> MapOut:
    analysis = one.analysis
    return MapOut(
        name=one.folder.name,
        title=analysis.title,
        created_utc=analysis.created,
        headline=list(analysis.headline),
        warnings=list(analysis.warnings),
        command=analysis.command,
    )


def _job(one: jobs.JobStatus) -> DomainJobOut:
    folder = FilePath(one.folder)
    done, total = job.fits_done(folder)
    return DomainJobOut(
        name=folder.name,
        state=one.state,
        ended=one.ended,
        reason=one.status.reason,
        fits=done,
        total=total,
    )


def _view(one: MapView) -> ViewOut:
    domain, question = one.domain, one.kept.analysis.question
    if len(domain.cells) * min(len(domain.groups), MAX_GROUPS) > 40_000:
        raise InvalidInput("axis", found="more cells than a page can show", expected="fewer")
    low, high = one.thresholds
    number = {group: g for g, group in enumerate(domain.groups)}
    errors = held_out_mm(one)
    points = [
        PointOut(
            id=one.evidence.ids[k],
            key=one.evidence.keys[k],
            group=number[one.evidence.group[k]],
            cell=int(domain.place[k]),
            error=_finite(float(errors[k])),
            fold=int(one.evidence.fold[k]),
        )
        for k in np.flatnonzero((domain.place >= 0) & ~np.isnan(errors)).tolist()
    ]
    return ViewOut(
        name=one.kept.folder.name,
        title=one.kept.analysis.title,
        measure=domain.measure,
        unit="mm" if domain.measure == "absolute" else "",
        low=low,
        high=high,
        threshold=min(max(one.usual_threshold, low), high),
        level=float(question["level"]),
        confidence=float(question["confidence"]),
        floor_mm=one.gathered.floor_mm,
        floor_from=one.gathered.floor_from,
        calibration=one.gathered.calibration,
        groups=list(domain.groups[:MAX_GROUPS]),
        omitted=max(0, len(domain.groups) - MAX_GROUPS),
        panels=[_panel(one, k) for k in range(len(one.table))],
        texts=[domain.cells.text(c) for c in range(len(domain.cells))],
        nominal=domain.cells.nominal,
        counts=domain.counts[:MAX_GROUPS].tolist(),
        points=points,
        axes=[MapAxisOut(**axis._asdict()) for axis in axes_offered(one)],
        chosen=[axis.name for axis in domain.cells.axes],
        aside=one.aside,
        simulated=not one.gathered.is_real,
    )


def _panel(one: MapView, k: int) -> PanelOut:
    across, up = one.axes_of(k)
    return PanelOut(
        across=_strip(across), up=None if up is None else _strip(up), cells=one.table[k]
    )


def _strip(axis: CellAxis) -> StripOut:
    return StripOut(name=axis.name, unit=axis.unit, ticks=[axis.text(k) for k in range(len(axis))])


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
