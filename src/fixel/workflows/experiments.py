"""Reading of experiments from files, folders and tables in memory."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fixel.database.bundle import import_bundle
from fixel.database.project import DATABASE, MEDIA, stored_experiments
from fixel.database.store import Store
from fixel.datasets import Experiments, plan_import
from fixel.datasets.reading import collected
from fixel.errors import InvalidInput
from fixel.formats.recording import is_recording
from fixel.formats.scene_file import SceneFile
from fixel.io.atomic import refuse_device
from fixel.model.fields import whole
from fixel.model.scene import SceneChoice
from fixel.model.selection import ExperimentQuery
from fixel.progress import ProgressOption
from fixel.workflows.acquisition.track import track_film

PathLike = str | os.PathLike[str]


def read_experiments(
    source: PathLike | Iterable[PathLike] | Any,
    *,
    scene: SceneChoice | SceneFile | PathLike | None = None,
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    split_by: str | None = None,
    object_name: str | None = None,
    simulated_by: str = "",
    limit: int | None = None,
    progress: ProgressOption = None,
) -> Experiments:
    """Read experiments from your own table, a public dataset, a recording or an export.

    Parameters
    ----------
    source : path, sequence of paths, or table
        CSV or Parquet table, or table of pandas, polars or Arrow, with columns such as `time_s`,
        `x_mm`, `y_mm`, `theta_deg`, `pusher_x_mm`, `pusher_y_mm`; MCAP file, ROS 2 bag or AprilTag
        log (`.jsonl`); folder of a public dataset; folder of a recording with its `rig.yaml` and
        `scene.yaml`, which is tracked; or `.zip` that `fixel export` wrote. Times may be those of a
        clock, such as 2026-11-30T09:00:00.25Z. Several paths are read one after the other.
    scene : Scene, SceneFile, path or callable, optional
        Scene of a table, without which its experiments can be drawn but not simulated. It may be a
        template whose pusher has no drive: start poses, path and duration come from the table. A
        function gets the conditions and the `name` of each experiment.
    format : str, optional
        Format of the source, such as `csv`, `mit-push` or `rpi-2dgad`; by default recognised.
    columns : mapping of str to str, optional
        Titles of columns whose role is not clear: `{"theta": "yaw", "pusher_x": "robot x"}`. For a
        bag, topics or frames by role: `{"part": "/part/pose", "pusher": "tip", "reference":
        "table"}`.
    units : mapping of str to str, optional
        Units of columns without a unit: `{"time": "ms", "length": "mm", "angle": "deg"}`. The unit
        of angles replaces that in the header; other units must agree with the header.
    split_by : str, optional
        Column whose values separate the experiments of a table; of a bag, topic of their names, or
        seconds without poses between them, by default 1.
    object_name : str, optional
        Body of the scene whose motion was measured; by default its only body.
    simulated_by : str
        Simulator that wrote a table or bag; empty for measured experiments.
    limit : int, optional
        Maximum number of experiments.
    progress : bool or callable, optional
        None: a bar in terminals and notebooks; False: nothing; or a function that is called.

    Returns
    -------
    Experiments
        With `notes` on how the source was read. Experiments that cannot be read are left out;
        `skipped` has their names and reasons.

    Raises
    ------
    InvalidInput
        A table without times, positions or a known column; poses that do not fit the scene; lengths
        or angles whose unit in the header cannot be right; no experiment that can be read.
    DatasetMissing
        The source does not exist or is not recognised.

    Examples
    --------
    >>> import fixel
    >>> table = {
    ...     "push": ["a", "a", "b", "b"],
    ...     "time_s": [0.0, 1.0, 0.0, 1.0],
    ...     "x_mm": [0.0, 8.0, 0.0, 9.0],
    ...     "y_mm": [0.0, 0.0, 0.0, 0.0],
    ...     "theta_deg": [0.0, 5.0, 0.0, -4.0],
    ...     "pusher_x_mm": [-55.0, -46.0, -55.0, -46.0],
    ...     "pusher_y_mm": [10.0, 10.0, -10.0, -10.0],
    ... }
    >>> part = fixel.Body("part", fixel.Polygon.rectangle(0.1, 0.1), mass=0.5,
    ...                   support=fixel.Tripod(radius=0.03, friction=0.25))
    >>> tip = fixel.Pusher("tip", fixel.Disk(0.005), friction=0.3)
    >>> fixel.read_experiments(table, split_by="push", scene=fixel.Scene(part, tip))
    Experiments: 2 of dataset 'table' (real), 2 with scene
      name     frames  duration [s]  moved [mm]  turned [deg]
      table/a       2          1.00         8.0           5.0
      table/b       2          1.00         9.0          -4.0
    """
    choice: Any = Path(scene) if isinstance(scene, str | os.PathLike) else scene
    sources = [*source] if isinstance(source, list | tuple) else [source]
    places = [Path(s) if isinstance(s, str | os.PathLike) else s for s in sources]
    if limit is not None:
        whole(limit, "limit")
    named = {"object_name": object_name, "simulated_by": simulated_by}
    options = {name: value for name, value in named.items() if value}
    own: Any = {"columns": columns, "units": units, "split_by": split_by, "progress": progress}
    plans, found = [], []
    for place in places:
        ready = None if format is not None else _ready(place, choice)
        if ready is not None:
            found.append(ready)
            continue
        plans.append(plan_import(place, format, scene=choice, options=options, **own))
    read = collected(plans, limit, progress)
    every = [one for some in (*found, read) for one in some][:limit]
    equal = [
        f"Equal names: {n} experiments are {key}; rename their files before a calibration."
        for key, n in Counter(own.key for own in every).items()
        if n > 1
    ]
    return Experiments.of(every, (*read.notes, *equal), read.skipped, read.simulations)


def _ready(place: Any, scene: SceneChoice | None) -> Experiments | None:
    """Experiments of a recording or a bundle; None for another source."""
    if not isinstance(place, Path):
        return None
    refuse_device(place, "a file or a folder")
    if is_recording(place):
        if scene is not None and not isinstance(scene, Path):
            found = "a function" if callable(scene) else "a Scene"
            raise InvalidInput("scene", found=found, expected="a scene file, for a recording")
        return Experiments.of(track_film(place, scene=scene).experiment)
    if place.suffix.lower() == ".zip" and place.is_file():
        with (  # through a database that is removed again
            TemporaryDirectory(prefix="fixel-bundle-") as folder,
            Store(f"sqlite:///{Path(folder) / DATABASE}", Path(folder) / MEDIA) as store,
        ):
            store.upgrade()
            import_bundle(place, store)
            return stored_experiments(store, ExperimentQuery(include_faulty=True)).in_memory()
    return None
