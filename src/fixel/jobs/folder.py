"""Folder of a job: its files, and functions that read and write them.

    job.json        what to run: the function that makes the work, options, checksum of the inputs,
                    version of fixel; never changed
    inputs/         files the work and its chunks read; never changed
    run.json        settings of the last `submit` or `resume`: workers, site
    journal         every answer; a job continues from it alone
    state.json      state and progress, for display
    log.txt         messages with their time
    result          bytes that the work returned
    cancel          exists if the job is to end

The files of `link.py` are there too while several processes work.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import secrets
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

from pydantic import BaseModel, Field, ValidationError

from fixel.errors import InvalidInput, refused_value
from fixel.io.atomic import write_whole
from fixel.io.document import read_document
from fixel.io.journal import lock_of, writer_of
from fixel.io.lock import FileLock, Owner
from fixel.jobs.functions import named_function, stamp
from fixel.jobs.site import Site
from fixel.jobs.work import JobProgress

State = Literal[
    "queued", "preparing", "running", "collecting", "done", "failed", "stopped", "cancelled"
]
STATES: Final[tuple[State, ...]] = get_args(State)
ENDED: Final = ("done", "failed", "stopped", "cancelled")
VERSION: Final = 1  # version of the layout

JOURNAL: Final = "journal"
RESULT: Final = "result"
LOG: Final = "log.txt"
CANCEL: Final = "cancel"
STATE: Final = "state.json"
Record = TypeVar("Record", bound=BaseModel)
UNFINISHED: Final = ".inputs."  # prefix of unfinished folders of inputs, in earlier versions


class Job(BaseModel, extra="forbid", frozen=True):
    """Content of `job.json`."""

    fixel_job: Literal[1] = 1
    name: str
    label: str = Field(pattern=r"^fixel-[0-9a-f]{12}$")  # unique name of its SLURM jobs
    maker: str  # `"KIND:FUNCTION"`, called as `maker(inputs: Path, options) -> Work`
    options: dict[str, Any] = {}
    inputs_sha256: str
    stamp: str  # stamp of the fixel that began it
    made_utc: str


class RunSettings(BaseModel, extra="forbid", frozen=True):
    """Content of `run.json`: settings with which the job is run."""

    # Number of worker processes; 0 to compute in the coordinator.
    workers: int = Field(default=0, ge=0)
    site: Site | None = None  # cluster that they run on; None for this machine
    # Time after which a silent worker counts as dead [s].
    lease_s: float = Field(default=300.0, gt=0.0)
    # Number of workers that a chunk may kill before it is given up.
    max_deaths: int = Field(default=5, ge=1)
    # Stamp of the fixel that may continue the job, if not that of the one that began it.
    stamp: str | None = None


class JobState(JobProgress):
    """Content of `state.json`, which only the coordinator writes."""

    state: State = "queued"


def prepare(
    folder: Path,
    *,
    maker: str,
    inputs: Mapping[str, bytes | Path] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Job:
    """Create a job folder, complete or not at all; by convention `<project>/jobs/<name>`.

    The folder must be empty or missing. `maker` is `"KIND:FUNCTION"`, called as
    `maker(inputs: Path, options) -> Work`. Inputs are files by name for the work and its chunks;
    options are JSON content.
    """
    named_function(maker)
    _left_in(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(lock_of(folder / JOURNAL), f"the job {folder}"):
        _clear(folder)
        write_status(folder, JobState())  # first: it marks the remains of an interrupted call
        (folder / "inputs").mkdir()
        try:
            for name, content in (inputs or {}).items():
                _add_input(folder / "inputs", name, content)
        except BaseException:
            _clear(folder)
            raise
        job = Job(
            name=folder.resolve().name,
            label=f"fixel-{secrets.token_hex(6)}",
            maker=maker,
            options=json.loads(json.dumps(dict(options or {}))),
            inputs_sha256=inputs_digest(folder / "inputs"),
            stamp=stamp(),
            made_utc=utc(),
        )
        # Last: a folder with this file counts as a job.
        _write(folder / "job.json", job)
    return job


def read_job(folder: Path) -> Job:
    """Load the job of a folder; raise `InvalidInput` if it has none.

    A folder that comes from elsewhere may have links, through which a run would write outside it.
    """
    if not (folder / "job.json").is_file():
        hint = "list those of a project: fixel jobs status --project FOLDER"
        raise InvalidInput(str(folder), found="no job", expected="a folder of one", hint=hint)
    for path in folder.rglob("*"):
        if path.is_symlink():
            raise InvalidInput(str(path), found="a link", expected="a folder without links")
    return _read(folder / "job.json", Job)


def read_run(folder: Path) -> RunSettings:
    """Load the settings of the last run, or the default settings."""
    return _read(folder / "run.json", RunSettings)


def write_run(folder: Path, run: RunSettings) -> None:
    """Store the settings of a run, for `resume`."""
    _write(folder / "run.json", run)


def read_status(folder: Path) -> JobState:
    """Load the state of a job."""
    return _read(folder / STATE, JobState)


def write_status(folder: Path, status: JobState) -> None:
    """Store the state of a job with the present time."""
    _write(folder / STATE, status.model_copy(update={"updated_utc": utc()}))


def coordinator_of(folder: Path) -> Owner | None:
    """Return the process that runs the job now, or None; decided by its lock, not by times."""
    return writer_of(folder / JOURNAL)


def inputs_digest(inputs: Path) -> str:
    """Return the SHA-256 checksum of all inputs and their names."""
    digest = hashlib.sha256()
    for path in sorted(inputs.iterdir()):
        with path.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        digest.update(f"{path.name}\0{content}\0".encode())
    return digest.hexdigest()


def log(folder: Path, sentence: str) -> None:
    """Add a line to the log."""
    with (folder / LOG).open("a", encoding="utf-8") as stream:
        stream.write(f"{utc()} {sentence}\n")


def utc() -> str:
    """Return the present UTC time as text; for display only."""
    now = datetime.datetime.fromtimestamp(time.time(), datetime.UTC)
    return now.isoformat(timespec="seconds").replace("+00:00", "Z")


def _left_in(folder: Path) -> list[Path]:
    """Return the remains of an interrupted `prepare`; raise for a folder with other files."""
    found = list(folder.iterdir()) if folder.is_dir() else []
    left = [path for path in found if not path.name.startswith(f"{JOURNAL}.lock")]
    ours = [path for path in left if path.name == STATE or path.name.startswith(UNFINISHED)]
    strange = any(path not in ours and path.name != "inputs" for path in left)
    if strange or (left and not ours) or (folder.exists() and not folder.is_dir()):
        raise InvalidInput(str(folder), found="an existing folder or file", expected="a new folder")
    return left


def _clear(folder: Path) -> None:
    for path in _left_in(folder):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def _add_input(folder: Path, name: str, content: bytes | Path) -> None:
    if not name or name.startswith(".") or Path(name).name != name or "\\" in name:
        raise InvalidInput("inputs", found=name, expected="a plain file name")
    if isinstance(content, bytes):
        (folder / name).write_bytes(content)
    else:
        shutil.copyfile(content, folder / name)


def _write(path: Path, record: BaseModel) -> None:
    # Otherwise a power cut may leave an empty file under the new name.
    write_whole(path, json.dumps(record.model_dump(), indent=1) + "\n", durable=True)


def _read(path: Path, kind: type[Record]) -> Record:
    """Load a record; without its file, one of defaults."""
    content = read_document(path) if path.is_file() else {}
    try:
        return kind.model_validate(content)
    except ValidationError as problem:
        raise refused_value(problem, str(path), known=kind.model_fields) from None
