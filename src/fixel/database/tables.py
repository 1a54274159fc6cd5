"""Database tables, as they are after the last migration. Column names end with their unit.

User-written queries may rely on these names. Rows are written once: triggers reject changes, except
of `deleted_at_utc`. Data that vary between experiments (conditions, a scene) are JSON. Long data
(a path, a signal) are rows of `series`: little-endian float64, row by row, or above `MEDIA_BYTES`
a file in the media folder.
"""

from __future__ import annotations

from typing import Any, Final

import sqlalchemy as sa

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


geometry = sa.Table(
    "object_pusher_geometry",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("is_object", sa.Boolean, nullable=False),
    sa.Column("shape", sa.JSON, nullable=False),  # as in a scene file, lengths in metres
    sa.Column("height_m", _FLOAT),
    sa.Column("mass_kg", _FLOAT),
    sa.Column("inertia_kg_m2", _FLOAT),
    sa.Column("centre_of_mass_x_m", _FLOAT),
    sa.Column("centre_of_mass_y_m", _FLOAT),
)

experiment = sa.Table(
    "experiment",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("dataset", sa.String(200), nullable=False),
    sa.Column("name", sa.String(400), nullable=False),
    sa.Column("is_real", sa.Boolean, nullable=False),
    sa.Column("simulated_by", sa.Text, nullable=False),
    sa.Column("object_name", sa.String(200), nullable=False),
    _reference("object_geometry_id", "object_pusher_geometry", needed=False),
    _reference("pusher_geometry_id", "object_pusher_geometry", needed=False),
    sa.Column("scene", sa.JSON(none_as_null=True)),
    sa.Column("object_height_m", _FLOAT),
    sa.Column("pusher_height_m", _FLOAT),
    sa.Column("fixel_height_m", _FLOAT),
    sa.Column("n_frame", sa.Integer, nullable=False),
    sa.Column("duration_s", _FLOAT, nullable=False),
    sa.Column("start_x_m", _FLOAT, nullable=False),
    sa.Column("start_y_m", _FLOAT, nullable=False),
    sa.Column("start_theta_rad", _FLOAT, nullable=False),
    sa.Column("end_x_m", _FLOAT, nullable=False),
    sa.Column("end_y_m", _FLOAT, nullable=False),
    sa.Column("end_theta_rad", _FLOAT, nullable=False),
    sa.Column("effective_start_s", _FLOAT),
    sa.Column("effective_end_s", _FLOAT),
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

flag = sa.Table(
    "flag",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    _reference("experiment_id", "experiment"),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("detail", sa.Text, nullable=False),
    sa.Column("is_fault", sa.Boolean, nullable=False),
    sa.Column("created_at_utc", sa.String(40), nullable=False),
    sa.Column("deleted_at_utc", sa.String(40)),
    sa.Index(None, "experiment_id"),
)

note = sa.Table(
    "note",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    _reference("experiment_id", "experiment"),
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("created_at_utc", sa.String(40), nullable=False),
    sa.Column("deleted_at_utc", sa.String(40)),
    sa.Index(None, "experiment_id"),
)

series = sa.Table(
    "series",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
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

system_parameters = sa.Table(
    "system_parameters",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("content_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("mu_support", _FLOAT),
    sa.Column("mu_fixel", _FLOAT),
    sa.Column("mu_pusher", _FLOAT),
    sa.Column("tripod_radius_m", _FLOAT),
    sa.Column("others", sa.JSON, nullable=False),  # JSON, for parameters without a column
)

simulation = sa.Table(
    "simulation",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    _reference("experiment_id", "experiment"),
    _reference("system_parameters_id", "system_parameters"),
    sa.Column("method", sa.JSON, nullable=False),
    sa.Column("status", sa.String(40), nullable=False),
    sa.Column("contact_mode", sa.String(40), nullable=False),
    sa.Column("error_mm2", _FLOAT),
    *_provenance(),
    sa.Index(None, "experiment_id"),
)

calibration = sa.Table(
    "calibration",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(400), nullable=False),
    _reference("system_parameters_id", "system_parameters"),
    sa.Column("method", sa.JSON, nullable=False),
    sa.Column("n_evaluation", sa.Integer, nullable=False),
    sa.Column("n_member", sa.Integer, nullable=False),
    sa.Column("mean_error_mm2", _FLOAT, nullable=False),
    sa.Column("sum_error_mm2", _FLOAT, nullable=False),
    sa.Column("max_error_mm2", _FLOAT, nullable=False),
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
    sa.Column("weight", _FLOAT, nullable=False),
    sa.Column("error_mm2", _FLOAT, nullable=False),
    sa.PrimaryKeyConstraint("calibration_id", "place"),
    sa.Index(None, "experiment_id"),
)

filter_parameters = sa.Table(
    "filter_parameters",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(400), nullable=False),
    sa.Column("is_particle_filter", sa.Boolean, nullable=False),
    sa.Column("options", sa.JSON, nullable=False),
    *_provenance(),
)

filter_run = sa.Table(
    "filter_run",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True),
    _reference("experiment_id", "experiment"),
    _reference("filter_parameters_id", "filter_parameters"),
    sa.Column("uses_tactile", sa.Boolean, nullable=False),
    sa.Column("occlusion_start_s", _FLOAT),
    sa.Column("occlusion_end_s", _FLOAT),
    sa.Column("contact_mode", sa.String(40), nullable=False),
    *_provenance(),
    sa.Index(None, "experiment_id"),
)
