"""Square the errors of calibrations that minimised a root mean square.

They were stored in mm, in columns in mm^2. The method of a calibration names its unit.
"""

import sqlalchemy as sa
from alembic import op

from fixel.database.migrations.freezing import freeze, thaw

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

CALIBRATION = sa.table(
    "calibration",
    sa.column("id", sa.Integer),
    sa.column("method", sa.JSON),
    sa.column("mean_error_mm2", sa.Float),
    sa.column("sum_error_mm2", sa.Float),
    sa.column("max_error_mm2", sa.Float),
)
MEMBER = sa.table(
    "calibration_member",
    sa.column("calibration_id", sa.Integer),
    sa.column("place", sa.Integer),
    sa.column("error_mm2", sa.Float),
)


def upgrade() -> None:
    connection = op.get_bind()
    methods = connection.execute(sa.select(CALIBRATION.c.id, CALIBRATION.c.method)).all()
    lengths = [number for number, method in methods if method.get("error_unit") == "mm"]
    if not lengths:
        return
    thaw("calibration")
    thaw("calibration_member")
    for number in lengths:
        _square(connection, number)
    freeze("calibration_member")
    freeze("calibration")


def _square(connection: sa.Connection, number: int) -> None:
    own = MEMBER.c.calibration_id == number
    rows = connection.execute(sa.select(MEMBER.c.place, MEMBER.c.error_mm2).where(own)).all()
    squares = [error * error for _, error in rows]
    for (place, _), square in zip(rows, squares, strict=True):
        at = sa.and_(own, MEMBER.c.place == place)
        connection.execute(sa.update(MEMBER).where(at).values(error_mm2=square))
    connection.execute(
        sa.update(CALIBRATION)
        .where(CALIBRATION.c.id == number)
        .values(
            mean_error_mm2=sum(squares) / len(squares),
            sum_error_mm2=sum(squares),
            max_error_mm2=max(squares),
        )
    )
