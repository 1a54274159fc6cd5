"""Replay of full-rate runs (`mit_timeseries`) in windows, each from its measured start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from fixel.datasets.contact import moved_to_contact
from fixel.datasets.mit_push import MitPush
from fixel.datasets.mit_pusher_slider import MU_PUSHER, MU_SUPPORT, MitPusherSlider
from fixel.drawing import palette
from fixel.drawing.chart import clean, sheet
from fixel.errors import InvalidInput
from fixel.model import Disk, Experiment, Scene, pose_error
from fixel.replay import base
from fixel.simulation import simulate_batch
from fixel.simulation.motion import motion_model
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Friction as in the authors' model of their rig.
NOMINAL = {"mu_pusher": MU_PUSHER, "mu_support": MU_SUPPORT, "support_points": 64}

RECORDS = "push_*.json"  # single pushes of the MIT push dataset

GRAVITY = 9.81  # [m/s^2]

# Inertia matters if a released object would slide farther than this [m].
MAX_COAST = 1e-3

# A window is left out if the tip starts deeper in the object than this (tracking lost), or is
# farther from it than this for half of the time (nothing is pushed) [m].
DEEPEST, FARTHEST = 2e-3, 2e-3
NO_SCENE = "run that starts too deep in the object"
NO_READING = "no new reading of the object"

# Time between errors in the output; aggregates use every measured time [s].
WRITTEN_EVERY = 0.1


class RunWindow(NamedTuple):
    """Window of a run; times count from its start."""

    run: Experiment
    scene: Scene
    tip: Disk
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
    status: str
    pose: FloatArray  # (n_sample, 3)
    position: FloatArray  # (n_sample,) error [m]
    angle: FloatArray  # (n_sample,) absolute error [rad]


@final
class RunReplay(base.AbstractReplay):
    """Runs along the measured path of the pusher, window by window."""

    def __init__(self, folder: Path, request: base.ReplayRequest) -> None:
        runs = read_runs(folder)
        self.request = request
        self.settings = base.settings_from(NOMINAL, request.settings)
        if not 0.0 <= request.window < np.inf:
            raise InvalidInput(
                "window", found=request.window, expected="seconds, or 0 for whole runs"
            )
        columns: dict[str, Sequence[object]] = {
            "run": [run.name for run in runs],
            "surface": [run.conditions["surface"] for run in runs],
            "shape": [run.conditions["shape"] for run in runs],
        }
        fits = base.matching(columns, request.select, len(runs))
        self.runs = [run for run, wanted in zip(runs, fits, strict=True) if wanted]
        windows = [w for run in self.runs if run.scene for w in cut(run, run.scene, request.window)]
        usable = doubt if not request.everything else lambda window: None
        reasons = [usable(window) if len(window.time) else NO_READING for window in windows]
        self.left_out = Counter(reason for reason in reasons if reason)
        self.left_out += Counter(NO_SCENE for run in self.runs if not run.scene)
        windows = [w for w, reason in zip(windows, reasons, strict=True) if not reason]
        windows = [windows[k] for k in base.spread(len(windows), request.limit)]
        if not windows:
            raise base.only_doubtful("windows")
        self.parts = [(window.run.name, 1, window) for window in windows]

    def simulate(self, item: RunWindow) -> WindowOutcome:
        """Simulate one window and compare all measured poses."""
        settings = self.settings
        motion = motion_model(self.request.motion or usual_motion(item.run, settings["mu_support"]))
        speed = _length(item.waypoints[:, 1:3]) / item.duration
        result = simulate_batch(
            base.template(item.scene.bodies[0], item.tip, settings, speed, item.duration),
            start=item.start[None],
            waypoints=item.waypoints[None],
            motion=motion,
            times=item.time,
        )
        pose = result["object"].pose[0]
        position, angle = pose_error(pose, item.measured)
        return WindowOutcome(
            item, motion.name, str(result.status[0]), pose, position, np.abs(angle)
        )

    def result(self, outcomes: list[WindowOutcome]) -> base.Replay:
        """List the errors of all windows, and aggregate those of each run."""
        solved = [outcome for outcome in outcomes if outcome.status == "converged"]
        return base.Replay(
            dataset="mit_timeseries",
            pushes=[_row(outcome) for outcome in outcomes],
            groups=_aggregates(solved),
            left_out=dict(self.left_out),
            not_solved=len(outcomes) - len(solved),
            settings={
                **self.settings,
                "motion": self.request.motion or "by speed",
                "window_s": self.request.window,
            },
            notes=_notes(self.runs, self.left_out),
            figure=partial(windows_figure, outcomes),
        )


def read_runs(folder: Path) -> list[Experiment]:
    """Import the runs of a folder, and the single pushes in the same folder."""
    runs = list(MitPusherSlider().read(folder).experiments())
    if next(folder.glob(RECORDS), None) is not None:
        runs += MitPush().read(folder).experiments()
    return runs


def cut(run: Experiment, scene: Scene, length: float) -> list[RunWindow]:
    """Cut a run into equal windows of about a given length [s]; 0 for one window."""
    object_time, pusher_time = run.trajectory.time, _path(run)[:, 0]
    begin = max(float(pusher_time[0]), float(object_time[0]))
    end = min(float(pusher_time[-1]), float(object_time[-1]))
    if end <= begin:
        raise InvalidInput(run.name, found="no common time of pusher and object", expected="some")
    n = max(1, round((end - begin) / length)) if length > 0.0 else 1
    borders = np.linspace(begin, end, n + 1)
    return [
        _window(run, scene, number, low, high)
        for number, (low, high) in enumerate(pairwise(borders.tolist()))
    ]


def doubt(window: RunWindow) -> str | None:
    """Reason why a window is useless for pushing; None if it is useful."""
    if window.gap[0] < -DEEPEST:
        return "tip starts more than 2 mm inside the object: tracking lost"
    if np.median(window.gap) > FARTHEST:
        return "tip more than 2 mm from the object for half of the time"
    return None


def usual_motion(run: Experiment, mu_support: float) -> str:
    """Motion model: dynamic if a released object would slide more than 1 mm, else quasi-static."""
    path = _path(run)
    commanded = float(run.conditions.get("speed_m_s", 0.0))
    speed = commanded or _length(path[:, 1:]) / float(np.ptp(path[:, 0]))
    coast = speed**2 / (2.0 * mu_support * GRAVITY) if mu_support > 0.0 else np.inf
    return "dynamic" if coast > MAX_COAST else "quasistatic"


def _path(run: Experiment) -> FloatArray:
    """Measured path of the tip (n, 3): time [s] and centre [m]."""
    assert run.pusher is not None
    return np.column_stack((run.pusher.time, run.pusher.pose[:, :2]))


def _length(points: FloatArray) -> float:
    """Length of a path through points (n, 2) [m]."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _window(run: Experiment, scene: Scene, number: int, begin: float, end: float) -> RunWindow:
    path, track = _path(run), run.trajectory
    tip = scene.pushers[0].shape
    assert isinstance(tip, Disk)
    inner = path[(path[:, 0] > begin) & (path[:, 0] < end), 0]
    time = np.concatenate(([begin], inner, [end]))
    place = np.column_stack([np.interp(time, path[:, 0], column) for column in path.T[1:]])
    seen = track.time[(track.time > begin) & (track.time <= end)]
    return RunWindow(
        run=run,
        scene=scene,
        tip=tip,
        number=number,
        begin=begin,
        duration=end - begin,
        waypoints=np.column_stack((time - begin, place, np.zeros(len(time)))),
        start=track.at(begin),
        time=seen - begin,
        measured=track.at(seen),
        gap=moved_to_contact(scene.bodies[0].shape, tip.radius, track.at(time), place)[0],
    )


def _row(outcome: WindowOutcome) -> base.Row:
    window = outcome.window
    written = np.searchsorted(
        window.time, np.arange(1, 1 + round(window.duration / WRITTEN_EVERY)) * WRITTEN_EVERY
    )
    written = np.unique(np.append(written[written < len(window.time)], len(window.time) - 1))
    return {
        "run": window.run.name,
        "surface": window.run.conditions["surface"],
        "shape": window.run.conditions["shape"],
        "window": window.number,
        "begin_s": window.begin,
        "duration_s": window.duration,
        "motion": outcome.motion,
        "status": outcome.status,
        "moved_mm": float(np.hypot(*(window.measured[-1] - window.start)[:2])) * 1e3,
        "way_mm": _length(np.vstack((window.start, window.measured))[:, :2]) * 1e3,
        "position_mm_rms": base.rms(outcome.position) * 1e3,
        "position_mm_final": float(outcome.position[-1]) * 1e3,
        "angle_deg_rms": float(np.degrees(base.rms(outcome.angle))),
        "angle_deg_final": float(np.degrees(outcome.angle[-1])),
        "error": {
            "time_s": window.time[written].tolist(),
            "position_mm": (outcome.position[written] * 1e3).tolist(),
            "angle_deg": np.degrees(outcome.angle[written]).tolist(),
        },
    }


def _aggregates(outcomes: list[WindowOutcome]) -> list[base.Row]:
    names = list(dict.fromkeys(outcome.window.run.name for outcome in outcomes))
    groups = [(name, [o for o in outcomes if o.window.run.name == name]) for name in names]
    if len(groups) > 1:
        groups.append(("all", outcomes))
    return [{"run": name, **_aggregate(own)} for name, own in groups]


def _aggregate(outcomes: list[WindowOutcome]) -> base.Row:
    rows = [_row(outcome) for outcome in outcomes]
    return {
        "windows": len(rows),
        "motion": " and ".join(sorted({outcome.motion for outcome in outcomes})),
        "moved_mm": base.mean_and_median([row["moved_mm"] for row in rows]),
        "position_mm_rms": base.rms(np.concatenate([o.position for o in outcomes])) * 1e3,
        "angle_deg_rms": float(np.degrees(base.rms(np.concatenate([o.angle for o in outcomes])))),
        "position_mm_final": base.mean_and_median([row["position_mm_final"] for row in rows]),
        "angle_deg_final": base.mean_and_median([row["angle_deg_final"] for row in rows]),
    }


def _notes(runs: list[Experiment], left_out: Counter[str]) -> list[str]:
    used = [len(run.pusher.time) for run in runs if run.pusher is not None]
    readings = sum(
        int(run.conditions.get("raw_readings", n)) for run, n in zip(runs, used, strict=True)
    )
    return [
        f"Pusher paths: {sum(used)} of {readings} rows are new readings; repeated readings were "
        "dropped, nothing was smoothed.",
        "A run ends with the last new reading of the object; the tracker stops before the pusher.",
        "Each window starts at the measured pose, at rest.",
        *(
            f"Skipped: {n} windows, {reason}"
            + ("." if reason in (NO_SCENE, NO_READING) else " (--all includes them).")
            for reason, n in left_out.items()
        ),
    ]


# --- figure -------------------------------------------------------------------------------------


def windows_figure(outcomes: Sequence[WindowOutcome]) -> Figure:
    """Draw paths and errors of windows, one row per run."""
    names = list(dict.fromkeys(outcome.window.run.name for outcome in outcomes))
    figure = sheet(base.WIDE, 1.25 * max(len(names), 1) + 0.5)
    panels = figure.subplots(max(len(names), 1), 3, squeeze=False, width_ratios=(1.3, 1.0, 1.0))
    for row, name in zip(panels, names, strict=False):
        own = [outcome for outcome in outcomes if outcome.window.run.name == name]
        origin = own[0].window.measured[0, :2]
        for outcome in own:
            window = outcome.window
            time = window.begin + window.time
            for which, pose, width in (
                ("measured", window.measured, 1.6), ("fixel", outcome.pose, 1.0),
            ):  # fmt: skip
                row[0].plot(
                    *((pose[:, :2] - origin).T * 1e3), linewidth=width, **base.style_of(which)
                )
            row[1].plot(time, outcome.position * 1e3, color=palette.BODY, linewidth=1.0)
            row[2].plot(time, np.degrees(outcome.angle), color=palette.BODY, linewidth=1.0)
        short = name.removeprefix("cpush_").removeprefix("StraightLine_2016_10_23_")
        row[0].set_title(short.replace("_", " "), loc="left")
        row[0].set_ylabel("y [mm]")
        row[1].set_ylabel("error [mm]")
        row[2].set_ylabel("error [deg]")
        for axes in row:
            clean(axes)
    panels[-1, 0].set_xlabel("x from the start of the run [mm]")
    panels[-1, 1].set_xlabel("time [s]")
    panels[-1, 2].set_xlabel("time [s]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], frameon=False, ncols=2, loc="outside upper right")
    return figure
