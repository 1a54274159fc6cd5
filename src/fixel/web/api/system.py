"""Status of the project and its installation; self-test, check and backup on demand."""

from __future__ import annotations

import datetime
import os
import re
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Final

import sqlalchemy as sa
from fastapi import APIRouter, Path as InPath
from fastapi.responses import FileResponse, Response
from pydantic import Field

import fixel
from fixel.database import schema
from fixel.database.engine import open_engine, reading
from fixel.database.project import Project
from fixel.errors import JobRefused, NotStored
from fixel.io.atomic import usable
from fixel.io.document import plain_numbers
from fixel.jobs.worker_process import WorkerProcess
from fixel.kernels.code_cache import cache_folder, share_compiled
from fixel.simulation.first_code import ENTRY
from fixel.web.context import Context
from fixel.web.values import Answer
from fixel.workflows import installation
from fixel.workflows.installation import SelfCheck, cache_size, engine_is_cold
from fixel.workflows.project import maintenance

MAX_TROUBLES: Final = 200  # faults that are listed
BACKUPS: Final = "backups"  # folder of a project
MAX_FILES: Final = 100_000  # largest number of files of the media folder to count
SELF_TEST_LIMIT: Final = 600.0  # [s]; with an engine to compile, it takes about two minutes
_BACKUP_NAME: Final = re.compile(r"experiments-[0-9]{8}-[0-9]{6}(-[0-9]{1,4})?\.db")

router = APIRouter()


class ProjectSummary(Answer):
    """Project that is served."""

    name: str
    version: str = Field(description="version of fixel")
    datasets: dict[str, int] = Field(description="number of experiments by dataset")
    flags: dict[str, int] = Field(description="number of experiments by flag")


class SelfTest(Answer):
    """Result of `fixel doctor`."""

    passed: bool
    max_residual: float | None
    allowed_residual: float
    checks: list[SelfCheck]
    seconds: float


class TroubleText(Answer):
    """One thing that is wrong."""

    where: str
    sentence: str
    hint: str


class DatabaseCheck(Answer):
    """Result of `fixel db check`."""

    ok: bool
    engine: str
    version: str | None
    counts: dict[str, int] = Field(description="number of rows by table, including deleted ones")
    media_files: int
    unused_files: int = Field(description="number of media files that no row refers to")
    troubles: list[TroubleText]
    n_trouble: int


class NewBackup(Answer):
    """A copy that was just made."""

    backup: BackupFile
    sha256: str
    media: str = Field(
        description="folder of the media files, which must be copied too; they never change"
    )


class CompiledKernels(Answer):
    """Compiled kernels."""

    folder: str
    size_bytes: int
    warm: bool = Field(description="whether the kernels are compiled")
    compiling: float | None = Field(description="share that a process has compiled by now")


class DatabaseStatus(Answer):
    """Database of the project."""

    engine: str = Field(description="database engine: sqlite or postgresql")
    place: str = Field(description="location without password")
    schema_version: str | None
    newest: str = Field(description="newest schema of this version of fixel")
    pending: list[str] = Field(description="migrations that an upgrade would apply")
    size_bytes: int | None = Field(description="size; null for a database on a server")


class DiskStatus(Answer):
    """Room for more."""

    folder: str
    media_bytes: int
    media_files: int
    counted: bool = Field(description="whether all media files were counted")
    free_bytes: int
    total_bytes: int


class BackupFile(Answer):
    """A copy of the database in the project's folder."""

    name: str
    path: str
    size_bytes: int
    made_utc: str


class SystemStatus(Answer):
    """Versions, database, disk and backups."""

    versions: dict[str, str]
    machine: dict[str, Any]
    cache: CompiledKernels
    database: DatabaseStatus
    disk: DiskStatus
    backups: list[BackupFile]


@router.get("/project", summary="Get the name and content of the project", tags=["project"])
def project(context: Context) -> ProjectSummary:
    return ProjectSummary(
        name=context.name,
        version=fixel.__version__,
        datasets=context.store.datasets(),
        flags=context.store.flags(),
    )


@router.get("/system", summary="Get versions, database, disk usage and backups", tags=["system"])
def system(context: Context) -> SystemStatus:
    return system_status(context.project)


@router.post(
    "/system/self-test", summary="Run the self-test, which takes up to a minute", tags=["system"]
)
def self_test(context: Context) -> SelfTest:
    with _only_one(context, "the self-test"):
        answer = self_tested()
    context.newest["self-test"] = found = SelfTest(allowed_residual=installation.RESIDUAL, **answer)
    return found


@router.post("/system/check", summary="Check everything that is stored", tags=["system"])
def check(context: Context) -> DatabaseCheck:
    with _only_one(context, "the check"):
        found = maintenance.check(context.project)
    troubles = found.summary()["troubles"]
    listed = {"troubles": troubles[:MAX_TROUBLES], "n_trouble": len(troubles)}
    context.newest["check"] = answer = DatabaseCheck(**found.summary() | listed)
    return answer


@router.post("/system/backups", summary="Back up the database", tags=["system"])
def back_up(context: Context) -> NewBackup:
    with _only_one(context, "the backup"):
        folder = context.project.folder / BACKUPS
        with usable(folder, "a folder in an existing project", FileNotFoundError):
            folder.mkdir(exist_ok=True)
        done = maintenance.backup(context.project, _new_name(folder))
    return NewBackup(
        backup=backup_named(context.project, done.file.name),
        sha256=done.sha256,
        media=str(done.media.resolve()),
    )


@router.get(
    "/system/backups/{name}",
    summary="Download a backup",
    response_class=FileResponse,
    responses={200: {"content": {"application/vnd.sqlite3": {}}}},
    tags=["system"],
)
def backup(context: Context, name: Annotated[str, InPath(min_length=1, max_length=80)]) -> Response:
    found = backup_named(context.project, name)
    return FileResponse(found.path, media_type="application/vnd.sqlite3", filename=found.name)


def system_status(project: Project) -> SystemStatus:
    """Return everything about the installation that needs no computing."""
    return SystemStatus(
        versions=installation.versions(),
        machine=installation.machine(),
        cache=CompiledKernels(
            folder=cache_folder(),
            size_bytes=cache_size(),
            warm=not engine_is_cold(),
            compiling=share_compiled(ENTRY),
        ),
        database=_database(project),
        disk=disk_status(project),
        backups=backups(project),
    )


def _database(project: Project) -> DatabaseStatus:
    engine = open_engine(project.url)
    try:
        with reading(engine) as connection:
            version = schema.version_of(connection)
    finally:
        engine.dispose()
    known = schema.versions()
    url = sa.make_url(project.url)
    size = None
    if url.get_backend_name() == "sqlite":
        file = Path(url.database or "")
        names = (file, file.with_name(f"{file.name}-wal"))
        size = sum(path.stat().st_size for path in names if path.is_file())
    return DatabaseStatus(
        engine=engine.dialect.name,
        place=url.render_as_string(hide_password=True),
        schema_version=version,
        newest=schema.newest(),
        pending=list(known[known.index(version) + 1 :] if version in known else known),
        size_bytes=size,
    )


def disk_status(project: Project) -> DiskStatus:
    """Measure the sizes of a project's media, and the free space on their disk."""
    total = files = 0
    for path in project.media.glob("??/*"):
        if files == MAX_FILES:
            break
        with suppress(FileNotFoundError):  # a temporary file that its writer has just renamed
            total += path.stat(follow_symlinks=False).st_size
            files += 1
    disk = shutil.disk_usage(project.folder)
    return DiskStatus(
        folder=str(project.folder.resolve()),
        media_bytes=total,
        media_files=files,
        counted=files < MAX_FILES,
        free_bytes=disk.free,
        total_bytes=disk.total,
    )


def self_tested() -> dict[str, Any]:
    """Run `fixel doctor --json` in a process of its own, as kernels would delay other requests."""
    with WorkerProcess(_examined, limit=SELF_TEST_LIMIT) as worker:
        answer: dict[str, Any] = worker.call(None)
    return answer


def _examined(_: None) -> dict[str, Any]:
    found: dict[str, Any] = plain_numbers(installation.examine().summary())
    return found


def _new_name(folder: Path) -> Path:
    now = datetime.datetime.now(datetime.UTC)
    stem = f"experiments-{now:%Y%m%d-%H%M%S}"
    names = [f"{stem}.db", *(f"{stem}-{k}.db" for k in range(2, 1000))]
    free = (folder / name for name in names if not os.path.lexists(folder / name))
    file = next(free, None)
    if file is None:
        raise JobRefused("a thousand backups within this second", hint="wait a second")
    return file


def backups(project: Project) -> list[BackupFile]:
    """Return the backups in the project's folder, newest first."""
    folder = project.folder / BACKUPS
    if not folder.is_dir():
        return []
    found = [
        _backup_file(path)
        for path in folder.iterdir()
        if _BACKUP_NAME.fullmatch(path.name) and path.is_file() and not path.is_symlink()
    ]
    return sorted(found, key=lambda one: (one.made_utc, len(one.name), one.name), reverse=True)


def backup_named(project: Project, name: str) -> BackupFile:
    """Return the backup of a name, which is compared with existing ones, never used as a path."""
    for backup in backups(project):
        if backup.name == name:
            return backup
    raise NotStored(f"backup {name!r}", hint="create one: fixel db backup FILE")


def _backup_file(path: Path) -> BackupFile:
    known = path.stat()
    made = datetime.datetime.fromtimestamp(known.st_mtime, datetime.UTC)
    return BackupFile(
        name=path.name,
        path=str(path.resolve()),
        size_bytes=known.st_size,
        made_utc=made.isoformat(timespec="seconds").replace("+00:00", "Z"),
    )


_running: set[tuple[str, str]] = set()
_lock = threading.Lock()


@contextmanager
def _only_one(context: Context, what: str) -> Iterator[None]:
    """Run a long task of a project once at a time: a page that is opened often must not load a
    disk."""
    task = (str(context.folder), what)
    with _lock:
        if task in _running:
            raise JobRefused(f"{what} is already running", hint="wait until it has finished")
        _running.add(task)
    try:
        yield
    finally:
        with _lock:
            _running.discard(task)
