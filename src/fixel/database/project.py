"""A project: a folder with settings, a database and the media that are too long for it.

my_lab/
    fixel.yaml          settings: a name, and where the database is
    experiments.db      SQLite, unless the settings or FIXEL_DATABASE name a server
    media/              videos and long arrays, named by their content
"""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused
from fixel.exchange.atomic import written_whole
from fixel.exchange.document import read_document

SETTINGS: Final = "fixel.yaml"
DATABASE: Final = "experiments.db"
MEDIA: Final = "media"
VARIABLE: Final = "FIXEL_DATABASE"  # environment: names a database in place of the settings


class Settings(BaseModel):
    """What `fixel.yaml` says."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(min_length=1, max_length=200)
    database: str | None = None  # URL of a server; none for the file in the folder


@final
@dataclass(frozen=True, slots=True)
class Project:
    """A project folder that exists.

    Parameters
    ----------
    folder : Path
    settings : Settings
    """

    folder: Path
    settings: Settings

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
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InvalidInput(
                str(folder), found="something else", expected="a new or an empty folder"
            )
        settings = Settings(name=folder.resolve().name or "project", database=database)
        project = cls(folder, settings)
        try:
            (folder / MEDIA).mkdir(parents=True)
        except OSError as problem:
            raise StoreRefused(f"{folder}: {(problem.strerror or str(problem)).lower()}") from None
        with Store(project.url, project.media) as store:
            store.upgrade()
        # Last, since this is what makes it a project.
        with written_whole(folder / SETTINGS) as path:
            path.write_text(_settings_text(settings), encoding="utf-8")
        return project

    @classmethod
    def open(cls, folder: Path) -> Project:
        """The project in a folder, or a refusal."""
        path = folder / SETTINGS
        if not path.is_file():
            raise StoreRefused(f"{folder} is no project", hint=f"make one with: fixel new {folder}")
        content = read_document(path)
        try:
            return cls(folder, Settings.model_validate(content))
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


def _settings_text(settings: Settings) -> str:
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
