"""Zip file of a bundle, possibly malicious: all of it is checked before any record is used.

A bundle is a project folder in a zip: ``experiments.db``, a SQLite database with the tables of a
project, its media, ``media/AB/SHA256``, and the reports, figures and arrays of its analyses; any
other member is rejected.
"""

from __future__ import annotations

import hashlib
import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import sqlalchemy as sa
from pydantic import TypeAdapter, ValidationError

from fixel.database import schema
from fixel.database.engine import reading
from fixel.database.project import ANALYSES, DATABASE, MEDIA
from fixel.database.rows import media_path
from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused, reason_of, refused_value
from fixel.io.atomic import INVALID_CONTENT, unreadable
from fixel.model.records import Estimate

CHUNK: Final = 1 << 20  # [bytes]
ANALYSIS_FILE: Final = re.compile(
    r"analysis\.json|arrays\.npz|[\w-]{1,80}\.(png|pdf|csv)", re.ASCII
)
_MEMBER = re.compile(
    rf"{re.escape(DATABASE)}|{MEDIA}/(?P<ab>[0-9a-f]{{2}})/(?P=ab)[0-9a-f]{{62}}"
    rf"|{ANALYSES}/[a-z-]{{1,40}}-[0-9a-f]{{10}}/({ANALYSIS_FILE.pattern})",
    re.ASCII,
)
# Constraint, generated column, or index of an expression or of some rows.
_COMPUTED = re.compile(r"\bCHECK\b|\bAS\b|\bWHERE\b|INDEX[^(]*\([^)]*\(", re.IGNORECASE)
_OLD_MANIFEST = "manifest.json"  # of bundles that fixel wrote before the first release


class BundleLimits(NamedTuple):
    """Maximum sizes of a bundle, so that a small file cannot fill a disk or the memory."""

    members: int = 1_000_000
    total: int = 200_000_000_000  # [bytes], unpacked
    in_memory: int = 1_000_000_000  # [bytes], series that is read at once
    ratio: int = 100  # unpacked to packed size, for members larger than `small`
    small: int = 1_000_000  # [bytes]
    text: int = 20_000_000  # characters of one value, most of which is JSON


LIMITS: Final = BundleLimits()


def private_url(file: Path) -> str:
    """URL of a SQLite file that only this process uses, for `Store`."""
    return f"sqlite:///{file.resolve().as_uri()}?uri=true"


@contextmanager
def opened_bundle(path: Path, folder: Path, limits: BundleLimits = LIMITS) -> Iterator[Store]:
    """Unpack and check a bundle in a folder; yield a store of its records, to read from."""
    with TemporaryDirectory(prefix=".bundle-", dir=folder) as name:
        _unpack(path, Path(name), limits)
        with Store(private_url(Path(name, DATABASE)), Path(name, MEDIA)) as store:
            with damage_refused(path):
                _check_pages(store)
            _check_version(path, store)
            with damage_refused(path):
                _check_values(store, limits)
            yield store


@contextmanager
def damage_refused(path: Path) -> Iterator[None]:
    """Raise any error of reading a bundle's records as `InvalidInput`."""
    try:
        yield
    except (StoreRefused, *INVALID_CONTENT, sa.exc.SQLAlchemyError) as problem:
        raise _refused(path, reason_of(problem), "complete records of a project") from None


def _refused(path: Path, found: str, expected: str, hint: str | None = None) -> InvalidInput:
    return InvalidInput(str(path), found=found, expected=expected, hint=hint)


# --- the zip ------------------------------------------------------------------------------------


def _unpack(path: Path, folder: Path, limits: BundleLimits) -> None:
    """Unpack a bundle; media must match the checksums that are their names."""
    try:
        archive = zipfile.ZipFile(path)
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as problem:
        raise unreadable(path, problem, "a complete bundle") from None
    with archive:
        infos = archive.infolist()
        _check_members(path, infos, limits)
        for info in infos:
            file = folder / info.filename
            file.parent.mkdir(parents=True, exist_ok=True)
            total = hashlib.sha256()
            with file.open("wb") as stream:
                for data in _chunks(path, archive, info):
                    stream.write(data)
                    total.update(data)
            if info.filename.startswith(MEDIA) and total.hexdigest() != file.name:
                raise _refused(path, f"{info.filename} changed", "content with its checksum")


def _check_members(path: Path, infos: list[zipfile.ZipInfo], limits: BundleLimits) -> None:
    names = {info.filename for info in infos}
    if _OLD_MANIFEST in names:
        raise _refused(
            path,
            "a bundle of a version before the first release",
            f"a bundle with {DATABASE}",
            "export it again with this version: fixel export",
        )
    if len(infos) > limits.members:
        raise _refused(path, f"{len(infos)} members", f"at most {limits.members}")
    for info in infos:
        _check_member(path, info, limits)
    if sum(info.file_size for info in infos) > limits.total:
        raise _refused(path, "a larger content", f"at most {limits.total} bytes")
    if len(names) < len(infos):
        raise _refused(path, "a repeated member", "each member once")
    if DATABASE not in names:
        raise _refused(path, f"no {DATABASE}", "one, as in a bundle", "create one: fixel export")


def _check_member(path: Path, info: zipfile.ZipInfo, limits: BundleLimits) -> None:
    name = info.filename
    # `orig_filename` is the name in the file; Python cuts `filename` at a null byte.
    if info.orig_filename != name or not _MEMBER.fullmatch(name):
        raise _refused(path, f"the member {name!r}", "only members of a bundle")
    if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG):
        raise _refused(path, f"{name} as a link or a device", "plain files")
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise _refused(
            path,
            f"{name} with encryption or another compression",
            "members that are stored or deflated",
        )
    if info.file_size > max(limits.small, limits.ratio * info.compress_size):
        raise _refused(
            path,
            f"{name} compressed to less than 1/{limits.ratio}",
            "a bundle written by fixel export",
        )


def _chunks(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[bytes]:
    """Read a member piece by piece; raise if it is longer than its announced size."""
    left = info.file_size
    try:
        with archive.open(info) as stream:
            while data := stream.read(CHUNK):
                left -= len(data)
                if left < 0:
                    raise _refused(
                        path, f"more data in {info.filename} than its header states", "its size"
                    )
                yield data
    except (EOFError, OSError, zipfile.BadZipFile, zlib.error, RuntimeError) as problem:
        found = f"{info.filename} damaged ({reason_of(problem)})"
        raise _refused(path, found, "a complete bundle") from None


# --- the database -------------------------------------------------------------------------------

_STORED_AS: Final[dict[type[Any], tuple[str, ...]]] = {
    sa.Boolean: ("integer",),
    sa.Integer: ("integer",),
    sa.BigInteger: ("integer",),
    sa.Float: ("real", "integer"),
    sa.String: ("text",),
    sa.Text: ("text",),
    sa.JSON: ("text",),
    sa.LargeBinary: ("blob",),
}
# Integers stay integers: the checksum of an experiment distinguishes 5 from 5.0.
_PLAIN: Final = TypeAdapter(dict[str, str | bool | int | float])
_CONTENT: Final[dict[str, TypeAdapter[Any]]] = {
    "conditions": _PLAIN,
    "method": _PLAIN,
    "options": _PLAIN,
    "others": TypeAdapter(dict[str, float]),
    "reasons": TypeAdapter(dict[str, str]),
    "columns": TypeAdapter(list[str]),
    "estimates": TypeAdapter(list[Estimate] | None),
}


def _check_pages(store: Store) -> None:
    """Raise for damaged pages, and for what is no table of data."""
    known = {"alembic_version", *schema.METADATA.tables}
    with reading(store._engine) as connection:
        master = connection.exec_driver_sql("SELECT type, name, sql FROM sqlite_master").all()
        for kind, name, sql in master:
            plain = name in known and str(sql).startswith("CREATE TABLE")
            # SQLite evaluates expressions when it checks the pages, and each may take hours.
            computed = kind in ("table", "index") and _COMPUTED.search(str(sql))
            if kind == "view" or (kind == "table" and not plain) or computed:
                raise InvalidInput(f"the {kind} {name!r}, which no project has")
        for check in ("integrity_check", "foreign_key_check"):
            found = [str(row[0]) for row in connection.exec_driver_sql(f"PRAGMA {check}")]
            if found not in ([], ["ok"]):
                raise InvalidInput(f"{check}: {found[0]}")


def _check_version(path: Path, store: Store) -> None:
    try:
        store.check_version("export the bundle again with this version: fixel export")
    except StoreRefused as problem:
        raise _refused(path, problem.reason, "a bundle of this version", problem.hint) from None


def _check_values(store: Store, limits: BundleLimits) -> None:
    """Raise unless each table has the columns of a project's, and values as a project writes."""
    with reading(store._engine) as connection:
        for table in schema.METADATA.tables.values():
            info = connection.exec_driver_sql(f'PRAGMA table_xinfo("{table.name}")').all()
            if {(row[1], row[6]) for row in info} != {(c.name, 0) for c in table.columns}:
                raise InvalidInput(f"other columns in the table {table.name}")
            wrong = sa.select(*(sa.func.max(_is_wrong(column, limits)) for column in table.columns))
            for column, found in zip(table.columns, connection.execute(wrong).one(), strict=True):
                if found:
                    raise InvalidInput(f"a value of {table.name}.{column.name} that no project has")
                if column.name in _CONTENT:
                    _check_content(connection, column)
        series = schema.series.c
        largest = connection.scalar(sa.select(sa.func.max(sa.func.length(series.data)))) or 0
        files = connection.scalars(sa.select(series.media_sha256).distinct()).all()
    for file in (media_path(digest, store.media) for digest in files if digest is not None):
        largest = max(largest, file.stat().st_size if file.is_file() else 0)
    if largest > limits.in_memory:
        raise InvalidInput(f"{largest} bytes in a series, which must fit in memory")


def _is_wrong(column: sa.Column[Any], limits: BundleLimits) -> Any:
    """Return the condition of a value of another type, of a longer text, or of no checksum."""
    kinds = _STORED_AS[type(column.type)] + (("null",) if column.nullable else ())
    wrong: Any = sa.func.typeof(column).not_in(kinds)
    if isinstance(column.type, sa.Boolean):
        wrong = sa.or_(wrong, sa.cast(column, sa.Integer).not_in((0, 1)))
    if "text" in kinds:
        length = getattr(column.type, "length", None) or limits.text
        wrong = sa.or_(wrong, sa.func.length(column) > length)
    if column.name in ("media_sha256", "video_sha256"):
        other = sa.or_(sa.func.length(column) != 64, column.bool_op("GLOB")("*[^0-9a-f]*"))
        wrong = sa.or_(wrong, sa.and_(column != "", other))
    return wrong


def _check_content(connection: sa.Connection, column: sa.Column[Any]) -> None:
    try:
        for content in connection.scalars(sa.select(column).distinct()):
            _CONTENT[column.name].validate_python(content, strict=column.name != "estimates")
    except ValidationError as problem:
        raise InvalidInput(str(refused_value(problem, column.table.name, column.name))) from None
