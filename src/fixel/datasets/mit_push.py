"""Importer of MIT's "more than a million ways to be pushed": the end-point set, and single pushes.

The end-point set has two poses for each straight push of 50 mm, in one table. It also has the
predictions of the quasi-static simulator of J. Zhou.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets import mit_push_records as records
from fixel.datasets.base import Importer, ImportPlan, guarded, named, origin_of
from fixel.datasets.contact import MAX_CORRECTION, moved_to_contact, pushed_scene
from fixel.datasets.files import MM, Problems, has_files, only_file, read_json, read_table
from fixel.errors import FixelError, InvalidInput
from fixel.model import Body, Experiment, Flag, Provenance, Trajectory
from fixel.typing import BoolArray, FloatArray, IntArray

TABLES: Final = ("pushes.csv.gz", "pushes.csv")
NUMBERS: Final = (
    *("speed_mm_s", "obj_x0", "obj_y0", "obj_th0", "obj_x1", "obj_y1", "obj_th1"),
    *("tip_x0", "tip_y0", "tip_x1", "tip_y1", "gap0_mm", "gap1_mm"),
)
STROKE: Final = 50e-3  # nominal length of a stroke [m]

# A larger gap means that a record contradicts its own geometry [m].
LARGEST_GAP: Final = 3e-3

# A larger difference from the nominal stroke means that a record contradicts itself [m].
MAX_STROKE_ERROR: Final = 1e-3

# Nothing is fitted: friction at the tip as in the published simulator, even pressure. Friction of
# the plane has no effect on quasi-static motion.
NOMINAL: Final = {
    "mu_pusher": records.MU_PUSHER,
    "mu_support": records.MU_SUPPORT,
    "support_points": 64,
}


class MitPush(Importer):
    """Importer of straight pushes of steel plates by a round tip."""

    name = records.DATASET
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
            return any(source.match(mask) for mask in records.RECORDS)
        published = any(next(source.glob(mask), None) for mask in records.PUBLISHED)
        return published or has_pushes(source)

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        if has_pushes(source):
            return _plan_of_table(source)
        given = options.get("shapes")
        return records.plan_of_records(source, None if given is None else Path(str(given)))


def has_pushes(folder: Path) -> bool:
    """Whether a folder contains the end-point set."""
    return has_files(folder, TABLES, (records.SHAPES,))


@dataclass(frozen=True, kw_only=True)
class MitPushes:
    """Pushes of the end-point set; every array has one row for each."""

    folder: Path
    source: str  # name of the table
    # (n,)
    names: NDArray[np.str_]
    surface: NDArray[np.str_]
    shape: NDArray[np.str_]
    # (n, 3) Measured poses of the object [m, m, rad].
    start: FloatArray
    end: FloatArray
    # (n, 2) Measured centres of the tip [m].
    tip_start: FloatArray
    tip_end: FloatArray
    speed: FloatArray  # (n,) speed of the tip [m/s]
    # (n,) Gap from the surface of the tip to the outline, in the table [m].
    gap_start: FloatArray
    gap_end: FloatArray
    gap: FloatArray  # (n,) gap at the start, computed by fixel [m]
    offset: FloatArray  # (n, 2) shift of the start of the tip in the scene [m]
    bodies: Mapping[str, Body]  # plates, with their outlines in the frame of the dataset's poses
    problems: Problems  # pushes that are left out

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def astray(self) -> BoolArray:
        """Mask (n,) of pushes with a gap that contradicts their own geometry."""
        return (np.abs(self.gap_start) > LARGEST_GAP) | (self.gap_end < -LARGEST_GAP)

    @cached_property
    def short(self) -> BoolArray:
        """Mask (n,) of other pushes with a stroke that is not the nominal one."""
        stroke = np.hypot(*(self.tip_end - self.tip_start).T)
        return np.asarray((np.abs(stroke - STROKE) > MAX_STROKE_ERROR) & ~self.astray)

    @property
    def usable(self) -> IntArray:
        """Rows that are consistent with their own geometry."""
        return np.flatnonzero(~self.astray & ~self.short)

    @cached_property
    def experiments(self) -> tuple[Experiment, ...]:
        """The pushes as experiments, in the same order."""
        provenance = origin_of(self.folder / self.source)
        return tuple(_push(self, row, provenance) for row in range(len(self)))

    @cached_property
    def published(self) -> dict[str, FloatArray]:
        """End poses (n, 3) by the published simulator, one per limit surface; NaN if missing."""
        table = read_table(self.folder / self.source, torn=True)
        rows = {name: row for row, name in enumerate(table.columns["push_id"])}
        table = table.only([rows[name] for name in self.names.tolist()])
        axes = ("x", "y", "th")
        return {
            name: table.stacked(*(f"author_{name}_{axis}1" for axis in axes), blank=True)
            for name in ("poly4", "quad")
            if f"author_{name}_x1" in table.columns
        }


def _plan_of_table(folder: Path) -> ImportPlan:
    pushes = _read(folder)
    n = len(pushes)
    provenance = cache(lambda: origin_of(folder / pushes.source))
    names = [f"{records.DATASET}/{name}" for name in pushes.names]
    corrected = int((pushes.gap < 0.0).sum())
    hopeless = int((pushes.gap < -MAX_CORRECTION).sum())
    return ImportPlan(
        records.DATASET,
        folder,
        (
            f"{n} pushes in {pushes.source}, each with the pose of object and tip at"
            " the start (t = 0) and at the end (0.05 m by the nominal speed).",
            "Poses in m and rad as they stand, in the frame of the robot; speed and gaps from mm.",
            f"Scenes: plates of known mass with even pressure, a round tip of"
            f" {records.TIP.radius / MM:g} mm on its measured line, nominal friction"
            f" {records.MU_PUSHER:g} at the tip and {records.MU_SUPPORT:g} on the plane.",
            f"{corrected} pushes start with the tip inside the object by their measurement: "
            f"{corrected - hopeless} tips are moved to contact in the scene "
            f"(pusher-moved-to-contact); {hopeless} with overlaps of more than "
            f"{MAX_CORRECTION / MM:g} mm have no scene (no-scene).",
            f"{int(pushes.astray.sum())} pushes do not fit their own geometry (misregistered).",
            "Intermediate poses and predictions of the published simulator are not imported.",
        ),
        names,
        lambda row: _push(pushes, row, provenance()),
        named(records.DATASET, pushes.problems),
    )


def read_mit_pushes(folder: Path) -> MitPushes:
    """Load the end-point set of the MIT push dataset; raise if all pushes start inside a plate."""
    with guarded(folder.name):
        pushes = _read(folder)
    deep = pushes.gap < -MAX_CORRECTION
    for name in pushes.bodies:
        if deep[pushes.shape == name].all():
            found, expected = "no push that starts outside the plate", "at least one"
            raise InvalidInput(f"{folder.name}: {name}", found=found, expected=expected)
    return pushes


def _read(folder: Path) -> MitPushes:
    table, problems = read_table(only_file(folder, *TABLES), torn=True).sound(
        "push_id", NUMBERS, once=True
    )
    table.require(["surface", "shape"])
    shapes, damaged = records.shapes_of(read_json(only_file(folder, records.SHAPES)))
    wrong: dict[int, FixelError] = {}
    for row, name in enumerate(table.columns["shape"]):
        if name not in shapes:
            expected = f"a shape in {records.SHAPES}: {', '.join(shapes)}"
            unknown = InvalidInput(table.source, found=f"the shape {name}", expected=expected)
            wrong[row] = damaged.get(name, unknown)
    speed = table.numbers("speed_mm_s") * MM
    for row in np.flatnonzero(speed <= 0.0).tolist():
        found, where = float(speed[row] / MM), table.place("speed_mm_s", row)
        wrong[row] = InvalidInput(where, found=found, expected="a positive speed [mm/s]")
    problems |= {table.columns["push_id"][row]: problem for row, problem in wrong.items()}
    if len(wrong) == len(table):
        raise wrong[0]
    table = table.only([row for row in range(len(table)) if row not in wrong])
    names, shape = table.text("push_id"), table.text("shape")
    speed = table.numbers("speed_mm_s") * MM
    used = np.unique(shape).tolist()
    start = table.stacked("obj_x0", "obj_y0", "obj_th0")
    tip_start = table.stacked("tip_x0", "tip_y0")
    gap, offset = np.zeros(len(table)), np.zeros((len(table), 2))
    for name in used:
        rows = np.flatnonzero(shape == name)
        gap[rows], offset[rows] = moved_to_contact(
            shapes[name], records.TIP.radius, start[rows], tip_start[rows]
        )
    return MitPushes(
        folder=folder,
        source=table.source,
        names=names,
        surface=table.text("surface"),
        shape=shape,
        start=start,
        end=table.stacked("obj_x1", "obj_y1", "obj_th1"),
        tip_start=tip_start,
        tip_end=table.stacked("tip_x1", "tip_y1"),
        speed=speed,
        gap_start=table.numbers("gap0_mm") * MM,
        gap_end=table.numbers("gap1_mm") * MM,
        gap=gap,
        offset=offset,
        bodies={name: records.plate(name, shapes[name], np.zeros(3)) for name in used},
        problems=problems,
    )


def _push(pushes: MitPushes, row: int, provenance: Provenance) -> Experiment:
    shape, speed = str(pushes.shape[row]), float(pushes.speed[row])
    duration = STROKE / speed
    start = pushes.start[row]
    time = np.array([0.0, duration])
    tip = np.column_stack((time, (pushes.tip_start[row], pushes.tip_end[row]), np.zeros(2)))
    scene, flags = pushed_scene(
        replace(pushes.bodies[shape], pose=start),
        records.TIP,
        tip,
        friction=records.MU_PUSHER,
        contact=(float(pushes.gap[row]), pushes.offset[row]),
    )
    return Experiment(
        dataset=records.DATASET,
        name=str(pushes.names[row]),
        real=True,
        provenance=provenance,
        object_name=records.OBJECT,
        trajectory=Trajectory(time=time, pose=np.stack((start, pushes.end[row]))),
        pusher=Trajectory(time=time, pose=tip[:, 1:]),
        scene=scene,
        effective=(0.0, duration),
        conditions={
            "surface": str(pushes.surface[row]),
            "shape": shape,
            "speed_m_s": speed,
            "gap0_m": float(pushes.gap_start[row]),
            "gap1_m": float(pushes.gap_end[row]),
        },
        flags=(*flags, *_doubts(pushes, row)),
    )


def _doubts(pushes: MitPushes, row: int) -> Iterator[Flag]:
    if pushes.astray[row]:
        start, end = float(pushes.gap_start[row]), float(pushes.gap_end[row])
        yield Flag(
            "misregistered",
            f"tip {start / MM:.3g} mm from the outline at the start, {end / MM:.3g} mm at the end",
        )
    yield from records.known_doubts(
        str(pushes.surface[row]), str(pushes.shape[row]), float(pushes.speed[row])
    )
