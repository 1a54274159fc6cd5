"""Triggers that reject changes of stored rows, for SQLite and PostgreSQL.

Only `deleted_at_utc` may change: deletion is soft. A row is never deleted.
"""

import sqlalchemy as sa
from alembic import op

SENTENCE = "finished records cannot change; write a new one"


def freeze(table: str) -> None:
    """Reject every DELETE from a table, and every UPDATE except of `deleted_at_utc`."""
    connection = op.get_bind()
    columns = [column["name"] for column in sa.inspect(connection).get_columns(table)]
    frozen = ", ".join(f'"{name}"' for name in columns if name != "deleted_at_utc")
    if connection.dialect.name == "sqlite":
        _freeze_in_sqlite(table, frozen)
    else:
        _freeze_in_postgresql(table, frozen)


def _freeze_in_sqlite(table: str, frozen: str) -> None:
    refuse = f"BEGIN SELECT RAISE(ABORT, '{SENTENCE}'); END"
    op.execute(f'CREATE TRIGGER "{table}_frozen" BEFORE UPDATE OF {frozen} ON "{table}" {refuse}')
    op.execute(f'CREATE TRIGGER "{table}_kept" BEFORE DELETE ON "{table}" {refuse}')


def _freeze_in_postgresql(table: str, frozen: str) -> None:
    op.execute(
        "CREATE OR REPLACE FUNCTION fixel_refuse() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{SENTENCE}'; END $$"
    )
    op.execute(
        f'CREATE TRIGGER "{table}_frozen" BEFORE UPDATE OF {frozen} ON "{table}" '
        "FOR EACH ROW EXECUTE FUNCTION fixel_refuse()"
    )
    op.execute(
        f'CREATE TRIGGER "{table}_kept" BEFORE DELETE ON "{table}" '
        "FOR EACH ROW EXECUTE FUNCTION fixel_refuse()"
    )
