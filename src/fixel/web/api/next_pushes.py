"""Proposals of the next pushes of a part, computed in a process of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from fixel.errors import NotStored
from fixel.web.context import Context, ProjectContext
from fixel.web.values import Answer, RequestBody, Text
from fixel.web.views import job_list
from fixel.workflows import jobs
from fixel.workflows.next_pushes import job
from fixel.workflows.next_pushes.report import command_of
from fixel.workflows.next_pushes.run import NextPushesRequest

router = APIRouter(prefix="/next", tags=["next pushes"])


class NextForm(RequestBody):
    """A part whose next pushes are proposed."""

    part: Annotated[Text, Field(min_length=1, max_length=80)]
    surface: Annotated[Text, Field(max_length=80)] = ""
    number: int = Field(5, ge=1, le=40, description="number of pushes")


class NextJob(Answer):
    """A proposal that is being computed."""

    name: str
    state: str
    ended: bool
    reason: str
    stage: str = Field(description="stage of the computation")


@router.post("", summary="Propose pushes in a separate process")
def begin(context: Context, wanted: NextForm) -> NextJob:
    request = NextPushesRequest(part=wanted.part, surface=wanted.surface, n=wanted.number)
    with job_list.job_slot(context.project.folder):
        folder = job.begin(context.project, request, command_of(request, context.folder))
    return _answer(folder)


@router.get("/jobs/{name}", summary="Get the progress of a proposal")
def progress(context: Context, name: str) -> NextJob:
    return _answer(_folder(context, name))


@router.post("/jobs/{name}/stop", summary="Stop a proposal; finished fits stay stored")
def stop(context: Context, name: str) -> NextJob:
    folder = _folder(context, name)
    jobs.cancel(folder)
    return _answer(folder)


def _folder(context: ProjectContext, name: str) -> Path:
    # Only what the project lists itself: no part of an address becomes a path.
    every = (path.parent for path in (context.project.folder / jobs.JOBS).glob("next-*/job.json"))
    own = next((folder for folder in every if folder.name == name), None)
    if own is None:
        raise NotStored(f"job {name!r}", hint="the page Jobs lists all")
    return own


def _answer(folder: Path) -> NextJob:
    one = jobs.status_of(folder)
    return NextJob(
        name=folder.name,
        state=one.state,
        ended=one.ended,
        reason=one.reason,
        stage=job.stage_of(folder),
    )
