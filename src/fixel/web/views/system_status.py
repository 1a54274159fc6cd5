"""Status of an installation: versions, database and schema, disk space, backups."""

from __future__ import annotations

import datetime
import os
import re
import shutil
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import sqlalchemy as sa

from fixel.database import schema
from fixel.database.engine import open_engine, reading
from fixel.database.project import Project
from fixel.errors import JobRefused, NotStored
from fixel.formats.trajectory_file import plain_numbers
from fixel.jobs.worker_process import WorkerProcess
from fixel.kernels.jit import cache_folder
from fixel.workflows.compilation import cache_size, engine_is_cold
from fixel.workflows.diagnostics import doctor
from fixel.workflows.project import maintenance
from fixel.workflows.project.maintenance import Backup, CheckResult

BACKUPS: Final = "backups"  # folder of a project
MAX_FILES: Final = 100_000  # largest number of files of the media folder to count
SELF_TEST_LIMIT: Final = 600.0  # [s]; with an engine to compile, it takes about two minutes
_BACKUP_NAME: Final = re.compile(r"experiments-[0-9]{8}-[0-9]{6}(-[0-9]{1,4})?\.db")


class Room(NamedTuple):
    """Sizes of files, and the space on their disk."""

    database: int | None  # [byte]; None if it is on a server
    media: int  # [byte]
    media_files: int
    counted: bool  # whether `media` contains all files
    free: int  # [byte]
    total: int  # [byte]


class Schema(NamedTuple):
    """Schema of a database."""

    engine: str  # sqlite or postgresql
    place: str  # address without a password
    version: str | None
    newest: str  # newest version that this program knows
    pending: tuple[str, ...]  # migrations between the two


class Installation(NamedTuple):
    """Versions and machine of this installation."""

    versions: dict[str, str]
    machine: dict[str, Any]
    cache_folder: str  # folder of compiled kernels
    cache_bytes: int
    compiled: bool


class BackupFile(NamedTuple):
    """Backup in the project's folder."""

    name: str
    file: Path
    size: int  # [byte]
    made_utc: str


def installation() -> Installation:
    """Return versions and machine; runs nothing."""
    return Installation(
        doctor.versions(), doctor.machine(), cache_folder(), cache_size(), not engine_is_cold()
    )


def schema_of(project: Project) -> Schema:
    """Return the version of the tables, and the migrations that an upgrade would apply."""
    engine = open_engine(project.url)
    try:
        with reading(engine) as connection:
            version = schema.version_of(connection)
    finally:
        engine.dispose()
    known = schema.versions()
    done = known.index(version) + 1 if version in known else 0
    place = sa.make_url(project.url).render_as_string(hide_password=True)
    return Schema(engine.dialect.name, place, version, schema.newest(), known[done:])


def room(project: Project) -> Room:
    """Measure the sizes of a project's files, and the free space on their disk."""
    url = sa.make_url(project.url)
    file = Path(url.database or "") if url.get_backend_name() == "sqlite" else None
    size = None
    if file is not None:
        names = (file, file.with_name(f"{file.name}-wal"))
        size = sum(path.stat().st_size for path in names if path.is_file())
    total = files = 0
    for path in project.media.glob("??/*"):
        if files == MAX_FILES:
            break
        with suppress(FileNotFoundError):  # a temporary file that its writer has just renamed
            total += path.stat(follow_symlinks=False).st_size
            files += 1
    disk = shutil.disk_usage(project.folder)
    return Room(size, total, files, files < MAX_FILES, disk.free, disk.total)


def self_tested(nobody_waits: Callable[[], bool] = lambda: False) -> dict[str, Any]:
    """Run `fixel doctor --json` in a process of its own, as kernels would delay other requests."""
    with WorkerProcess(_examined, limit=SELF_TEST_LIMIT) as beside:
        answer: dict[str, Any] = beside.call(None, nobody_waits)
    return answer


def _examined(_: None) -> dict[str, Any]:
    found: dict[str, Any] = plain_numbers(doctor.examine().summary())
    return found


def checked(project: Project) -> CheckResult:
    """Return the result of `fixel db check`."""
    return maintenance.check(project.folder)


# --- backups ------------------------------------------------------------------------------------

_making = threading.Lock()


def back_up(project: Project) -> Backup:
    """Copy the database into the folder of backups, under a name with the time."""
    folder = project.folder / BACKUPS
    with _making:  # or two might choose the same name
        folder.mkdir(exist_ok=True)
        return maintenance.backup(project.folder, _new_name(folder))


def _new_name(folder: Path) -> Path:
    now = datetime.datetime.now(datetime.UTC)
    stem = f"experiments-{now:%Y%m%d-%H%M%S}"
    names = [f"{stem}.db", *(f"{stem}-{k}.db" for k in range(2, 1000))]
    free = (folder / name for name in names if not os.path.lexists(folder / name))
    file = next(free, None)
    if file is None:
        raise JobRefused("a thousand backups within this second", hint="wait a moment")
    return file


def backups(project: Project) -> list[BackupFile]:
    """Return the backups in the project's folder, newest first."""
    folder = project.folder / BACKUPS
    if not folder.is_dir():
        return []
    found = [
        _kept(path)
        for path in folder.iterdir()
        if _BACKUP_NAME.fullmatch(path.name) and path.is_file() and not path.is_symlink()
    ]
    return sorted(found, key=lambda kept: (kept.made_utc, len(kept.name), kept.name), reverse=True)


def backup_named(project: Project, name: str) -> BackupFile:
    """Return the backup of a name, which is compared with existing ones, never used as a path."""
    for kept in backups(project):
        if kept.name == name:
            return kept
    raise NotStored(f"backup {name!r}", hint="make one with: fixel db backup FILE")


def _kept(path: Path) -> BackupFile:
    known = path.stat()
    made = datetime.datetime.fromtimestamp(known.st_mtime, datetime.UTC)
    instant = made.isoformat(timespec="seconds").replace("+00:00", "Z")
    return BackupFile(path.name, path, known.st_size, instant)
