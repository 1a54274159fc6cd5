"""Schema versions of databases, their upgrade, and triggers that reject changes of stored rows."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Final

import sqlalchemy as sa
from alembic import command, op
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from fixel.errors import StoreRefused

MIGRATIONS: Final = Path(__file__).with_name("migrations")
FROZEN: Final = "finished records cannot change; write a new one"  # message of the triggers


def _config(connection: sa.Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.attributes["connection"] = connection
    return config


def newest() -> str:
    """Newest schema version that this program knows."""
    return versions()[-1]


@functools.cache
def versions() -> tuple[str, ...]:
    """All schema versions that this program knows, oldest first."""
    scripts = ScriptDirectory.from_config(_config()).walk_revisions()
    return tuple(reversed([script.revision for script in scripts]))


def version_of(connection: sa.Connection) -> str | None:
    """Schema version of a database; None for an empty one."""
    heads = MigrationContext.configure(connection).get_current_heads()
    if len(heads) > 1:
        raise StoreRefused(
            f"the database has two schemas: {' and '.join(sorted(heads))}",
            hint="replace it with a backup, which fixel db backup wrote",
        )
    return heads[0] if heads else None


def upgrade(connection: sa.Connection, version: str = "head") -> None:
    """Upgrade a database to a schema version, or leave it unchanged on failure.

    One that is newer than this program, or of another program, raises `StoreRefused`.
    """
    if check_known(connection) is None and sa.inspect(connection).get_table_names():
        raise StoreRefused(
            "the database has tables that do not belong to fixel", hint="use an empty database"
        )
    command.upgrade(_config(connection), version)


def check_known(connection: sa.Connection) -> str | None:
    """Return `version_of` a database; raise `StoreRefused` if this program does not know it."""
    found = version_of(connection)
    if found is not None and found < versions()[0]:
        raise StoreRefused(
            f"the database has schema {found} of a version before the first release, which cannot "
            "be upgraded",
            hint="create a project with fixel new, then import the experiments again",
        )
    if found is not None and found not in versions():
        raise StoreRefused(
            f"the database has schema {found}, newer than schema {newest()} of this version of "
            "fixel",
            hint="install the version of fixel that wrote it, or a newer one",
        )
    return found


def check_newest(connection: sa.Connection, command: str = "fixel db upgrade") -> None:
    """Raise `StoreRefused` for a database that must be upgraded first; `command` is the hint."""
    found = check_known(connection)
    if found != newest():
        what = "is empty" if found is None else f"has schema {found}"
        raise StoreRefused(
            f"the database {what}; this version of fixel needs {newest()}", hint=f"run: {command}"
        )


# --- triggers ------------------------------------------------------------------------------------


def freeze(table: str) -> None:
    """Reject every DELETE from a table, and every UPDATE except of `deleted_at_utc`.

    Deletion is soft. Called by migrations, for SQLite and PostgreSQL.
    """
    connection = op.get_bind()
    columns = [column["name"] for column in sa.inspect(connection).get_columns(table)]
    frozen = ", ".join(f'"{name}"' for name in columns if name != "deleted_at_utc")
    if connection.dialect.name == "sqlite":
        refuse = f"BEGIN SELECT RAISE(ABORT, '{FROZEN}'); END"
    else:
        refuse = "FOR EACH ROW EXECUTE FUNCTION fixel_refuse()"
        op.execute(
            "CREATE OR REPLACE FUNCTION fixel_refuse() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{FROZEN}'; END $$"
        )
    op.execute(f'CREATE TRIGGER "{table}_frozen" BEFORE UPDATE OF {frozen} ON "{table}" {refuse}')
    op.execute(f'CREATE TRIGGER "{table}_kept" BEFORE DELETE ON "{table}" {refuse}')


def unfreeze(table: str) -> None:
    """Remove the triggers of `freeze` from a table whose columns a migration has changed."""
    on = "" if op.get_bind().dialect.name == "sqlite" else f' ON "{table}"'
    for kind in ("frozen", "kept"):
        op.execute(f'DROP TRIGGER "{table}_{kind}"{on}')
