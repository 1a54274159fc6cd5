"""Capabilities and the jobs that run them: start, progress and workers, cancel and resume."""

from __future__ import annotations

import json
from pathlib import Path as FilePath
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Path, Query

from fixel.capability.capability import named
from fixel.errors import InvalidInput
from fixel.web.context import Context
from fixel.web.pages.run import FORMS, begin, form_of
from fixel.web.values import Answer, OpenBody, Whole
from fixel.web.views import job_list
from fixel.web.views.job_list import JobLog, Worker
from fixel.workflows import jobs
from fixel.workflows.jobs import JobStatus

MAX_LINES: Final = 2000
JobName = Annotated[
    str, Path(min_length=1, max_length=255, description="name of the folder of the job")
]

router = APIRouter(prefix="/jobs", tags=["jobs"])
runs = APIRouter(prefix="/run", tags=["capabilities"])


class JobDetail(Answer):
    """A job and its workers."""

    job: JobStatus
    workers: list[Worker]


@router.get("", summary="List jobs of the project, the newest first")
def all_jobs(context: Context) -> dict[Literal["jobs"], list[JobStatus]]:
    return {"jobs": jobs.jobs_in(context.project.folder)}


@router.get("/{name}", summary="Get a job and its workers")
def one(context: Context, name: JobName) -> JobDetail:
    job = job_list.job_named(context.project.folder, name)
    return JobDetail(job=job, workers=[] if job.state == jobs.UNREADABLE else job_list.workers(job))


@router.get("/{name}/log", summary="Get the end of the log of a job")
def log(
    context: Context, name: JobName, lines: Annotated[Whole, Query(ge=1, le=MAX_LINES)] = 200
) -> JobLog:
    return job_list.log_tail(job_list.job_named(context.project.folder, name), lines)


@router.post("/{name}/cancel", summary="Cancel a job and its workers; finished chunks stay stored")
def cancel(context: Context, name: JobName) -> JobDetail:
    jobs.cancel(FilePath(job_list.job_named(context.project.folder, name).folder))
    return one(context, name)


@router.post("/{name}/resume", summary="Resume a job in a separate process")
def resume(context: Context, name: JobName) -> JobDetail:
    with job_list.job_slot(context.project.folder):
        job_list.resume(job_list.job_named(context.project.folder, name))
    return one(context, name)


@runs.get("", summary="List capabilities with the JSON schemas of their requests")
def capabilities() -> dict[str, dict[str, Any]]:
    return {name: own.model.model_json_schema() for name, own in FORMS.items()}


@runs.post("/{name}", summary="Run a capability as a job; its result is an analysis")
def start(context: Context, name: str, request: OpenBody) -> JobDetail:
    own = form_of(name)
    try:
        folder = begin(context, own, own.from_json(json.dumps(request)))
    except InvalidInput as error:
        raise named(error, own.keys()) from None
    return one(context, folder.name)
