"""Jobs: progress and workers; cancel and resume a job."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final, Literal

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, Field

from fixel.web.views import job_list
from fixel.web.views.job_list import JobSummary

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_LINES: Final = 2000
JobName = Annotated[str, Path(min_length=1, max_length=255, description="of its folder")]


class JobOut(BaseModel):
    """A job."""

    name: str
    state: str = Field(
        description="queued, preparing, running, collecting, done, failed, stopped, cancelled; "
        "lost where the process that ran it has died; unreadable"
    )
    reason: str = Field(description="of a failure; what is being waited for")
    note: str = Field(description="what the work says of itself")
    maker: str = Field(description="the function that made the work")
    done: int = Field(description="chunks with an answer")
    total: int = Field(description="chunks, as far as is known")
    failed: int = Field(description="chunks whose answer is a failure")
    kept: int = Field(description="answers in the journal, which no accident takes away")
    rate_per_s: float
    left_s: float | None
    share: float | None = Field(description="of the work that is done; none where nobody knows")
    workers: int = Field(description="that compute now")
    deaths: int = Field(description="workers that died while they computed")
    again: int = Field(description="chunks that were given out once more")
    host: str = Field(description="where it is or was run from")
    pid: int
    made_utc: str
    started_utc: str
    updated_utc: str
    command: str = Field(description="what to type to go on with it, or to watch it")
    can_cancel: bool
    can_resume: bool


class WorkerOut(BaseModel):
    """A process that computes for a job, or did."""

    name: str
    host: str
    pid: int
    state: Literal["working", "joined", "starting", "refused", "ended"] = Field(
        description="joined where another machine would have to be asked"
    )
    reason: str


class JobsOut(BaseModel):
    """All jobs, the newest first."""

    jobs: list[JobOut]


class JobDetailOut(BaseModel):
    """A job and its workers."""

    job: JobOut
    workers: list[WorkerOut]


class LogOut(BaseModel):
    """The end of a log."""

    lines: list[str]
    whole: bool = Field(description="whether these are all")


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/jobs`."""
    found = APIRouter(tags=["jobs"])
    project = desk.project.folder

    @found.get("/jobs", summary="All jobs of the project, the newest first")
    def listed() -> JobsOut:
        return JobsOut(jobs=[job_out(job) for job in job_list.board(project)])

    @found.get("/jobs/{name}", summary="One of them and its workers")
    def one(name: JobName) -> JobDetailOut:
        return _detail(job_list.posted(project, name))

    @found.get("/jobs/{name}/log", summary="The end of its log")
    def log(name: JobName, lines: Annotated[int, Query(ge=1, le=MAX_LINES)] = 200) -> LogOut:
        tail, whole = job_list.log_tail(job_list.posted(project, name), lines)
        return LogOut(lines=[_plain(line) for line in tail], whole=whole)

    @found.post("/jobs/{name}/cancel", summary="End it and its workers; what is finished stays")
    def cancel(name: JobName) -> JobDetailOut:
        job_list.cancel(job_list.posted(project, name))
        return _detail(job_list.posted(project, name))

    @found.post("/jobs/{name}/resume", summary="Go on with it, in a process of its own")
    def resume(name: JobName) -> JobDetailOut:
        with job_list.room(project):
            job_list.resume(job_list.posted(project, name))
        return _detail(job_list.posted(project, name))

    return found


def _detail(job: JobSummary) -> JobDetailOut:
    found = [] if job.status is None else job_list.workers(job)
    return JobDetailOut(job=job_out(job), workers=[WorkerOut(**one._asdict()) for one in found])


def job_out(job: JobSummary) -> JobOut:
    """Convert a job for JSON."""
    known = job.status
    said = None if known is None else known.status
    return JobOut(
        name=job.name,
        state=job.state,
        reason=job.reason,
        note=said.note if said else "",
        maker=job.maker,
        done=said.done if said else 0,
        total=said.total if said else 0,
        failed=said.failed if said else 0,
        kept=known.kept if known else 0,
        rate_per_s=said.rate if said else 0.0,
        left_s=said.left_s if said else None,
        share=said.share if said else None,
        workers=said.workers if said and known and not known.ended else 0,
        deaths=said.deaths if said else 0,
        again=said.again if said else 0,
        host=said.host if said else "",
        pid=said.pid if said else 0,
        made_utc=job.made_utc,
        started_utc=said.started_utc if said else "",
        updated_utc=said.updated_utc if said else "",
        command=job.command,
        can_cancel=job.can_cancel,
        can_resume=job.can_resume,
    )


def _plain(line: str) -> str:
    """Remove the codes by which terminals colour text."""
    return "".join(c if c >= " " or c == "\t" else "\ufffd" for c in line)
