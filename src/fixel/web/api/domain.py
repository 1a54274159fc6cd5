"""Domain of applicability: stored maps at any threshold."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from fixel.domain.evidence import Measure
from fixel.errors import NotStored
from fixel.web.context import Context, ProjectContext
from fixel.web.values import Answer, RequestBody, Text
from fixel.web.views import domain_views, job_list
from fixel.web.views.domain_views import MapDocument, SuggestedExperiment, ThresholdMap
from fixel.workflows import jobs
from fixel.workflows.analysis import StoredAnalysis
from fixel.workflows.domain import job
from fixel.workflows.domain.request import DomainRequest, command_of

router = APIRouter(prefix="/domain", tags=["domain"])


class MapSummary(Answer):
    """A kept map."""

    name: str
    title: str
    created_utc: str
    headline: list[str]
    warnings: list[str]
    command: str


class DomainJob(Answer):
    """A map that is being made."""

    name: str
    state: str
    ended: bool
    reason: str
    fits: int
    total: int = Field(description="number of fits; 0 while unknown")


class MapList(Answer):
    """All kept maps, the newest first."""

    maps: list[MapSummary]
    jobs: list[DomainJob]
    unreadable: list[str] = Field(description="reasons why other maps and jobs cannot be shown")
    command: str = Field(description="command that makes a map")


class NextExperiments(Answer):
    """Experiments to try next."""

    proposals: list[SuggestedExperiment]
    command: str


class FitProgress(Answer):
    """Progress of the fit of a map."""

    ready: bool
    seconds: float = Field(description="time since the fit to these axes began [s]")


class MapForm(RequestBody):
    """A map to make."""

    by: list[Annotated[Text, Field(min_length=1, max_length=80)]] = Field(
        default_factory=list,
        max_length=3,
        description="conditions; each of their values has its own map",
    )


class MapQuery(BaseModel):
    """Request for one map of an analysis."""

    axis: list[Text] | None = Field(
        None, max_length=3, description="axes of the map; by default those it was made for"
    )
    measure: Measure | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes that were asked for."""
        return tuple(self.axis or ())


class ClaimQuery(MapQuery):
    """Request for one map of an analysis, and the claim that is checked."""

    threshold: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="threshold [mm], or as a share above the smallest error of the experiment",
    )
    level: float = Field(0.9, gt=0.0, lt=1.0)
    confidence: float = Field(0.95, gt=0.5, lt=1.0)


@router.get("", summary="List stored maps")
def maps(context: Context) -> MapList:
    stored, bad_maps = context.domains.maps()
    own_jobs, bad_jobs = job.jobs_of(context.project)
    return MapList(
        maps=[_summary(one) for one in stored],
        jobs=[_job(one) for one in own_jobs],
        unreadable=[str(problem) for problem in (*bad_maps, *bad_jobs)],
        command=_first_command(context, ()),
    )


@router.post("", summary="Compute a map in a separate process")
def begin(context: Context, wanted: MapForm) -> DomainJob:
    request = DomainRequest(by=tuple(wanted.by))
    with job_list.job_slot(context.project.folder):
        folder = job.begin(context.project, request, _first_command(context, wanted.by))
    return _job(jobs.status_of(folder))


@router.post("/jobs/{name}/stop", summary="Stop computing a map; finished fits stay stored")
def stop(context: Context, name: str) -> DomainJob:
    own_jobs, _ = job.jobs_of(context.project)
    own = next((one for one in own_jobs if Path(one.folder).name == name), None)
    if own is None:
        raise NotStored(f"job {name!r}", hint="the page Domain lists all")
    return _job(jobs.cancel(Path(own.folder)))


@router.get("/{name}", summary="Get a map for all thresholds")
def view(context: Context, name: str, query: Annotated[MapQuery, Query()]) -> MapDocument:
    return domain_views.document(context.domains.view(name, query.axes, query.measure))


@router.get(
    "/{name}/fit",
    summary="Fit a map to other axes, or get the progress of the fit",
    description="The fit runs in a separate process, shared by all requests. It stops after two "
    "minutes without a request. Until it has finished, requests for other parts of "
    "the map are rejected after two seconds.",
)
def fit(context: Context, name: str, query: Annotated[MapQuery, Query()]) -> FitProgress:
    seconds = context.domains.fit(name, query.axes, query.measure)
    return FitProgress(ready=seconds is None, seconds=seconds or 0.0)


@router.post("/{name}/fit/stop", summary="Stop the fit of a map", status_code=204)
def stop_fit(context: Context, name: str, query: Annotated[MapQuery, Query()]) -> None:
    context.domains.stop(name, query.axes, query.measure)


@router.get("/{name}/map", summary="Get the map at a threshold")
def at_threshold(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> ThresholdMap:
    one = context.domains.view(name, query.axes, query.measure)
    claim = domain_views.claim_of(one, query.threshold, query.level, query.confidence)
    return domain_views.at_threshold(one, claim, context.folder)


@router.get("/{name}/next", summary="Get suggested experiments")
def next_experiments(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> NextExperiments:
    one = context.domains.view(name, query.axes, query.measure)
    claim = domain_views.claim_of(one, query.threshold, query.level, query.confidence)
    return NextExperiments(
        proposals=domain_views.suggested(one, claim),
        command=command_of(context.folder, one.asked, claim),
    )


def _first_command(context: ProjectContext, by: Sequence[str]) -> str:
    words = ["fixel", "domain", "--project", str(context.folder)]
    return shlex.join([*words, "--by", ",".join(by)] if by else words)


def _summary(one: StoredAnalysis) -> MapSummary:
    analysis = one.analysis
    return MapSummary(
        name=one.folder.name,
        title=analysis.title,
        created_utc=analysis.created,
        headline=list(analysis.headline),
        warnings=list(analysis.warnings),
        command=analysis.command,
    )


def _job(one: jobs.JobStatus) -> DomainJob:
    folder = Path(one.folder)
    done, total = job.fits_done(folder)
    return DomainJob(
        name=folder.name,
        state=one.state,
        ended=one.ended,
        reason=one.reason,
        fits=done,
        total=total,
    )
