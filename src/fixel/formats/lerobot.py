"""Export of experiments as a LeRobot dataset, version 3.0, without videos.

LeRobot requires one frame rate: trajectories are resampled at even steps, linearly, angles the
short way. A frame's state is the pose of the object and of the pusher; its action is the pusher's
pose one frame later. Simulated episodes are marked in `info.json`, in their row of
`meta/episodes`, and in every frame, by `is_real`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.formats.frames_file import pusher_at
from fixel.model import Experiment

CODEBASE: Final = "v3.0"
DATA: Final = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES: Final = "meta/episodes/chunk-000/file-000.parquet"
CHUNK_FILES: Final = 1000
FILE_MB: Final = 100
FILE_FRAMES: Final = 1_000_000  # about 60 MB, so that no file exceeds FILE_MB
QUANTILES: Final = (1, 10, 50, 90, 99)  # [%]

_STATE = tuple(f"{who}_{x}" for who in ("object", "pusher") for x in ("x_m", "y_m", "theta_rad"))
FEATURES: Final[Mapping[str, tuple[str, tuple[str, ...] | None]]] = {
    "observation.state": ("float32", _STATE),
    "action": ("float32", _STATE[3:]),
    "is_real": ("bool", None),
    "timestamp": ("float32", None),
    "frame_index": ("int64", None),
    "episode_index": ("int64", None),
    "index": ("int64", None),
    "task_index": ("int64", None),
}
Features = Mapping[str, tuple[str, tuple[str, ...] | None]]
Columns = dict[str, NDArray[Any]]
# Frames of an episode, its task, and further columns of its row in `meta/episodes`.
_Episode = tuple[Columns, str, dict[str, Any]]

# Those of the widely used dataset of the Push-T task, with the state of the T instead of pictures.
PUSH_T_FEATURES: Final[Features] = {
    "observation.state": ("float32", ("x", "y")),
    "observation.environment_state": ("float32", tuple(f"{x}{k}" for k in range(8) for x in "xy")),
    "action": ("float32", ("x", "y")),
    "next.reward": ("float32", None),
    "next.done": ("bool", None),
    "next.success": ("bool", None),
    "is_real": ("bool", None),
    **{key: FEATURES[key] for key in ("timestamp", "frame_index", "episode_index", "index")},
    "task_index": FEATURES["task_index"],
}
PUSH_T_FPS: Final = 10
PUSH_T_TASK: Final = "Push the T-shaped block onto the T-shaped target."


@dataclass(slots=True)
class _Dataset:
    """Counts and metadata of the episodes written so far."""

    fps: int
    features: Features = field(default_factory=lambda: FEATURES)
    tasks: dict[str, int] = field(default_factory=dict)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    frames: int = 0
    real: int = 0
    sources: dict[str, int] = field(default_factory=dict)
    total: list[Columns] = field(default_factory=list)


def write_lerobot(
    experiments: Iterable[Experiment],
    folder: Path,
    *,
    fps: int,
    name: str,
    rights: Mapping[str, Any],
) -> int:
    """Write a LeRobot dataset into an empty folder; return the number of frames.

    Its card has the `name`, and the licence and citation of each source dataset in `rights`.
    """
    found = _Dataset(fps)
    _write(found, (_of_experiment(own, fps) for own in experiments), folder)
    (folder / "README.md").write_text(_card(found, name, rights), encoding="utf-8")
    return found.frames


def write_push_t(episodes: Iterable[Columns], folder: Path) -> int:
    """Write Push-T as a LeRobot dataset into an empty folder; return the number of frames.

    Each episode has the arrays of its frames: ``observation.state`` (n, 2) and
    ``observation.environment_state`` (n, 16) before each step, ``action`` (n, 2) [px],
    ``next.reward``, ``next.done`` and ``next.success`` (n,) after it.
    """
    found = _Dataset(PUSH_T_FPS, PUSH_T_FEATURES)
    _write(found, (_of_push_t(own) for own in episodes), folder)
    return found.frames


def _write(found: _Dataset, episodes: Iterable[_Episode], folder: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    writer, number = None, 0
    try:
        for episode in episodes:
            if writer is None or found.frames >= FILE_FRAMES * (number + 1):
                if writer is not None:
                    writer.close()
                    number += 1
                path = folder / DATA.format(**_file(number))
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(path, _schema(pa, found.features))
            writer.write_table(_table(pa, _add(found, episode, number), found.features))
    finally:
        if writer is not None:
            writer.close()
    _write_meta(pa, found, folder)


def _of_experiment(experiment: Experiment, fps: int) -> _Episode:
    about = {
        "is_real": experiment.real,
        "simulated_by": experiment.simulated_by,
        "source_dataset": experiment.dataset,
        "source_name": experiment.name,
        "flags": [flag.name for flag in experiment.flags],
    }
    return frames_of(experiment, fps), f"push {experiment.object_name}", about


def _of_push_t(episode: Columns) -> _Episode:
    steps = np.arange(len(episode["action"]), dtype=np.int64)
    found = {key: np.asarray(episode[key]) for key in PUSH_T_FEATURES if key in episode}
    missing = [key for key in list(PUSH_T_FEATURES)[:6] if key not in found]
    if missing or any(len(values) != len(steps) for values in found.values()):
        raise InvalidInput(
            "episode",
            found=f"no {', '.join(missing)}" if missing else "arrays of different lengths",
            expected="an array for each feature, with a row for each step",
        )
    added = {"is_real": np.zeros(len(steps), bool), "timestamp": steps / PUSH_T_FPS}
    about = {"is_real": False, "simulated_by": "fixel", "source_dataset": "fixel/PushT-v0"}
    return {**found, **added, "frame_index": steps}, PUSH_T_TASK, about


def frames_of(experiment: Experiment, fps: int) -> Columns:
    """Frame features of an episode that do not depend on other episodes."""
    first = experiment.trajectory.time[0]
    n = int(np.floor(experiment.duration * fps + 1e-6)) + 1
    steps = np.arange(n, dtype=np.int64)
    time = np.minimum(first + steps / fps, experiment.trajectory.time[-1])
    pusher = pusher_at(experiment, time)
    later = np.concatenate((pusher[1:], pusher[-1:]))
    return {
        "observation.state": np.column_stack((experiment.trajectory.at(time), pusher)),
        "action": later,
        "is_real": np.full(n, experiment.real),
        "timestamp": steps / fps,
        "frame_index": steps,
    }


def _add(found: _Dataset, given: _Episode, file: int) -> Columns:
    """Add an episode to the metadata; return the columns of its frames."""
    episode, (own, task, about) = len(found.episodes), given
    columns = dict(own)
    n, start = len(columns["timestamp"]), found.frames
    columns["episode_index"] = np.full(n, episode, dtype=np.int64)
    columns["index"] = np.arange(start, start + n, dtype=np.int64)
    columns["task_index"] = np.full(n, found.tasks.setdefault(task, len(found.tasks)))
    columns = {key: columns[key].astype(kind) for key, (kind, _) in found.features.items()}
    where = {f"data/{key}": value for key, value in _file(file).items()}
    found.episodes.append(
        {
            "episode_index": episode,
            "tasks": [task],
            "length": n,
            **where,
            "dataset_from_index": start,
            "dataset_to_index": start + n,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            **about,
            **{
                f"stats/{key}/{what}": value
                for key, statistics in statistics_of(columns).items()
                for what, value in statistics.items()
            },
        }
    )
    source = about["source_dataset"]
    found.frames += n
    found.real += about["is_real"]
    found.sources[source] = found.sources.get(source, 0) + 1
    found.total.append(columns)
    return columns


def statistics_of(columns: Columns) -> dict[str, dict[str, list[float]]]:
    """Statistics of each feature per component, without missing values."""
    return {key: _statistics(values) for key, values in columns.items()}


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    table = values.reshape(len(values), -1).astype(np.float64)
    there = [column[~np.isnan(column)] for column in table.T]
    # A component that was never measured counts as 0: LeRobot computes with these numbers.
    there = [column if len(column) else np.zeros(1) for column in there]
    found: dict[str, list[float]] = {
        "min": [float(column.min()) for column in there],
        "max": [float(column.max()) for column in there],
        "mean": [float(column.mean()) for column in there],
        "std": [float(column.std()) for column in there],
        "count": [len(values)],
    }
    for percent in QUANTILES:
        found[f"q{percent:02d}"] = [float(np.percentile(column, percent)) for column in there]
    return found


def _file(number: int) -> dict[str, int]:
    return {"chunk_index": number // CHUNK_FILES, "file_index": number % CHUNK_FILES}


def _schema(pa: Any, features: Features) -> Any:
    kinds = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
    return pa.schema(
        [
            (key, kinds[kind] if names is None else pa.list_(kinds[kind], len(names)))
            for key, (kind, names) in features.items()
        ]
    )


def _table(pa: Any, columns: Columns, features: Features) -> Any:
    arrays = [
        pa.array(values)
        if values.ndim == 1
        else pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        for values in columns.values()
    ]
    return pa.table(arrays, schema=_schema(pa, features))


def _write_meta(pa: Any, found: _Dataset, folder: Path) -> None:
    import pyarrow.parquet as pq

    path = folder / EPISODES
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.Table.from_pylist(found.episodes), path)
    pq.write_table(_tasks(pa, found), folder / "meta" / "tasks.parquet")
    whole = {key: np.concatenate([c[key] for c in found.total]) for key in found.features}
    _dump(statistics_of(whole), folder / "meta" / "stats.json")
    _dump(_info(found), folder / "meta" / "info.json")


def _tasks(pa: Any, found: _Dataset) -> Any:
    """Table of tasks; LeRobot reads their text as the index of a pandas table."""
    table = pa.table({"task_index": list(found.tasks.values()), "task": list(found.tasks)})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy}
        for name, kind, numpy in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    about = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps(about)})


def _info(found: _Dataset) -> dict[str, Any]:
    n = len(found.episodes)
    return {
        "codebase_version": CODEBASE,
        "robot_type": "planar-pusher",
        "total_episodes": n,
        "total_frames": found.frames,
        "total_tasks": len(found.tasks),
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": 2 * FILE_MB,
        "fps": found.fps,
        "splits": {"train": f"0:{n}"},
        "data_path": DATA,
        "video_path": None,
        "features": {
            key: {
                "dtype": kind,
                "shape": [1 if names is None else len(names)],
                "names": None if names is None else list(names),
            }
            for key, (kind, names) in found.features.items()
        },
        "total_simulated_episodes": n - found.real,
        "total_real_episodes": found.real,
    }


def _card(found: _Dataset, name: str, rights: Mapping[str, Any]) -> str:
    """Text of the README: description, sources, licences and citations."""
    n = len(found.episodes)
    sources = []
    for source, count in sorted(found.sources.items()):
        licence, citation = rights.get(source, ("", ""))
        says = f"licence: {licence or 'not stated; contact the authors of the data'}"
        sources.append(
            f"- `{source}`, episodes: {count}; {says}" + f"; cite: {citation}" * (citation != "")
        )
    listed = "\n".join(sources)
    return f"""\
---
license: other
task_categories:
- robotics
tags:
- LeRobot
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# {name}

{n} episodes of planar pushing, {found.frames} frames at {found.fps} Hz,
**{found.real} measured and {n - found.real} simulated**: each frame has `is_real`.

Exported by fixel in the LeRobot layout, version 3.0. Trajectories are resampled at an
even rate, linearly. State: poses of object and pusher in metres and radians, NaN
where the pusher was not measured; action: the pusher's pose a frame later. Tactile
and force signals, scenes and conditions are in `fixel export PROJECT FILE.zip`.

## Licence and citation

{listed}

fixel itself: The fixel authors, *fixel: planar rigid bodies in frictional contact,
solved as complementarity problems*, Apache-2.0.
"""


def _dump(content: Any, path: Path) -> None:
    path.write_text(json.dumps(content, indent=4, allow_nan=False) + "\n", encoding="utf-8")
