"""Jobs of a project for a page: progress, workers, losses, log."""

from __future__ import annotations

import os
import shlex
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Literal, NamedTuple

from fixel.errors import FixelError, JobRefused, NotStored
from fixel.io.lock import Owner
from fixel.jobs import folder as files
from fixel.jobs import link
from fixel.workflows import jobs
from fixel.workflows.jobs import LOST, JobStatus

UNREADABLE: Final = "unreadable"  # the state of a folder that another program wrote into
NO_WORKERS: Final = ("scheduler", "coordinator")  # names of other logs in the workers' folder
MAX_LOG: Final = 256 * 1024  # [byte] that are read from the end of a log
MAX_WORKERS: Final = 200  # that are listed, the newest
MAX_AT_ONCE: Final = 4  # jobs of a project that pages may have running

_starting = threading.Lock()

WorkerState = Literal["working", "joined", "starting", "refused", "ended"]


class Worker(NamedTuple):
    """A process that computes for a job, or did."""

    name: str
    host: str
    pid: int
    state: WorkerState  # `joined` if only another machine could know more
    reason: str  # why it refused


class JobSummary(NamedTuple):
    """Job with its state, for a page."""

    name: str
    folder: Path
    state: str
    status: JobStatus | None  # None if it cannot be read
    reason: str
    maker: str
    made_utc: str

    @property
    def can_cancel(self) -> bool:
        """Whether there is something to stop."""
        return self.status is not None and not (self.status.ended and self.state != LOST)

    @property
    def can_resume(self) -> bool:
        """Whether the job can be resumed."""
        return self.state in ("queued", "stopped", "cancelled", "failed", LOST)

    @property
    def command(self) -> str:
        """Command that resumes or watches the job."""
        verb = "resume" if self.can_resume else "logs -f" if self.can_cancel else "status"
        return f"fixel jobs {verb} {shlex.quote(str(self.folder))}"


def board(project: Path) -> list[JobSummary]:
    """Return the jobs of a project, newest first."""
    found = [_posted(folder) for folder in _folders(project).values()]
    return sorted(found, key=lambda job: (job.made_utc, job.name), reverse=True)


def posted(project: Path, name: str) -> JobSummary:
    """Return the job of a name, which is compared with existing ones and never used as a path."""
    folders = _folders(project)
    if name not in folders:
        raise NotStored(f"job {name!r}", hint="see what there is with: fixel jobs status")
    return _posted(folders[name])


def workers(job: JobSummary) -> list[Worker]:
    """Return the workers of a job, present and past; the present ones first."""
    owner = files.coordinator_of(job.folder)
    found = [_worker(job.folder, name, owner) for name in _worker_names(job.folder)]
    order = ("working", "joined", "starting", "refused", "ended")
    return sorted(found, key=lambda worker: order.index(worker.state))[:MAX_WORKERS]


def log_tail(job: JobSummary, lines: int) -> tuple[list[str], bool]:
    """Return the last lines of a job's log, and whether these are all."""
    path = job.folder / files.LOG
    if not path.is_file():
        return [], True
    with path.open("rb") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - MAX_LOG))
        text = stream.read().decode("utf-8", errors="replace")
    found = text.splitlines()
    if size > MAX_LOG:
        found = found[1:]  # it begins within a line
    return found[-lines:], size <= MAX_LOG and len(found) <= lines


def cancel(job: JobSummary) -> None:
    """Cancel a job and its workers; finished chunks are saved."""
    jobs.cancel(job.folder)


def resume(job: JobSummary) -> None:
    """Resume a job in a process of its own, as it was run before."""
    if not job.can_resume:
        raise JobRefused(f"{job.name} is {job.state}", hint="it runs, or needs nothing any more")
    jobs.arrange(job.folder)
    jobs.run_detached(job.folder)


@contextmanager
def room(project: Path) -> Iterator[None]:
    """Allow one job to be started within: each takes a core or more, and a click costs nothing.

    Raises
    ------
    JobRefused
        Too many jobs are running.
    """
    with _starting:
        running = [path for path in _folders(project).values() if files.coordinator_of(path)]
        if len(running) >= MAX_AT_ONCE:
            raise JobRefused(
                f"{len(running)} jobs of this project are running",
                hint="wait until one ends, or end one on the page Jobs",
            )
        yield


def _folders(project: Path) -> dict[str, Path]:
    """Folders of jobs by the names that are shown, which any text can contain."""
    found = [path.parent for path in (project / jobs.JOBS).glob("*/job.json")]
    return {folder.name.encode("utf-8", "replace").decode(): folder for folder in sorted(found)}


def _posted(folder: Path) -> JobSummary:
    name = folder.name.encode("utf-8", "replace").decode()
    try:
        job, status = files.read_job(folder), jobs.status_of(folder)
    except (FixelError, OSError) as problem:
        return JobSummary(name, folder, UNREADABLE, None, str(problem), "", "")
    return JobSummary(
        name, folder, status.state, status, status.status.reason, job.maker, job.made_utc
    )


def _worker_names(folder: Path) -> list[str]:
    paths = (folder / "workers").glob("*.*")
    known = {path.stem for path in paths if path.suffix in (".json", ".log", ".refused")}
    return sorted(known - {*NO_WORKERS}, reverse=True)


def _worker(folder: Path, name: str, owner: Owner | None) -> Worker:
    refused = folder / "workers" / f"{name}.refused"
    joined = link.joined(folder, name)
    host, pid = (joined.host, joined.pid) if joined else ("", 0)
    if refused.is_file():
        return Worker(name, host, pid, "refused", refused.read_text(errors="replace"))
    return Worker(name, host, pid, _state(name, host, pid, owner), "")


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
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True
