"""Pools, which start the workers of a job and replace those that end: processes or SLURM jobs.

SLURM jobs are submitted from the machine of the coordinator: no SSH, no accounting. One job is one
worker for many chunks: no arrays, few submissions. Dask-jobqueue writes the head of the script.
Submission, polling and replacement are done here, since each may fail on clusters.
"""

from __future__ import annotations

import abc
import getpass
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.errors import InvalidInput, JobRefused
from fixel.jobs import link
from fixel.jobs.functions import stamp
from fixel.jobs.site import Site, check_site

MAX_STILLBORN: Final = 3  # workers in a row that end before they have joined
MAX_LOCAL, MAX_A_CORE = 64, 8  # worker processes of a machine, the larger limit of both
TAIL: Final = 12  # lines of a log in an error message


class AbstractPool(abc.ABC):
    """Pool of `size` workers, which are replaced when they end."""

    size: int  # workers that are wanted
    interface: str = link.LOOPBACK

    @abc.abstractmethod
    def keep(self) -> None:
        """Replace workers that have ended; called about once a second, returns soon.

        Raise `JobRefused` if workers cannot be started, and waiting does not help.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """End the workers."""

    @property
    def note(self) -> str:
        """Reason why workers wait; empty if they do not."""
        return ""


class LocalPool(AbstractPool):
    """Pool of `size` worker processes on this machine; they end with this process.

    `python` is their interpreter, by default the one that runs.
    """

    def __init__(self, folder: Path, size: int, python: str | None = None) -> None:
        most = max(MAX_LOCAL, MAX_A_CORE * (os.cpu_count() or 1))
        if not 1 <= size <= most:  # the number may come from a foreign folder
            raise InvalidInput("workers", found=size, expected=f"1 to {most} on this machine")
        self.size = size
        self._folder = folder
        self._python = python or sys.executable
        self._slots: dict[int, tuple[str, subprocess.Popen[bytes]] | None] = dict.fromkeys(
            range(size)
        )
        self._stillborn = 0
        self._started = 0
        # Workers of earlier sessions must not count as joined to this one.
        self._session = f"{os.getpid()}-{time.time_ns() % 10**6:06d}"

    def keep(self) -> None:
        for slot, held in self._slots.items():
            if held is not None and held[1].poll() is not None:
                self._note_end(*held)
                self._slots[slot] = None
            if self._slots[slot] is None:
                self._slots[slot] = self._start()

    def close(self) -> None:
        held = [slot for slot in self._slots.values() if slot is not None]
        for _, process in held:
            process.kill()
        for _, process in held:
            process.wait()
            if process.stdin is not None:
                process.stdin.close()
        self._slots = dict.fromkeys(self._slots)

    def _start(self) -> tuple[str, subprocess.Popen[bytes]]:
        self._started += 1
        name = f"local-{self._session}-{self._started}"
        cores = max(1, (os.cpu_count() or 1) // self.size)
        command = [*worker_command(self._folder, name, self.interface, cores), "--watch-parent"]
        with (self._folder / "workers" / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                [self._python, *command],
                stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        return name, process

    def _note_end(self, name: str, process: subprocess.Popen[bytes]) -> None:
        if process.stdin is not None:
            process.stdin.close()
        if link.joined(self._folder, name):
            self._stillborn = 0
            return
        if process.returncode == link.REFUSED:
            return  # the engine reads the reason that the worker has stored
        self._stillborn += 1
        if self._stillborn >= MAX_STILLBORN:
            raise stillborn(self._folder / "workers" / f"{name}.log")


def worker_command(folder: Path, name: str, interface: str, cores: int) -> list[str]:
    """Return the arguments of the interpreter that start a worker."""
    return [
        "-P", "-m", "fixel.jobs.worker", str(folder.resolve()),
        "--name", name,
        "--stamp", stamp(),
        "--interface", interface,
        "--threads", str(cores),
    ]  # fmt: skip


def stillborn(*logs: Path) -> JobRefused:
    """Return the error for workers that ended before they had joined, with lines of logs."""
    said = "\n".join(
        line
        for log in logs
        if log.exists()
        for line in log.read_text(errors="replace").splitlines()[-TAIL:]
    )
    end = f"; output of the last one:\n{said}" if said else ", without output"
    return JobRefused(f"{MAX_STILLBORN} workers in a row ended before they could compute{end}")


COMMAND_S: Final = 60.0  # [s] for a command of SLURM; a busy controller takes long to answer
MAX_BACK_OFF_S: Final = 120.0
# [s] A job that was just submitted may not be listed yet.
UNSEEN_S: Final = 30.0
PATIENCE_S: Final = 120.0  # [s] that a worker waits for another scheduler when its own is gone
MAX_CANCELLED: Final = 3  # jobs cancelled one after the other before they started
_ACTIVE: Final = frozenset(
    ("PENDING", "RUNNING", "CONFIGURING", "COMPLETING", "SUSPENDED", "STOPPED", "RESIZING",
     "REQUEUED", "REQUEUE_HOLD", "REQUEUE_FED", "SIGNALING", "STAGE_OUT", "SPECIAL_EXIT",
     "RESV_DEL_HOLD")
)  # fmt: skip
# Messages of sbatch about errors that do not disappear by waiting.
_HOPELESS: Final = (
    "invalid partition",
    "invalid account",
    "invalid qos",
    "invalid wckey",
    "invalid generic resource",
    "unrecognized option",
    "invalid numeric value",
    "invalid --",
    "memory specification can not be satisfied",
    "node configuration is not available",
    "requested time limit is invalid",
    "user's group not permitted",
    "access/permission denied",
)


class SlurmJob(NamedTuple):
    """Job as SLURM lists it."""

    id: str
    state: str
    reason: str

    @property
    def active(self) -> bool:
        """Whether the job waits or runs."""
        return self.state in _ACTIVE


class SlurmError(Exception):
    """Exception raised when a SLURM command fails; `hopeless` if it always will."""

    def __init__(self, said: str, hopeless: bool = False) -> None:
        self.hopeless = hopeless
        super().__init__(said)


def require_slurm() -> None:
    """Raise `InvalidInput` if the commands of SLURM are missing."""
    for command in ("sbatch", "squeue", "scancel"):
        if shutil.which(command) is None:
            found = f"no command {command}"
            expected = "a machine from which jobs can be submitted"
            hint = "work on the login node of the cluster, or without a site"
            raise InvalidInput("scheduler slurm", found=found, expected=expected, hint=hint)


def submit(script: Path) -> str:
    """Submit a script and return the id of its job."""
    said = _call("sbatch", "--parsable", str(script)).strip()
    number = said.splitlines()[-1].split(";")[0] if said else ""
    if not number.isdecimal():
        raise SlurmError(f"sbatch answered {said!r}")
    return number


def listed_jobs(name: str) -> list[SlurmJob]:
    """Return the user's jobs of a name, also ended ones that SLURM still lists."""
    answer = _call(
        "squeue", "--noheader", "--states=all",
        f"--user={getpass.getuser()}", f"--name={name}", "--format=%i|%T|%r",
    )  # fmt: skip
    rows = (line.strip().split("|", 2) for line in answer.splitlines() if line.count("|") >= 2)
    return [SlurmJob(*row) for row in rows]


def cancel(name: str) -> None:
    """Cancel the user's jobs of a name."""
    _call("scancel", f"--user={getpass.getuser()}", f"--name={name}")


def _call(*command: str) -> str:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=COMMAND_S, stdin=subprocess.DEVNULL
        )
    except FileNotFoundError:
        raise SlurmError(f"{command[0]} is not installed", hopeless=True) from None
    except (OSError, subprocess.TimeoutExpired) as problem:
        raise SlurmError(f"{command[0]}: {problem}") from None
    if done.returncode != 0:
        said = " ".join((done.stderr or done.stdout).split()) or f"exit code {done.returncode}"
        raise SlurmError(said, any(words in said.lower() for words in _HOPELESS))
    return done.stdout


def job_script(site: Site, name: str, command: list[str], logs: Path) -> str:
    """Return a script for sbatch; `command` are the arguments of Python, quoted for the shell.

    The user must have named the shell lines of the site.
    """
    check_site(site)
    job = _slurm_job()(
        scheduler="none",
        name=name,
        queue=site.queue,
        account=site.account,
        walltime=site.walltime,
        cores=site.cores,
        processes=1,
        memory=site.memory.replace(" ", ""),
        job_name=name,
        job_extra_directives=list(site.directives),
        job_directives_skip=list(site.skip_directives),
        log_directory=str(logs),
        interface=None,
        # Given here, so that a configuration of Dask cannot change the template.
        config_name="slurm",
        job_script_prologue=list(site.prologue),
        worker_extra_args=[],
        job_cpu=site.cores,
    )
    python = shlex.quote(site.python or sys.executable)
    lines = [job.shebang, "", job.job_header, *site.prologue, " ".join(["exec", python, *command])]
    return "\n".join(lines) + "\n"


def _slurm_job() -> Any:
    """Import dask-jobqueue's job class without its handler of Ctrl-C."""
    here = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    from dask_jobqueue.slurm import SLURMJob

    if here:
        signal.signal(signal.SIGINT, handler)
    return SLURMJob


class SlurmPool(AbstractPool):
    """Pool of `size` workers as SLURM jobs; takes over those of an interrupted session.

    The folder is on a file system that the nodes share. Jobs have one unique name, by which they
    are found again. `notify` is called with a sentence when something happens. `squeue` is called
    every `poll_s`. After a refused submission the pool waits `back_off_s`, doubled each time.
    """

    def __init__(
        self,
        folder: Path,
        size: int,
        site: Site,
        name: str,
        *,
        notify: Callable[[str], None],
        poll_s: float = 3.0,
        back_off_s: float = 1.0,
    ) -> None:
        require_slurm()
        self.size = min(size, site.max_jobs)
        self.interface = site.interface
        self._folder = folder
        self._site = site
        self._name = name
        self._say = notify
        self._poll_s = poll_s
        self._jobs: dict[str, SlurmJob] = {}
        self._ended: set[str] = set()
        self._submitted: dict[str, float] = {}
        self._next_look = self._next_submit = 0.0
        self._first_back_off = max(back_off_s, site.submit_interval_s)
        self._back_off = self._first_back_off
        self._in_a_row = {"stillborn": 0, "cancelled": 0}
        self._trouble = ""
        self._first = True

    @property
    def note(self) -> str:
        if self._trouble:
            return self._trouble
        pending = [job for job in self._jobs.values() if job.state == "PENDING"]
        reasons = ", ".join(sorted({job.reason for job in pending}))
        return f"{len(pending)} jobs are waiting in the queue ({reasons})" if pending else ""

    def keep(self) -> None:
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + self._poll_s
        if self._look(now):
            self._top_up(now)

    def close(self) -> None:
        try:
            cancel(self._name)
        except SlurmError as trouble:
            self._say(f"the workers could not be cancelled and will end by themselves: {trouble}")

    def _look(self, now: float) -> bool:
        """Update the jobs from SLURM; return False if it does not answer."""
        try:
            jobs = listed_jobs(self._name)
        except SlurmError as trouble:
            self._note_trouble(f"squeue: {trouble}")
            return False
        if self._first:
            # Jobs that ended before this session do not count.
            self._ended |= {job.id for job in jobs if not job.active}
            self._first = False
        self._jobs = {job.id: job for job in jobs if job.active}
        for job in jobs:
            self._submitted.pop(job.id, None)
            if not job.active and job.id not in self._ended:
                self._ended.add(job.id)
                self._note_end(job)
        self._submitted = {k: t for k, t in self._submitted.items() if now - t < UNSEEN_S}
        return True

    def _top_up(self, now: float) -> None:
        """Submit missing workers, one per `submit_interval_s`."""
        while (
            len(self._jobs) + len(self._submitted) < self.size
            and time.monotonic() >= self._next_submit
        ):
            try:
                number = submit(self._script())
            except SlurmError as trouble:
                self._submit_failed(trouble, now)
                return
            self._trouble = ""
            self._back_off = self._first_back_off
            self._submitted[number] = now
            self._say(f"submitted worker {number}")
            # Counted from the answer: a busy controller takes long to give one.
            self._next_submit = time.monotonic() + self._site.submit_interval_s
            self._next_look = min(self._next_look, self._next_submit)

    def _submit_failed(self, trouble: SlurmError, now: float) -> None:
        if trouble.hopeless:
            raise JobRefused(
                f"sbatch rejects the worker: {trouble}", hint="correct the site template"
            )
        self._next_submit = now + self._back_off
        self._note_trouble(f"sbatch: {trouble}; again in {self._back_off:.0f} s")
        self._back_off = min(2.0 * self._back_off, MAX_BACK_OFF_S)

    def _note_trouble(self, sentence: str) -> None:
        if sentence != self._trouble:
            self._say(sentence)
        self._trouble = sentence

    def _note_end(self, job: SlurmJob) -> None:
        """Count workers that never joined; raise `JobRefused` after several in a row."""
        self._say(f"worker {job.id} has ended: {job.state.lower()}")
        if link.joined(self._folder, f"slurm-{job.id}"):
            self._in_a_row = {"stillborn": 0, "cancelled": 0}
            return
        if job.state in ("FAILED", "COMPLETED", "OUT_OF_MEMORY", "TIMEOUT"):
            self._in_a_row["stillborn"] += 1
        elif job.state == "CANCELLED":
            self._in_a_row["cancelled"] += 1
        if self._in_a_row["stillborn"] >= MAX_STILLBORN:
            raise stillborn(*sorted((self._folder / "workers").glob(f"*-{job.id}.*")))
        if self._in_a_row["cancelled"] >= MAX_CANCELLED:
            raise JobRefused(
                f"{MAX_CANCELLED} workers were cancelled before they started",
                hint="if this was not intended, resume the job",
            )

    def _script(self) -> Path:
        path = self._folder / "workers" / "worker.sh"
        site = self._site
        command = [
            shlex.quote(word)
            for word in worker_command(self._folder, "NAME", site.interface, site.cores)
        ]
        command[command.index("NAME")] = "slurm-$SLURM_JOB_ID"
        command += [f"--lifetime-s={site.lifetime_s:g}", f"--patience-s={PATIENCE_S:g}"]
        path.write_text(job_script(site, self._name, command, self._folder.resolve() / "workers"))
        return path
