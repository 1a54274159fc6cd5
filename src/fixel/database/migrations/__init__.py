"""Migrations, one module per schema version, and their triggers; `schema.py` applies them."""

import sqlalchemy as sa
from alembic import op

FROZEN = "finished records cannot change; write a new one"  # message of the triggers


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
