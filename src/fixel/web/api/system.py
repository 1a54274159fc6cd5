"""Status of the project and its installation; self-test, check and backup on demand."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Final

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse, Response
from pydantic import Field

import fixel
from fixel.errors import JobRefused
from fixel.web.context import Context
from fixel.web.values import Answer
from fixel.web.views import system_status
from fixel.web.views.system_status import BackupFile, SystemStatus
from fixel.workflows.diagnostics import RESIDUAL
from fixel.workflows.project import maintenance

MAX_TROUBLES: Final = 200  # faults that are listed

router = APIRouter()


class ProjectSummary(Answer):
    """Project that is served."""

    name: str
    version: str = Field(description="version of fixel")
    datasets: dict[str, int] = Field(description="number of experiments by dataset")
    flags: dict[str, int] = Field(description="number of experiments by flag")


class SelfTestCheck(Answer):
    """A line of the self-test."""

    name: str
    passed: bool
    detail: str
    residual: float | None


class SelfTest(Answer):
    """Result of `fixel doctor`."""

    passed: bool
    max_residual: float | None
    allowed_residual: float
    checks: list[SelfTestCheck]
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
    return system_status.system_status(context.project)


@router.post(
    "/system/self-test", summary="Run the self-test, which takes up to a minute", tags=["system"]
)
def self_test(context: Context) -> SelfTest:
    with _only_one(context, "the self-test"):
        answer = system_status.self_tested()
    return SelfTest(allowed_residual=RESIDUAL, **answer)


@router.post("/system/check", summary="Check everything that is stored", tags=["system"])
def check(context: Context) -> DatabaseCheck:
    with _only_one(context, "the check"):
        found = maintenance.check(context.project)
    return DatabaseCheck(
        ok=not found.troubles,
        engine=found.engine,
        version=found.version,
        counts=found.counts,
        media_files=found.media_files,
        unused_files=found.unused_files,
        troubles=[TroubleText.model_validate(one) for one in found.troubles[:MAX_TROUBLES]],
        n_trouble=len(found.troubles),
    )


@router.post("/system/backups", summary="Back up the database", tags=["system"])
def back_up(context: Context) -> NewBackup:
    with _only_one(context, "the backup"):
        done = system_status.back_up(context.project)
    return NewBackup(
        backup=system_status.backup_named(context.project, done.file.name),
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
def backup(context: Context, name: Annotated[str, Path(min_length=1, max_length=80)]) -> Response:
    found = system_status.backup_named(context.project, name)
    return FileResponse(found.path, media_type="application/vnd.sqlite3", filename=found.name)


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
