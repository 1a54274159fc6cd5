"""Stored analyses: results, charts and the numbers behind those."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from fastapi import APIRouter
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from fixel.errors import NotStored
from fixel.workflows.analysis import Kind, kept_and_not

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext
    from fixel.workflows.analysis import StoredAnalysis

TYPES: Final = {"png": "image/png", "pdf": "application/pdf", "csv": "text/csv"}


class PictureOut(BaseModel):
    """A picture of an analysis."""

    name: str
    caption: str


class TextTableOut(BaseModel):
    """A table as people read it."""

    title: str
    head: list[str]
    rows: list[list[str]]


class AnalysisOut(BaseModel):
    """A kept analysis."""

    name: str
    kind: str
    title: str
    created_utc: str
    warnings: list[str]
    headline: list[str]
    pictures: list[PictureOut]
    tables: list[TextTableOut]
    methods: list[str]
    command: str
    calibrations: list[int]


class AnalysesOut(BaseModel):
    """All of them, the newest first."""

    analyses: list[AnalysisOut]
    unreadable: list[str] = Field(description="why others cannot be shown")


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/analyses`."""
    found = APIRouter(tags=["analyses"])

    @found.get("/analyses", summary="Kept analyses")
    def analyses(
        kind: Kind | None = None,
    ) -> AnalysesOut:
        every, unreadable = kept_and_not(desk.project, kind)
        return AnalysesOut(
            analyses=[_analysis(one) for one in every],
            unreadable=[str(problem) for problem in unreadable],
        )

    @found.get(
        "/analyses/{name}/{picture}.{ending}",
        summary="A picture of an analysis, or the numbers behind it",
        response_class=FileResponse,
    )
    def picture(name: str, picture: str, ending: str) -> FileResponse:
        every, _ = kept_and_not(desk.project)
        one = next((one for one in every if one.folder.name == name), None)
        # Only what an analysis names itself: no part of an address becomes a path.
        own = None if one is None else next(
            (p.name for p in one.analysis.pictures if p.name == picture), None
        )  # fmt: skip
        if one is None or own is None or ending not in TYPES:
            raise NotStored(f"picture {picture}.{ending} of {name}", hint="see /analyses")
        path = one.picture(own, ending)
        if not path.is_file():
            raise NotStored(f"picture {picture}.{ending} of {name}", hint="make the analysis again")
        return FileResponse(path, media_type=TYPES[ending])

    return found


def _analysis(one: StoredAnalysis) -> AnalysisOut:
    analysis = one.analysis
    return AnalysisOut(
        name=one.folder.name,
        kind=analysis.kind,
        title=analysis.title,
        created_utc=analysis.created,
        warnings=list(analysis.warnings),
        headline=list(analysis.headline),
        pictures=[PictureOut(name=p.name, caption=p.caption) for p in analysis.pictures],
        tables=[TextTableOut(**table.text()) for table in analysis.tables],
        methods=list(analysis.methods),
        command=analysis.command,
        calibrations=list(analysis.calibrations),
    )
