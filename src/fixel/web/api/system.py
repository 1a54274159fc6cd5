"""Status of the installation; self-test, check and backup on demand."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Final

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel, Field

from fixel.errors import JobRefused
from fixel.web.views import system_status
from fixel.workflows.diagnostics.self_test import RESIDUAL
from fixel.workflows.project.maintenance import CheckResult

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_TROUBLES: Final = 200  # faults that are listed


class CacheOut(BaseModel):
    """Compiled kernels."""

    folder: str
    size_bytes: int
    warm: bool = Field(description="whether the engine is compiled already")


class DatabaseOut(BaseModel):
    """Database of the project."""

    engine: str
    place: str = Field(description="without a password")
    schema_version: str | None
    newest: str = Field(description="schema that this program knows")
    pending: list[str] = Field(description="migrations that an upgrade would do")
    size_bytes: int | None = Field(description="none where it lies on a server")


class DiskOut(BaseModel):
    """Room for more."""

    folder: str
    media_bytes: int
    media_files: int
    counted: bool = Field(description="whether that is all of the media")
    free_bytes: int
    total_bytes: int


class BackupOut(BaseModel):
    """A copy of the database in the project's folder."""

    name: str
    path: str
    size_bytes: int
    made_utc: str


class SystemOut(BaseModel):
    """Versions, database, disk and backups."""

    versions: dict[str, str]
    machine: dict[str, Any]
    cache: CacheOut
    database: DatabaseOut
    disk: DiskOut
    backups: list[BackupOut]


class CheckOut(BaseModel):
    """A line of the self-test."""

    name: str
    passed: bool
    detail: str
    residual: float | None


class SelfTestOut(BaseModel):
    """Result of `fixel doctor`."""

    passed: bool
    max_residual: float | None
    allowed_residual: float
    checks: list[CheckOut]
    seconds: float


class TroubleOut(BaseModel):
    """One thing that is wrong."""

    where: str
    sentence: str
    hint: str


class DatabaseCheckOut(BaseModel):
    """Result of `fixel db check`."""

    ok: bool
    engine: str
    version: str | None
    counts: dict[str, int] = Field(description="rows of every table, deleted ones too")
    media_files: int
    unused_files: int = Field(description="that no row names")
    troubles: list[TroubleOut]
    n_trouble: int


class BackedUpOut(BaseModel):
    """A copy that was just made."""

    backup: BackupOut
    sha256: str
    media: str = Field(description="this folder must be copied, too; its files never change")


BackupName = Annotated[str, Path(min_length=1, max_length=80)]


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/system`."""
    found = APIRouter(tags=["system"])
    project = desk.project
    alone = _OneAtATime()

    @found.get("/system", summary="Versions, database, disk, backups")
    def known() -> SystemOut:
        return system_out(desk)

    @found.post("/system/self-test", summary="Problems with known answers: takes a minute")
    def self_test() -> SelfTestOut:
        with alone.at("the self-test"):
            answer = system_status.self_tested()
        return SelfTestOut(
            passed=answer["passed"],
            max_residual=answer["max_residual"],
            allowed_residual=RESIDUAL,
            checks=[CheckOut(**check) for check in answer["checks"]],
            seconds=answer["seconds"],
        )

    @found.post("/system/check", summary="Read all that is stored, and say what is wrong")
    def check() -> DatabaseCheckOut:
        with alone.at("the check"):
            return _checked(system_status.checked(project))

    @found.post("/system/backups", summary="Copy the database, while others go on using it")
    def back_up() -> BackedUpOut:
        with alone.at("the backup"):
            done = system_status.back_up(project)
        kept = system_status.backup_named(project, done.file.name)
        return BackedUpOut(
            backup=_backup(kept), sha256=done.sha256, media=str(done.media.resolve())
        )

    @found.get(
        "/system/backups/{name}",
        summary="A backup, to be saved",
        response_class=FileResponse,
        responses={200: {"content": {"application/vnd.sqlite3": {}}}},
    )
    def backup(name: BackupName) -> Response:
        kept = system_status.backup_named(project, name)
        return FileResponse(kept.file, media_type="application/vnd.sqlite3", filename=kept.name)

    return found


def system_out(desk: ProjectContext) -> SystemOut:
    """Return everything about the installation that needs no computing, for JSON."""
    project = desk.project
    here, tables, room = (
        system_status.installation(),
        system_status.schema_of(project),
        system_status.room(project),
    )
    return SystemOut(
        versions=here.versions,
        machine=here.machine,
        cache=CacheOut(folder=here.cache_folder, size_bytes=here.cache_bytes, warm=here.compiled),
        database=DatabaseOut(
            engine=tables.engine,
            place=tables.place,
            schema_version=tables.version,
            newest=tables.newest,
            pending=list(tables.pending),
            size_bytes=room.database,
        ),
        disk=DiskOut(
            folder=str(desk.folder),
            media_bytes=room.media,
            media_files=room.media_files,
            counted=room.counted,
            free_bytes=room.free,
            total_bytes=room.total,
        ),
        backups=[_backup(kept) for kept in system_status.backups(project)],
    )


def _backup(kept: system_status.BackupFile) -> BackupOut:
    return BackupOut(
        name=kept.name, path=str(kept.file.resolve()), size_bytes=kept.size, made_utc=kept.made_utc
    )


def _checked(found: CheckResult) -> DatabaseCheckOut:
    told = found.troubles[:MAX_TROUBLES]
    return DatabaseCheckOut(
        ok=not found.troubles,
        engine=found.engine,
        version=found.version,
        counts=found.counts,
        media_files=found.media_files,
        unused_files=found.unused_files,
        troubles=[TroubleOut(**trouble._asdict()) for trouble in told],
        n_trouble=len(found.troubles),
    )


class _OneAtATime:
    """Long tasks, each running once at a time: a page that is opened often must not load a disk."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[str] = set()

    @contextmanager
    def at(self, what: str) -> Iterator[None]:
        with self._lock:
            if what in self._running:
                raise JobRefused(f"{what} is running already", hint="wait for it to end")
            self._running.add(what)
        try:
            yield
        finally:
            with self._lock:
                self._running.discard(what)
