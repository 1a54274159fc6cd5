"""Stored analyses: results, charts and the numbers behind those."""

from __future__ import annotations

from typing import Final

from fastapi import APIRouter
from fastapi.responses import FileResponse
from pydantic import Field

from fixel.errors import NotStored
from fixel.web.context import Context
from fixel.web.values import Answer
from fixel.workflows.analysis import (
    Analysis,
    AnalysisFigure,
    StoredAnalysis,
    find_analysis,
    load_with_errors,
)

TYPES: Final = {"png": "image/png", "pdf": "application/pdf", "csv": "text/csv"}

router = APIRouter(prefix="/analyses", tags=["analyses"])


class TableText(Answer):
    """A table as people read it."""

    title: str
    head: list[str]
    rows: list[list[str]]


class AnalysisSummary(Answer):
    """A kept analysis."""

    name: str
    kind: str
    title: str
    created_utc: str
    warnings: list[str]
    headline: list[str]
    pictures: list[AnalysisFigure]
    tables: list[TableText]
    methods: list[str]
    command: str
    calibrations: list[int]


class AnalysisList(Answer):
    """All of them, the newest first."""

    analyses: list[AnalysisSummary]
    unreadable: list[str] = Field(description="reasons why other analyses cannot be shown")


@router.get("", summary="List stored analyses")
def analyses(context: Context, kind: str | None = None) -> AnalysisList:
    every, unreadable = load_with_errors(context.project, kind)
    return AnalysisList(
        analyses=[
            AnalysisSummary.model_validate(
                one.analysis.model_dump(include={*AnalysisSummary.model_fields})
                | {"name": one.folder.name, "created_utc": one.analysis.created}
            )
            for one in every
        ],
        unreadable=[str(problem) for problem in unreadable],
    )


@router.get("/{name}", summary="Get a stored analysis with all its numbers")
def analysis(context: Context, name: str) -> Analysis:
    return _named(context, name).analysis


def _named(context: Context, name: str) -> StoredAnalysis:
    one = find_analysis(context.project, name)
    if one is None:
        raise NotStored(f"analysis {name}", hint="/analyses lists all")
    return one


@router.get(
    "/{name}/{picture}.{ending}",
    summary="Get a chart of an analysis, or its data",
    response_class=FileResponse,
)
def picture(context: Context, name: str, picture: str, ending: str) -> FileResponse:
    one = _named(context, name)
    # Only what an analysis names itself: no part of an address becomes a path.
    own = next((p.name for p in one.analysis.pictures if p.name == picture), None)
    if own is None or ending not in TYPES:
        raise NotStored(f"chart {picture}.{ending} of {name}", hint="/analyses lists all")
    path = one.picture(own, ending)
    if not path.is_file():
        raise NotStored(f"chart {picture}.{ending} of {name}", hint="run the analysis again")
    return FileResponse(path, media_type=TYPES[ending])
