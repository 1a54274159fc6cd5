"""Conversion between records and rows of the database.

Numeric tables are rows of `series`: in the database, or as files above a size limit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from string import hexdigits
from typing import Any, Final, TypeVar

import numpy as np
import sqlalchemy as sa

from fixel.database.schema import MEDIA_BYTES, series
from fixel.errors import InvalidInput, StoreRefused, os_reason
from fixel.formats.scene_file import SceneRecord, scene_content, scene_of
from fixel.io.atomic import sync_folder, write_whole
from fixel.model import Channel, Experiment, Flag, Parameters, Provenance, Trajectory
from fixel.model.records import Estimate, Evaluations, FilterRecord
from fixel.model.trajectory import path_columns
from fixel.typing import FloatArray

T = TypeVar("T")
Measured = tuple[str, tuple[str, ...], FloatArray]  # name, columns, (n, n_column) values

PATH = ("time_s", "x_m", "y_m", "theta_rad")
WITH_COLUMN = ("mu_support", "mu_fixel", "mu_pusher")


def now() -> str:
    """Current time in UTC, ISO 8601, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def digest(content: object, *values: FloatArray) -> str:
    """Checksum of plain content and arrays."""
    total = hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=True).encode())
    for array in values:
        total.update(repr(array.shape).encode())
        total.update(bytes_of(array))
    return total.hexdigest()


def columns_of(record: Any, table: sa.Table) -> dict[str, Any]:
    """Columns of a table that a record has under the same names, and its provenance."""
    found = {c.name: getattr(record, c.name) for c in table.c if hasattr(record, c.name)}
    plain = {k: dict(v) if isinstance(v, Mapping) else v for k, v in found.items()}
    return plain | provenance_row(record.provenance)


def record_of(kind: type[T], row: sa.Row[Any], **given: Any) -> T:
    """Build a record from the columns of its names; some of its fields are given instead."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    own = {name: value for name, value in row._mapping.items() if name in names}
    return kind(**{"provenance": provenance_of(row), **own, **given})


def provenance_row(provenance: Provenance) -> dict[str, Any]:
    """Columns of a provenance."""
    return {
        "created_at_utc": provenance.created or now(),
        "fixel_version": provenance.version,
        "command": provenance.command,
        "source_file": provenance.source,
        "source_sha256": provenance.sha256,
        "seed": provenance.seed,
    }


def provenance_of(row: sa.Row[Any]) -> Provenance:
    """Inverse of `provenance_row`."""
    return Provenance(
        version=row.fixel_version,
        command=row.command,
        source=row.source_file,
        sha256=row.source_sha256,
        seed=row.seed,
        created=row.created_at_utc,
    )


def path_table(trajectory: Trajectory) -> FloatArray:
    """Return a trajectory as an (n, 4) table with the columns `PATH`."""
    return np.column_stack((trajectory.time, trajectory.pose))


def trajectory_of(values: FloatArray) -> Trajectory:
    """Inverse of `path_table`."""
    return Trajectory(time=values[:, 0], pose=values[:, 1:])


def series_of(experiment: Experiment) -> list[Measured]:
    """Name, columns and values of each series measured in an experiment."""
    found = paths_of(experiment.trajectory, experiment.pusher)
    for channel in experiment.channels:
        values = np.column_stack((channel.time, channel.values))
        found.append((f"channel {channel.name}", ("time_s", *channel.columns), values))
    return found


def paths_of(trajectory: Trajectory, pusher: Trajectory | None) -> list[Measured]:
    """Series of the object's trajectory and, if there is one, of the pusher's."""
    found: list[Measured] = [("object", PATH, path_table(trajectory))]
    if pusher is not None:
        found.append(("pusher", PATH, path_table(pusher)))
    return found


def trials_of(tried: Evaluations | None) -> list[Measured]:
    """Series of a calibration's evaluations."""
    if tried is None:
        return []
    table = np.column_stack((tried.values, tried.error))
    return [("evaluations", (*tried.names, f"error_{tried.unit}"), table)]


def evaluations_of(measured: list[Measured], reasons: Sequence[str]) -> Evaluations | None:
    """Inverse of `trials_of`; `reasons` of failures, one per evaluation, are empty for success."""
    if not measured:
        return None
    _, columns, values = measured[0]
    return Evaluations(
        names=columns[:-1],
        values=values[:, :-1],
        error=values[:, -1],
        reasons=tuple(reasons),
        unit=columns[-1].removeprefix("error_"),
    )


def estimates_of(row: Sequence[Mapping[str, Any]] | None) -> tuple[Estimate, ...]:
    """Estimates from the plain values of a JSON column."""
    return tuple(Estimate(**plain) for plain in row or ())


def filtered_of(run: FilterRecord) -> list[Measured]:
    """Series of a filter's trajectory and further estimates."""
    found = paths_of(run.trajectory, None)
    if run.estimate_names:
        found.append(("estimates", run.estimate_names, run.estimates))
    return found


# Columns of experiments that have the value of a field.
_EXPERIMENT: Final = {
    **{name: name for name in ("dataset", "name", "simulated_by", "object_name", "contact_mode")},
    **{"is_real": "real", "object_height_m": "height", "pusher_height_m": "pusher_height"},
    **{"fixel_height_m": "fixel_height", "video_sha256": "video"},
}


def experiment_row(experiment: Experiment) -> dict[str, Any]:
    """Columns of an experiment, except for its geometries and the experiment it replaces."""
    effective = experiment.effective or (None, None)
    own = {name: getattr(experiment, field) for name, field in _EXPERIMENT.items()}
    scene = None if experiment.scene is None else scene_content(experiment.scene)
    row = own | {
        "scene": scene,
        **path_columns(experiment.trajectory),
        "effective_start_s": effective[0],
        "effective_end_s": effective[1],
        "conditions": dict(experiment.conditions),
        "n_import_flag": len(experiment.flags),
    }
    flags = [[flag.name, flag.detail, flag.fault] for flag in experiment.flags]
    row["content_sha256"] = content_digest(row, flags, series_of(experiment))
    return row | provenance_row(experiment.provenance)


# Columns that the checksum of an experiment covers.
_CONTENT: Final = (
    *("dataset", "name", "is_real", "simulated_by", "object_name", "scene", "object_height_m"),
    *("pusher_height_m", "fixel_height_m", "n_frame", "duration_s", "start_x_m", "start_y_m"),
    *("start_theta_rad", "end_x_m", "end_y_m", "end_theta_rad", "effective_start_s"),
    *("effective_end_s", "contact_mode", "conditions", "video_sha256", "n_import_flag"),
)


def content_digest(
    row: Mapping[str, Any], flags: Sequence[Sequence[Any]], measured: Sequence[Measured]
) -> str:
    """Checksum of an experiment's columns, flags of the import and series."""
    content = {name: row[name] for name in _CONTENT}
    names = [[name, list(columns)] for name, columns, _ in measured]
    return digest([content, flags, names], *(values for _, _, values in measured))


def geometries_of(
    content: Any, object_name: str, height: float | None, pusher_height: float | None
) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """Columns of both geometries, from the content of a scene; None where unknown."""
    if content is None:
        return None, None
    body = next(b for b in content["bodies"] if b["name"] == object_name)
    com = body.get("centre_of_mass") or [None, None]
    object_row = _geometry(
        is_object=True,
        shape=body["shape"],
        height_m=height,
        mass_kg=body.get("mass"),
        inertia_kg_m2=body.get("inertia"),
        centre_of_mass_x_m=com[0],
        centre_of_mass_y_m=com[1],
    )
    pushers = content.get("pushers") or []
    if not pushers:
        return object_row, None
    pusher = _geometry(is_object=False, shape=pushers[0]["shape"], height_m=pusher_height)
    return object_row, pusher


def _geometry(**columns: Any) -> dict[str, Any]:
    return columns | {"content_sha256": digest(columns)}


def experiment_of(
    row: sa.Row[Any], flags: tuple[Flag, ...], measured: list[Measured]
) -> Experiment:
    """Build an experiment from its row, flags and series."""
    paths = {name: trajectory_of(values) for name, columns, values in measured if columns == PATH}
    channels = tuple(
        Channel(
            name=name.removeprefix("channel "),
            time=values[:, 0],
            columns=columns[1:],
            values=values[:, 1:],
        )
        for name, columns, values in measured
        if name.startswith("channel ")
    )
    effective = (row.effective_start_s, row.effective_end_s)
    scene = None if row.scene is None else scene_of(SceneRecord.model_validate(row.scene))
    return Experiment(
        **{field: getattr(row, name) for name, field in _EXPERIMENT.items()},
        provenance=provenance_of(row),
        trajectory=paths["object"],
        pusher=paths.get("pusher"),
        scene=scene,
        channels=channels,
        effective=None if effective[0] is None else effective,
        conditions=row.conditions,
        flags=flags,
    )


def parameters_row(parameters: Mapping[str, float]) -> dict[str, Any]:
    """Columns of a set of parameters."""
    values = dict(sorted(parameters.items()))
    row: dict[str, Any] = {name: values.get(name) for name in WITH_COLUMN}
    row["tripod_radius_m"] = values.get("tripod_radius")
    known = (*WITH_COLUMN, "tripod_radius")
    row["others"] = {name: x for name, x in values.items() if name not in known}
    return row | {"content_sha256": digest(values)}


def parameters_of(row: sa.Row[Any]) -> Parameters:
    """Inverse of `parameters_row`."""
    values = {n: getattr(row, n) for n in WITH_COLUMN} | {"tripod_radius": row.tripod_radius_m}
    given = {name: x for name, x in values.items() if x is not None}
    return Parameters(given | dict(row.others))


def bytes_of(values: FloatArray) -> bytes:
    """Return (n, k) numbers as bytes: float64, row by row, little-endian."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def array_of(data: bytes, n_row: int, n_column: int) -> FloatArray:
    """Inverse of `bytes_of`."""
    return np.frombuffer(data, dtype="<f8").reshape(n_row, n_column).astype(np.float64)


def rows_of(
    owner: str, several: Iterable[tuple[str, tuple[str, ...], FloatArray]], media: Path
) -> list[dict[str, Any]]:
    """Rows of `series` without their owner's id; data above `MEDIA_BYTES` are written to files.

    Each series has a name, columns and values (n, n_column).
    """
    found = []
    for place, (name, columns, values) in enumerate(several):
        data = bytes_of(values)
        is_long = len(data) > MEDIA_BYTES
        row = {"owner": owner, "place": place, "name": name, "columns": list(columns)}
        row |= {"n_row": len(values), "data": None if is_long else data}
        found.append(row | {"media_sha256": keep(data, media) if is_long else None})
    return found


def read_all(
    connection: sa.Connection, owner: str, owner_id: int, media: Path
) -> list[tuple[str, tuple[str, ...], FloatArray]]:
    """Name, columns and (n, k) values of all series of a record, in order."""
    return [
        (
            row["name"],
            tuple(row["columns"]),
            array_of(
                fetch(row["media_sha256"], media) if row["data"] is None else row["data"],
                row["n_row"],
                len(row["columns"]),
            ),
        )
        for row in stored_rows(connection, owner, owner_id)
    ]


def stored_rows(connection: sa.Connection, owner: str, owner_id: int) -> list[dict[str, Any]]:
    """Return the rows of a record's series as `rows_of` does; no media file is read."""
    shown = [column for column in series.c if column.name not in ("id", "owner_id")]
    own = (series.c.owner == owner, series.c.owner_id == owner_id)
    wanted = sa.select(*shown).where(*own).order_by(series.c.place)
    return [row._asdict() for row in connection.execute(wanted)]


def keep(data: bytes, media: Path) -> str:
    """Write bytes to the media folder under their SHA-256, unless already there; return it."""
    digest = hashlib.sha256(data).hexdigest()
    path = media_path(digest, media)
    if path.exists():
        return digest
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data, durable=True)
        sync_folder(path.parent)
    except (OSError, InvalidInput) as problem:
        why = problem.found if isinstance(problem, InvalidInput) else os_reason(problem)
        refused = f"{media} cannot be written to: {why}"
        hint = "make the folder writable, or free disk space"
        raise StoreRefused(refused, hint) from None
    return digest


def fetch(digest: str, media: Path) -> bytes:
    """Load the media file of a checksum; raise `StoreRefused` if it is missing or has changed."""
    path = media_path(digest, media)
    try:
        data = path.read_bytes()
    except OSError:
        raise lost(path, "is missing") from None
    if hashlib.sha256(data).hexdigest() != digest:
        raise lost(path, "has changed")
    return data


def lost(path: Path, how: str) -> StoreRefused:
    """Return the error for a media file that `is missing` or `has changed`."""
    return StoreRefused(
        f"the file {path} {how}", hint="restore it from a backup of the media folder"
    )


def media_path(digest: str, media: Path) -> Path:
    """Path of the media file with a checksum; raise `StoreRefused` for what is none."""
    if len(digest) != 64 or set(digest) - set(hexdigits):
        raise lost(media / digest[:2], f"is named {digest[:80]!r}, which is no checksum")
    return media / digest[:2] / digest
