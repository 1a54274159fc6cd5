"""Add a column for a calibration's estimates: value, interval and verdict per parameter."""

import sqlalchemy as sa
from alembic import op

from fixel.database.migrations.freezing import freeze, thaw

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    thaw("calibration")
    op.add_column("calibration", sa.Column("estimates", sa.JSON(), nullable=True))
    freeze("calibration")
