"""Experiments as two Parquet tables: one row per experiment, and one row per measured pose.

Column names end with their unit. The pusher has its own clock: `frames` has its poses interpolated
linearly at the times of the object, and no value where it was not measured.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.io.atomic import refuse_unwritable, unfinished_path, usable
from fixel.model import Experiment
from fixel.model.trajectory import path_columns
from fixel.typing import FloatArray

EXPERIMENTS: Final = "experiments.parquet"
FRAMES: Final = "frames.parquet"
BATCH: Final = 100_000  # [frames] per row group

_POSE = ("x_m", "y_m", "theta_rad")
_COLUMNS: Final = (
    *("experiment_index", "dataset", "name", "is_real", "simulated_by", "is_flagged", "flags"),
    *("object_name", "n_frame", "duration_s", *(f"start_{p}" for p in _POSE)),
    *(*(f"end_{p}" for p in _POSE), "effective_start_s", "effective_end_s", "contact_mode"),
    *("object_height_m", "conditions_json", "fixel_version", "source_file", "created_at_utc"),
)


def write_frames(experiments: Iterable[Experiment], folder: Path) -> int:
    """Write both tables into a folder; return the number of frames."""
    # Imported here since the first import of pyarrow takes a second.
    import pyarrow as pa
    import pyarrow.parquet as pq

    lines: list[dict[str, Any]] = []
    waiting: list[Any] = []
    total = n_waiting = 0
    schema = _frames_schema(pa)
    with pq.ParquetWriter(folder / FRAMES, schema) as writer:
        for number, experiment in enumerate(experiments):
            lines.append({"experiment_index": number, **experiment_columns(experiment)})
            waiting.append(pa.table(frame_columns(number, experiment), schema=schema))
            n_waiting += waiting[-1].num_rows
            total += waiting[-1].num_rows
            if n_waiting >= BATCH:
                writer.write_table(pa.concat_tables(waiting).combine_chunks())
                waiting, n_waiting = [], 0
        if waiting:
            writer.write_table(pa.concat_tables(waiting).combine_chunks())
    pq.write_table(
        pa.Table.from_pylist(lines, schema=_experiments_schema(pa)), folder / EXPERIMENTS
    )
    return total


def experiment_columns(experiment: Experiment) -> dict[str, Any]:
    """Row of the table of experiments, without `experiment_index`."""
    effective = experiment.effective or (None, None)
    return {
        "dataset": experiment.dataset,
        "name": experiment.name,
        "is_real": experiment.real,
        "simulated_by": experiment.simulated_by,
        "is_flagged": any(flag.fault for flag in experiment.flags),
        "flags": [f"{flag.name}: {flag.detail}".rstrip(": ") for flag in experiment.flags],
        "object_name": experiment.object_name,
        **path_columns(experiment.trajectory),
        "effective_start_s": effective[0],
        "effective_end_s": effective[1],
        "contact_mode": experiment.contact_mode,
        "object_height_m": experiment.height,
        "conditions_json": json.dumps(dict(experiment.conditions)),
        "fixel_version": experiment.provenance.version,
        "source_file": experiment.provenance.source,
        "created_at_utc": experiment.provenance.created,
    }


def frame_columns(number: int, experiment: Experiment) -> dict[str, Any]:
    """Columns of the table of frames: one row per measured pose of the object."""
    time = experiment.trajectory.time
    n = len(time)
    pusher = pusher_at(experiment, time)
    columns: dict[str, Any] = {
        "experiment_index": np.full(n, number, dtype=np.int64),
        "dataset": [experiment.dataset] * n,
        "name": [experiment.name] * n,
        "is_real": np.full(n, experiment.real),
        "frame_index": np.arange(n, dtype=np.int64),
        "time_s": time,
    }
    for k, label in enumerate(_POSE):
        columns[label] = experiment.trajectory.pose[:, k]
    for k, label in enumerate(_POSE):
        columns[f"pusher_{label}"] = [None if math.isnan(x) else x for x in pusher[:, k].tolist()]
    return columns


def pusher_at(experiment: Experiment, time: FloatArray) -> FloatArray:
    """Poses (n, 3) of the pusher at given times, NaN where it was not measured."""
    pusher = experiment.pusher
    if pusher is None:
        return np.full((len(time), 3), np.nan)
    inside = (time >= pusher.time[0]) & (time <= pusher.time[-1])
    return np.where(inside[:, None], pusher.at(time), np.nan)


@contextmanager
def folder_whole(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder that replaces `folder`, which must be new or empty, on success."""
    refuse_folder(folder)
    unfinished = unfinished_path(folder)
    try:
        with usable(folder, "a folder to write to"):
            unfinished.mkdir()
            yield unfinished
            if folder.exists():
                folder.rmdir()
            os.replace(unfinished, folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def refuse_folder(folder: Path) -> None:
    """Raise `InvalidInput` for a folder that is not empty or cannot be created."""
    if folder.exists():
        if not folder.is_dir() or any(folder.iterdir()):
            raise InvalidInput(
                str(folder), found="an existing file or folder", expected="a new or empty folder"
            )
    else:
        refuse_unwritable(folder)


def _frames_schema(pa: Any) -> Any:
    text = pa.dictionary(pa.int32(), pa.string())
    places = [("experiment_index", pa.int64()), ("dataset", text), ("name", text)]
    numbers = [(name, pa.float64()) for name in ("time_s", *_POSE, *(f"pusher_{p}" for p in _POSE))]
    return pa.schema([*places, ("is_real", pa.bool_()), ("frame_index", pa.int64()), *numbers])


def _experiments_schema(pa: Any) -> Any:
    text, number, count, yes = pa.string(), pa.float64(), pa.int64(), pa.bool_()
    kinds = {"experiment_index": count, "n_frame": count, "flags": pa.list_(text)}
    kinds |= dict.fromkeys(("is_real", "is_flagged"), yes)
    return pa.schema(
        [(name, kinds.get(name, number if name.endswith(("_s", "_m", "_rad")) else text))
         for name in _COLUMNS]
    )  # fmt: skip
