"""Connections and transactions, alike on SQLite and PostgreSQL, and readable database errors."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import event, exc

from fixel.errors import InvalidInput, StoreRefused

# Network file systems, where a lock of one machine is invisible to the others.
NETWORK: Final = frozenset(
    {"nfs", "nfs4", "cifs", "smb", "smb2", "smb3", "smbfs", "ncpfs", "afs", "fuse.sshfs"}
    | {"lustre", "gpfs", "beegfs", "ceph", "fuse.ceph", "fuse.glusterfs", "orangefs"}
    | {"davfs", "fuse.davfs2"}
)
_WRITERS: Final = 5130624061  # arbitrary number of the advisory lock of writers
WAIT_S: Final = 20.0  # maximum wait for the transaction of another process


def open_engine(url: str) -> sa.Engine:
    """Create an engine for a database that exists or, with SQLite, can be created.

    Network file systems, invalid URLs and missing drivers raise `StoreRefused`.
    """
    try:
        parsed = sa.make_url(url)
        if parsed.get_backend_name() == "sqlite":
            return _sqlite(parsed)
        if parsed.get_backend_name() != "postgresql":
            raise exc.ArgumentError
        return sa.create_engine(parsed, pool_pre_ping=True, pool_size=2, max_overflow=8)
    except exc.ArgumentError:
        raise StoreRefused(
            f"{url!r} is not a database URL",
            hint="write sqlite:///FILE or postgresql+psycopg://USER@HOST/DATABASE",
            is_input=True,
        ) from None
    except ModuleNotFoundError as missing:
        raise StoreRefused(
            f"the driver {missing.name} is not installed", hint="run: pip install 'fixel[postgres]'"
        ) from None


def _sqlite(url: sa.URL) -> sa.Engine:
    # The file of a bundle: only this process uses it, and it may be malicious.
    is_private = "uri" in url.query
    if url.database and url.database != ":memory:" and not is_private:
        check_local(Path(url.database))
    engine = sa.create_engine(_on_read_only_media(url), connect_args={"timeout": WAIT_S})

    @event.listens_for(engine, "connect")
    def set_up(connection: Any, _: object) -> None:
        # `begin` below starts the transactions; the driver would start them late.
        connection.isolation_level = None
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute(f"PRAGMA synchronous = {'OFF' if is_private else 'FULL'}")
        if is_private:
            connection.execute("PRAGMA trusted_schema = OFF")

    @event.listens_for(engine, "begin")
    def begin(connection: sa.Connection) -> None:
        # A read transaction that starts to write may fail at once; BEGIN IMMEDIATE waits.
        writing = connection.get_execution_options().get("writing", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")

    return engine


def _on_read_only_media(url: sa.URL) -> sa.URL:
    """Let SQLite open a file on read-only media as immutable.

    Databases with a write-ahead log need a `-shm` file next to them, which cannot be created there.
    If the last changes are in such a log, `StoreRefused` is raised: only a writer can merge it.
    """
    file = Path(url.database or "")
    if not url.database or url.database == ":memory:" or not _is_on_read_only_media(file):
        return url
    log, shared = (file.with_name(f"{file.name}-{kind}") for kind in ("wal", "shm"))
    if log.is_file() and log.stat().st_size > 0:
        if shared.is_file():
            return url
        raise StoreRefused(
            f"{file} is on a read-only disk, and its newest changes are only in {log.name}",
            hint="copy the project to a disk that can be written to",
        )
    return sa.URL.create(
        url.drivername,
        database=f"file:{quote(str(file.resolve()))}",
        query={"immutable": "1", "mode": "ro", "uri": "true"},
    )


def _is_on_read_only_media(file: Path) -> bool:
    if not hasattr(os, "statvfs") or not file.is_file():
        return False
    return bool(os.statvfs(file).f_flag & os.ST_RDONLY)


def set_journal(engine: sa.Engine) -> None:
    """Let readers read during a write (SQLite's WAL); stored in the file, so set once."""
    if engine.dialect.name == "sqlite":
        with translated(engine), engine.connect() as connection:
            raw: Any = connection.connection.dbapi_connection
            raw.execute("PRAGMA journal_mode = WAL")


@contextmanager
def writing(engine: sa.Engine) -> Iterator[sa.Connection]:
    """Open a write transaction: durable as a whole after the block, or rolled back."""
    with (
        translated(engine),
        engine.connect().execution_options(writing=True) as connection,
        connection.begin(),
    ):
        if engine.dialect.name == "postgresql":
            # One writer at a time, as in SQLite, so that a read and a later write are atomic.
            connection.execute(sa.text(f"SET LOCAL lock_timeout = {int(1e3 * WAIT_S)}"))
            connection.execute(sa.text(f"SELECT pg_advisory_xact_lock({_WRITERS})"))
        yield connection


@contextmanager
def reading(engine: sa.Engine) -> Iterator[sa.Connection]:
    """Open a read transaction with a consistent snapshot, unaffected by concurrent writes."""
    with translated(engine), engine.connect() as connection:
        if engine.dialect.name == "postgresql":
            connection = connection.execution_options(isolation_level="REPEATABLE READ")
        with connection.begin():
            yield connection


def insert_one(connection: sa.Connection, table: sa.Table, row: Mapping[str, Any]) -> int:
    """Insert a row; return its id."""
    key = connection.execute(sa.insert(table), dict(row)).inserted_primary_key
    assert key is not None
    return int(key[0])


@contextmanager
def translated(engine: sa.Engine) -> Iterator[None]:
    """Raise errors of the database as `StoreRefused`, with a hint."""
    place = engine.url.render_as_string(hide_password=True)
    try:
        yield
    # Also from direct calls of the driver, or a damaged page's message that is no text.
    except (exc.DBAPIError, sqlite3.Error, OverflowError, UnicodeDecodeError) as problem:
        said = str(getattr(problem, "orig", problem))
        if said.endswith(("too large to convert to SQLite INTEGER", "integer out of range")):
            found, expected = "a number too large for the database", "a smaller one"
            raise InvalidInput("id or seed", found=found, expected=expected) from None
        raise StoreRefused(*_reason(place, said)) from problem


def _reason(place: str, said: str) -> tuple[str, str | None]:
    said = " ".join(said.split())
    low = said.lower()
    locked = f"{place} is locked by another process for more than {WAIT_S:g} s"
    full = (f"the disk of {place} is full", "free disk space, then repeat the command")
    no_tables = (f"{place} has no tables yet", "run: fixel db upgrade")
    denied = (
        f"{place} rejects the login: {said}",
        "check user and password in the URL of the database",
    )
    # The first match decides, so specific words stand before common ones.
    known = {
        "cannot change": (
            "finished records cannot change",
            "add a new record, which replaces the old one",
        ),
        "lock timeout": (locked, "wait until it has finished"),
        "locked": (locked, "wait until it has finished, or find it with: fuser FILE"),
        "readonly": (f"{place} is read-only", "make the file and its folder writable"),
        "read-only": (f"{place} is read-only", "write to the primary server"),
        "is full": full,
        "no space left": full,
        "unable to open": (
            f"{place} cannot be opened",
            "check that its folder exists and may be written to",
        ),
        "disk i/o": (
            f"the disk of {place} fails or is full: {said}",
            "free disk space or check the disk, then repeat the command",
        ),
        "not a database": (
            f"{place} is not a SQLite database",
            "replace it with a backup, which fixel db backup wrote",
        ),
        "malformed": (f"{place} is damaged", "list the errors: fixel db check"),
        "no such table": no_tables,
        "authentication": denied,
        "no password": denied,
        "connection": (f"no connection to {place}: {said}", "check that the server runs"),
        "terminating": (
            f"the connection to the server of {place} was lost",
            "repeat the command when the server is available",
        ),
    }
    # psycopg reports "connection failed" for a missing database, too.
    if "does not exist" in low:
        if "relation" in low:
            return no_tables
        if "role" in low:
            return denied
        return f"{place}: {said}", "create the database, then run: fixel db upgrade"
    for word, answer in known.items():
        if word in low:
            return answer
    return f"{place}: {said}", None


def check_local(path: Path, mounts: str | None = None) -> None:
    """Raise for a file on a network file system, where two machines would overwrite each other.

    It need not exist yet. `mounts` replaces /proc/self/mounts, which exists on Linux only.
    """
    if mounts is None:
        try:
            mounts = Path("/proc/self/mounts").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return
    kind = _file_system(os.path.realpath(path), mounts)
    if kind in NETWORK:
        raise StoreRefused(
            f"{path} is on a network file system ({kind}), where SQLite loses data, since locks "
            "do not work between machines",
            hint="move the project to a local disk, or set a PostgreSQL server in its settings",
        )


def _file_system(path: str, mounts: str) -> str:
    """File system type of the longest mount point that contains a path."""
    best, kind = "", ""
    for line in mounts.splitlines():
        fields = line.split()
        if len(fields) < 3:
            continue
        point = fields[1].encode().decode("unicode_escape")  # a space is \\040 there
        inside = path == point or path.startswith(point.rstrip("/") + "/")
        if inside and len(point) >= len(best):
            best, kind = point, fields[2]
    return kind
