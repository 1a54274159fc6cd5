"""Importer of CMU's repeated two-finger pushes of small blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.base import Importer, ImportPlan, Origin, named, remark, trajectory_of
from fixel.datasets.files import (
    MM,
    advancing,
    missing_rows,
    only_file,
    rate_of,
    read_table,
    rows_of,
)
from fixel.errors import InvalidInput
from fixel.model import Channel, Experiment, Flag, Provenance
from fixel.typing import FloatArray

DATASET: Final = "cmu-two-point"
RUNS, POSES = "runs.csv", ("poses.csv.gz", "poses.csv")

FINGER_RADIUS = 2.5e-3  # [m]
FINGER_SPACING = 18e-3  # [m]; an early script had 24 mm

MEASURED = ("t", "obj_x_mm", "obj_y_mm", "obj_th", "pusher_x_mm", "pusher_y_mm", "pusher_th")

# Missing data, without which no scene can be built.
UNKNOWN = (
    remark("no-mass", "masses of the blocks were not recorded: no scene"),
    remark("pusher-offset", "the frame of the fingers is off by millimetres in each action"),
)
NO_SUPPORT = remark("no-support", "the positions of the three support points were not recorded")


@final
class CmuTwoPoint(Importer):
    """Importer of stable pushes by two parallel fingers, with repeated starts."""

    name = DATASET
    title = "CMU two-point: repeated two-finger pushes of small blocks (2017)"
    licence = "Apache-2.0"
    citation = (
        "J. Zhou, M. T. Mason, logs of two-finger stable pushes, github.com/robinzhoucmu/Pushing"
    )

    def recognised(self, source: Path) -> bool:
        """Whether a folder has runs.csv and poses.csv.gz or poses.csv."""
        return (source / RUNS).is_file() and any((source / name).is_file() for name in POSES)

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        runs, problems = read_table(only_file(source, RUNS), torn=True).sound(
            "run_id", (), once=True
        )
        runs.require(["object", "start_pose"])
        file = only_file(source, *POSES)
        table, damaged = read_table(file, torn=True).sound(
            "run_id", MEASURED, ("obj_lost", "action_id")
        )
        readings = table.stacked(*MEASURED) * (1.0, MM, MM, 1.0, MM, MM, 1.0)
        lost, action = table.whole_numbers("obj_lost") > 0, table.whole_numbers("action_id")
        rows = rows_of(table, "run_id")
        problems |= missing_rows(rows, table.source, runs, "run_id", least=2) | damaged
        listed = [k for k, name in enumerate(runs.columns["run_id"]) if name not in problems]
        names = [runs.columns["run_id"][k] for k in listed]
        origin = Origin()

        def build(k: int) -> Experiment:
            own = rows[names[k]][1:]  # the first row belongs to the previous action
            about = {key: runs.columns[key][listed[k]] for key in ("object", "start_pose")}
            return _run(names[k], about, readings[own], lost[own], action[own], origin.of(file))

        rate = rate_of(readings[rows[names[0]], 0]) if names else 0.0
        return ImportPlan(
            DATASET,
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
            [f"{DATASET}/{name}" for name in names],
            build,
            named(DATASET, problems),
        )


def _run(
    name: str,
    about: Mapping[str, str],
    readings: FloatArray,
    lost: NDArray[np.bool_],
    action: NDArray[np.int64],
    provenance: Provenance,
) -> Experiment:
    if not advancing(readings[:, 0]).all():
        raise InvalidInput(f"run {name}", found="decreasing times", expected="increasing times")
    time = readings[:, 0] - readings[0, 0]
    seen = ~lost
    if not seen.any():
        raise InvalidInput(f"run {name}", found="no pose of the object", expected="at least one")
    return Experiment(
        dataset=DATASET,
        name=name,
        real=True,
        provenance=provenance,
        object_name=about["object"],
        trajectory=trajectory_of(time[seen], readings[seen, 1:4]),
        pusher=trajectory_of(time, readings[:, 4:7]),
        channels=(
            Channel(
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
        flags=tuple(_doubts(about["object"], lost)),
    )


def _doubts(kind: str, lost: NDArray[np.bool_]) -> Iterator[Flag]:
    yield from UNKNOWN
    if kind.endswith("3pts"):
        yield NO_SUPPORT
    if lost.any():
        yield remark("tracking-lost", f"{int(lost.sum())} of {len(lost)} rows without the object")
