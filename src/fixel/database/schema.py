"""Database tables, as they are after the last migration; versions of databases, and their upgrade.

Column names end with their unit. User-written queries may rely on these names. Rows are written
once: triggers reject changes, except of `deleted_at_utc`. Data that vary between experiments
(conditions, a scene) are JSON. Long data (a path, a signal) are rows of `series`: little-endian
float64, row by row, or above `MEDIA_BYTES` a file in the media folder.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, Final

import sqlalchemy as sa

from fixel.errors import StoreRefused

METADATA: Final = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

MEDIA_BYTES: Final = 1_000_000  # a longer series is stored as a file

_FLOAT = sa.Float(53)


def _provenance() -> list[sa.Column[Any]]:
    return [
        sa.Column("created_at_utc", sa.String(40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(40)),
        sa.Column("fixel_version", sa.String(40), nullable=False),
        sa.Column("command", sa.Text, nullable=False),
        sa.Column("source_file", sa.Text, nullable=False),
        sa.Column("source_sha256", sa.String(64), nullable=False),
        sa.Column("seed", sa.BigInteger),
    ]


def _reference(name: str, target: str, *, needed: bool = True) -> sa.Column[Any]:
    return sa.Column(name, sa.Integer, sa.ForeignKey(f"{target}.id"), nullable=not needed)


def _table(name: str, *content: Any) -> sa.Table:
    """Table of records with ids."""
    return sa.Table(name, METADATA, sa.Column("id", sa.Integer, primary_key=True), *content)


def _numbers(*names: str, needed: bool = False) -> list[sa.Column[Any]]:
    return [sa.Column(name, _FLOAT, nullable=not needed) for name in names]


geometry = _table(
    "object_pusher_geometry",
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("is_object", sa.Boolean, nullable=False),
    sa.Column("shape", sa.JSON, nullable=False),  # as in a scene file, lengths in metres
    *_numbers("height_m", "mass_kg", "inertia_kg_m2", "centre_of_mass_x_m", "centre_of_mass_y_m"),
)

experiment = _table(
    "experiment",
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("dataset", sa.String(200), nullable=False),
    sa.Column("name", sa.String(400), nullable=False),
    sa.Column("is_real", sa.Boolean, nullable=False),
    sa.Column("simulated_by", sa.Text, nullable=False),
    sa.Column("object_name", sa.String(200), nullable=False),
    _reference("object_geometry_id", "object_pusher_geometry", needed=False),
    _reference("pusher_geometry_id", "object_pusher_geometry", needed=False),
    sa.Column("scene", sa.JSON(none_as_null=True)),
    *_numbers("object_height_m", "pusher_height_m", "fixel_height_m"),
    sa.Column("n_frame", sa.Integer, nullable=False),
    *_numbers(
        "duration_s",
        "start_x_m",
        "start_y_m",
        "start_theta_rad",
        "end_x_m",
        "end_y_m",
        "end_theta_rad",
        needed=True,
    ),
    *_numbers("effective_start_s", "effective_end_s"),
    sa.Column("contact_mode", sa.String(40), nullable=False),
    sa.Column("conditions", sa.JSON, nullable=False),
    sa.Column("video_sha256", sa.String(64), nullable=False),
    sa.Column("n_import_flag", sa.Integer, nullable=False),
    _reference("replaces_id", "experiment", needed=False),
    *_provenance(),
    sa.Index(None, "dataset", "name"),
    sa.Index(None, "replaces_id"),
    # Rows are long, since they contain the scene; counting should not have to read them.
    sa.Index(None, "deleted_at_utc"),
)

flag = _table(
    "flag",
    _reference("experiment_id", "experiment"),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("detail", sa.Text, nullable=False),
    sa.Column("is_fault", sa.Boolean, nullable=False),
    sa.Column("created_at_utc", sa.String(40), nullable=False),
    sa.Column("deleted_at_utc", sa.String(40)),
    sa.Index(None, "experiment_id"),
)

note = _table(
    "note",
    _reference("experiment_id", "experiment"),
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("created_at_utc", sa.String(40), nullable=False),
    sa.Column("deleted_at_utc", sa.String(40)),
    sa.Index(None, "experiment_id"),
)

series = _table(
    "series",
    sa.Column("owner", sa.String(20), nullable=False),  # experiment, simulation, calibration, ...
    sa.Column("owner_id", sa.Integer, nullable=False),
    sa.Column("place", sa.Integer, nullable=False),  # position among the series of its owner
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("columns", sa.JSON, nullable=False),  # JSON list; the first is mostly time_s
    sa.Column("n_row", sa.Integer, nullable=False),
    sa.Column("data", sa.LargeBinary),
    sa.Column("media_sha256", sa.String(64)),
    sa.UniqueConstraint("owner", "owner_id", "place"),
)

system_parameters = _table(
    "system_parameters",
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    *_numbers("mu_support", "mu_fixel", "mu_pusher", "tripod_radius_m"),
    sa.Column("others", sa.JSON, nullable=False),  # JSON, for parameters without a column
)

simulation = _table(
    "simulation",
    _reference("experiment_id", "experiment"),
    _reference("system_parameters_id", "system_parameters"),
    sa.Column("method", sa.JSON, nullable=False),
    sa.Column("status", sa.String(40), nullable=False),
    sa.Column("contact_mode", sa.String(40), nullable=False),
    sa.Column("error_mm2", _FLOAT),
    *_provenance(),
    sa.Index(None, "experiment_id"),
)

calibration = _table(
    "calibration",
    sa.Column("name", sa.String(400), nullable=False),
    _reference("system_parameters_id", "system_parameters"),
    sa.Column("method", sa.JSON, nullable=False),
    sa.Column("n_evaluation", sa.Integer, nullable=False),
    sa.Column("n_member", sa.Integer, nullable=False),
    *_numbers("mean_error_mm2", "sum_error_mm2", "max_error_mm2", needed=True),
    sa.Column("reasons", sa.JSON, nullable=False),  # JSON: failed evaluation's number -> reason
    sa.Column("estimates", sa.JSON(none_as_null=True)),  # JSON list, one item per parameter
    *_provenance(),
    # Both are empty in calibrations stored by earlier versions.
    sa.Column("request", sa.JSON(none_as_null=True)),  # JSON: all options of the run
    sa.Column("result", sa.JSON(none_as_null=True)),  # JSON: profiles, noise, errors before, ...
)

calibration_member = sa.Table(
    "calibration_member",
    METADATA,
    _reference("calibration_id", "calibration"),
    _reference("experiment_id", "experiment"),
    sa.Column("place", sa.Integer, nullable=False),
    *_numbers("weight", "error_mm2", needed=True),
    sa.PrimaryKeyConstraint("calibration_id", "place"),
    sa.Index(None, "experiment_id"),
)

filter_parameters = _table(
    "filter_parameters",
    sa.Column("name", sa.String(400), nullable=False),
    sa.Column("is_particle_filter", sa.Boolean, nullable=False),
    sa.Column("options", sa.JSON, nullable=False),
    *_provenance(),
)

filter_run = _table(
    "filter_run",
    _reference("experiment_id", "experiment"),
    _reference("filter_parameters_id", "filter_parameters"),
    sa.Column("uses_tactile", sa.Boolean, nullable=False),
    *_numbers("occlusion_start_s", "occlusion_end_s"),
    sa.Column("contact_mode", sa.String(40), nullable=False),
    *_provenance(),
    sa.Index(None, "experiment_id"),
)


MIGRATIONS: Final = Path(__file__).with_name("migrations")


def newest() -> str:
    """Newest schema version that this program knows."""
    return versions()[-1]


@functools.cache
def versions() -> tuple[str, ...]:
    """All schema versions that this program knows, oldest first."""
    return tuple(sorted(path.name[1:5] for path in MIGRATIONS.glob("versions/m*.py")))


def version_of(connection: sa.Connection) -> str | None:
    """Schema version of a database; None for an empty one."""
    if not sa.inspect(connection).has_table("alembic_version"):
        return None
    heads = connection.scalars(sa.text("SELECT version_num FROM alembic_version")).all()
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
    # Imported here: a project of today's version is opened without it, which takes long to load.
    from alembic import command
    from alembic.config import Config

    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    command.upgrade(config, version)


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
