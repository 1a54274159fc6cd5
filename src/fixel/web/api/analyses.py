"""Stored analyses: results, charts and the numbers behind those; maps at any threshold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse
from pydantic import Field

from fixel.errors import FixelError, NotStored
from fixel.web.context import Context, ProjectContext
from fixel.web.values import Answer
from fixel.web.views import domain_views
from fixel.web.views.domain_views import ClaimQuery, MapDocument, MapView, SuggestedExperiment
from fixel.workflows.analysis import Analysis, find_analysis, load_with_errors
from fixel.workflows.planning.execute import run_on_testbed
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.request import load_plan, load_trials

TYPES: Final = {"png": "image/png", "pdf": "application/pdf", "csv": "text/csv"}

router = APIRouter(prefix="/analyses", tags=["analyses"])
maps = APIRouter(prefix="/domain", tags=["domain"])
plans = APIRouter(prefix="/plan", tags=["planning"])


class AnalysisSummary(Analysis, frozen=True):
    """A kept analysis, without its numbers."""

    name: str
    created_utc: str


class AnalysisList(Answer):
    """All of them, the newest first."""

    analyses: list[AnalysisSummary]
    unreadable: list[str] = Field(description="reasons why other analyses cannot be shown")


@router.get("", summary="List stored analyses")
def analyses(context: Context, kind: str | None = None) -> AnalysisList:
    every, unreadable = load_with_errors(context.project, kind)
    return AnalysisList(
        analyses=[
            AnalysisSummary(
                **{k: v for k, v in one.analysis if k not in ("numbers", "request")},
                name=one.folder.name,
                created_utc=one.analysis.created,
            )
            for one in every
        ],
        unreadable=[str(problem) for problem in unreadable],
    )


@router.get("/{name}", summary="Get a stored analysis with all its numbers")
def analysis(context: Context, name: str) -> Analysis:
    return find_analysis(context.project, name).analysis


@router.get(
    "/{name}/{picture}.{ending}",
    summary="Get a chart of an analysis, or its data",
    response_class=FileResponse,
)
def picture(context: Context, name: str, picture: str, ending: str) -> FileResponse:
    one = find_analysis(context.project, name)
    # Only what an analysis names itself: no part of an address becomes a path.
    own = next((p.name for p in one.analysis.pictures if p.name == picture), None)
    if own is None or ending not in TYPES:
        raise NotStored(f"chart {picture}.{ending} of {name}", hint="/analyses lists all")
    path = one.picture(own, ending)
    if not path.is_file():
        raise NotStored(f"chart {picture}.{ending} of {name}", hint="run the analysis again")
    return FileResponse(path, media_type=TYPES[ending])


@plans.post("/{name}/trials", summary="Carry out a plan 20 times on the simulated testbed")
def trials(context: Context, name: str) -> dict[Literal["lines"], list[str]]:
    own = find_analysis(context.project, name, "plan")
    if not (own.folder / FILE).is_file():
        raise NotStored(f"plan {name!r}", hint="/analyses lists all")
    run_on_testbed(own.folder / FILE, trials=20)
    return {"lines": trials_of(own.folder)}


def trials_of(folder: Path) -> list[str]:
    """Return the trials of a stored plan as lines of text; none without a plan file."""
    path = folder / FILE
    if not path.is_file():
        return []
    try:
        found = load_trials(path, load_plan(path))
    except FixelError as problem:
        return [str(problem)]
    return str(found).splitlines() if found.n else []


def _view(context: ProjectContext, name: str) -> MapView:
    return context.domain(name, find_analysis(context.project, name, "domain").analysis.created)


@maps.get("/{name}", summary="Get a map at a threshold")
def at_threshold(context: Context, name: str, query: Annotated[ClaimQuery, Query()]) -> MapDocument:
    one = _view(context, name)
    return domain_views.document(one, query.claim(one), context.folder)


@maps.get("/{name}/next", summary="Get suggested experiments")
def next_experiments(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> dict[Literal["proposals"], list[SuggestedExperiment]]:
    one = _view(context, name)
    return {"proposals": domain_views.suggested(one, query.claim(one))}
