"""Create all tables and their triggers, as they were before the columns of later revisions.

`METADATA` is always that of the newest revision. A later one that changes more than it adds
columns to tables must write the tables of this one out.
"""

from alembic import op

from fixel.database.migrations import freeze
from fixel.database.schema import METADATA

revision = "0004"
down_revision = None

LATER = {"calibration": ("request", "result")}  # columns by table


def upgrade() -> None:
    METADATA.create_all(op.get_bind())
    for table, columns in LATER.items():
        for column in columns:
            op.drop_column(table, column)
    for table in METADATA.tables:
        freeze(table)
