"""Importer of MIT's "more than a million ways to be pushed": the end-point set, and single pushes.

The published data set has one HDF5 file per push, named after its conditions; the few in public
repositories are JSON with the same keys. The end-point set has two poses per push, in one table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.base import (
    LARGEST_NUMBER,
    Importer,
    ImportPlan,
    Origin,
    advancing,
    refuse_giants,
    refuse_repeated,
    remark,
    scene_or_flag,
)
from fixel.datasets.contact import (
    MAX_CORRECTION,
    corrected_path,
    correction_flag,
    moved_to_contact,
)
from fixel.datasets.raw import mit_push
from fixel.datasets.raw.base import MM, read_json
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import (
    Body,
    Channel,
    Disk,
    Experiment,
    Flag,
    PathDrive,
    Polygon,
    Pusher,
    Scene,
    Shape,
    Trajectory,
    UniformPressure,
)
from fixel.typing import FloatArray

DATASET: Final = "mit-push"
OBJECT, PUSHER = "object", "pusher"

# Nominal friction: at the tip as in the published simulator; that of the plane has no effect on
# quasi-static motion.
MU_PUSHER, MU_SUPPORT = 0.25, 0.3

# A larger gap means that a record contradicts its own geometry [m].
LARGEST_GAP = 3e-3

# Surfaces and shapes whose registration is off by 1 to 3 mm in all pushes.
SYSTEMATIC = frozenset(("plywood", shape) for shape in ("ellip2", "ellip3", "hex", "rect2"))
# Surface, shape and speed [m/s] of pushes that no published model explains.
UNEXPLAINED = ("abs", "rect1", 0.02)

RECORDS = ("motion_surface=*.h5", "motion_surface=*.json", "push_*.json", "push_*.h5")

# Duration of the correction of a path that starts inside the object [s].
FADE = 0.05

# Conditions in the name of a published file.
_IN_NAME = re.compile(
    r"motion_surface=(?P<surface>[^_]+)_shape=(?P<shape>[^_]+)_a=(?P<a>[-\d.]+)_v=(?P<v>[-\d.]+)"
    r"(?:_i=(?P<i>[-\d.]+?))?(?:_s=(?P<s>[-\d.]+?))?(?:_t=(?P<t>[-\d.]+?))?$"
)

_KEYS = {"object_pose": 4, "tip_pose": 3, "ft_wrench": 4}  # key -> minimum number of columns


@final
class MitPush(Importer):
    """Importer of straight pushes of steel plates by a round tip."""

    name = DATASET
    title = "MIT push dataset: straight pushes of steel plates (2016)"
    licence = "none stated for the data; the end-point table comes from an Apache-2.0 repository"
    citation = (
        "K.-T. Yu, M. Bauza, N. Fazeli, A. Rodriguez, More than a million ways to be pushed,"
        " IROS 2016"
    )
    options: ClassVar[Mapping[str, str]] = {
        "shapes": "a shapes.json with the outlines, for single pushes"
    }

    def recognised(self, source: Path) -> bool:
        """Whether this is the end-point set, a folder of motion_surface=... files, or one push."""
        if source.is_file():
            return any(source.match(mask) for mask in RECORDS)
        if any(next(source.glob(mask), None) for mask in _masks(RECORDS[:2])):
            return True
        return mit_push.recognised(source)

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        if mit_push.recognised(source):
            return _plan_of_table(source)
        given = options.get("shapes")
        return _plan_of_records(source, None if given is None else Path(str(given)))


# --- the end-point set


@final
@dataclass(frozen=True)
class _Pushes:
    """Table of pushes, with quantities computed for all rows at once."""

    data: mit_push.MitPushes
    names: NDArray[np.str_]
    surface: NDArray[np.str_]
    shape: NDArray[np.str_]
    gap: FloatArray  # (n,) at the start, computed by fixel [m]
    offset: FloatArray  # (n, 2) shift of the start of the tip in the scene [m]
    bodies: Mapping[str, Body]


def _plan_of_table(folder: Path) -> ImportPlan:
    data = mit_push.read(folder)
    pushes = _pushes(data)
    origin = Origin()
    path = folder / data.table.source
    corrected = int((pushes.gap < 0.0).sum())
    hopeless = int((pushes.gap < -MAX_CORRECTION).sum())
    return ImportPlan(
        DATASET,
        folder,
        (
            f"{len(data)} pushes in {data.table.source}, each with the pose of object and tip at"
            " the start (t = 0) and at the end (0.05 m by the nominal speed).",
            "Poses in m and rad as they stand, in the frame of the robot; speed and gaps from mm.",
            f"Scenes: plates of known mass with even pressure, a round tip of"
            f" {mit_push.PUSHER_RADIUS / MM:g} mm on its measured line, nominal friction"
            f" {MU_PUSHER:g} at the tip and {MU_SUPPORT:g} on the plane.",
            f"{corrected} pushes start with the tip inside the object by their measurement:"
            f" {corrected - hopeless} tips are moved to contact in the scene"
            f" (pusher-moved-to-contact), {hopeless} by more than"
            f" {MAX_CORRECTION / MM:g} mm have no scene (no-scene).",
            f"{int(_misregistered(data).sum())} pushes do not fit their own geometry"
            " (misregistered).",
            "Poses on the way and the predictions of the published simulator are left out.",
        ),
        len(data),
        lambda: (_push(pushes, row, origin.of(path)) for row in range(len(data))),
    )


def _pushes(data: mit_push.MitPushes) -> _Pushes:
    refuse_giants(data.table, *(f"{thing}{end}" for thing in _MEASURED for end in "01"))
    names, shape = data.table.text("push_id"), data.shape
    refuse_repeated(names.tolist(), data.table.source, "push_id")
    gap, offset = np.zeros(len(data)), np.zeros((len(data), 2))
    for name in np.unique(shape).tolist():
        rows = np.flatnonzero(shape == name)
        gap[rows], offset[rows] = moved_to_contact(
            data.shapes[name], mit_push.PUSHER_RADIUS, data.start[rows], data.tip_start[rows]
        )
    bodies = {name: _body(name, data.shapes[name]) for name in np.unique(shape).tolist()}
    return _Pushes(data, names, data.surface, shape, gap, offset, bodies)


_MEASURED = ("obj_x", "obj_y", "obj_th", "tip_x", "tip_y")


def _misregistered(data: mit_push.MitPushes) -> NDArray[np.bool_]:
    return (np.abs(data.gap_start) > LARGEST_GAP) | (data.gap_end < -LARGEST_GAP)


def _body(name: str, shape: Shape) -> Body:
    return Body(
        name=OBJECT,
        shape=shape,
        mass=mit_push.mass_of(name, shape),
        pose=np.zeros(3),
        support=UniformPressure(friction=MU_SUPPORT),
    )


def _push(pushes: _Pushes, row: int, provenance: Any) -> Experiment:
    data = pushes.data
    duration = mit_push.STROKE / float(data.speed[row])
    time = np.array([0.0, duration])
    tip = np.column_stack((time, (data.tip_start[row], data.tip_end[row]), np.zeros(2)))
    scene, flags = _scene(
        pushes.bodies[str(pushes.shape[row])],
        data.start[row],
        corrected_path(tip, pushes.offset[row]),
        float(pushes.gap[row]),
    )
    return Experiment(
        dataset=DATASET,
        name=str(pushes.names[row]),
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=Trajectory(time=time, pose=np.stack((data.start[row], data.end[row]))),
        pusher=Trajectory(time=time, pose=tip[:, 1:]),
        scene=scene,
        effective=(0.0, duration),
        conditions={
            "surface": str(pushes.surface[row]),
            "shape": str(pushes.shape[row]),
            "speed_m_s": float(data.speed[row]),
            "gap0_m": float(data.gap_start[row]),
            "gap1_m": float(data.gap_end[row]),
        },
        flags=(*flags, *_doubts(pushes, row)),
    )


def _doubts(pushes: _Pushes, row: int) -> Iterator[Flag]:
    data = pushes.data
    surface, shape = str(pushes.surface[row]), str(pushes.shape[row])
    start, end = float(data.gap_start[row]), float(data.gap_end[row])
    if abs(start) > LARGEST_GAP or end < -LARGEST_GAP:
        yield Flag(
            "misregistered",
            f"tip {start / MM:.3g} mm from the outline at the start, {end / MM:.3g} mm at the end",
        )
    yield from _known_doubts(surface, shape, float(data.speed[row]))


def _known_doubts(surface: str, shape: str, speed: float) -> Iterator[Flag]:
    if (surface, shape) in SYSTEMATIC:
        yield remark("systematic-offset", f"{shape} on {surface} is registered 1 to 3 mm off")
    if (surface, shape) == UNEXPLAINED[:2] and abs(speed - UNEXPLAINED[2]) < 1e-6:
        yield remark("unexplained-error", "published models miss these by twice the usual error")


def _scene(
    body: Body, start: FloatArray, path: FloatArray, gap: float
) -> tuple[Scene | None, tuple[Flag, ...]]:
    """Build a scene with a round tip on a corrected path; if impossible, a flag has the reason."""
    if gap < -MAX_CORRECTION:
        return None, (remark("no-scene", f"the tip starts {-gap / MM:.3g} mm inside the object"),)

    def build() -> Scene:
        return Scene(
            bodies=(replace(body, pose=start),),
            pushers=(
                Pusher(
                    name=PUSHER,
                    shape=_TIP,
                    pose=path[0, 1:],
                    drive=PathDrive(waypoints=path),
                    friction=MU_PUSHER,
                ),
            ),
            duration=float(path[-1, 0]),
        )

    scene, flags = scene_or_flag(build)
    return scene, (*flags, correction_flag(gap)) if scene and gap < 0.0 else flags


_TIP = Disk(mit_push.PUSHER_RADIUS)


# --- single pushes


class _PushRecord(NamedTuple):
    """Content of the file of one push; times are on its own clock."""

    conditions: dict[str, str | float]
    object_pose: FloatArray  # (n, 4) [s, m, m, rad]
    tip_pose: FloatArray  # (n, 3 or 4) [s, m, m, rad]
    ft_wrench: FloatArray  # (n, 4) [s, N, N, N m]


def _plan_of_records(source: Path, shapes_file: Path | None) -> ImportPlan:
    files = _record_files(source)
    if not files:
        raise DatasetMissing(
            source, "pushes.csv.gz and shapes.json, or files " + " or ".join(RECORDS)
        )
    if any(path.suffix == ".h5" for path in files):
        _h5py(files[0])
    refuse_repeated((_stem(path) for path in files), source.name, "file name")
    shapes = _shapes_near(files[0], shapes_file)
    origin = Origin()
    known = "outlines from shapes.json" if shapes else "no shapes.json found: no scenes (no-shape)"
    return ImportPlan(
        DATASET,
        source,
        (
            f"Files of one push each: {len(files)}; object_pose, tip_pose and ft_wrench, about"
            " 250 Hz each on times of its own.",
            "Times are re-based to the first pose of the object; m, rad, N and N m as they stand,"
            " forces in the axes they were logged in.",
            f"Scenes: {known}; nominal friction {MU_PUSHER:g} at the tip, {MU_SUPPORT:g} on the"
            " plane.",
            "Rows whose time does not advance are dropped, with a flag (repeated-times).",
        ),
        len(files),
        lambda: (_experiment_of(path, shapes, origin) for path in files),
    )


def _record_files(source: Path) -> list[Path]:
    if source.is_file():
        return [source] if source.suffix in (".h5", ".json") else []
    return sorted({path for mask in _masks(RECORDS) for path in source.glob(mask)})


def _masks(names: tuple[str, ...]) -> list[str]:
    """Glob masks for a folder and two levels below: surface and shape in the published data set."""
    return [f"{folder}{name}" for folder in ("", "*/", "*/*/") for name in names]


def _stem(path: Path) -> str:
    return path.name.removesuffix(path.suffix)


def _shapes_near(path: Path, given: Path | None) -> dict[str, Shape]:
    """Load outlines from a given file, or from a shapes.json in the folder or up to three above."""
    if given is not None and not given.is_file():
        raise DatasetMissing(given, "a file with outlines")
    near = [folder / mit_push.SHAPES for folder in path.resolve().parents[:4]]
    found = given or next((file for file in near if file.is_file()), None)
    if found is None:
        return {}
    content = read_json(found)
    shapes = mit_push.shapes_of({k: v for k, v in content.items() if isinstance(v, dict)})
    for name, corners in content.items():
        if isinstance(corners, list):
            shapes[name] = Polygon(np.array(corners, dtype=np.float64))
    return shapes


def _experiment_of(path: Path, shapes: dict[str, Shape], origin: Origin) -> Experiment:
    record = _hdf5(path) if path.suffix == ".h5" else _json(path)
    (pose, tip, wrench), flags = _on_one_clock(record)
    body_flags: tuple[Flag, ...]
    scene, body_flags = _record_scene(record, pose, tip, shapes)
    surface, shape = str(record.conditions["surface"]), str(record.conditions["shape"])
    speed = float(record.conditions.get("speed_m_s", 0.0))
    return Experiment(
        dataset=DATASET,
        name=_stem(path),
        real=True,
        provenance=origin.of(path),
        object_name=OBJECT,
        trajectory=Trajectory(time=pose[:, 0], pose=pose[:, 1:]),
        pusher=Trajectory(time=tip[:, 0], pose=tip[:, 1:]),
        scene=scene,
        channels=(
            Channel(
                name="force",
                time=wrench[:, 0],
                columns=("fx_n", "fy_n", "torque_nm"),
                values=wrench[:, 1:],
            ),
        ),
        conditions=record.conditions,
        flags=(*flags, *body_flags, *_known_doubts(surface, shape, speed)),
    )


def _on_one_clock(record: _PushRecord) -> tuple[list[FloatArray], list[Flag]]:
    """Tables of object, tip and wrench, with times counted from the first pose of the object."""
    tip = record.tip_pose
    if tip.shape[1] == 3:
        tip = np.column_stack((tip, np.zeros(len(tip))))
    begin, tables, flags = record.object_pose[0, 0], [], []
    for rows in (record.object_pose, tip, record.ft_wrench):
        good = advancing(rows[:, 0])
        kept = rows[good]
        kept[:, 0] -= begin
        tables.append(kept)
        if not good.all():
            flags.append(remark("repeated-times", f"{int((~good).sum())} rows dropped"))
    for rows in tables[:2]:
        rows[:, 3] = np.unwrap(rows[:, 3])
    return tables, flags


def _record_scene(
    record: _PushRecord, pose: FloatArray, tip: FloatArray, shapes: dict[str, Shape]
) -> tuple[Scene | None, tuple[Flag, ...]]:
    name = str(record.conditions["shape"])
    if name not in shapes:
        return None, (remark("no-shape", f"no outline of {name}"),)
    path = np.column_stack((tip[:, :3], np.zeros(len(tip))))
    path = path[path[:, 0] >= 0.0]
    if not len(path) or path[-1, 0] <= 0.0:
        return None, (remark("no-scene", "the tip was not seen after the object"),)
    gap, offset = moved_to_contact(
        shapes[name], mit_push.PUSHER_RADIUS, pose[:1, 1:], path[:1, 1:3]
    )
    return _scene(
        _body(name, shapes[name]),
        pose[0, 1:],
        corrected_path(path, offset[0], FADE),
        float(gap[0]),
    )


def _json(path: Path) -> _PushRecord:
    content = read_json(path)
    return _record(path, {key: content.get(key) for key in _KEYS}, content)


def _hdf5(path: Path) -> _PushRecord:
    h5py = _h5py(path)
    try:
        with h5py.File(path, "r") as file:
            return _record(path, {key: _dataset(h5py, file, key) for key in _KEYS}, {})
    except OSError as problem:
        raise InvalidInput(path.name, found=str(problem), expected="an HDF5 file") from None


def _dataset(h5py: Any, file: Any, key: str) -> Any:
    """Load a small numeric table; None for anything else, such as a link to another file."""
    if not isinstance(file.get(key, getlink=True), h5py.HardLink):
        return None
    table = file[key]
    small = isinstance(table, h5py.Dataset) and table.nbytes <= MOST_BYTES
    return table[()] if small and table.dtype.kind in "iuf" else None


MOST_BYTES = 50_000_000  # maximum size of one table of a push, which lasts seconds


def _h5py(path: Path) -> Any:
    try:
        import h5py  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise InvalidInput(
            path.name,
            found="an HDF5 file, and no h5py to read it with",
            expected="h5py to be installed",
            hint="pip install h5py, or convert the file to JSON with the same keys",
        ) from None
    return h5py


def _record(path: Path, tables: Mapping[str, Any], about: Mapping[str, Any]) -> _PushRecord:
    rows = {key: _rows(path, key, tables[key]) for key in _KEYS}
    return _PushRecord(_conditions(path, about), **rows)


def _rows(path: Path, key: str, given: Any) -> FloatArray:
    try:
        rows = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        rows = np.zeros(0)
    width = _KEYS[key]
    if rows.ndim != 2 or not len(rows) or not width <= rows.shape[1] <= 4:
        raise InvalidInput(
            f"{path.name}: {key}",
            found="nothing" if given is None else f"shape {rows.shape}",
            expected=f"rows of {width} numbers, time first",
        )
    if not np.isfinite(rows).all() or np.abs(rows).max() > LARGEST_NUMBER:
        raise InvalidInput(f"{path.name}: {key}", found="wild numbers", expected="finite readings")
    return rows


def _conditions(path: Path, about: Mapping[str, Any]) -> dict[str, str | float]:
    """Conditions of a push from its file, or else from the file name."""
    match = _IN_NAME.match(_stem(path))
    named = {key: value for key, value in (match.groupdict() if match else {}).items() if value}
    surface, shape = about.get("surface", named.get("surface")), about.get("shape")
    shape = shape or named.get("shape")
    if not isinstance(surface, str) or not isinstance(shape, str):
        raise InvalidInput(
            path.name,
            found="no surface and shape",
            expected="both in the file, or in its name: motion_surface=..._shape=..._a=..._v=...",
        )
    conditions: dict[str, str | float] = {"surface": surface, "shape": shape}
    for target, key, short, scale in _NUMBERS:
        value = about.get(key, named.get(short))
        # A negative speed marks an accelerated push.
        if value is None or (short == "v" and float(value) < 0.0):
            continue
        if not math.isfinite(float(value)):
            raise InvalidInput(f"{path.name}: {key}", found=value, expected="a finite number")
        conditions[target] = float(value) * scale
    return conditions


_NUMBERS = (
    ("speed_m_s", "speed_mm_s", "v", MM),
    ("acceleration_m_s2", "acceleration", "a", 1.0),
    ("edge", "edge_index_i", "i", 1.0),
    ("edge_position", "edge_param_s", "s", 1.0),
    ("push_angle_rad", "push_angle_t_rad", "t", 1.0),
)
