"""Add the request and the whole result to calibrations; those stored before have neither."""

import sqlalchemy as sa
from alembic import op

from fixel.database.migrations import freeze, unfreeze

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    for column in ("request", "result"):
        op.add_column("calibration", sa.Column(column, sa.JSON()))
    unfreeze("calibration")  # its trigger names the columns
    freeze("calibration")
