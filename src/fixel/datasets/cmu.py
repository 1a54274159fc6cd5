"""Importers of CMU's pushes: a triangular block on known supports, with force; small blocks,
pushed again and again by two fingers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel import model
from fixel.datasets import base
from fixel.datasets.contact import FADE, pushed_scene
from fixel.datasets.files import (
    MM,
    CsvRows,
    Problems,
    advancing,
    has_files,
    member,
    missing_rows,
    only_file,
    rate_of,
    read_json,
    read_table,
    rows_of,
)
from fixel.errors import InvalidInput
from fixel.typing import FloatArray

DATASET: Final = "cmu-tripod"
OBJECT, FINGER = "block", "finger"
PUSHES, SETUP = "pushes.csv", "setup.json"
FORCE, ROBOT = ("force.csv.gz", "force.csv"), ("robot.csv.gz", "robot.csv")

# Friction of the finger on the block was not recorded; the authors search around this value.
MU_FINGER = 0.5

# Larger final gaps cannot be explained by errors of calibration [m].
LARGEST_GAP = 1.3e-3

PUSH: Final = "push_id"
GAPS = ("tip_gap0_mm", "tip_gap1_mm")
FORCES = ("t", "fx_on_object", "fy_on_object")
FINGER_POSE = ("t", "x_mm", "y_mm", "qz", "qw")
POSES = tuple(f"obj_{axis}{end}" for end in "01" for axis in ("x", "y", "th"))


class CmuTripod(base.Importer):
    """Importer of pushes with force, of a block on three machined points or on its face."""

    name = DATASET
    title = "CMU tripod: pushes of a block on known support points, with force (2015)"
    licence = "Apache-2.0"
    citation = (
        "J. Zhou, R. Paolini, J. A. Bagnell, M. T. Mason, A convex polynomial force-motion model"
        " for planar sliding, ICRA 2016"
    )

    def recognised(self, source: Path) -> bool:
        """Whether a folder has pushes.csv, setup.json, and tables of force and robot."""
        return has_files(source, (PUSHES,), (SETUP,), FORCE, ROBOT)

    def _plan(self, source: Path, options: Mapping[str, object]) -> base.ImportPlan:
        data = _read(source)
        pushes = data.table
        provenance = cache(lambda: base.origin_of(source / PUSHES))
        force, robot = (rate_of(own[data.names[0]][:, 0]) for own in (data.force, data.robot))
        n_force, n_robot = (sum(map(len, own.values())) for own in (data.force, data.robot))
        return base.ImportPlan(
            DATASET,
            source,
            (
                f"{len(pushes)} pushes: force at {force:.0f} Hz ({n_force} rows), finger at"
                f" {robot:.0f} Hz ({n_robot} rows), each on times of its own from the first"
                " force reading.",
                "The pose of the block is known before and after, not during (no-pose-during-push):"
                " at 0 s and at the last reading of force or finger.",
                "Poses in m and rad at the centre of mass, in the frame of the robot; the finger"
                " from mm to m, its angle from the quaternion; force on the block in N.",
                "Scenes: the machined support points with loads from statics, or uniform "
                f"pressure for the patch; friction of the surface from the authors; {MU_FINGER:g} "
                "is assumed at the finger.",
                f"Final gaps beyond {LARGEST_GAP / MM:g} mm are flagged (tip-gap).",
            ),
            [f"{DATASET}/{name}" for name in data.names],
            lambda row: _push(data, row, provenance()),
            base.named(DATASET, data.problems),
        )


class _TripodData(NamedTuple):
    """Content of all files of the folder."""

    table: CsvRows  # of the pushes
    names: Sequence[str]
    poses: FloatArray  # (n, 6) before and after [m, m, rad]
    gaps: FloatArray  # (n, 2) at start and end [m]
    force: Mapping[str, FloatArray]  # (n, 3) of each push [s, N, N]
    robot: Mapping[str, FloatArray]  # (n, 4) of each push [s, m, m, rad]
    bodies: Mapping[tuple[str, str], model.Body]
    finger: model.Disk
    problems: Problems  # of pushes that are left out


def _read(folder: Path) -> _TripodData:
    setup = read_json(only_file(folder, SETUP))
    table, problems = read_table(only_file(folder, PUSHES), torn=True).sound(
        PUSH, (*POSES, *GAPS), once=True
    )
    table.require(["surface", "support", "source_log"])
    series, rows = [], []
    for files, columns in ((FORCE, FORCES), (ROBOT, FINGER_POSE)):
        read = read_table(only_file(folder, *files), torn=True)
        readings, damaged = read.sound(PUSH, columns)
        rows.append(rows_of(readings, PUSH))
        series.append(readings)
        problems = missing_rows(rows[-1], readings.source, table, PUSH) | problems | damaged
    bodies: dict[tuple[str, str], model.Body] = {}
    for name, *key in zip(*(table.columns[c] for c in (PUSH, "surface", "support")), strict=True):
        kind = (key[0], key[1])
        with base.collected(problems, name, SETUP):
            if kind not in bodies:
                bodies[kind] = _body(setup, *kind)
    kept = [row for row, name in enumerate(table.columns[PUSH]) if name not in problems]
    if not kept:
        raise next(iter(problems.values()))
    table = table.only(kept)
    names, finger = table.columns[PUSH], series[1]
    angle = 2.0 * np.arctan2(finger.numbers("qz"), finger.numbers("qw"))
    path = np.column_stack((finger.numbers("t"), finger.stacked("x_mm", "y_mm") * MM, angle))
    values = series[0].stacked(*FORCES), path
    force, robot = (
        {name: all_rows[own[name]] for name in names}
        for all_rows, own in zip(values, rows, strict=True)
    )
    return _TripodData(
        table=table,
        names=names,
        poses=table.stacked(*POSES),
        gaps=table.stacked(*GAPS) * MM,
        force=force,
        robot=robot,
        bodies=bodies,
        finger=model.Disk(member(setup, "pusher.radius_m_assumed_by_authors", SETUP)),
        problems=problems,
    )


def _body(setup: dict[str, Any], surface: str, support: str) -> model.Body:
    friction = member(setup, f"author_friction_coefficient.{surface}", SETUP)
    points = member(setup, "support_points_m", SETUP)
    if support not in points:
        raise InvalidInput(PUSHES, found=f"the support {support}", expected=", ".join(points))
    # Statics determines the loads on three points; they equal the load fractions of the authors.
    rests: model.Support = (
        model.UniformPressure(friction=friction)
        if points[support] is None
        else model.SupportPoints(points=points[support], friction=friction)
    )
    return model.Body(
        name=OBJECT,
        shape=model.Polygon(member(setup, "object.vertices_m", SETUP)),
        mass=member(setup, "object.mass_kg", SETUP),
        centre_of_mass=np.zeros(2),
        pose=np.zeros(3),
        support=rests,
    )


def _push(data: _TripodData, row: int, provenance: model.Provenance) -> model.Experiment:
    name, columns = data.names[row], data.table.columns
    surface, support, log = (columns[c][row] for c in ("surface", "support", "source_log"))
    force, path = data.force[name], data.robot[name]
    good = advancing(path[:, 0])
    path = path[good]
    path[:, 3] = np.unwrap(path[:, 3])
    force = force[advancing(force[:, 0])]
    end = float(max(force[-1, 0], path[-1, 0]))
    pose = data.poses[row].reshape(2, 3)
    scene, flags = pushed_scene(
        replace(data.bodies[surface, support], pose=pose[0]),
        data.finger,
        path,
        friction=MU_FINGER,
        fade=FADE,
        pusher=FINGER,
        words=("finger", "block"),
    )
    return model.Experiment(
        dataset=DATASET,
        name=name,
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=model.Trajectory(time=np.array([0.0, end]), pose=pose),
        pusher=model.Trajectory(time=path[:, 0], pose=path[:, 1:]),
        scene=scene,
        channels=(
            model.Channel(
                name="force", time=force[:, 0], columns=("fx_n", "fy_n"), values=force[:, 1:]
            ),
        ),
        effective=(0.0, end),
        conditions={
            "surface": surface,
            "support": support,
            "log": log,
            "gap0_m": float(data.gaps[row, 0]),
            "gap1_m": float(data.gaps[row, 1]),
        },
        flags=(*flags, *_doubts(data, row, int((~good).sum()))),
    )


def _doubts(data: _TripodData, row: int, dropped: int) -> Iterator[model.Flag]:
    yield base.remark("no-pose-during-push", "poses before and after, once the arm is away")
    gap = float(data.gaps[row, 1])
    if abs(gap) > LARGEST_GAP:
        yield model.Flag("tip-gap", f"the finger ends {gap / MM:.3g} mm from the outline")
    if "mixed" in data.table.columns["source_log"][row]:
        yield base.remark("joined-sessions", "the log was combined from two sessions")
    if dropped:
        yield base.remark("repeated-times", f"{dropped} rows of the finger dropped")


TWO_POINT: Final = "cmu-two-point"
RUNS, POSE_FILES = "runs.csv", ("poses.csv.gz", "poses.csv")

FINGER_RADIUS = 2.5e-3  # [m]
FINGER_SPACING = 18e-3  # [m]; an early script had 24 mm

MEASURED = ("t", "obj_x_mm", "obj_y_mm", "obj_th", "pusher_x_mm", "pusher_y_mm", "pusher_th")

# Missing data, without which no scene can be built.
UNKNOWN = (
    base.remark("no-mass", "masses of the blocks were not recorded: no scene"),
    base.remark("pusher-offset", "the frame of the fingers is off by millimetres in each action"),
)
NO_SUPPORT = base.remark(
    "no-support", "the positions of the three support points were not recorded"
)


class CmuTwoPoint(base.Importer):
    """Importer of stable pushes by two parallel fingers, with repeated starts."""

    name = TWO_POINT
    title = "CMU two-point: repeated two-finger pushes of small blocks (2017)"
    licence = "Apache-2.0"
    citation = (
        "J. Zhou, M. T. Mason, logs of two-finger stable pushes, github.com/robinzhoucmu/Pushing"
    )

    def recognised(self, source: Path) -> bool:
        """Whether a folder has runs.csv and poses.csv.gz or poses.csv."""
        return has_files(source, (RUNS,), POSE_FILES)

    def _plan(self, source: Path, options: Mapping[str, object]) -> base.ImportPlan:
        runs, problems = read_table(only_file(source, RUNS), torn=True).sound(
            "run_id", (), once=True
        )
        runs.require(["object", "start_pose"])
        file = only_file(source, *POSE_FILES)
        table, damaged = read_table(file, torn=True).sound(
            "run_id", MEASURED, ("obj_lost", "action_id")
        )
        readings = table.stacked(*MEASURED) * (1.0, MM, MM, 1.0, MM, MM, 1.0)
        lost, action = table.whole_numbers("obj_lost") > 0, table.whole_numbers("action_id")
        rows = rows_of(table, "run_id")
        problems |= missing_rows(rows, table.source, runs, "run_id", least=2) | damaged
        listed = [k for k, name in enumerate(runs.columns["run_id"]) if name not in problems]
        names = [runs.columns["run_id"][k] for k in listed]
        provenance = cache(lambda: base.origin_of(file))

        def build(k: int) -> model.Experiment:
            own = rows[names[k]][1:]  # the first row belongs to the previous action
            about = {key: runs.columns[key][listed[k]] for key in ("object", "start_pose")}
            return _run(names[k], about, readings[own], lost[own], action[own], provenance())

        rate = rate_of(readings[rows[names[0]], 0]) if names else 0.0
        return base.ImportPlan(
            TWO_POINT,
            source,
            (
                f"{len(names)} runs, {len(table)} rows at {rate:.0f} Hz; the first row of each run"
                " belongs to the action before and is dropped. Times in s from the second.",
                "Positions from mm to m, angles in rad and unwrapped, in the frame of the robot.",
                f"{int(lost.sum())} rows without the object hold the pose (0, 0, 0): they are"
                " dropped from its trajectory (tracking-lost).",
                "The pusher is the point midway between the two fingers, which moves freely between"
                " actions; the number of the action is a channel.",
                "No scenes: masses, and most supports, were not recorded (no-mass, no-support).",
            ),
            [f"{TWO_POINT}/{name}" for name in names],
            build,
            base.named(TWO_POINT, problems),
        )


def _run(
    name: str,
    about: Mapping[str, str],
    readings: FloatArray,
    lost: NDArray[np.bool_],
    action: NDArray[np.int64],
    provenance: model.Provenance,
) -> model.Experiment:
    if not advancing(readings[:, 0]).all():
        raise InvalidInput(f"run {name}", found="decreasing times", expected="increasing times")
    time = readings[:, 0] - readings[0, 0]
    seen = ~lost
    if not seen.any():
        raise InvalidInput(f"run {name}", found="no pose of the object", expected="at least one")
    return model.Experiment(
        dataset=TWO_POINT,
        name=name,
        real=True,
        provenance=provenance,
        object_name=about["object"],
        trajectory=base.trajectory_of(time[seen], readings[seen, 1:4]),
        pusher=base.trajectory_of(time, readings[:, 4:7]),
        channels=(
            model.Channel(
                name="action",
                time=time,
                columns=("action_id_count",),
                values=action[:, None].astype(np.float64),
            ),
        ),
        conditions={
            **about,
            "finger_radius_m": FINGER_RADIUS,
            "nominal_finger_spacing_m": FINGER_SPACING,
        },
        flags=tuple(_lost_doubts(about["object"], lost)),
    )


def _lost_doubts(kind: str, lost: NDArray[np.bool_]) -> Iterator[model.Flag]:
    yield from UNKNOWN
    if kind.endswith("3pts"):
        yield NO_SUPPORT
    if lost.any():
        yield base.remark(
            "tracking-lost", f"{int(lost.sum())} of {len(lost)} rows without the object"
        )
