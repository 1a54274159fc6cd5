"""Importer of the pusher-slider runs of MIT's MCube laboratory: a square pushed along a line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, final

import numpy as np

from fixel.datasets.base import (
    Importer,
    ImportPlan,
    Origin,
    rate_of,
    refuse_giants,
    remark,
    scene_or_flag,
)
from fixel.datasets.contact import (
    MAX_CORRECTION,
    corrected_path,
    correction_flag,
    moved_to_contact,
)
from fixel.datasets.raw import mit_timeseries
from fixel.datasets.raw.base import MM, CsvRows, read_table
from fixel.datasets.raw.mit_timeseries import RUNS, SHAPES, PushRun
from fixel.errors import DatasetMissing
from fixel.model import (
    Body,
    Channel,
    Disk,
    Experiment,
    Flag,
    PathDrive,
    Pusher,
    Scene,
    Trajectory,
    UniformPressure,
)
from fixel.typing import FloatArray

DATASET: Final = "mit-pusher-slider"
OBJECT, PUSHER = "slider", "pusher"

# Friction and mass as in the authors' model of their rig: nominal, not measured.
MU_PUSHER, MU_SUPPORT = 0.3, 0.35
DENSITY, THICKNESS = 10_000.0, 0.013  # [kg/m^3], [m]

# A tip measured deeper in the object than this means that the tracker had lost the object [m].
DROPOUT = -3e-3

# Duration of the correction of a path that starts inside the object [s].
FADE = 0.5

MEASURED = ("t", "slider_x", "slider_y", "slider_th", "pusher_x", "pusher_y")


@final
class MitPusherSlider(Importer):
    """Importer of runs of a round pusher that steers a steel square, at full rate."""

    name = DATASET
    title = "MIT pusher-slider: feedback control of a pushed square (2016)"
    licence = "none stated; reference use only"
    citation = "F. Hogan, A. Rodriguez, Feedback control of the pusher-slider system, WAFR 2016"

    def recognised(self, source: Path) -> bool:
        """Whether a folder has cpush_*.csv.gz and shapes.json."""
        return (source / SHAPES).is_file() and next(source.glob(RUNS), None) is not None

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        files = {path.name.split(".")[0]: path for path in sorted(source.glob(RUNS))}
        if not files:
            raise DatasetMissing(source, f"{RUNS} and {SHAPES}")
        runs = tuple(run for run in mit_timeseries.read(source).runs if run.name in files)
        origin = Origin()

        def make() -> Iterator[Experiment]:
            for run in runs:
                yield _experiment(run, files[run.name], origin)

        return ImportPlan(DATASET, source, _understood(runs), len(runs), make)


def _understood(runs: tuple[PushRun, ...]) -> tuple[str, ...]:
    readings = sum(run.readings for run in runs)
    rates = [rate_of(run.object.time) for run in runs]
    return (
        f"{len(runs)} runs, {readings} rows; repeated readings are dropped, which leaves poses at"
        f" about {np.median(rates):.0f} Hz. How many rows there were is a condition.",
        "Times in s from the first row, m and rad as they stand, in the frame of the robot.",
        "Controller outputs and commanded positions are channels with every row.",
        f"Scenes: a 90 mm square of {DENSITY:g} kg/m^3, 13 mm thick, even pressure, nominal"
        f" friction {MU_PUSHER:g} at the tip and {MU_SUPPORT:g} on the plane; the tip follows its"
        " measured path, from contact where it starts inside the object"
        " (pusher-moved-to-contact).",
        f"Runs in which the tip is more than {-DROPOUT / MM:g} mm inside the object have lost the"
        " tracker for moments (tracking-dropouts).",
    )


def _experiment(run: PushRun, path: Path, origin: Origin) -> Experiment:
    rows = read_table(path)
    refuse_giants(rows, *MEASURED)
    begin = float(run.object.time[0])
    pusher = np.column_stack(
        (run.pusher[:, 0] - begin, run.pusher[:, 1:], np.zeros(len(run.pusher)))
    )
    time = run.object.time - begin
    pose = np.column_stack((run.object.pose[:, :2], np.unwrap(run.object.pose[:, 2])))
    scene, flags = _scene(run, pose, pusher)
    return Experiment(
        dataset=DATASET,
        name=run.name,
        real=True,
        provenance=origin.of(path),
        object_name=OBJECT,
        trajectory=Trajectory(time=time, pose=pose),
        pusher=Trajectory(time=pusher[:, 0], pose=pusher[:, 1:]),
        scene=scene,
        channels=tuple(_channels(rows, rows.numbers("t") - begin)),
        conditions={
            "surface": run.surface,
            "shape": run.shape_name,
            "raw_readings": float(run.readings),
        },
        flags=(*flags, *_dropouts(rows)),
    )


def _channels(rows: CsvRows, time: FloatArray) -> Iterator[Channel]:
    if {"pusher_cmd_x", "pusher_cmd_y"} <= set(rows.columns):
        yield Channel(
            name="commanded",
            time=time,
            columns=("x_m", "y_m"),
            values=rows.stacked("pusher_cmd_x", "pusher_cmd_y", blank=True),
        )
    if {"u0", "u1"} <= set(rows.columns):
        # The meaning of the two outputs, and so their unit, was not documented.
        yield Channel(
            name="controller",
            time=time,
            columns=("u0_ratio", "u1_ratio"),
            values=rows.stacked("u0", "u1", blank=True),
        )


def _dropouts(rows: CsvRows) -> Iterator[Flag]:
    if "gap_mm" not in rows.columns:
        return
    gap = rows.numbers("gap_mm", blank=True) * MM
    lost = int((gap < DROPOUT).sum())
    if lost:
        yield Flag(
            "tracking-dropouts",
            f"in {lost} of {len(gap)} rows the tip is more than {-DROPOUT / MM:g} mm inside the"
            f" object, at most {-float(np.nanmin(gap)) / MM:.2g} mm",
        )


def _scene(
    run: PushRun, pose: FloatArray, pusher: FloatArray
) -> tuple[Scene | None, tuple[Flag, ...]]:
    deep, offset = moved_to_contact(run.shape, run.pusher_radius, pose[:1], pusher[:1, 1:3])
    gap = float(deep[0])
    if gap < -MAX_CORRECTION:
        return None, (remark("no-scene", f"the tip starts {-gap / MM:.3g} mm inside the object"),)
    path = corrected_path(pusher, offset[0], FADE)

    def build() -> Scene:
        return Scene(
            bodies=(
                Body(
                    name=OBJECT,
                    shape=run.shape,
                    mass=DENSITY * THICKNESS * run.shape.area,
                    pose=pose[0],
                    support=UniformPressure(friction=MU_SUPPORT),
                ),
            ),
            pushers=(
                Pusher(
                    name=PUSHER,
                    shape=Disk(run.pusher_radius),
                    pose=path[0, 1:],
                    drive=PathDrive(waypoints=path),
                    friction=MU_PUSHER,
                ),
            ),
            duration=float(path[-1, 0]),
        )

    scene, flags = scene_or_flag(build)
    return scene, (*flags, correction_flag(gap)) if scene and gap < 0.0 else flags
