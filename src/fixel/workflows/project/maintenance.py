"""Upgrade, back up, check and draw the database of a project."""

from __future__ import annotations

import contextlib
import hashlib
import re
import shlex
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import sqlalchemy as sa

from fixel.database import rows, schema
from fixel.database.engine import open_engine, reading
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.database.stored_content import RESTORE, Trouble, content_troubles, schema_troubles
from fixel.errors import InvalidInput, StoreRefused, counted, os_reason, reason_of
from fixel.io.atomic import written_whole

OWNERS: Final = {
    "experiment": schema.experiment,
    "simulation": schema.simulation,
    "calibration": schema.calibration,
    "filter_run": schema.filter_run,
}
# Records that are incomplete without the motion of the object.
MOVING: Final = ("experiment", "simulation", "filter_run")
RESTORE_MEDIA: Final = "restore it from a backup of the media folder"
SEE: Final = "list the errors: fixel db check"


class Backup(NamedTuple):
    """Backup of a database, and what must be copied separately."""

    file: Path
    size: int  # [bytes]
    sha256: str
    media: Path  # must be copied too


class CheckResult(NamedTuple):
    """Result of checking a database."""

    engine: str  # `sqlite` or `postgresql`
    version: str | None  # version of the schema; None if it could not be read
    counts: dict[str, int]  # deleted rows are counted, too
    # Files in the media folder, and those of them that no row refers to; another project may.
    media_files: int
    unused_files: int
    troubles: tuple[Trouble, ...]

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        troubles = [trouble._asdict() for trouble in self.troubles]
        return {"ok": not troubles, **self._asdict(), "troubles": troubles}


# --- upgrade ------------------------------------------------------------------------------------


class SchemaVersions(NamedTuple):
    """Versions of the schema before and after an upgrade."""

    before: str | None  # None for a database that was empty
    after: str | None


def upgrade(project: Project) -> SchemaVersions:
    """Upgrade the tables of a project to this program's version, or leave them unchanged."""
    with Store(project.url, project.media) as store:
        return SchemaVersions(*store.upgrade())


# --- backup -------------------------------------------------------------------------------------


def backup(project: Project, file: Path) -> Backup:
    """Copy a project's SQLite database while other programs may use it.

    Raise `InvalidInput` if the file cannot be written, or is the database itself, and
    `StoreRefused` for a database that is on a server, missing or damaged.
    """
    database = _database_file(project, file)
    if file.exists() and file.samefile(database):
        raise InvalidInput(str(file), found="the database itself", expected="another file")
    if file.is_file() and not file.read_bytes()[:16].startswith(b"SQLite format 3"):
        raise InvalidInput(str(file), found="a file", expected="a new name, or an earlier backup")
    with written_whole(file, durable=True) as path:
        _copy(database, path)
        with open(path, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return Backup(file, file.stat().st_size, digest, project.media)


def _database_file(project: Project, target: Path | None = None) -> Path:
    """Return the SQLite file of a project; for a server, raise with its own backup command."""
    url = sa.make_url(project.url)
    if url.get_backend_name() != "sqlite":
        raise StoreRefused(
            f"{url.render_as_string(hide_password=True)} is on a server, which makes its own "
            "backups",
            hint=f"run: {_dump_command(url, target or Path('backup.dump'))}",
        )
    file = Path(url.database or "")
    if not file.is_file():
        hint = f"{RESTORE}; or create an empty one: {project.upgrade_command}"
        raise StoreRefused(f"there is no database {file}", hint=hint)
    return file


def _dump_command(url: sa.URL, target: Path) -> str:
    # Without the password, which other users of the machine would see; pg_dump prompts for it.
    plain = sa.URL.create(
        "postgresql", url.username, None, url.host, url.port, url.database, url.query
    )
    return shlex.join(["pg_dump", "--format=custom", f"--file={target}", str(plain)])


def _copy(database: Path, path: Path) -> None:
    """Copy one consistent state of a database, pages and journal together, as a single file."""
    try:
        with (
            contextlib.closing(
                sqlite3.connect(f"{database.resolve().as_uri()}?mode=ro", uri=True)
            ) as source,
            contextlib.closing(sqlite3.connect(path)) as target,
        ):
            source.backup(target)
            said = [str(row[0]) for row in target.execute("PRAGMA integrity_check")]
    except sqlite3.Error as problem:
        full = "is full" in str(problem) or "disk I/O" in str(problem)
        reason = "its disk or that of the copy is full or fails" if full else reason_of(problem)
        raise StoreRefused(
            f"{database} cannot be copied: {reason}",
            hint="free disk space, then repeat the command" if full else SEE,
        ) from None
    if said != ["ok"]:
        raise StoreRefused(f"{database} is damaged: {said[0]}", hint=SEE)


# --- check --------------------------------------------------------------------------------------


def check(project: Project) -> CheckResult:
    """Read everything a project stores and report what is wrong with it; changes nothing."""
    if sa.make_url(project.url).get_backend_name() == "sqlite":
        _database_file(project)
    engine = open_engine(project.url)
    try:
        return _checked(engine, project)
    finally:
        engine.dispose()


def _checked(engine: sa.Engine, project: Project) -> CheckResult:
    media = project.media
    troubles: list[Trouble] = []
    version: str | None = None
    counts: dict[str, int] = {}
    try:
        with reading(engine) as connection:
            troubles += _damage(connection)
            schema.check_newest(connection, project.upgrade_command)
            version = schema.version_of(connection)
            lacking = list(schema_troubles(connection))
            troubles += lacking
            if any("missing" in one.sentence and one.hint == RESTORE for one in lacking):
                raise StoreRefused("its content cannot be read without them", RESTORE)
            for name, table in schema.METADATA.tables.items():
                n = connection.scalar(sa.select(sa.func.count()).select_from(table))
                counts[name] = int(n or 0)
            troubles += _broken_references(connection)
            troubles += _bad_series(connection, media)
            troubles += _without_motion(connection)
            troubles += _missing_videos(connection, media)
            reported = {trouble.where.partition(",")[0] for trouble in troubles}
            found = content_troubles(connection, media)
            troubles += (one for one in found if one.where not in reported)
            used, videos = _used(connection)
    except StoreRefused as refused:
        # A damaged file may be readable up to some point only; report what was found until there.
        # Here the advice to run a check is useless.
        useless = refused.hint is None or "db check" in refused.hint
        hint = RESTORE if useless else str(refused.hint)
        troubles.append(Trouble("database", refused.reason, hint))
        used, videos = set(), set()
    files, bad = _media_files(media, read_already=used)
    try:
        len(project.analyses)
    except StoreRefused as refused:  # the first that cannot be read
        bad.append(Trouble("results", refused.reason, refused.hint or RESTORE))
    return CheckResult(
        engine=engine.dialect.name,
        version=version,
        counts=counts,
        media_files=len(files),
        unused_files=len(files - used - videos),
        troubles=(*troubles, *bad),
    )


def _damage(connection: sa.Connection) -> Iterator[Trouble]:
    """Yield the faults that SQLite finds in its own pages; a server checks its own."""
    if connection.dialect.name != "sqlite":
        return
    for said in connection.exec_driver_sql("PRAGMA integrity_check").scalars():
        if said != "ok":
            yield Trouble("database", str(said), RESTORE)


def _broken_references(connection: sa.Connection) -> Iterator[Trouble]:
    """Yield tables with rows that refer to missing rows."""
    for table in schema.METADATA.tables.values():
        for key in table.foreign_keys:
            target = key.column.table.alias("target")
            column = key.parent
            lost = (
                sa.select(sa.func.count())
                .select_from(table)
                .where(column.is_not(None))
                .where(~sa.exists().where(target.c[key.column.name] == column))
            )
            if n := connection.scalar(lost):
                sentence = f"{counted(n, 'row')} of {table.name} without their {column.name}"
                yield Trouble(table.name, sentence, RESTORE)


def _bad_series(connection: sa.Connection, media: Path) -> Iterator[Trouble]:
    """Yield series that cannot be read, or whose record is gone."""
    table = schema.series
    # One by one, since together they may be larger than memory.
    for number in connection.scalars(sa.select(table.c.id).order_by(table.c.id)).all():
        try:
            row = connection.execute(sa.select(table).where(table.c.id == number)).one()
        except (ValueError, TypeError, sa.exc.NoResultFound) as problem:
            # Content that should be JSON or text is not, or an index leads to no row.
            yield Trouble(f"series {number}", f"cannot be read: {reason_of(problem)}", RESTORE)
            continue
        where = f"{row.owner} {row.owner_id}, series {row.name!r}"
        if complaint := _owner_gone(connection, row) or _unreadable(row, media):
            yield Trouble(where, *complaint)


def _owner_gone(connection: sa.Connection, row: sa.Row[Any]) -> tuple[str, str] | None:
    owner = OWNERS.get(row.owner)
    if owner is not None and connection.scalar(
        sa.select(owner.c.id).where(owner.c.id == row.owner_id)
    ):
        return None
    return "its record is missing", RESTORE


def _unreadable(row: sa.Row[Any], media: Path) -> tuple[str, str] | None:
    try:
        data = rows.fetch(row.media_sha256, media) if row.data is None else row.data
    except StoreRefused as refused:
        return refused.reason, refused.hint or RESTORE_MEDIA
    expected = 8 * row.n_row * len(row.columns)
    if len(data) != expected:
        return f"has {len(data)} bytes instead of {expected}", RESTORE
    return None


def _without_motion(connection: sa.Connection) -> Iterator[Trouble]:
    """Yield records without the path of their object, or with one of another length."""
    series = schema.series
    for name in MOVING:
        owner = OWNERS[name]
        path = sa.exists().where(
            series.c.owner == name, series.c.owner_id == owner.c.id, series.c.name == "object"
        )
        if name == "experiment":
            path = path.where(series.c.n_row == owner.c.n_frame)
        for number in connection.scalars(sa.select(owner.c.id).where(~path)):
            yield Trouble(f"{name} {number}", "the trajectory of its object is incomplete", RESTORE)


def _missing_videos(connection: sa.Connection, media: Path) -> Iterator[Trouble]:
    table = schema.experiment
    named = sa.select(table.c.id, table.c.video_sha256).where(table.c.video_sha256 != "")
    for number, digest in connection.execute(named):
        path = rows.media_path(digest, media)
        if not path.is_file():
            yield Trouble(f"experiment {number}", f"its video {path} is missing", RESTORE_MEDIA)


def _used(connection: sa.Connection) -> tuple[set[str], set[str]]:
    """Return the checksums of the files that rows refer to: of series, of videos."""
    series, video = schema.series.c.media_sha256, schema.experiment.c.video_sha256
    found = connection.scalars(sa.select(series).where(series.is_not(None)))
    return set(found), set(connection.scalars(sa.select(video).where(video != "")))


def _media_files(media: Path, read_already: set[str]) -> tuple[set[str], list[Trouble]]:
    """Return the checksums that name the files of a media folder, and the faults of the files."""
    files: set[str] = set()
    bad: list[Trouble] = []
    for path in sorted(media.glob("??/*")):
        # Others are left by a process that died while it wrote; nothing reads those.
        if not re.fullmatch(r"[0-9a-f]{64}", path.name):
            continue
        files.add(path.name)
        if path.name not in read_already and (sentence := _file_trouble(path)):
            bad.append(Trouble(f"file {path}", sentence, RESTORE_MEDIA))
    return files, bad


def _file_trouble(path: Path) -> str | None:
    try:
        with open(path, "rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        return f"cannot be read: {os_reason(problem)}"
    return None if digest == path.name else "has changed: its checksum differs from its name"


def diagram(file: Path) -> list[str]:
    """Draw the tables of a project's database and their references; return the tables' names.

    The schema is this program's, not that of a project, which `upgrade` brings up to date.
    """
    from fixel.database.schema import METADATA
    from fixel.drawing.relations import Entity, draw_relations
    from fixel.io.atomic import refuse_unwritable

    refuse_unwritable(file)
    entities = [
        Entity(
            table.name,
            [column.name for column in table.columns],
            {
                column.name: key.column.table.name
                for column in table.columns
                for key in column.foreign_keys
            },
        )
        for table in METADATA.tables.values()
    ]
    draw_relations(entities, file)
    return [entity.name for entity in entities]
