"""Add a table of notes, and an index that counts experiments without reading long rows."""

import sqlalchemy as sa
from alembic import op

from fixel.database.migrations.freezing import freeze

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "note",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("experiment_id", sa.Integer(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.ForeignKeyConstraint(
            ["experiment_id"], ["experiment.id"], name=op.f("fk_note_experiment_id_experiment")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_note")),
    )
    op.create_index(op.f("ix_note_experiment_id"), "note", ["experiment_id"])
    freeze("note")
    op.create_index(op.f("ix_experiment_deleted_at_utc"), "experiment", ["deleted_at_utc"])
