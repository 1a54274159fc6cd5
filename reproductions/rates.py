"""Errors relative to the motion and size of objects, compared with those of the ASME paper.

The paper calls a simulation good with an RMS error of 20 um over 600 um of motion, and angles
within 1 to 3 degrees of the measured ones. Errors of rigs of other sizes are comparable only as
shares of the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import LeastSquares
from fixel.calibration.target import target_of
from fixel.errors import DatasetMissing
from fixel.model import Disk, Shape, pose_error
from fixel.replay import ReplayRequest, replay_dataset
from fixel.replay.base import Row
from fixel.replay.runs import read_runs
from fixel.typing import FloatArray
from reproductions import cmu_tripod, rpi_141
from reproductions.charts.error_bounds import rates_figure
from reproductions.protocols import calibrated_bench, full_fit
from reproductions.result import Reproduction, RunOptions
from reproductions.tripod_pushes import TripodPush, comparer_of, read_pushes, support_of

PAPER_RMS, PAPER_MOTION = 20e-6, 600e-6  # [m]
PAPER_RATE: Final = PAPER_RMS / PAPER_MOTION
PAPER_ANGLE: Final = (1.0, 3.0)  # [deg]
# Hypotheses that use no more information than was recorded.
RPI_SHOWN: Final = ("as recorded", "push above the plane, friction")
NOTHING: Final = "nothing fitted"
NOT_SIMULATED: Final = {
    "cmu_two_point_push": "masses and support points of the blocks were not recorded, and the"
    " fingers' frame is off by millimetres: there is no scene to simulate"
}


class RateErrors(NamedTuple):
    """Errors of one simulator on one dataset; one entry for each push, window or frame."""

    dataset: str
    simulator: str
    compared: str  # kind of poses that are compared
    position: FloatArray  # (n,) [m]
    angle: FloatArray  # (n,) absolute [rad]
    motion: float  # mean motion of the object [m]
    size: float  # mean of the largest extent of the object [m]


def run(options: RunOptions) -> Reproduction:
    """Compute errors on each dataset in the folder, as shares of motion and size.

    Missing datasets are reported as left out. With `quick`, it uses few pushes of each dataset.
    """
    rows: list[Row] = []
    missing = []
    for k, (name, errors_of) in enumerate(DATASETS.items()):
        own = replace(options, folder=options.folder / name)
        if own.folder.is_dir():
            rows += [_row(errors) for errors in errors_of(own)]
        else:
            missing.append(name)
        options.progress(k + 1, len(DATASETS), name)
    if not rows:
        raise DatasetMissing(options.folder, " or ".join(DATASETS))
    left_out = [{"dataset": name, "reason": "not in the folder"} for name in missing]
    left_out += [{"dataset": name, "reason": why} for name, why in NOT_SIMULATED.items()]
    return Reproduction(
        tables={"rates": rows, "left_out": left_out},
        conclusions=_conclusions(rows, left_out),
        settings={"quick": options.quick, "paper_rms_over_motion": PAPER_RATE},
        figure=partial(rates_figure, rows, PAPER_RATE, PAPER_ANGLE),
    )


def _row(own: RateErrors) -> Row:
    position = float(np.sqrt(np.mean(own.position**2)))
    middle = float(np.median(own.position))
    return {
        "dataset": own.dataset,
        "simulator": own.simulator,
        "judged_on": own.compared,
        "count": len(own.position),
        "position_mm_rms": 1e3 * position,
        "position_mm_median": 1e3 * middle,
        "motion_mm": 1e3 * own.motion,
        "size_mm": 1e3 * own.size,
        "rms_over_motion": position / own.motion,
        "median_over_motion": middle / own.motion,
        "rms_over_size": position / own.size,
        "angle_deg_rms": float(np.degrees(np.sqrt(np.mean(own.angle**2)))),
        "angle_deg_median": float(np.degrees(np.median(own.angle))),
    }


def extent(shape: Shape) -> float:
    """Largest distance between two points of an outline [m]."""
    if isinstance(shape, Disk):
        return 2.0 * shape.radius
    points = shape.outline
    return float(np.linalg.norm(points[:, None] - points[None], axis=2).max())


# --- datasets -----------------------------------------------------------------------------------


def _mit(options: RunOptions) -> Iterator[RateErrors]:
    bench = calibrated_bench(options, 3)
    parts: dict[str, list[tuple[FloatArray, FloatArray]]] = {NOTHING: [], "calibrated": []}
    motion, size = [], []
    for key in bench.rows:
        group = bench.group(key)
        for k, split in enumerate(bench.splits(key)):
            held = split.held_out
            found = full_fit(bench, group, k, split).predict(group, held)
            nominal = np.where(group.nominal.good[held, None], group.nominal.end[held], np.nan)
            for name, end in ((NOTHING, nominal), ("calibrated", found)):
                good = np.isfinite(end).all(axis=1)
                position, angle = pose_error(end[good], group.end[held][good])
                parts[name].append((position, np.abs(angle)))
            motion.append(np.hypot(*(group.end[held] - group.start[held]).T[:2]))
            size.append(np.full(len(held), extent(group.shape)))
    for name, own in parts.items():
        yield RateErrors(
            "mit_push_endpoints", name, "ends of held-out pushes",
            np.concatenate([p for p, _ in own]), np.concatenate([a for _, a in own]),
            float(np.concatenate(motion).mean()), float(np.concatenate(size).mean()),
        )  # fmt: skip


def _timeseries(options: RunOptions) -> Iterator[RateErrors]:
    choice = ReplayRequest(limit=4 if options.quick else None)
    pushes = [
        row for row in replay_dataset(options.folder, choice).pushes if row["status"] == "converged"
    ]
    size = {
        run.name: extent(run.scene.bodies[0].shape)
        for run in read_runs(options.folder)
        if run.scene
    }
    yield RateErrors(
        "mit_timeseries", NOTHING, "RMS of 2 s windows, each from its measured start",
        1e-3 * np.array([row["position_mm_rms"] for row in pushes]),
        np.radians([row["angle_deg_rms"] for row in pushes]),
        1e-3 * float(np.mean([row["way_mm"] for row in pushes])),
        float(np.mean([size[row["run"]] for row in pushes])),
    )  # fmt: skip


def _tripod(options: RunOptions) -> Iterator[RateErrors]:
    pushes = [
        p for p in read_pushes(options.folder, 6 if options.quick else 1) if "3pts" in support_of(p)
    ]
    train, test = pushes[::2], pushes[1::2]
    nominal = cmu_tripod.shared_space().nominal
    search = LeastSquares(starts=1, most_iterations=5 if options.quick else 20)
    yield _of_tripod(test, nominal, f"{NOTHING}, machined supports known")
    point = cmu_tripod.fit_shared(train, search)
    yield _of_tripod(test, point, "calibrated, machined supports known")


def _of_tripod(pushes: Sequence[TripodPush], point: FloatArray, simulator: str) -> RateErrors:
    n = len(pushes)
    comparer = comparer_of(pushes, cmu_tripod.shared_space())
    difference, good, _ = comparer.differences(np.arange(n), np.tile(point, (n, 1)))
    end = difference[good, -1]
    bodies = [p.target.case.scene.bodies[0] for p in pushes]
    moved = [p.target.pose[-1] - b.pose for p, b in zip(pushes, bodies, strict=True)]
    return RateErrors(
        "cmu_tripod_push", simulator, "ends of every second push",
        np.hypot(end[:, 0], end[:, 1]), np.abs(end[:, 2]),
        float(np.hypot(*np.array(moved).T[:2]).mean()), extent(bodies[0].shape),
    )  # fmt: skip


def _rpi(options: RunOptions) -> Iterator[RateErrors]:
    experiment = rpi_141.experiment_141(options.folder)
    for hypothesis in rpi_141.HYPOTHESES:
        if hypothesis.name not in RPI_SHOWN:
            continue
        own = experiment
        for change in hypothesis.changes:
            own = change(own)
        target = target_of(own)
        every = np.ones(len(target.pose), bool)
        found = rpi_141.fit_hypothesis(target, hypothesis, every, 1 if options.quick else 3)
        body = target.case.scene.bodies[0]
        steps = np.diff(np.vstack((body.pose, target.pose))[:, :2], axis=0)
        fitted = "calibrated to this very run" if hypothesis.fitted else "recorded parameters"
        yield RateErrors(
            "rpi_2dgad", f"{fitted} ({hypothesis.name})", "frames of experiment 141",
            np.hypot(found.difference[:, 0], found.difference[:, 1]),
            np.abs(found.difference[:, 2]),
            float(np.hypot(*steps.T).sum()), extent(body.shape),
        )  # fmt: skip


DATASETS: Final[dict[str, Callable[[RunOptions], Iterator[RateErrors]]]] = {
    "mit_push_endpoints": _mit,
    "mit_timeseries": _timeseries,
    "cmu_tripod_push": _tripod,
    "rpi_2dgad": _rpi,
}


def _conclusions(rows: Sequence[Row], left_out: Sequence[Row]) -> list[str]:
    sentences = [
        f"{row['dataset']}, {row['simulator']}: {row['position_mm_rms']:.2f} mm RMS over"
        f" {row['motion_mm']:.1f} mm of motion ({100 * row['rms_over_motion']:.1f} %; median"
        f" {100 * row['median_over_motion']:.1f} %), {100 * row['rms_over_size']:.1f} % of an"
        f" object of {row['size_mm']:.0f} mm; {row['angle_deg_rms']:.1f} deg RMS, median"
        f" {row['angle_deg_median']:.1f}."
        for row in rows
    ]
    sentences.append(
        f"The paper: 20 um RMS over 600 um of motion ({100 * PAPER_RATE:.1f} %), 1 to 3 deg."
    )
    return sentences + [f"Left out: {row['dataset']}, {row['reason']}." for row in left_out]
