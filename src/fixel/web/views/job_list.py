"""Jobs of a project for a page: progress, workers, losses, log."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal, get_args

from pydantic import Field

from fixel.errors import JobRefused, NotStored
from fixel.io.lock import UNKNOWN, Owner, is_running
from fixel.jobs import folder as files, link
from fixel.web.values import Answer
from fixel.workflows import jobs
from fixel.workflows.jobs import JobStatus

NO_WORKERS: Final = ("scheduler", "coordinator")  # names of other logs in the workers' folder
MAX_LOG: Final = 256 * 1024  # [byte] that are read from the end of a log
MAX_WORKERS: Final = 200  # that are listed, the newest
MAX_AT_ONCE: Final = 4  # jobs of a project that pages may have running

_starting = threading.Lock()

WorkerState = Literal["working", "joined", "starting", "refused", "ended"]


class Worker(Answer):
    """A process that computes for a job, or did."""

    name: str
    host: str
    pid: int
    state: WorkerState = Field(
        description="state of the worker; `joined` if it is on another machine"
    )
    reason: str


class JobLog(Answer):
    """The end of a log."""

    lines: list[str]
    whole: bool = Field(description="whether these are all lines")


def job_named(project: Path, name: str) -> JobStatus:
    """Return the job of a name, which is compared with existing ones and never used as a path."""
    folders = jobs.job_folders(project)
    if name not in folders:
        raise NotStored(f"job {name!r}", hint="list the jobs: fixel jobs status")
    return jobs.readable_status(folders[name])


def workers(job: JobStatus) -> list[Worker]:
    """Return the workers of a job, present and past; the present ones first."""
    folder = Path(job.folder)
    owner = files.coordinator_of(folder)
    found = [_worker(folder, name, owner) for name in _worker_names(folder)]
    order = get_args(WorkerState)
    return sorted(found, key=lambda worker: order.index(worker.state))[:MAX_WORKERS]


def log_tail(job: JobStatus, lines: int) -> JobLog:
    """Return the last lines of a job's log."""
    path = Path(job.folder) / files.LOG
    if not path.is_file():
        return JobLog(lines=[], whole=True)
    with path.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - MAX_LOG))
        text = stream.read().decode("utf-8", errors="replace")
    found = text.splitlines()
    if size > MAX_LOG:
        found = found[1:]  # it begins within a line
    # Without the codes by which terminals colour text.
    shown = ["".join(c if c >= " " or c == "\t" else "\ufffd" for c in s) for s in found[-lines:]]
    whole = size <= MAX_LOG and len(found) <= lines
    return JobLog(lines=shown, whole=whole)


def resume(job: JobStatus) -> None:
    """Resume a job in a process of its own, as it was run before."""
    if not job.can_resume:
        raise JobRefused(
            f"{job.name} is {job.state}", hint="only stopped, failed or queued jobs can be resumed"
        )
    jobs.arrange(Path(job.folder))
    jobs.run_detached(Path(job.folder))


@contextmanager
def job_slot(project: Path) -> Iterator[None]:
    """Allow one job to be started within: each takes a core or more, and a click costs nothing."""
    with _starting:
        running = [
            path for path in jobs.job_folders(project).values() if files.coordinator_of(path)
        ]
        if len(running) >= MAX_AT_ONCE:
            hint = "wait until one has finished, or cancel one on the page Jobs"
            raise JobRefused(f"{len(running)} jobs of this project are running", hint=hint)
        yield


def _worker_names(folder: Path) -> list[str]:
    paths = (folder / "workers").glob("*.*")
    known = {path.stem for path in paths if path.suffix in (".json", ".log", ".refused")}
    return sorted(known - {*NO_WORKERS}, reverse=True)


def _worker(folder: Path, name: str, owner: Owner | None) -> Worker:
    refused = folder / "workers" / f"{name}.refused"
    host, pid = link.joined(folder, name) or UNKNOWN
    if refused.is_file():
        state: WorkerState = "refused"
        reason = refused.read_text(errors="replace")
    else:
        state, reason = _state(name, host, pid, owner), ""
    return Worker(name=name, host=host, pid=pid, state=state, reason=reason)


def _state(name: str, host: str, pid: int, owner: Owner | None) -> WorkerState:
    # Names of local workers contain the process id of the coordinator that started them.
    if owner is None or (name.startswith("local-") and name.split("-")[1] != str(owner.pid)):
        return "ended"
    if not pid:
        return "starting"
    if host != socket.gethostname():
        return "joined"
    return "working" if _lives(pid, name) else "ended"


def _lives(pid: int, name: str) -> bool:
    """Whether a process of this machine is still that worker, not a later one of its id."""
    try:
        return name.encode() in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        pass
    if Path("/proc/self").exists():
        return False
    return is_running(pid)
