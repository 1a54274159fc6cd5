"""Projects: folders with settings, a database, and media too large for the database.

my_lab/
    fixel.yaml          settings: a name, and where the database is
    experiments.db      SQLite, unless the settings or FIXEL_DATABASE name a server
    media/              videos and long arrays, named by their content
"""

from __future__ import annotations

import os
import shlex
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused, machine_failure
from fixel.io.atomic import written_whole
from fixel.io.document import read_document

SETTINGS: Final = "fixel.yaml"
DATABASE: Final = "experiments.db"
DATABASE_FILES: Final = (DATABASE, f"{DATABASE}-wal", f"{DATABASE}-shm", f"{DATABASE}-journal")
MEDIA: Final = "media"
MAX_NAME: Final = 200  # characters
VARIABLE: Final = "FIXEL_DATABASE"  # environment variable; overrides the database of the settings


class ProjectSettings(BaseModel):
    """Content of `fixel.yaml`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=MAX_NAME)
    database: str | None = None  # URL of a server; None for the file in the folder


@final
@dataclass(frozen=True, slots=True)
class Project:
    """Existing project folder and its settings.

    Parameters
    ----------
    folder : Path
    settings : ProjectSettings
    """

    folder: Path
    settings: ProjectSettings

    @classmethod
    def create(cls, folder: Path, database: str | None = None) -> Project:
        """Create a project with an empty database, in a new or empty folder.

        Raises
        ------
        InvalidInput
            The folder is not empty.
        StoreRefused
            The database cannot be created.
        """
        if (folder / SETTINGS).exists():
            raise InvalidInput(str(folder), found="a project", expected="a new folder")
        was_there = folder.exists()
        if was_there and not (folder.is_dir() and _is_empty(folder)):
            raise InvalidInput(
                str(folder), found="something else", expected="a new or an empty folder"
            )
        name = folder.resolve().name[:MAX_NAME] or "project"
        settings = ProjectSettings(name=name, database=database)
        project = cls(folder, settings)
        try:
            (folder / MEDIA).mkdir(parents=True, exist_ok=True)
            with Store(project.url, project.media) as store:
                store.upgrade()
            # Last, since this file makes the folder a project.
            with written_whole(folder / SETTINGS) as path:
                path.write_text(_settings_text(settings), encoding="utf-8")
        except BaseException as problem:
            _clear(folder, keep=was_there)
            if isinstance(problem, OSError) and (failure := machine_failure(problem)) is not None:
                raise failure from None
            raise
        return project

    @classmethod
    def open(cls, folder: Path) -> Project:
        """Load the project in a folder; raise `StoreRefused` if there is none."""
        path = folder / SETTINGS
        if not path.is_file():
            raise StoreRefused(f"{folder} is no project", hint=f"make one with: fixel new {folder}")
        content = read_document(path)
        try:
            return cls(folder, ProjectSettings.model_validate(content))
        except ValidationError as problem:
            first = problem.errors()[0]
            raise InvalidInput(
                f"{path}: {'.'.join(map(str, first['loc'])) or 'settings'}",
                found=first["msg"].lower(),
                expected="name and, for a server, database",
            ) from None

    @property
    def url(self) -> str:
        """URL of the database: from the environment, the settings, or of the file in the folder."""
        named = os.environ.get(VARIABLE) or self.settings.database
        return named or f"sqlite:///{self.folder / DATABASE}"

    @property
    def media(self) -> Path:
        """Folder of long arrays and videos."""
        return self.folder / MEDIA

    @property
    def upgrade_command(self) -> str:
        """Shell command that upgrades the tables to this version of fixel."""
        return shlex.join(["fixel", "db", "upgrade", str(self.folder)])

    def store(self) -> Store:
        """Open the project's store; raise `StoreRefused` if its tables have another version."""
        store = Store(self.url, self.media)
        try:
            store.check_version(self.upgrade_command)
        except StoreRefused:
            store.close()
            raise
        return store


def _is_empty(folder: Path) -> bool:
    """Whether a folder is empty, or has only the remains of an interrupted `create`."""
    left = {path.name for path in folder.iterdir()}
    if not left <= {MEDIA, *DATABASE_FILES} or any((folder / MEDIA).glob("*")):
        return False
    file = folder / DATABASE
    if not file.is_file() or file.stat().st_size == 0:
        return True
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as raw:
            tables = raw.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
            rows = ["alembic_version"] if tables else []
            rows += [t for (t,) in tables if raw.execute(f'SELECT 1 FROM "{t}" LIMIT 1').fetchone()]
    except sqlite3.Error:
        return False
    return set(rows) <= {"alembic_version"}


def _clear(folder: Path, *, keep: bool) -> None:
    """Remove the remains of a failed `create`, so that it can be repeated."""
    with suppress(OSError):
        for name in DATABASE_FILES:
            (folder / name).unlink(missing_ok=True)
        (folder / MEDIA).rmdir()
        if not keep:
            folder.rmdir()


def _settings_text(settings: ProjectSettings) -> str:
    lines = [
        "# Settings of a fixel project.",
        yaml.safe_dump({"name": settings.name}, allow_unicode=True).rstrip(),
        "# The database of a laboratory: postgresql+psycopg://USER@HOST/DATABASE",
    ]
    if settings.database is None:
        lines.append("# database:")
    else:
        lines.append(yaml.safe_dump({"database": settings.database}).rstrip())
    return "\n".join(lines) + "\n"
