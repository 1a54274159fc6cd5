"""Full-rate pushes of MIT's MCube laboratory, with the motion of object and pusher.

Sources: F. Hogan, A. Rodriguez (2016), Feedback control of the pusher-slider system, WAFR
(`cpush_*.csv.gz`); one raw record of the MIT push dataset (`push_*.json`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, final

import numpy as np

from fixel.datasets.raw.base import MM, increasing, member, read_json, read_table
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import Polygon, Trajectory
from fixel.typing import BoolArray, FloatArray

SHAPES = "shapes.json"
RUNS = "cpush_*.csv*"
RECORDS = "push_*.json"

# A reading repeated for longer than this is retained, since the pusher then stands still. The
# sensors refresh every 4 to 7 ms [s].
STANDSTILL = 0.02


@final
@dataclass(frozen=True, slots=True)
class PushRun:
    """Recorded run of a pusher and an object.

    Attributes
    ----------
    name : str
        Name of the file, without its ending.
    surface, shape_name : str
        Names in the file; in the cpush runs `rect1`, and plywood or an unknown surface.
    shape : Polygon
    pusher_radius : float
        Radius of the round pusher [m].
    object : Trajectory
        Measured poses of the object, one per new reading.
    pusher : (n, 3) float64
        Time [s] and measured centre of the tip [m, m], one row per new reading.
    readings : int
        Number of rows in the file, including repeated ones.
    commanded_speed : float or None
        Commanded speed of the tip, if it is in the file [m/s].
    """

    name: str
    surface: str
    shape_name: str
    shape: Polygon
    pusher_radius: float
    object: Trajectory
    pusher: FloatArray
    readings: int
    commanded_speed: float | None = None


@final
@dataclass(frozen=True, slots=True)
class PushRuns:
    """All runs of a folder."""

    name: ClassVar[str] = "mit_timeseries"
    folder: Path
    runs: tuple[PushRun, ...]


def recognised(folder: Path) -> bool:
    """Whether a folder contains this dataset."""
    return (folder / SHAPES).is_file() and any(
        next(folder.glob(pattern), None) for pattern in (RUNS, RECORDS)
    )


def read(folder: Path) -> PushRuns:
    """Load all runs of a folder."""
    if not (folder / SHAPES).is_file():
        raise DatasetMissing(folder, SHAPES)
    shapes = read_json(folder / SHAPES)
    radius = member(shapes, "pusher_radius_m", SHAPES)
    outlines = {name: value for name, value in shapes.items() if isinstance(value, list)}
    tables = [_from_table(path, outlines, radius) for path in sorted(folder.glob(RUNS))]
    records = [_from_record(path, outlines, radius) for path in sorted(folder.glob(RECORDS))]
    if not tables and not records:
        raise DatasetMissing(folder, f"{RUNS} or {RECORDS}")
    return PushRuns(folder, (*tables, *records))


def _from_table(path: Path, outlines: dict[str, list[object]], radius: float) -> PushRun:
    rows = read_table(path)
    time = increasing(rows.numbers("t"), rows.source)
    pose = rows.stacked("slider_x", "slider_y", "slider_th")
    tip = rows.stacked("pusher_x", "pusher_y")
    seen, moved = _new_readings(time, pose), _new_readings(time, tip)
    return PushRun(
        name=path.name.split(".")[0],
        surface="plywood" if "plywood" in path.name.lower() else "unknown",
        shape_name="rect1",
        shape=_outline(outlines, "rect1"),
        pusher_radius=radius,
        object=Trajectory(time=time[seen], pose=pose[seen]),
        pusher=np.column_stack((time, tip))[moved],
        readings=len(time),
    )


def _from_record(path: Path, outlines: dict[str, list[object]], radius: float) -> PushRun:
    record = read_json(path)
    pose = _rows(record, "object_pose", path.name)
    tip = _rows(record, "tip_pose", path.name)
    shape_name = member(record, "shape", path.name)
    return PushRun(
        name=path.name.split(".")[0],
        surface=str(member(record, "surface", path.name)),
        shape_name=str(shape_name),
        shape=_outline(outlines, shape_name),
        pusher_radius=radius,
        object=Trajectory(time=increasing(pose[:, 0], path.name), pose=pose[:, 1:]),
        pusher=tip[:, :3],
        readings=len(tip),
        commanded_speed=float(member(record, "speed_mm_s", path.name)) * MM,
    )


def _new_readings(time: FloatArray, values: FloatArray) -> BoolArray:
    """Mask of rows with a new reading: a changed value, or the last row of a standstill.

    Rows after the last change are not new: in every cpush run the tracker stops a tenth of a second
    before the pusher does.
    """
    changed = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
    row = np.flatnonzero(changed)
    # The last row of a standstill, just before a change, is new information too.
    changed[row[1:][np.diff(time[row]) > STANDSTILL] - 1] = True
    return changed


def _outline(outlines: dict[str, list[object]], name: str) -> Polygon:
    if name not in outlines:
        raise InvalidInput(SHAPES, found=", ".join(outlines), expected=f"an outline of {name}")
    return Polygon(np.asarray(outlines[name], dtype=np.float64))


def _rows(record: dict[str, object], name: str, source: str) -> FloatArray:
    try:
        rows = np.asarray(member(record, name, source), dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.zeros(0)
    if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise InvalidInput(f"{source}: {name}", found=f"shape {rows.shape}", expected="(n, 4) rows")
    increasing(rows[:, 0], f"{source}: {name}")
    return rows
