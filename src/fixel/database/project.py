"""A project: a folder with settings, a database and the media that are too long for it.

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
VARIABLE: Final = "FIXEL_DATABASE"  # environment: names a database in place of the settings


class ProjectSettings(BaseModel):
    """What `fixel.yaml` says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=MAX_NAME)
    database: str | None = None  # URL of a server; none for the file in the folder


@final
@dataclass(frozen=True, slots=True)
class Project:
    """A project folder that exists.

    Parameters
    ----------
    folder : Path
    settings : ProjectSettings
    """

    folder: Path
    settings: ProjectSettings

    @classmethod
    def create(cls, folder: Path, database: str | None = None) -> Project:
        """Make a folder into a project, with an empty database.

        Raises
        ------
        InvalidInput
            Something is there already.
        StoreRefused
            The database cannot be made.
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
            # Last, since this is what makes it a project.
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
        """The project in a folder, or a refusal."""
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
        """Of the database: the environment's, the settings', or the file's in this folder."""
        named = os.environ.get(VARIABLE) or self.settings.database
        return named or f"sqlite:///{self.folder / DATABASE}"

    @property
    def media(self) -> Path:
        """Folder of long arrays and videos."""
        return self.folder / MEDIA

    @property
    def upgrade_command(self) -> str:
        """What brings its tables to this program's version."""
        return shlex.join(["fixel", "db", "upgrade", str(self.folder)])

    def store(self) -> Store:
        """The project's records; refused where the tables are of another version."""
        store = Store(self.url, self.media)
        try:
            store.check_version(self.upgrade_command)
        except StoreRefused:
            store.close()
            raise
        return store


def _is_empty(folder: Path) -> bool:
    """Whether a folder holds nothing, or no more than a `create` that was killed has left."""
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
    """Remove what a `create` that failed has made, so that it can be repeated."""
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
