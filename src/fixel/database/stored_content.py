"""Check where a project leads; its schema, checksums of records, and values derived from others."""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import sqlalchemy as sa

from fixel.database import rows, schema
from fixel.database.project import ANALYSES, DATABASE_FILES, MEDIA, SETTINGS, VARIABLE
from fixel.errors import FixelError, InvalidInput, StoreRefused, reason_of
from fixel.io.atomic import INVALID_CONTENT
from fixel.io.document import read_document
from fixel.model.trajectory import path_columns
from fixel.trust import TrustedEntry, is_trusted, trust

RESTORE: Final = "replace experiments.db with a backup, which fixel db backup wrote"
ADVICE: Final = "copy the experiments into a new project with: fixel export"
FOLDERS: Final = (MEDIA, ANALYSES, "backups", "bench", "cache", "jobs", "rigs")  # of a project
CHANGED: Final = "has changed: its checksum differs"


class Trouble(NamedTuple):
    """Fault found in a database."""

    where: str
    sentence: str
    hint: str


# --- the folder -----------------------------------------------------------------------------------


def check_place(folder: Path, database: str | None) -> None:
    """Raise `InvalidInput` if a project leads out of its folder, unless the user trusts it."""
    if database is not None and database.lower().startswith("sqlite"):
        _check_inside(folder, database)
    outside = _outside(folder, database)
    if outside["leads_to"] and not is_trusted(outside):
        command = shlex.join(["fixel", "trust", str(folder)])
        found = f"a project that leads to {outside['leads_to'][0]}"
        expected = "a project in one folder, or one that you trust"
        hint = f"if you know what is there, run: {command}"
        raise InvalidInput(str(folder), found=found, expected=expected, hint=hint)


def trust_place(folder: str | Path) -> TrustedEntry:
    """Add a project to the user's list, with the server and the links to which it leads."""
    return trust(_outside(Path(folder), read_document(Path(folder, SETTINGS)).get("database")))


def _check_inside(folder: Path, database: str) -> None:
    """Raise `InvalidInput` for a file of SQLite elsewhere, which opening it would create."""
    # A query, an escape, or anything before the file, may make it another: `file:/x?uri=true`.
    file = re.fullmatch(r"sqlite[\w+]*:///([^?%\0]+)", database, re.IGNORECASE)
    if file is None or not Path(file[1]).resolve().is_relative_to(folder.resolve()):
        raise InvalidInput(
            f"{folder / SETTINGS}: database",
            found=database,
            expected="the URL of a server, or a file in the folder of the project",
            hint=f"to use this file, set {VARIABLE} to its URL",
        )


def _outside(folder: Path, database: str | None) -> dict[str, Any]:
    """Return a project with the server that its settings name, and the links that leave its folder.

    Files of media are not searched: their checksums are known.
    """
    home, found = Path(os.path.realpath(folder)), list[str]()
    if database and database.lower().startswith("postgres") and VARIABLE not in os.environ:
        found.append(f"the database {re.sub('//.*@', '//', database)}")
    for name in (SETTINGS, *DATABASE_FILES, *FOLDERS):
        for link in _links(str(folder / name), deep=name != MEDIA):
            target = os.path.realpath(link)
            if not Path(target).is_relative_to(home):
                found.append(f"{target}, by the link {Path(link).relative_to(folder)}")
    return {"project": str(home), "leads_to": found}


def _links(path: str, deep: bool) -> Iterator[str]:
    """Yield a path that is a link, or the links in a folder; those below it only if `deep`."""
    if os.path.islink(path):
        yield path
    elif os.path.isdir(path):
        with suppress(PermissionError), os.scandir(path) as entries:
            for entry in entries:
                if entry.is_symlink() or (deep and entry.is_dir()):
                    yield from _links(entry.path, deep)


# --- the schema -----------------------------------------------------------------------------------


def schema_troubles(connection: sa.Connection) -> Iterator[Trouble]:
    """Yield missing tables, columns, indices, references and triggers."""
    look = sa.inspect(connection)
    triggers = _triggers(connection)
    there = set(look.get_table_names())
    for name, table in schema.METADATA.tables.items():
        if name not in there:
            yield Trouble(name, "the table is missing", RESTORE)
            continue
        missing = sorted(set(_wanted(table)) - set(_found(look, name)))
        for sentence in (*missing, *_trigger_faults(table, triggers)):
            yield Trouble(name, sentence, ADVICE)


def _wanted(table: sa.Table) -> Iterator[str]:
    """Yield one sentence per required property of a table, to report if the property is missing."""
    for column in table.columns:
        yield _column(column.name, bool(column.nullable))
    for index in table.indexes:
        yield _index([column.name for column in index.columns])
    for key in table.foreign_keys:
        yield f"the reference from {key.parent.name} to {key.column.table.name} is missing"
    for constraint in table.constraints:
        if isinstance(constraint, sa.UniqueConstraint):
            yield _unique([column.name for column in constraint.columns])


def _found(look: sa.Inspector, name: str) -> Iterator[str]:
    for column in look.get_columns(name):
        yield _column(column["name"], column["nullable"])
    for index in look.get_indexes(name):
        columns = [column or "" for column in index["column_names"]]
        yield _unique(columns) if index["unique"] else _index(columns)
    for key in look.get_foreign_keys(name):
        target = key["referred_table"]
        yield f"the reference from {key['constrained_columns'][0]} to {target} is missing"
    for constraint in look.get_unique_constraints(name):
        yield _unique(constraint["column_names"])


def _column(name: str, nullable: bool) -> str:
    return f"the column {name} is missing, or {'must not' if nullable else 'may'} be empty"


def _index(columns: list[str]) -> str:
    return f"the index of {', '.join(columns)} is missing"


def _unique(columns: list[str]) -> str:
    return f"{', '.join(sorted(columns))} may be duplicated"


def _triggers(connection: sa.Connection) -> Mapping[str, str]:
    """Definitions of all triggers, by name."""
    if connection.dialect.name == "sqlite":
        text = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
    else:
        text = "SELECT tgname, pg_get_triggerdef(oid) FROM pg_trigger WHERE NOT tgisinternal"
    return {str(name): str(sql) for name, sql in connection.execute(sa.text(text))}


def _trigger_faults(table: sa.Table, triggers: Mapping[str, str]) -> Iterator[str]:
    deeds = {"frozen": ("BEFORE UPDATE", "changes"), "kept": ("BEFORE DELETE", "deletion")}
    for name, (words, verb) in deeds.items():
        text = triggers.get(f"{table.name}_{name}", "")
        frozen = [c.name for c in table.columns if c.name != "deleted_at_utc"]
        whole = name == "kept" or all(column in text for column in frozen)
        refuses = "RAISE(ABORT" in text or "fixel_refuse" in text
        if words not in text or " WHEN " in text or not refuses or not whole:
            yield f"its rows are not protected: the trigger against {verb} is missing"


# --- records --------------------------------------------------------------------------------------


def content_troubles(connection: sa.Connection, media: Path) -> Iterator[Trouble]:
    """Yield records whose content disagrees with their checksum or with their source."""
    checks: dict[sa.Table, Callable[[sa.Connection, sa.Row[Any], Path], str | None]] = {
        schema.experiment: _experiment,
        schema.system_parameters: _parameters,
        schema.simulation: _moved,
        schema.filter_run: _moved,
        schema.calibration: _calibration,
    }
    for table, check in checks.items():
        # One by one, since together they may be larger than memory.
        for number in connection.scalars(sa.select(table.c.id).order_by(table.c.id)).all():
            try:
                row = connection.execute(sa.select(table).where(table.c.id == number)).one()
                sentence = check(connection, row, media)
            except StoreRefused:
                continue  # a file that is missing or has changed, which is reported with its series
            except (FixelError, sa.exc.NoResultFound, *INVALID_CONTENT) as problem:
                sentence = f"cannot be read: {reason_of(problem)}"
            if sentence is not None:
                yield Trouble(f"{table.name} {number}", sentence, RESTORE)


def _experiment(connection: sa.Connection, row: sa.Row[Any], media: Path) -> str | None:
    flag = schema.flag
    imported = connection.execute(
        sa.select(flag.c.name, flag.c.detail, flag.c.is_fault)
        .where(flag.c.experiment_id == row.id)
        .order_by(flag.c.id)
        .limit(row.n_import_flag)
    )
    measured = rows.read_all(connection, "experiment", row.id, media)
    paths = [values for name, _, values in measured if name == "object"]
    if not paths or len(paths[0]) != row.n_frame:
        return None  # reported by another check
    content = row._asdict()
    derived = path_columns(rows.trajectory_of(paths[0]))
    if any(content[name] != value for name, value in derived.items()):
        return "its duration, start or end differs from its trajectory"
    flags = [list(one) for one in imported]
    if rows.content_digest(content | derived, flags, measured) != row.content_sha256:
        return CHANGED
    return _geometries(connection, row)


def _geometries(connection: sa.Connection, row: sa.Row[Any]) -> str | None:
    heights = (row.object_height_m, row.pusher_height_m)
    wanted = rows.geometries_of(row.scene, row.object_name, *heights)
    for number, geometry in zip(
        (row.object_geometry_id, row.pusher_geometry_id), wanted, strict=True
    ):
        if (number is None) != (geometry is None):
            return "a geometry of its scene is missing or belongs to another scene"
        if geometry is None:
            continue
        table = schema.geometry
        stored = connection.execute(sa.select(table).where(table.c.id == number)).one_or_none()
        if stored is None:
            return None  # a broken reference, which another check reports
        found = stored._asdict()
        if any(found[name] != value for name, value in geometry.items()):
            return f"object_pusher_geometry {number} does not belong to its scene"
    return None


def _parameters(_: sa.Connection, row: sa.Row[Any], __: Path) -> str | None:
    values = rows.parameters_of(row)
    return None if rows.parameters_row(values)["content_sha256"] == row.content_sha256 else CHANGED


def _moved(connection: sa.Connection, row: sa.Row[Any], media: Path) -> str | None:
    owner = "simulation" if hasattr(row, "error_mm2") else "filter_run"
    for name, columns, values in rows.read_all(connection, owner, row.id, media):
        if columns == rows.PATH:
            rows.trajectory_of(values)  # raises if it is no path
        elif name in ("object", "pusher"):
            return f"its trajectory has the columns {', '.join(columns)}"
    return None


def _calibration(connection: sa.Connection, row: sa.Row[Any], media: Path) -> str | None:
    member = schema.calibration_member
    errors = connection.scalars(
        sa.select(member.c.error_mm2).where(member.c.calibration_id == row.id)
    ).all()
    if len(errors) != row.n_member or not errors:
        return f"has {len(errors)} of {row.n_member} members"
    total = math.fsum(errors)
    wanted = (total / len(errors), total, max(errors))
    found = (row.mean_error_mm2, row.sum_error_mm2, row.max_error_mm2)
    if not all(math.isclose(a, b) for a, b in zip(found, wanted, strict=True)):
        return "its errors differ from those of its members"
    tried = rows.read_all(connection, "calibration", row.id, media)
    if sum(len(values) for name, _, values in tried if name == "evaluations") != row.n_evaluation:
        return "its evaluations are incomplete"
    rows.estimates_of(row.estimates)
    return None
