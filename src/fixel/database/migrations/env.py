"""Alembic's entry point: runs migrations in the transaction that `schema.py` has opened."""

from alembic import context

from fixel.database.schema import METADATA

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=METADATA,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
