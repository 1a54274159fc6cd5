"""Create tables of experiments, simulations, parameters, calibrations and filter runs."""

import sqlalchemy as sa
from alembic import op

from fixel.database.migrations.freezing import freeze

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

FROZEN = (
    "object_pusher_geometry",
    "experiment",
    "flag",
    "series",
    "system_parameters",
    "simulation",
    "calibration",
    "calibration_member",
    "filter_parameters",
    "filter_run",
)


def upgrade() -> None:
    op.create_table(
        "filter_parameters",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=400), nullable=False),
        sa.Column("is_particle_filter", sa.Boolean(), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.Column("fixel_version", sa.String(length=40), nullable=False),
        sa.Column("command", sa.Text(), nullable=False),
        sa.Column("source_file", sa.Text(), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_filter_parameters")),
    )
    op.create_table(
        "object_pusher_geometry",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("is_object", sa.Boolean(), nullable=False),
        sa.Column("shape", sa.JSON(), nullable=False),
        sa.Column("height_m", sa.Float(precision=53), nullable=True),
        sa.Column("mass_kg", sa.Float(precision=53), nullable=True),
        sa.Column("inertia_kg_m2", sa.Float(precision=53), nullable=True),
        sa.Column("centre_of_mass_x_m", sa.Float(precision=53), nullable=True),
        sa.Column("centre_of_mass_y_m", sa.Float(precision=53), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_object_pusher_geometry")),
        sa.UniqueConstraint(
            "content_sha256", name=op.f("uq_object_pusher_geometry_content_sha256")
        ),
    )
    op.create_table(
        "series",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("owner", sa.String(length=20), nullable=False),
        sa.Column("owner_id", sa.Integer(), nullable=False),
        sa.Column("place", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("columns", sa.JSON(), nullable=False),
        sa.Column("n_row", sa.Integer(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=True),
        sa.Column("media_sha256", sa.String(length=64), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_series")),
        sa.UniqueConstraint(
            "owner", "owner_id", "place", name=op.f("uq_series_owner_owner_id_place")
        ),
    )
    op.create_table(
        "system_parameters",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("mu_support", sa.Float(precision=53), nullable=True),
        sa.Column("mu_fixel", sa.Float(precision=53), nullable=True),
        sa.Column("mu_pusher", sa.Float(precision=53), nullable=True),
        sa.Column("tripod_radius_m", sa.Float(precision=53), nullable=True),
        sa.Column("others", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_system_parameters")),
        sa.UniqueConstraint("content_sha256", name=op.f("uq_system_parameters_content_sha256")),
    )
    op.create_table(
        "calibration",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=400), nullable=False),
        sa.Column("system_parameters_id", sa.Integer(), nullable=False),
        sa.Column("method", sa.JSON(), nullable=False),
        sa.Column("n_evaluation", sa.Integer(), nullable=False),
        sa.Column("n_member", sa.Integer(), nullable=False),
        sa.Column("mean_error_mm2", sa.Float(precision=53), nullable=False),
        sa.Column("sum_error_mm2", sa.Float(precision=53), nullable=False),
        sa.Column("max_error_mm2", sa.Float(precision=53), nullable=False),
        sa.Column("reasons", sa.JSON(), nullable=False),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.Column("fixel_version", sa.String(length=40), nullable=False),
        sa.Column("command", sa.Text(), nullable=False),
        sa.Column("source_file", sa.Text(), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["system_parameters_id"],
            ["system_parameters.id"],
            name=op.f("fk_calibration_system_parameters_id_system_parameters"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_calibration")),
    )
    op.create_table(
        "experiment",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("dataset", sa.String(length=200), nullable=False),
        sa.Column("name", sa.String(length=400), nullable=False),
        sa.Column("is_real", sa.Boolean(), nullable=False),
        sa.Column("simulated_by", sa.Text(), nullable=False),
        sa.Column("object_name", sa.String(length=200), nullable=False),
        sa.Column("object_geometry_id", sa.Integer(), nullable=True),
        sa.Column("pusher_geometry_id", sa.Integer(), nullable=True),
        sa.Column("scene", sa.JSON(), nullable=True),
        sa.Column("object_height_m", sa.Float(precision=53), nullable=True),
        sa.Column("pusher_height_m", sa.Float(precision=53), nullable=True),
        sa.Column("fixel_height_m", sa.Float(precision=53), nullable=True),
        sa.Column("n_frame", sa.Integer(), nullable=False),
        sa.Column("duration_s", sa.Float(precision=53), nullable=False),
        sa.Column("start_x_m", sa.Float(precision=53), nullable=False),
        sa.Column("start_y_m", sa.Float(precision=53), nullable=False),
        sa.Column("start_theta_rad", sa.Float(precision=53), nullable=False),
        sa.Column("end_x_m", sa.Float(precision=53), nullable=False),
        sa.Column("end_y_m", sa.Float(precision=53), nullable=False),
        sa.Column("end_theta_rad", sa.Float(precision=53), nullable=False),
        sa.Column("effective_start_s", sa.Float(precision=53), nullable=True),
        sa.Column("effective_end_s", sa.Float(precision=53), nullable=True),
        sa.Column("contact_mode", sa.String(length=40), nullable=False),
        sa.Column("conditions", sa.JSON(), nullable=False),
        sa.Column("video_sha256", sa.String(length=64), nullable=False),
        sa.Column("n_import_flag", sa.Integer(), nullable=False),
        sa.Column("replaces_id", sa.Integer(), nullable=True),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.Column("fixel_version", sa.String(length=40), nullable=False),
        sa.Column("command", sa.Text(), nullable=False),
        sa.Column("source_file", sa.Text(), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["object_geometry_id"],
            ["object_pusher_geometry.id"],
            name=op.f("fk_experiment_object_geometry_id_object_pusher_geometry"),
        ),
        sa.ForeignKeyConstraint(
            ["pusher_geometry_id"],
            ["object_pusher_geometry.id"],
            name=op.f("fk_experiment_pusher_geometry_id_object_pusher_geometry"),
        ),
        sa.ForeignKeyConstraint(
            ["replaces_id"], ["experiment.id"], name=op.f("fk_experiment_replaces_id_experiment")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_experiment")),
        sa.UniqueConstraint("content_sha256", name=op.f("uq_experiment_content_sha256")),
    )
    op.create_index(op.f("ix_experiment_replaces_id"), "experiment", ["replaces_id"], unique=False)
    op.create_index(
        op.f("ix_experiment_dataset_name"), "experiment", ["dataset", "name"], unique=False
    )
    op.create_table(
        "calibration_member",
        sa.Column("calibration_id", sa.Integer(), nullable=False),
        sa.Column("experiment_id", sa.Integer(), nullable=False),
        sa.Column("place", sa.Integer(), nullable=False),
        sa.Column("weight", sa.Float(precision=53), nullable=False),
        sa.Column("error_mm2", sa.Float(precision=53), nullable=False),
        sa.ForeignKeyConstraint(
            ["calibration_id"],
            ["calibration.id"],
            name=op.f("fk_calibration_member_calibration_id_calibration"),
        ),
        sa.ForeignKeyConstraint(
            ["experiment_id"],
            ["experiment.id"],
            name=op.f("fk_calibration_member_experiment_id_experiment"),
        ),
        sa.PrimaryKeyConstraint("calibration_id", "place", name=op.f("pk_calibration_member")),
    )
    op.create_index(
        op.f("ix_calibration_member_experiment_id"),
        "calibration_member",
        ["experiment_id"],
        unique=False,
    )
    op.create_table(
        "filter_run",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("experiment_id", sa.Integer(), nullable=False),
        sa.Column("filter_parameters_id", sa.Integer(), nullable=False),
        sa.Column("uses_tactile", sa.Boolean(), nullable=False),
        sa.Column("occlusion_start_s", sa.Float(precision=53), nullable=True),
        sa.Column("occlusion_end_s", sa.Float(precision=53), nullable=True),
        sa.Column("contact_mode", sa.String(length=40), nullable=False),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.Column("fixel_version", sa.String(length=40), nullable=False),
        sa.Column("command", sa.Text(), nullable=False),
        sa.Column("source_file", sa.Text(), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["experiment_id"],
            ["experiment.id"],
            name=op.f("fk_filter_run_experiment_id_experiment"),
        ),
        sa.ForeignKeyConstraint(
            ["filter_parameters_id"],
            ["filter_parameters.id"],
            name=op.f("fk_filter_run_filter_parameters_id_filter_parameters"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_filter_run")),
    )
    op.create_index(
        op.f("ix_filter_run_experiment_id"), "filter_run", ["experiment_id"], unique=False
    )
    op.create_table(
        "flag",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("experiment_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.Column("is_fault", sa.Boolean(), nullable=False),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.ForeignKeyConstraint(
            ["experiment_id"], ["experiment.id"], name=op.f("fk_flag_experiment_id_experiment")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_flag")),
    )
    op.create_index(op.f("ix_flag_experiment_id"), "flag", ["experiment_id"], unique=False)
    op.create_table(
        "simulation",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("experiment_id", sa.Integer(), nullable=False),
        sa.Column("system_parameters_id", sa.Integer(), nullable=False),
        sa.Column("method", sa.JSON(), nullable=False),
        sa.Column("status", sa.String(length=40), nullable=False),
        sa.Column("contact_mode", sa.String(length=40), nullable=False),
        sa.Column("error_mm2", sa.Float(precision=53), nullable=True),
        sa.Column("created_at_utc", sa.String(length=40), nullable=False),
        sa.Column("deleted_at_utc", sa.String(length=40), nullable=True),
        sa.Column("fixel_version", sa.String(length=40), nullable=False),
        sa.Column("command", sa.Text(), nullable=False),
        sa.Column("source_file", sa.Text(), nullable=False),
        sa.Column("source_sha256", sa.String(length=64), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["experiment_id"],
            ["experiment.id"],
            name=op.f("fk_simulation_experiment_id_experiment"),
        ),
        sa.ForeignKeyConstraint(
            ["system_parameters_id"],
            ["system_parameters.id"],
            name=op.f("fk_simulation_system_parameters_id_system_parameters"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_simulation")),
    )
    op.create_index(
        op.f("ix_simulation_experiment_id"), "simulation", ["experiment_id"], unique=False
    )
    for table in FROZEN:
        freeze(table)
