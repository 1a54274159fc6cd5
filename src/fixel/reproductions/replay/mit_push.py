"""Replay of straight pushes with known start and end (`mit_push_endpoints`), group by group."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.raw.mit_push import PUSHER_RADIUS, STROKE, MitPushes, mass_of
from fixel.errors import InvalidInput
from fixel.kernels.codes import CONVERGED, STATUS_NAMES
from fixel.model import (
    Body,
    Disk,
    LineDrive,
    Pusher,
    Scene,
    Shape,
    UniformPressure,
    pose_error,
)
from fixel.reproductions.charts.replay import PushExample, PushPicture
from fixel.reproductions.replay.choose import (
    ReplayRequest,
    matching,
    motion_named,
    settings_from,
    spread,
)
from fixel.reproductions.replay.report import Replay, Row, Timing, mean_and_median
from fixel.simulation import AbstractMotionModel, BatchResult, simulate_batch
from fixel.typing import FloatArray, Progress

# Nothing is fitted: friction at the tip as in the published simulator, even pressure. Friction of
# the plane has no effect on quasi-static motion.
NOMINAL = {"mu_pusher": 0.25, "mu_support": 0.3, "support_points": 64}

# Larger values mean that a record contradicts its own geometry (the dataset's README) [m].
LARGEST_GAP = 3e-3
MAX_STROKE_ERROR = 1e-3

# Quantiles of the error at which pushes are drawn as examples.
EXAMPLES_AT = (0.25, 0.5, 0.75, 0.9)

CLEAR_DISTANCE = 1.0  # place of the template's pusher, clear of the object [m]


def replay_pushes(
    data: MitPushes, choice: ReplayRequest, progress: Progress, reading: float = 0.0
) -> Replay:
    """Simulate recorded pushes from their measured start along their measured stroke.

    Parameters
    ----------
    data : MitPushes
    choice : ReplayRequest
    progress : callable
    reading : float
        Time spent on reading the data [s].
    """
    begun = clock.perf_counter()
    settings = settings_from(NOMINAL, choice.settings)
    motion = motion_named(choice.motion or "quasistatic")
    chosen, left_out = _usable(data, choice)
    groups = _groups(data, chosen)
    parts = [(key, rows, scene_of(data, key, settings)) for key, rows in groups.items()]

    started = clock.perf_counter()
    run_group(data, parts[0][1][:1], parts[0][2], motion)
    compiling = clock.perf_counter() - started

    end = np.full((len(data), 3), np.nan)
    status = np.zeros(len(data), dtype=np.int64)
    simulation, done = 0.0, 0
    for key, rows, scene in parts:
        started = clock.perf_counter()
        result = run_group(data, rows, scene, motion)
        simulation += clock.perf_counter() - started
        end[rows] = np.where(result.converged[:, None], result.final[:, 0], np.nan)
        status[rows] = result.status
        done += len(rows)
        progress(done, len(chosen), " ".join((key[0], key[1], f"{key[2]:g} mm/s")))

    ends = {"fixel": end, **data.predictions}
    errors = {name: _errors(predicted, data.end) for name, predicted in ends.items()}
    total = clock.perf_counter() - begun + reading
    return Replay(
        dataset=data.name,
        pushes=_rows(data, chosen, status, end, errors),
        groups=_aggregates(groups, chosen, errors),
        left_out=left_out,
        not_solved=int((status[chosen] != CONVERGED).sum()),
        settings={**settings, "motion": motion.name, "pusher_radius_m": PUSHER_RADIUS},
        notes=_notes(data, chosen, left_out, choice.everything),
        timing=Timing(reading, compiling, simulation, total, len(chosen)),
        picture=_picture(data, chosen, ends, errors),
    )


def scene_of(data: MitPushes, key: tuple[str, str, float], settings: dict[str, float]) -> Scene:
    """Template scene of one surface, shape and speed [mm/s]; starts and strokes vary."""
    _, name, speed = key
    shape = data.shapes[name]
    return Scene(
        bodies=(
            Body(
                name="object",
                shape=shape,
                mass=mass_of(name, shape),
                pose=(0.0, 0.0, 0.0),  # type: ignore[arg-type]
                support=UniformPressure(
                    friction=settings["mu_support"],
                    n_points=_whole("support_points", settings["support_points"]),
                ),
            ),
        ),
        pushers=(
            Pusher(
                name="pusher",
                shape=Disk(PUSHER_RADIUS),
                pose=(CLEAR_DISTANCE, 0.0, 0.0),  # type: ignore[arg-type]
                drive=LineDrive(direction=(1.0, 0.0), speed=speed * 1e-3),  # type: ignore[arg-type]
                friction=settings["mu_pusher"],
            ),
        ),
        duration=STROKE / (speed * 1e-3),
    )


def run_group(
    data: MitPushes, rows: NDArray[np.intp], scene: Scene, motion: AbstractMotionModel
) -> BatchResult:
    """Simulate pushes that share a scene, in one compiled call."""
    waypoints = np.zeros((len(rows), 2, 4))
    waypoints[:, 1, 0] = scene.duration
    waypoints[:, 0, 1:3] = data.tip_start[rows]
    waypoints[:, 1, 1:3] = data.tip_end[rows]
    result = simulate_batch(scene, start=data.start[rows], waypoints=waypoints, motion=motion)
    assert isinstance(result, BatchResult)
    return result


def _whole(name: str, value: float) -> int:
    if value != int(value):
        raise InvalidInput(f"--set {name}", found=value, expected="a whole number")
    return int(value)


def _usable(data: MitPushes, choice: ReplayRequest) -> tuple[NDArray[np.intp], dict[str, int]]:
    """Rows to replay, and numbers of rows left out by reason."""
    fits = matching(data.table.columns, choice.select, len(data))
    astray = (np.abs(data.gap_start) > LARGEST_GAP) | (data.gap_end < -LARGEST_GAP)
    short = np.abs(data.stroke - STROKE) > MAX_STROKE_ERROR
    reasons = {
        "gap at the start beyond 3 mm or at the end below -3 mm": astray,
        "stroke off 50 mm by more than 1 mm": short & ~astray,
    }
    left_out = {}
    if not choice.everything:
        left_out = {reason: int((fits & bad).sum()) for reason, bad in reasons.items()}
        fits &= ~astray & ~short
    rows = np.flatnonzero(fits)
    if not len(rows):
        raise InvalidInput(
            "--select", found="only pushes of doubtful quality", expected="others", hint="try --all"
        )
    return rows[spread(len(rows), choice.limit)], {k: n for k, n in left_out.items() if n}


def _groups(
    data: MitPushes, chosen: NDArray[np.intp]
) -> dict[tuple[str, str, float], NDArray[np.intp]]:
    speeds = np.round(data.speed * 1e3, 6)
    keys = list(zip(data.surface.tolist(), data.shape.tolist(), speeds.tolist(), strict=True))
    return {
        key: np.array([row for row in chosen.tolist() if keys[row] == key], dtype=np.intp)
        for key in sorted({keys[row] for row in chosen.tolist()})
    }


def _errors(predicted: FloatArray, measured: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances of the frames' origins [mm] and absolute angles between them [deg]."""
    position, angle = pose_error(predicted, measured)
    missing = np.isnan(predicted).any(axis=1)
    return position * 1e3, np.where(missing, np.nan, np.degrees(np.abs(angle)))


Errors = dict[str, tuple[FloatArray, FloatArray]]


def _rows(
    data: MitPushes,
    chosen: NDArray[np.intp],
    status: NDArray[np.int64],
    end: FloatArray,
    errors: Errors,
) -> list[Row]:
    names = data.table.text("push_id").tolist()
    surface, shape = data.surface.tolist(), data.shape.tolist()
    return [
        {
            "push_id": names[row],
            "surface": surface[row],
            "shape": shape[row],
            "speed_mm_s": round(float(data.speed[row]) * 1e3, 6),
            "status": STATUS_NAMES[int(status[row])],
            "end": end[row],
            **{
                f"{name}_{what}": float(values[row])
                for name, pair in errors.items()
                for what, values in zip(("position_mm", "angle_deg"), pair, strict=True)
            },
        }
        for row in chosen.tolist()
    ]


def _aggregates(
    groups: dict[tuple[str, str, float], NDArray[np.intp]],
    chosen: NDArray[np.intp],
    errors: Errors,
) -> list[Row]:
    rows: list[Row] = [
        {"surface": surface, "shape": shape, "speed_mm_s": speed, **_aggregate(own, errors)}
        for (surface, shape, speed), own in groups.items()
    ]
    if len(rows) > 1:
        rows.append(
            {"surface": "all", "shape": "all", "speed_mm_s": None, **_aggregate(chosen, errors)}
        )
    return rows


def _aggregate(rows: NDArray[np.intp], errors: Errors) -> Row:
    """Aggregate the errors of every model, on the rows that all models can predict."""
    common = rows[np.all([np.isfinite(pair[0][rows]) for pair in errors.values()], axis=0)]
    return {
        "pushes": len(common),
        **{
            name: {
                "position_mm": mean_and_median(position[common]),
                "angle_deg": mean_and_median(angle[common]),
            }
            for name, (position, angle) in errors.items()
        },
    }


def _notes(
    data: MitPushes, chosen: NDArray[np.intp], left_out: dict[str, int], everything: bool
) -> list[str]:
    notes = ["Errors are mean / median, on the pushes that every model has an answer to."]
    if left_out:
        reasons = "; ".join(f"{n} with {reason}" for reason, n in left_out.items())
        notes.append(f"Left out: {reasons} (--all keeps them).")
    if everything:
        notes.append("Nothing was left out, pushes of doubtful quality included.")
    deep = int((data.gap_start[chosen] < 0.0).sum())
    notes.append(
        f"{deep} pushes start with tip and object overlapping in the measurement, by"
        f" {max(0.0, -1e3 * float(data.gap_start[chosen].min())):.2f} mm at most;"
        " the first step pushes the object out."
    )
    return notes


def _picture(
    data: MitPushes, chosen: NDArray[np.intp], ends: dict[str, FloatArray], errors: Errors
) -> PushPicture:
    own = errors["fixel"][0][chosen]
    order = chosen[np.argsort(np.where(np.isfinite(own), own, np.inf))]
    n = int(np.isfinite(own).sum())
    picked = dict.fromkeys(int(order[min(int(share * n), n - 1)]) for share in EXAMPLES_AT if n)
    return PushPicture(
        position={name: pair[0][chosen] for name, pair in errors.items()},
        angle={name: pair[1][chosen] for name, pair in errors.items()},
        examples=[_example(data, row, ends, errors) for row in picked],
    )


def _example(data: MitPushes, row: int, ends: dict[str, FloatArray], errors: Errors) -> PushExample:
    shape: Shape = data.shapes[str(data.shape[row])]
    shown: dict[str, Any] = {
        name: poses[row]
        for name, poses in ends.items()
        if name in ("fixel", "poly4") and np.isfinite(poses[row]).all()
    }
    return PushExample(
        name=str(data.table.text("push_id")[row]),
        outline=shape.outline,
        start=data.start[row],
        measured=data.end[row],
        predicted=shown,
        tip_start=data.tip_start[row],
        tip_end=data.tip_end[row],
        tip_radius=PUSHER_RADIUS,
        error_mm=float(errors["fixel"][0][row]),
    )
