"""Prepare, submit, inspect, resume, cancel and copy jobs, here or on a cluster.

A job is a folder (`fixel.jobs.folder`). However it was interrupted, running it again continues
from its journal.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Final

from pydantic import Field, computed_field

from fixel.errors import FixelError, InvalidInput, JobRefused
from fixel.io.array_bytes import RATIO, SMALL
from fixel.io.atomic import usable, written_whole
from fixel.io.journal import read_journal
from fixel.jobs import folder as files
from fixel.jobs.coordinator import coordinate
from fixel.jobs.folder import JobState, RunSettings
from fixel.jobs.functions import stamp
from fixel.jobs.site import Site, trust_site
from fixel.jobs.work import AbstractEngine, JobProgress, Show
from fixel.typing import Notify

START_S: Final = 30.0  # [s] within which a detached coordinator begins
END_S: Final = 60.0  # [s] within which a coordinator ends when requested to
LOST: Final = "lost"  # the state of a job whose coordinator died: `resume` continues it
UNREADABLE: Final = "unreadable"  # the state of a folder that another program wrote into
JOBS: Final = "jobs"  # folder of the jobs in a project
# Contents of a packed job: nothing that is secret or specific to one machine.
_PACKED: Final = ("job.json", "run.json", "state.json", "journal", "log.txt", "result")
_MAX_BYTES: Final = 50_000_000_000

prepare_job: Final = files.prepare


class JobStatus(JobProgress):
    """State and progress of a job, as found in its folder."""

    folder: str = Field(exclude=True)
    name: str  # name of the folder as text; characters that no text can contain are replaced
    # One of `fixel.jobs.folder.STATES`, or `lost`: its coordinator died, or its result is gone; or
    # `unreadable`: another program wrote into the folder.
    state: str = Field(
        description="status: queued, preparing, running, collecting, done, failed, stopped, "
        "cancelled; lost if its process has died; unreadable"
    )
    maker: str = Field(default="", description="function that created the work")
    made_utc: str = ""
    kept: int = Field(
        default=0, description="number of answers in the journal, which survive a crash"
    )

    @property
    def ended(self) -> bool:
        """Whether the job has ended, so that nothing runs."""
        return self.state in (*files.ENDED, LOST, UNREADABLE)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def can_cancel(self) -> bool:
        """Whether there is something to stop."""
        return self.state == LOST or not self.ended

    @computed_field  # type: ignore[prop-decorator]
    @property
    def can_resume(self) -> bool:
        """Whether the job can be resumed."""
        return self.state in ("queued", "stopped", "cancelled", "failed", LOST)

    @computed_field(description="command that resumes the job or shows its log")  # type: ignore[prop-decorator]
    @property
    def command(self) -> str:
        """Command that resumes or watches the job."""
        verb = "resume" if self.can_resume else "logs -f" if self.can_cancel else "status"
        return f"fixel jobs {verb} {shlex.quote(self.folder)}"

    def summary(self) -> dict[str, Any]:
        """Return plain values, for `--json`."""
        known = {*JobProgress.model_fields, "state", "kept"}
        return self.model_dump(include=known) | {"folder": self.folder}


def arrange(
    folder: Path,
    *,
    workers: int | None = None,
    site: Site | None = None,
    lease_s: float | None = None,
    accept_version: bool = False,
) -> RunSettings:
    """Set how a job is to be run; arguments that are None leave it unchanged.

    Raise `JobRefused` if the job is running, or something that it needs is missing here.
    """
    files.read_job(folder)
    _check_idle(folder)
    changes: dict[str, Any] = {"workers": workers, "site": site, "lease_s": lease_s}
    if site is not None:
        trust_site(site)
        changes["workers"] = site.max_jobs if workers is None else workers
    if accept_version:
        changes["stamp"] = stamp()
    kept = {name: value for name, value in changes.items() if value is not None}
    run = files.read_run(folder).model_copy(update=kept)
    _check_settings(run)
    files.write_run(folder, run)
    (folder / files.CANCEL).unlink(missing_ok=True)
    return run


def run_here(
    folder: Path,
    progress: Show | None = None,
    notify: Notify | None = None,
    local: AbstractEngine | None = None,
) -> JobStatus:
    """Run or continue a job in this process, until it ends; arguments as of `coordinate`."""
    coordinate(folder, progress=progress, notify=notify, local=local)
    return status_of(folder)


def run_detached(folder: Path) -> JobStatus:
    """Run or continue a job in its own process, which outlives this one."""
    with (folder / files.LOG).open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "fixel.jobs.coordinator", str(folder.resolve())],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
        )  # fmt: skip
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and process.poll() is None:
        owner = files.coordinator_of(folder)
        if owner is not None and owner.pid == process.pid:
            break
        time.sleep(0.05)
    # The process outlives this one; if it ends first, it must be waited for.
    threading.Thread(target=process.wait, daemon=True).start()
    return status_of(folder)


def run_on_slurm(folder: Path) -> str:
    """Run or continue a job with a coordinator that is a SLURM job itself; return its number."""
    from fixel.jobs.link import require_dask
    from fixel.jobs.pool import SlurmError, job_script, submit

    require_dask()
    run, job = files.read_run(folder), files.read_job(folder)
    if run.site is None:
        raise InvalidInput("coordinator", found="slurm", expected="a site template with it")
    workers = folder / "workers"
    workers.mkdir(exist_ok=True)
    script = workers / "coordinator.sh"
    command = ["-P", "-m", "fixel.jobs.coordinator", shlex.quote(str(folder.resolve()))]
    alone = run.site.model_copy(update={"cores": 1})
    script.write_text(job_script(alone, f"{job.label}-c", command, workers.resolve()))
    try:
        number = submit(script)
    except SlurmError as trouble:
        raise JobRefused(f"sbatch rejects the coordinator: {trouble}") from None
    files.write_status(folder, JobState(reason=f"the coordinator waits in the queue as {number}"))
    files.log(folder, f"submitted the coordinator as {number}")
    return number


def status_of(folder: Path) -> JobStatus:
    """Return the status of a job; `lost` if it should run but has no coordinator."""
    job = files.read_job(folder)
    owner = files.coordinator_of(folder)
    status = files.read_status(folder)
    state: str = status.state
    if owner is not None and owner.pid != status.pid:
        state = "preparing"  # the file has the state of the previous coordinator
    elif owner is None and state not in (*files.ENDED, "queued"):
        state = LOST
    elif state == "done" and not (folder / files.RESULT).is_file():
        state = LOST  # the result is lost: the journal has all but the large answers behind it
    journal = folder / files.JOURNAL
    kept = sum(1 for _ in read_journal(journal)) if journal.exists() else 0
    progress = status.model_dump(exclude={"state"})
    if state == LOST:
        progress["workers"] = 0  # they ended with the coordinator
    return JobStatus(
        folder=str(folder),
        name=shown_name(folder),
        state=state,
        maker=job.maker,
        made_utc=job.made_utc,
        kept=kept,
        **progress,
    )


def shown_name(folder: Path) -> str:
    """Return the name of a folder as text; characters that no text can contain are replaced."""
    return folder.name.encode("utf-8", "replace").decode()


def job_folders(project: Path) -> dict[str, Path]:
    """Return the folders of a project's jobs by the names that are shown."""
    found = [path.parent for path in (project / JOBS).glob("*/job.json")]
    return {shown_name(folder): folder for folder in sorted(found)}


def capability_of(folder: Path) -> str:
    """Return the name of the capability that a job runs; empty for others and unreadable ones."""
    try:
        return str(files.read_job(folder).options.get("capability", ""))
    except InvalidInput:
        return ""


def jobs_in(project: Path) -> list[JobStatus]:
    """Return the jobs of a project, newest first; those that cannot be read are `unreadable`."""
    found = [readable_status(folder) for folder in job_folders(project).values()]
    return sorted(found, key=lambda job: (job.made_utc, job.name), reverse=True)


def readable_status(folder: Path) -> JobStatus:
    """Return the status of a job; `unreadable`, with the reason, if another program wrote it."""
    try:
        return status_of(folder)
    except (FixelError, OSError) as problem:
        name = shown_name(folder)
        return JobStatus(folder=str(folder), name=name, state=UNREADABLE, reason=str(problem))


def cancel(folder: Path) -> JobStatus:
    """Cancel a job and its workers; finished chunks are saved, and `resume` continues."""
    job, run = files.read_job(folder), files.read_run(folder)
    before = status_of(folder)
    if before.ended and before.state != LOST:
        return before
    owner = files.coordinator_of(folder)
    if owner is not None:
        (folder / files.CANCEL).touch()
        if owner.host == socket.gethostname():
            # It may be another user's, or gone: the file requests the end, too.
            with suppress(ProcessLookupError, PermissionError):
                os.kill(owner.pid, signal.SIGTERM)
        _wait_for_end(folder)
    if run.site is not None:
        _cancel_on_slurm(job.label)
    after = status_of(folder)
    if after.state == LOST or not after.ended:  # it was not run, or ended without a message
        cancelled = files.read_status(folder).model_copy(update={"state": "cancelled"})
        files.write_status(folder, cancelled)
        files.log(folder, "cancelled")
        after = status_of(folder)
    return after


def log_lines(folder: Path, follow: bool = False) -> Iterator[str]:
    """Yield the lines of a job's log; with `follow`, also those to come until the job ends."""
    files.read_job(folder)
    path = folder / files.LOG
    path.touch()
    with path.open(encoding="utf-8", errors="replace") as stream:
        while True:
            # Checked before reading, so that the last lines are not missed.
            ended = not follow or files.coordinator_of(folder) is None
            for line in stream:
                yield line.rstrip("\n")
            if ended:
                return
            time.sleep(0.3)


def pack(folder: Path, file: Path) -> int:
    """Write a job into one file, to be copied by hand; return its size in bytes."""
    files.read_job(folder)
    _check_idle(folder)
    names = [folder / name for name in _PACKED] + sorted((folder / "inputs").iterdir())
    with (
        written_whole(file) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for path in names:
            if path.is_file():
                archive.write(path, path.relative_to(folder).as_posix())
    return file.stat().st_size


def unpack(file: Path, folder: Path) -> JobStatus:
    """Unpack the job of a file into a new folder."""
    if folder.exists() and any(folder.iterdir()):
        raise InvalidInput(str(folder), found="an existing folder or file", expected="a new folder")
    errors = (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)
    with usable(file, "a packed job", errors), zipfile.ZipFile(file) as archive:
        members = [m for m in archive.infolist() if not m.is_dir()]
        _check_members(file, members)
        (folder / "inputs").mkdir(parents=True)
        # `job.json` last, since it makes the folder a job.
        for member in sorted(members, key=lambda m: m.filename == "job.json"):
            with archive.open(member) as source, (folder / member.filename).open("wb") as copy:
                shutil.copyfileobj(source, copy)
    return status_of(folder)


def _check_members(file: Path, members: list[zipfile.ZipInfo]) -> None:
    names = [member.filename for member in members]
    for name in names:
        path = PurePosixPath(name)
        plain = path.parent == PurePosixPath("inputs") and not path.name.startswith(".")
        if "\\" in name or str(path) != name or not (name in _PACKED or plain):
            raise InvalidInput(str(file), found=f"a file {name!r}", expected="a packed job")
    if "job.json" not in names or len(set(names)) < len(names):
        raise InvalidInput(str(file), found="something else", expected="a packed job")
    total, most = sum(member.file_size for member in members), file.stat().st_size * RATIO
    if total > min(max(SMALL, most), _MAX_BYTES):
        raise InvalidInput(
            str(file), found=f"{total} bytes in a small file", expected="a packed job"
        )


def _check_idle(folder: Path) -> None:
    owner = files.coordinator_of(folder)
    if owner is not None:
        hint = "show it with fixel jobs status, or stop it with fixel jobs cancel"
        raise JobRefused(f"{folder} is being run by {owner}", hint=hint)


def _check_settings(run: RunSettings) -> None:
    if run.workers:
        from fixel.jobs.link import listening, require_dask

        require_dask()
        if run.site is not None:
            listening(run.site.interface)
    if run.site is not None:
        from fixel.jobs.pool import require_slurm

        require_slurm()


def _wait_for_end(folder: Path) -> None:
    deadline = time.monotonic() + END_S
    while files.coordinator_of(folder) is not None:
        if time.monotonic() > deadline:
            raise JobRefused(f"{folder} has not stopped yet", hint="it stops after its chunk")
        time.sleep(0.1)


def _cancel_on_slurm(label: str) -> None:
    from fixel.jobs.pool import SlurmError, cancel

    try:
        cancel(label)
        cancel(f"{label}-c")
    except SlurmError as trouble:
        raise JobRefused(f"the SLURM jobs {label} could not be cancelled: {trouble}") from None
