"""Replay of full-rate runs (`mit_timeseries`) in windows, each from its measured start."""

from __future__ import annotations

import time as clock
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fixel.datasets.contact import moved_to_contact
from fixel.datasets.raw.mit_timeseries import PushRun, PushRuns
from fixel.errors import InvalidInput
from fixel.kernels.codes import CONVERGED, STATUS_NAMES
from fixel.model import (
    Body,
    Disk,
    LineDrive,
    Pusher,
    Scene,
    UniformPressure,
    pose_error,
)
from fixel.reproductions.charts.replay import WindowCurve, WindowPicture
from fixel.reproductions.replay.choose import (
    ReplayRequest,
    matching,
    motion_named,
    settings_from,
    spread,
)
from fixel.reproductions.replay.report import Replay, Row, Timing, mean_and_median, rms
from fixel.simulation import AbstractMotionModel, BatchResult, simulate_batch
from fixel.typing import FloatArray, Progress

# Friction as in the authors' model of their rig; masses of 13 mm steel plates: with the authors'
# 10000 kg/m^3 for rect1, and from the MIT push dataset for the hexagon.
NOMINAL = {"mu_pusher": 0.3, "mu_support": 0.35, "support_points": 64}
MASSES = {"rect1": 10_000.0 * 0.09 * 0.09 * 0.013, "hex": 0.983}

GRAVITY = 9.81  # [m/s^2]

# Inertia matters if a released object would slide farther than this [m].
MAX_COAST = 1e-3

# A window is left out if the tip starts deeper in the object than this (tracking lost), or is
# farther from it than this for half of the time (nothing is pushed) [m].
DEEPEST, FARTHEST = 2e-3, 2e-3

# Time between errors in the output; aggregates use every measured time [s].
WRITTEN_EVERY = 0.1


class RunWindow(NamedTuple):
    """Window of a run; times count from its start."""

    run: PushRun
    number: int
    begin: float  # [s] on the clock of the run
    duration: float
    waypoints: FloatArray  # (n, 4)
    start: FloatArray  # (3,)
    time: FloatArray  # (n_sample,) times with a measured pose
    measured: FloatArray  # (n_sample, 3)
    gap: FloatArray  # (n,) gap of the tip at the waypoints [m]


class WindowOutcome(NamedTuple):
    """Simulation of one window, with its errors."""

    window: RunWindow
    motion: str
    status: int
    pose: FloatArray  # (n_sample, 3)
    position: FloatArray  # (n_sample,) error [m]
    angle: FloatArray  # (n_sample,) absolute error [rad]


def replay_runs(
    data: PushRuns, choice: ReplayRequest, progress: Progress, reading: float = 0.0
) -> Replay:
    """Simulate the measured path of the pusher, window by window.

    Parameters
    ----------
    data : PushRuns
    choice : ReplayRequest
    progress : callable
    reading : float
        Time spent on reading the data [s].
    """
    begun = clock.perf_counter()
    settings = settings_from(NOMINAL, choice.settings)
    if not 0.0 <= choice.window < np.inf:
        raise InvalidInput("--window", found=choice.window, expected="seconds, or 0 for whole runs")
    columns = {
        "run": [run.name for run in data.runs],
        "surface": [run.surface for run in data.runs],
        "shape": [run.shape_name for run in data.runs],
    }
    fits = matching(columns, choice.select, len(data.runs))
    runs = [run for run, wanted in zip(data.runs, fits, strict=True) if wanted]
    windows = [window for run in runs for window in cut(run, choice.window)]
    reasons = [None if choice.everything else doubt(window) for window in windows]
    left_out = Counter(reason for reason in reasons if reason)
    windows = [w for w, reason in zip(windows, reasons, strict=True) if not reason]
    windows = [windows[k] for k in spread(len(windows), choice.limit)]
    if not windows:
        raise InvalidInput(
            "--select",
            found="only windows of doubtful quality",
            expected="others",
            hint="try --all",
        )
    started = clock.perf_counter()
    _outcome(windows[0], settings, choice)
    compiling = clock.perf_counter() - started
    outcomes = []
    started = clock.perf_counter()
    for count, window in enumerate(windows):
        outcomes.append(_outcome(window, settings, choice))
        progress(count + 1, len(windows), window.run.name)
    simulation = clock.perf_counter() - started
    solved = [outcome for outcome in outcomes if outcome.status == CONVERGED]
    total = clock.perf_counter() - begun + reading
    return Replay(
        dataset=data.name,
        pushes=[_row(outcome) for outcome in outcomes],
        groups=_aggregates(solved),
        left_out=dict(left_out),
        not_solved=len(outcomes) - len(solved),
        settings={**settings, "motion": choice.motion or "by speed", "window_s": choice.window},
        notes=_notes(runs, left_out),
        timing=Timing(reading, compiling, simulation, total, len(windows)),
        picture=_picture(outcomes),
    )


def cut(run: PushRun, length: float) -> list[RunWindow]:
    """Cut a run into equal windows of about a given length [s]; 0 for one window."""
    begin = max(float(run.pusher[0, 0]), float(run.object.time[0]))
    end = min(float(run.pusher[-1, 0]), float(run.object.time[-1]))
    if end <= begin:
        raise InvalidInput(run.name, found="no common time of pusher and object", expected="some")
    n = max(1, round((end - begin) / length)) if length > 0.0 else 1
    borders = np.linspace(begin, end, n + 1)
    return [
        _window(run, number, low, high)
        for number, (low, high) in enumerate(pairwise(borders.tolist()))
    ]


def doubt(window: RunWindow) -> str | None:
    """Reason why a window is useless for pushing; None if it is useful."""
    if window.gap[0] < -DEEPEST:
        return "tip starts more than 2 mm inside the object: tracking lost"
    if np.median(window.gap) > FARTHEST:
        return "tip more than 2 mm from the object for half of the time"
    return None


def usual_motion(run: PushRun, mu_support: float) -> str:
    """Motion model: dynamic if a released object would slide more than 1 mm, else quasi-static."""
    way = float(np.hypot(*np.diff(run.pusher[:, 1:], axis=0).T).sum())
    speed = run.commanded_speed or way / float(np.ptp(run.pusher[:, 0]))
    coast = speed**2 / (2.0 * mu_support * GRAVITY) if mu_support > 0.0 else np.inf
    return "dynamic" if coast > MAX_COAST else "quasistatic"


def _window(run: PushRun, number: int, begin: float, end: float) -> RunWindow:
    instants = run.pusher[:, 0]
    inner = instants[(instants > begin) & (instants < end)]
    time = np.concatenate(([begin], inner, [end]))
    tip = np.column_stack([np.interp(time, instants, column) for column in run.pusher.T[1:]])
    seen = run.object.time[(run.object.time > begin) & (run.object.time <= end)]
    return RunWindow(
        run=run,
        number=number,
        begin=begin,
        duration=end - begin,
        waypoints=np.column_stack((time - begin, tip, np.zeros(len(time)))),
        start=run.object.at(begin),
        time=seen - begin,
        measured=run.object.at(seen),
        gap=moved_to_contact(run.shape, run.pusher_radius, run.object.at(time), tip)[0],
    )


def _outcome(window: RunWindow, settings: dict[str, float], choice: ReplayRequest) -> WindowOutcome:
    motion = motion_named(choice.motion or usual_motion(window.run, settings["mu_support"]))
    result = _simulate(window, settings, motion)
    pose = result.pose_of("object")[0]
    position, angle = pose_error(pose, window.measured)
    return WindowOutcome(window, motion.name, int(result.status[0]), pose, position, np.abs(angle))


def _simulate(
    window: RunWindow, settings: dict[str, float], motion: AbstractMotionModel
) -> BatchResult:
    run = window.run
    way = float(np.hypot(*np.diff(window.waypoints[:, 1:3], axis=0).T).sum())
    # Measured starts may overlap, due to noise of the tracker. Therefore the template's pusher is
    # clear of the object; start and path are variations, which the first step separates.
    template = Scene(
        bodies=(
            Body(
                name="object",
                shape=run.shape,
                mass=MASSES.get(run.shape_name, 1.0),
                pose=(0.0, 0.0, 0.0),  # type: ignore[arg-type]
                support=UniformPressure(
                    friction=settings["mu_support"], n_points=int(settings["support_points"])
                ),
            ),
        ),
        pushers=(
            Pusher(
                name="pusher",
                shape=Disk(run.pusher_radius),
                pose=(1.0, 0.0, 0.0),  # type: ignore[arg-type]
                drive=LineDrive(
                    direction=(1.0, 0.0),  # type: ignore[arg-type]
                    speed=way / window.duration,
                ),
                friction=settings["mu_pusher"],
            ),
        ),
        gravity=GRAVITY,
        duration=window.duration,
    )
    result = simulate_batch(
        template,
        start=window.start[None],
        waypoints=window.waypoints[None],
        motion=motion,
        times=window.time,
    )
    assert isinstance(result, BatchResult)
    return result


def _row(outcome: WindowOutcome) -> Row:
    window = outcome.window
    travel = np.diff(np.vstack((window.start, window.measured))[:, :2], axis=0)
    written = np.searchsorted(
        window.time, np.arange(1, 1 + round(window.duration / WRITTEN_EVERY)) * WRITTEN_EVERY
    )
    written = np.unique(np.append(written[written < len(window.time)], len(window.time) - 1))
    return {
        "run": window.run.name,
        "surface": window.run.surface,
        "shape": window.run.shape_name,
        "window": window.number,
        "begin_s": window.begin,
        "duration_s": window.duration,
        "motion": outcome.motion,
        "status": STATUS_NAMES[outcome.status],
        "moved_mm": float(np.hypot(*(window.measured[-1] - window.start)[:2])) * 1e3,
        "way_mm": float(np.hypot(*travel.T).sum()) * 1e3,
        "position_mm_rms": rms(outcome.position) * 1e3,
        "position_mm_final": float(outcome.position[-1]) * 1e3,
        "angle_deg_rms": float(np.degrees(rms(outcome.angle))),
        "angle_deg_final": float(np.degrees(outcome.angle[-1])),
        "error": {
            "time_s": window.time[written],
            "position_mm": outcome.position[written] * 1e3,
            "angle_deg": np.degrees(outcome.angle[written]),
        },
    }


def _aggregates(outcomes: list[WindowOutcome]) -> list[Row]:
    names = list(dict.fromkeys(outcome.window.run.name for outcome in outcomes))
    groups = [(name, [o for o in outcomes if o.window.run.name == name]) for name in names]
    if len(groups) > 1:
        groups.append(("all", outcomes))
    return [{"run": name, **_aggregate(own)} for name, own in groups]


def _aggregate(outcomes: list[WindowOutcome]) -> Row:
    rows = [_row(outcome) for outcome in outcomes]
    return {
        "windows": len(rows),
        "motion": " and ".join(sorted({outcome.motion for outcome in outcomes})),
        "moved_mm": mean_and_median([row["moved_mm"] for row in rows]),
        "position_mm_rms": rms(np.concatenate([o.position for o in outcomes])) * 1e3,
        "angle_deg_rms": float(np.degrees(rms(np.concatenate([o.angle for o in outcomes])))),
        "position_mm_final": mean_and_median([row["position_mm_final"] for row in rows]),
        "angle_deg_final": mean_and_median([row["angle_deg_final"] for row in rows]),
    }


def _notes(runs: list[PushRun], left_out: Counter[str]) -> list[str]:
    readings = sum(run.readings for run in runs)
    kept = sum(len(run.pusher) for run in runs)
    notes = [
        f"Pusher paths: {kept} of {readings} rows say something new; repeated readings were"
        " dropped, nothing was smoothed.",
        "A run ends with the last new reading of the object; the tracker stops before the pusher.",
        "Each window starts at the measured pose, at rest.",
    ]
    notes += [
        f"Left out: {n} windows, {reason} (--all keeps them)." for reason, n in left_out.items()
    ]
    return notes


def _picture(outcomes: list[WindowOutcome]) -> WindowPicture:
    return WindowPicture(
        [
            WindowCurve(
                run=outcome.window.run.name,
                time=outcome.window.begin + outcome.window.time,
                measured=outcome.window.measured,
                simulated=outcome.pose,
                position=outcome.position,
                angle=outcome.angle,
            )
            for outcome in outcomes
        ]
    )
