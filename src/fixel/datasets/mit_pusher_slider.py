"""Importer of the pusher-slider runs of MIT's MCube laboratory: a square pushed along a line.

Source: F. Hogan, A. Rodriguez (2016), Feedback control of the pusher-slider system, WAFR.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.datasets import files as tables
from fixel.datasets.base import Importer, ImportPlan, collected, origin_of, remark, trajectory_of
from fixel.datasets.contact import FADE, pushed_scene
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import Body, Channel, Disk, Experiment, Flag, Polygon, Trajectory, UniformPressure
from fixel.typing import BoolArray, FloatArray

DATASET: Final = "mit-pusher-slider"
OBJECT = "slider"
SHAPES, RUNS = "shapes.json", "cpush_*.csv*"
OUTLINE = "rect1"

# Friction and mass as in the authors' model of their rig: nominal, not measured.
MU_PUSHER, MU_SUPPORT = 0.3, 0.35
DENSITY, THICKNESS = 10_000.0, 0.013  # [kg/m^3], [m]

# A tip measured deeper in the object than this means that the tracker had lost the object [m].
DROPOUT = -3e-3

# Largest share of such rows in a run whose other rows are used.
MAX_LOST = 0.05

# A reading repeated for longer than this is retained, since the pusher then stands still. The
# sensors refresh every 4 to 7 ms [s].
STANDSTILL = 0.02


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
        files = sorted(source.glob(RUNS))
        if not files or not (source / SHAPES).is_file():
            raise DatasetMissing(source, f"{RUNS} and {SHAPES}")
        shapes = tables.read_json(source / SHAPES)
        tip = Disk(tables.member(shapes, "pusher_radius_m", SHAPES))
        outlines = {name: value for name, value in shapes.items() if isinstance(value, list)}
        if OUTLINE not in outlines:
            found, expected = ", ".join(outlines), f"an outline of {OUTLINE}"
            raise InvalidInput(SHAPES, found=found, expected=expected)
        shape = Polygon(np.asarray(outlines[OUTLINE], dtype=np.float64))
        runs: list[_Run] = []
        problems: tables.Problems = {}
        for path in files:
            with collected(problems, f"{DATASET}/{_stem(path)}", path.name):
                runs.append(_read(path))
        if not runs:
            raise next(iter(problems.values()))
        return ImportPlan(
            DATASET,
            source,
            _understood(runs),
            [f"{DATASET}/{_stem(run.path)}" for run in runs],
            lambda k: _experiment(runs[k], shape, tip),
            problems,
        )


class _Run(NamedTuple):
    """Readings of one run, on the clock of its file."""

    path: Path
    table: tables.CsvRows
    time: FloatArray  # (n,) [s] of every row
    object: FloatArray  # (k, 4) time and pose, one row per sound reading [s, m, m, rad]
    pusher: FloatArray  # (m, 3) time and centre of the tip, one row per new reading [s, m, m]
    gap: FloatArray  # (n,) from the tip to the object, where the table has it, else NaN [m]
    lost: BoolArray  # (n,) rows in which the tracker had lost the object


def _read(path: Path) -> _Run:
    table = tables.read_table(path)
    time = tables.increasing(table.numbers("t"), table.source)
    pose = np.column_stack((time, table.stacked("slider_x", "slider_y", "slider_th")))
    tip = np.column_stack((time, table.stacked("pusher_x", "pusher_y")))
    known = "gap_mm" in table.columns
    gap = table.numbers("gap_mm", blank=True) * tables.MM if known else np.full(len(time), np.nan)
    lost = gap < DROPOUT
    # A run that was lost as a whole is imported as it is, with a fault.
    sound = _new_readings(pose) & ~(lost if lost.mean() <= MAX_LOST else np.zeros_like(lost))
    return _Run(path, table, time, pose[sound], tip[_new_readings(tip)], gap, lost)


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _new_readings(rows: FloatArray) -> BoolArray:
    """Mask of rows with a new reading: a changed value, or the last row of a standstill.

    Rows after the last change are not new: in every run the tracker stops a tenth of a second
    before the pusher does.
    """
    changed = np.append(True, (np.diff(rows[:, 1:], axis=0) != 0.0).any(axis=1))
    row = np.flatnonzero(changed)
    # The last row of a standstill, just before a change, is new information too.
    changed[row[1:][np.diff(rows[row, 0]) > STANDSTILL] - 1] = True
    return changed


def _understood(runs: list[_Run]) -> tuple[str, ...]:
    readings = sum(len(run.time) for run in runs)
    rates = [tables.rate_of(run.object[:, 0]) for run in runs]
    return (
        f"{len(runs)} runs, {readings} rows; repeated readings are dropped, which leaves poses at"
        f" about {np.median(rates):.0f} Hz. How many rows there were is a condition.",
        "Times in s from the first row, m and rad as they stand, in the frame of the robot.",
        "Controller outputs and commanded positions are channels with every row.",
        f"Scenes: a 90 mm square of {DENSITY:g} kg/m^3, 13 mm thick, even pressure, nominal"
        f" friction {MU_PUSHER:g} at the tip and {MU_SUPPORT:g} on the plane; the tip follows its"
        " measured path, from contact where it starts inside the object"
        " (pusher-moved-to-contact).",
        f"Where the tip is more than {-DROPOUT / tables.MM:g} mm inside the object, the tracker had"
        f" lost it: these rows are left out; runs with more than {100 * MAX_LOST:g} % of them have"
        " a fault (tracking-dropouts).",
    )


def _experiment(run: _Run, shape: Polygon, tip: Disk) -> Experiment:
    begin = run.object[0, 0]
    track = trajectory_of(run.object[:, 0] - begin, run.object[:, 1:])
    path = np.column_stack((run.pusher[:, 0] - begin, run.pusher[:, 1:], np.zeros(len(run.pusher))))
    body = Body(
        name=OBJECT,
        shape=shape,
        mass=DENSITY * THICKNESS * shape.area,
        pose=track.pose[0],
        support=UniformPressure(friction=MU_SUPPORT),
    )
    scene, flags = pushed_scene(body, tip, path, friction=MU_PUSHER, fade=FADE)
    return Experiment(
        dataset=DATASET,
        name=_stem(run.path),
        real=True,
        provenance=origin_of(run.path),
        object_name=OBJECT,
        trajectory=track,
        pusher=Trajectory(time=path[:, 0], pose=path[:, 1:]),
        scene=scene,
        channels=tuple(_channels(run.table, run.time - begin)),
        conditions={
            "surface": "plywood" if "plywood" in run.path.name.lower() else "unknown",
            "shape": OUTLINE,
            "raw_readings": float(len(run.time)),
        },
        flags=(*flags, *_dropouts(run)),
    )


def _channels(rows: tables.CsvRows, time: FloatArray) -> Iterator[Channel]:
    for name, titles, columns in (
        ("commanded", ("pusher_cmd_x", "pusher_cmd_y"), ("x_m", "y_m")),
        # The meaning of the two outputs, and so their unit, was not documented.
        ("controller", ("u0", "u1"), ("u0_ratio", "u1_ratio")),
    ):
        if {*titles} <= {*rows.columns}:
            values = rows.stacked(*titles, blank=True)
            yield Channel(name=name, time=time, columns=columns, values=values)


def _dropouts(run: _Run) -> Iterator[Flag]:
    """Yield a flag if the tracker had lost the object; a fault if for a large share of the run."""
    n, lost = len(run.gap), int(run.lost.sum())
    if not lost:
        return
    deepest = -float(np.nanmin(run.gap)) / tables.MM
    found = (
        f"{lost} of {n} rows ({100.0 * lost / n:.2g} %): the tip is more than"
        f" {-DROPOUT / tables.MM:g} mm inside the object there, at most {deepest:.2g} mm"
    )
    if lost > MAX_LOST * n:
        yield Flag("tracking-dropouts", found)
    else:
        yield remark("tracking-dropouts", f"left out {found}")
