"""Create all tables and their triggers.

The only revision before the first release. As soon as another one follows, write the tables of
this one out, since `METADATA` is always that of the newest.
"""

from alembic import op

from fixel.database.schema import freeze
from fixel.database.tables import METADATA

revision = "0004"
down_revision = None


def upgrade() -> None:
    METADATA.create_all(op.get_bind())
    for table in METADATA.tables:
        freeze(table)
