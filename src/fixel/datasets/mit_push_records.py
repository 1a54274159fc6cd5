"""Single pushes of MIT's "more than a million ways to be pushed", one file each.

The published data set has one HDF5 file per push, named after its conditions; the few in public
repositories are JSON with the same keys.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel import model
from fixel.datasets.base import ImportPlan, collected, origin_of, remark, trajectory_of
from fixel.datasets.contact import pushed_scene
from fixel.datasets.files import LARGEST_NUMBER, MM, Problems, advancing, member, read_json
from fixel.errors import DatasetMissing, InvalidInput, require
from fixel.io.atomic import usable
from fixel.typing import FloatArray

RECORDS = ("motion_surface=*.h5", "motion_surface=*.json", "push_*.json", "push_*.h5")
# Glob masks of published files in a folder and two levels below: surface and shape.
PUBLISHED = tuple(f"{folder}{name}" for folder in ("", "*/", "*/*/") for name in RECORDS[:2])

# Duration of the correction of a path that starts inside the object [s].
FADE = 0.05

MAX_BYTES = 50_000_000  # maximum size of one table of a push, which lasts seconds

# Conditions in the name of a published file.
_IN_NAME = re.compile(
    r"motion_surface=(?P<surface>[^_]+)_shape=(?P<shape>[^_]+)_a=(?P<a>[-\d.]+)_v=(?P<v>[-\d.]+)"
    r"(?:_i=(?P<i>[-\d.]+?))?(?:_s=(?P<s>[-\d.]+?))?(?:_t=(?P<t>[-\d.]+?))?$"
)
# Condition, its name in a file and in a file name, and its unit.
_NUMBERS = (
    ("speed_m_s", "speed_mm_s", "v", MM),
    ("acceleration_m_s2", "acceleration", "a", 1.0),
    ("edge", "edge_index_i", "i", 1.0),
    ("edge_position", "edge_param_s", "s", 1.0),
    ("push_angle_rad", "push_angle_t_rad", "t", 1.0),
)

# Tables of a file, time first, and their minimum numbers of columns: poses of object and tip
# [s, m, m, rad], force and torque [s, N, N, N m].
_KEYS = {"object_pose": 4, "tip_pose": 3, "ft_wrench": 4}


def plan_of_records(source: Path, shapes_file: Path | None) -> ImportPlan:
    """Plan the import of files of one push each: a file, or all in a folder."""
    files = _record_files(source)
    if not files:
        raise DatasetMissing(
            source, "pushes.csv.gz and shapes.json, or files " + " or ".join(RECORDS)
        )
    problems: Problems = {}
    stems = Counter(path.stem for path in files)
    for stem, n in stems.items():
        if n > 1:
            found, expected = f"{n} files of this name", "each name once"
            problems[f"{DATASET}/{stem}"] = InvalidInput(stem, found=found, expected=expected)
    shapes, damaged = _shapes_near(files[0], shapes_file)
    files = [path for path in files if stems[path.stem] == 1]
    problems |= {f"{SHAPES}: {name}": problem for name, problem in damaged.items()}
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
        [f"{DATASET}/{path.stem}" for path in files],
        lambda k: _experiment_of(files[k], shapes),
        problems,
    )


def _record_files(source: Path) -> list[Path]:
    if source.is_file():
        return [source] if source.suffix in (".h5", ".json") else []
    masks = [f"{folder}{name}" for folder in ("", "*/", "*/*/") for name in RECORDS]
    return sorted({path for mask in masks for path in source.glob(mask)})


def _shapes_near(path: Path, given: Path | None) -> tuple[dict[str, model.Shape], Problems]:
    """Load outlines from a given file, or from a shapes.json in the folder or up to three above.

    Return also the errors of those that cannot be read; a given file must be sound as a whole.
    """
    if given is not None and not given.is_file():
        raise DatasetMissing(given, "a file with outlines")
    near = [folder / SHAPES for folder in path.resolve().parents[:4]]
    found = given or next((file for file in near if file.is_file()), None)
    if found is None:
        return {}, {}
    try:
        content = read_json(found)
    except InvalidInput as problem:
        if given is not None:
            raise
        return {}, {"the whole file": problem}
    outlines = {k: v for k, v in content.items() if isinstance(v, dict | list)}
    shapes, problems = shapes_of(outlines)
    if given is not None and problems:
        raise next(iter(problems.values()))
    return shapes, problems


def _experiment_of(path: Path, shapes: dict[str, model.Shape]) -> model.Experiment:
    content = _hdf5_tables(path) if path.suffix == ".h5" else read_json(path)
    conditions = _conditions(path, content)
    (pose, tip, wrench), flags = _on_one_clock(
        *(_rows(path, key, content.get(key)) for key in _KEYS)
    )
    surface, shape = str(conditions["surface"]), str(conditions["shape"])
    scene, body_flags = _scene(shape, pose, tip, shapes)
    speed = float(conditions.get("speed_m_s", 0.0))
    return model.Experiment(
        dataset=DATASET,
        name=path.stem,
        real=True,
        provenance=origin_of(path),
        object_name=OBJECT,
        trajectory=trajectory_of(pose[:, 0], pose[:, 1:]),
        pusher=trajectory_of(tip[:, 0], tip[:, 1:]),
        scene=scene,
        channels=(
            model.Channel(
                name="force",
                time=wrench[:, 0],
                columns=("fx_n", "fy_n", "torque_nm"),
                values=wrench[:, 1:],
            ),
        ),
        conditions=conditions,
        flags=(*flags, *body_flags, *known_doubts(surface, shape, speed)),
    )


def _on_one_clock(
    pose: FloatArray, tip: FloatArray, wrench: FloatArray
) -> tuple[list[FloatArray], list[model.Flag]]:
    """Count times from the first pose of the object, and drop rows whose time does not advance."""
    if tip.shape[1] == 3:
        tip = np.column_stack((tip, np.zeros(len(tip))))
    begin, tables, flags = pose[0, 0], [], []
    for rows in (pose, tip, wrench):
        good = advancing(rows[:, 0])
        used = rows[good]
        used[:, 0] -= begin
        tables.append(used)
        if not good.all():
            flags.append(remark("repeated-times", f"{int((~good).sum())} rows dropped"))
    return tables, flags


def _scene(
    name: str, pose: FloatArray, tip: FloatArray, shapes: dict[str, model.Shape]
) -> tuple[model.Scene | None, tuple[model.Flag, ...]]:
    if name not in shapes:
        return None, (remark("no-shape", f"no outline of {name}"),)
    path = np.column_stack((tip[:, :3], np.zeros(len(tip))))
    path = path[path[:, 0] >= 0.0]
    if not len(path) or path[-1, 0] <= 0.0:
        return None, (remark("no-scene", "the tip was not seen after the object"),)
    body = plate(name, shapes[name], pose[0, 1:])
    return pushed_scene(body, TIP, path, friction=MU_PUSHER, fade=FADE)


def _hdf5_tables(path: Path) -> dict[str, Any]:
    require("h5py", path.name, extra="hdf5")
    import h5py  # type: ignore[import-not-found,import-untyped,unused-ignore]

    with usable(path.name, "an HDF5 file"), h5py.File(path, "r") as file:
        return {key: _dataset(h5py, file, key) for key in _KEYS}


def _dataset(h5py: Any, file: Any, key: str) -> Any:
    """Load a small numeric table; None for anything else, such as a link to another file."""
    if not isinstance(file.get(key, getlink=True), h5py.HardLink):
        return None
    table = file[key]
    small = isinstance(table, h5py.Dataset) and table.nbytes <= MAX_BYTES
    return table[()] if small and table.dtype.kind in "iuf" else None


def _rows(path: Path, key: str, given: Any) -> FloatArray:
    try:
        rows = np.array(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        rows = np.zeros(0)
    width = _KEYS[key]
    if rows.ndim != 2 or not len(rows) or not width <= rows.shape[1] <= 4:
        found = "nothing" if given is None else f"shape {rows.shape}"
        expected = f"rows of {width} numbers, time first"
        raise InvalidInput(f"{path.name}: {key}", found=found, expected=expected)
    if not np.isfinite(rows).all() or np.abs(rows).max() > LARGEST_NUMBER:
        found, expected = "implausible numbers", "finite readings"
        raise InvalidInput(f"{path.name}: {key}", found=found, expected=expected)
    return rows


def _conditions(path: Path, about: Mapping[str, Any]) -> dict[str, str | float]:
    """Conditions of a push from its file, or else from the file name."""
    match = _IN_NAME.match(path.stem)
    named = {key: value for key, value in (match.groupdict() if match else {}).items() if value}
    surface, shape = about.get("surface", named.get("surface")), about.get("shape")
    shape = shape or named.get("shape")
    if not isinstance(surface, str) or not isinstance(shape, str):
        expected = "both in the file, or in its name: motion_surface=..._shape=..._a=..._v=..."
        raise InvalidInput(path.name, found="no surface and shape", expected=expected)
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


DATASET: Final = "mit-push"
OBJECT: Final = "object"
SHAPES: Final = "shapes.json"

TIP: Final = model.Disk(4.75e-3)  # of steel

# Nominal friction: at the tip as in the published simulator; that of the plane has no effect on
# quasi-static motion.
MU_PUSHER, MU_SUPPORT = 0.25, 0.3

# Masses of steel plates [kg], which the dataset's README quotes from the paper.
MASSES = {
    "rect1": 0.837, "rect2": 1.045, "rect3": 1.251, "tri1": 0.803, "tri2": 0.983, "tri3": 1.133,
    "ellip1": 0.894, "ellip2": 1.110, "ellip3": 1.334, "hex": 0.983, "butter": 1.197,
}  # fmt: skip

# Mass of other plates by area [kg/m^2]: 13 mm of steel.
MASS_PER_AREA = 0.013 * 7950.0

# Corners of the polygon that approximates an ellipse: at most 0.02 mm inside one of 65 mm.
ELLIPSE_CORNERS = 128

# Surfaces and shapes whose registration is off by 1 to 3 mm in all pushes.
SYSTEMATIC = frozenset(("plywood", shape) for shape in ("ellip2", "ellip3", "hex", "rect2"))
# Surface, shape and speed [m/s] of pushes that no published model explains.
UNEXPLAINED = ("abs", "rect1", 0.02)


def plate(name: str, shape: model.Shape, start: FloatArray) -> model.Body:
    """Create a plate with even pressure, of the mass in the paper or else by its area."""
    return model.Body(
        name=OBJECT,
        shape=shape,
        mass=MASSES.get(name, MASS_PER_AREA * shape.area),
        pose=start,
        support=model.UniformPressure(friction=MU_SUPPORT),
    )


def shapes_of(content: Mapping[str, Any]) -> tuple[dict[str, model.Shape], Problems]:
    """Return the outlines in a shapes.json, and the errors of those that cannot be read."""
    shapes: dict[str, model.Shape] = {}
    problems: Problems = {}
    for name, value in content.items():
        where = f"{SHAPES}: {name}"
        with collected(problems, name, where):
            shapes[name] = _shape(where, value)
    return shapes, problems


def _shape(where: str, value: Any) -> model.Shape:
    try:
        if isinstance(value, list):
            return model.Polygon(np.array(value, dtype=np.float64))
        kind = member(value, "type", where)
        if kind == "ellipse":
            axes = (member(value, f"semi_axis_{axis}_m", where) for axis in "xy")
            return _ellipse(*axes)
        if kind == "polygon":
            return model.Polygon(member(value, "vertices_m", where))
    except InvalidInput as problem:
        raise problem if problem.where == where else problem.within(where) from None
    raise InvalidInput(where, found=f"the type {kind}", expected="the type polygon or ellipse")


def _ellipse(semi_axis_x: float, semi_axis_y: float) -> model.Shape:
    """Build an ellipse about the origin [m]: a disk, or a polygon with corners on the curve."""
    if semi_axis_x == semi_axis_y:
        return model.Disk(semi_axis_x)
    angle = np.arange(ELLIPSE_CORNERS) * (2.0 * math.pi / ELLIPSE_CORNERS)
    return model.Polygon(
        np.column_stack((semi_axis_x * np.cos(angle), semi_axis_y * np.sin(angle)))
    )


def known_doubts(surface: str, shape: str, speed: float) -> Iterator[model.Flag]:
    """Yield remarks on pushes of which the dataset's users know that something is wrong."""
    if (surface, shape) in SYSTEMATIC:
        yield remark("systematic-offset", f"{shape} on {surface} is registered 1 to 3 mm off")
    if (surface, shape) == UNEXPLAINED[:2] and abs(speed - UNEXPLAINED[2]) < 1e-6:
        yield remark(
            "unexplained-error", "the errors of published models are twice the usual error"
        )
