"""Proposals of the next pushes of a part, computed in a process of their own."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from fixel.web.context import Context
from fixel.web.values import RequestBody, Text
from fixel.web.views.job_list import PageJob, job_slot, page_job
from fixel.workflows import jobs
from fixel.workflows.capabilities import begin as begin_job
from fixel.workflows.next_pushes.run import NEXT

router = APIRouter(prefix="/next", tags=["next pushes"])


class NextForm(RequestBody):
    """A part whose next pushes are proposed."""

    part: Annotated[Text, Field(min_length=1, max_length=80)]
    surface: Annotated[Text, Field(max_length=80)] = ""
    number: int = Field(5, ge=1, le=40, description="number of pushes")


@router.post("", summary="Propose pushes in a separate process")
def begin(context: Context, wanted: NextForm) -> PageJob:
    request = NEXT.request(wanted.model_dump())
    with job_slot(context.project.folder):
        folder = begin_job(NEXT, request, context.project)
    return PageJob.of(folder)


@router.get("/jobs/{name}", summary="Get the progress of a proposal")
def progress(context: Context, name: str) -> PageJob:
    return PageJob.of(page_job(context.project.folder, "next", name))


@router.post("/jobs/{name}/stop", summary="Stop a proposal; finished fits stay stored")
def stop(context: Context, name: str) -> PageJob:
    folder = page_job(context.project.folder, "next", name)
    jobs.cancel(folder)
    return PageJob.of(folder)
