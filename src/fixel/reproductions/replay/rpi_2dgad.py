"""Replay of grasp acquisition trials (`rpi_2dgad`): a square, an actuator and three fixels."""

from __future__ import annotations

import time as clock
from typing import NamedTuple

import numpy as np

from fixel.datasets.raw.rpi_2dgad import FRAME_RATE, LabSimulation, RpiTrial, RpiTrials
from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Disk,
    Fixel,
    Parameters,
    PathDrive,
    Pusher,
    Scene,
    Tripod,
    pose_error,
)
from fixel.reproductions.charts.replay import TrialCurve, TrialPicture
from fixel.reproductions.replay.choose import (
    ReplayRequest,
    matching,
    motion_named,
    settings_from,
    spread,
)
from fixel.reproductions.replay.report import ANGLE_LENGTH, Replay, Row, Timing, rms
from fixel.simulation import Simulation, StewartTrinkle, simulate
from fixel.typing import FloatArray, Progress

GRAVITY = 9.81  # [m/s^2]

# Settings of the laboratory's MATLAB simulator, only to reproduce its stored simulation: gravity of
# 9.810 mm/s^2, friction polygons of 16 directions, steps of one video frame with the driver one
# step ahead (mechanics.md, sections 0 and 2.8).
LAB_GRAVITY = 9.81e-3
LAB_DIRECTIONS = 16
LAB_STEP = 1.0 / FRAME_RATE

OBJECT, ACTUATOR = "object", "actuator"


class ObjectMotion(NamedTuple):
    """Poses of the object in the video frames of a trial."""

    frame: FloatArray  # (n,)
    pose: FloatArray  # (n, 3) [m, m, rad]


def replay_trials(
    data: RpiTrials, choice: ReplayRequest, progress: Progress, reading: float = 0.0
) -> Replay:
    """Simulate the measured actuator path of every complete trial, and compare with the
    laboratory's own simulation.

    Parameters
    ----------
    data : RpiTrials
    choice : ReplayRequest
    progress : callable
    reading : float
        Time spent on reading the data [s].
    """
    begun = clock.perf_counter()
    numbers = [trial.experiment_id for trial in data.trials]
    every = [*numbers, *data.incomplete]
    fits = matching({"experiment_id": every}, choice.select, len(every))
    trials = [
        trial for trial, wanted in zip(data.trials, fits[: len(numbers)], strict=True) if wanted
    ]
    if not trials:
        raise InvalidInput(
            "--select experiment_id",
            found="a trial without actuator path and fixel positions",
            expected="a complete one: " + ", ".join(map(str, numbers)),
        )
    trials = [trials[k] for k in spread(len(trials), choice.limit)]
    rows: list[Row] = []
    pictures: list[TrialPicture] = []
    started = clock.perf_counter()
    _replay_trial(trials[0], choice)
    compiling = clock.perf_counter() - started
    simulation = 0.0
    for count, trial in enumerate(trials):
        started = clock.perf_counter()
        own_rows, picture = _replay_trial(trial, choice)
        simulation += clock.perf_counter() - started
        rows += own_rows
        pictures.append(picture)
        progress(count + 1, len(trials), f"experiment {trial.experiment_id}")
    left_out = int(fits[len(numbers) :].sum())
    total = clock.perf_counter() - begun + reading
    return Replay(
        dataset=data.name,
        pushes=rows,
        groups=[],
        left_out={"no actuator path or fixel positions": left_out} if left_out else {},
        not_solved=sum(row["status"] not in ("converged", "stored") for row in rows),
        settings={
            **{f"experiment_{t.experiment_id}": dict(_parameters(t, choice)[0]) for t in trials},
            "gravity": _parameters(trials[0], choice)[1],
            "motion": choice.motion or "dynamic",
            "angle_length_m": ANGLE_LENGTH,
        },
        notes=_notes(left_out),
        timing=Timing(reading, compiling, simulation, total, len(rows)),
        picture=pictures[0],
    )


def trial_scene(
    trial: RpiTrial,
    start: FloatArray,
    path: FloatArray,
    time: FloatArray,
    parameters: Parameters,
    *,
    gravity: float = GRAVITY,
    support_directions: int | None = None,
) -> Scene:
    """Build the scene of a trial.

    Parameters
    ----------
    trial : RpiTrial
    start : (3,) float64
        Start pose of the object [m, m, rad].
    path : (n, 2) float64
        Path of the actuator [m], at `time` (n,) [s], which starts at 0.
    parameters : Parameters
        Values of all four parameters.
    gravity : float
        Gravitational acceleration [m/s^2].
    support_directions : int, optional
        Directions of friction polygons; by default exact friction discs.
    """
    waypoints = np.column_stack((time, path, np.full(len(path), trial.actuator_angle)))
    origin: FloatArray = np.zeros(2)
    return Scene(
        bodies=(
            Body(
                name=OBJECT,
                shape=trial.object_shape,
                mass=trial.mass,
                inertia=trial.inertia,
                centre_of_mass=origin,
                pose=start,
                support=Tripod(
                    radius=parameters["tripod_radius"], friction=parameters["mu_support"]
                ),
            ),
        ),
        pushers=(
            Pusher(
                name=ACTUATOR,
                shape=trial.actuator_shape,
                pose=waypoints[0, 1:],
                drive=PathDrive(waypoints=waypoints),
                friction=parameters["mu_pusher"],
            ),
        ),
        fixels=tuple(
            Fixel(
                name=f"fixel-{k + 1}",
                shape=Disk(trial.fixel_radius),
                pose=np.append(centre, 0.0),
                friction=parameters["mu_fixel"],
            )
            for k, centre in enumerate(trial.fixels)
        ),
        gravity=gravity,
        duration=float(time[-1]),
        support_directions=support_directions,
    )


def as_the_lab_did(trial: RpiTrial, *, leading: bool = True) -> Simulation:
    """Repeat the laboratory's stored simulation, including its mistakes.

    Parameters
    ----------
    trial : RpiTrial
        Trial with a stored simulation.
    leading : bool
        Whether the driver is a step ahead of the object, as in the laboratory's code.
    """
    lab = _lab(trial)
    path = lab.actuator
    if leading:
        path = np.concatenate((path[1:], 2.0 * path[-1:] - path[-2:-1]))
    time: FloatArray = np.arange(len(path), dtype=np.float64) * LAB_STEP
    scene = trial_scene(
        trial,
        lab.object_pose[0],
        path,
        time,
        trial.parameters,
        gravity=LAB_GRAVITY,
        support_directions=LAB_DIRECTIONS,
    )
    return simulate(scene, stepper=StewartTrinkle(step=LAB_STEP), output_interval=LAB_STEP)


def weighted_error(a: FloatArray, b: FloatArray) -> FloatArray:
    """Distances (n,) of poses, with angles scaled by 35 mm/rad [m]; thesis, section 5.1."""
    position, angle = pose_error(a, b)
    return np.hypot(position, ANGLE_LENGTH * angle)


def contact_mode(touching: list[tuple[str, str]], n_fixel: int) -> int:
    """Contact mode as bits of the touched fixels: fixels 1, 2, 3 have the values 4, 2, 1."""
    names = {name for pair in touching for name in pair}
    return sum(1 << (n_fixel - 1 - k) for k in range(n_fixel) if f"fixel-{k + 1}" in names)


def _lab(trial: RpiTrial) -> LabSimulation:
    if trial.lab is None:
        raise InvalidInput(
            f"experiment {trial.experiment_id}",
            found="no stored simulation",
            expected=f"exp{trial.experiment_id}_author_simulation.csv",
        )
    return trial.lab


def _parameters(trial: RpiTrial, choice: ReplayRequest) -> tuple[Parameters, float]:
    nominal = {**trial.parameters, "gravity": GRAVITY}
    values = settings_from(nominal, choice.settings)
    gravity = values.pop("gravity")
    return Parameters(values), gravity


def _replay_trial(trial: RpiTrial, choice: ReplayRequest) -> tuple[list[Row], TrialPicture]:
    parameters, gravity = _parameters(trial, choice)
    motion = motion_named(choice.motion or "dynamic")
    valid = (trial.frame >= trial.start_frame) & (trial.frame <= trial.end_frame)
    time = trial.time[valid] - trial.time[valid][0]
    measured = ObjectMotion(trial.frame[valid].astype(np.float64), trial.object_pose[valid])
    rows: list[Row] = []
    curves = [TrialCurve("measured", time, measured.pose)]
    for path, label in ((trial.marker, "actuator marker"), (trial.filtered, "smoothed actuator")):
        scene = trial_scene(trial, measured.pose[0], path[valid], time, parameters, gravity=gravity)
        simulation = simulate(scene, motion=motion, output_interval=LAB_STEP)
        reached = time <= simulation.duration * (1.0 + 1e-9)
        pose = simulation.trajectory(OBJECT).at(time)
        row = _row(trial, "fixel", label, "measured", pose[reached], measured.pose[reached])
        row["status"] = simulation.status
        row["contact_mode"] = contact_mode(simulation.touching, len(trial.fixels))
        row["contact_mode_measured"] = _tactile_mode(trial, valid)
        rows.append(row)
        if path is trial.marker:
            curves.append(TrialCurve("fixel", time[reached], pose[reached]))
    if trial.lab is not None:
        at = np.isin(trial.lab.frame, trial.frame[valid])
        stored = trial.lab.object_pose[at]
        row = _row(trial, "laboratory", "smoothed actuator", "measured", stored, measured.pose)
        row["contact_mode_measured"] = _tactile_mode(trial, valid)
        rows.append(row)
        curves.append(TrialCurve("laboratory", time, stored))
        repeated = as_the_lab_did(trial)
        own = repeated.pose[OBJECT]
        row = _row(
            trial,
            "fixel, laboratory's slips",
            "smoothed actuator",
            "laboratory",
            own,
            trial.lab.object_pose[: len(own)],
        )
        row["status"] = repeated.status
        rows.append(row)
    return rows, TrialPicture(
        name=f"experiment {trial.experiment_id}",
        outline=trial.object_shape.outline,
        curves=curves,
        fixels=trial.fixels,
        fixel_radius=trial.fixel_radius,
        actuator_outline=trial.actuator_shape.outline,
        actuator_angle=trial.actuator_angle,
        actuator=trial.marker[valid],
    )


def _row(
    trial: RpiTrial,
    model: str,
    path: str,
    against: str,
    pose: FloatArray,
    reference: FloatArray,
) -> Row:
    n = min(len(pose), len(reference))
    position, angle = pose_error(pose[:n], reference[:n])
    weighted = weighted_error(pose[:n], reference[:n]) * 1e3
    return {
        "experiment_id": trial.experiment_id,
        "model": model,
        "path": path,
        "against": against,
        "status": "stored",
        "frames": n,
        "position_mm_rms": rms(position) * 1e3,
        "angle_deg_rms": float(np.degrees(rms(angle))),
        "weighted_mm_rms": rms(weighted),
        "error_mm2": float(np.mean(weighted**2)),
        "position_mm_final": float(position[-1]) * 1e3,
        "angle_deg_final": float(np.degrees(abs(angle[-1]))),
        "contact_mode": None,
        "contact_mode_measured": None,
    }


def _tactile_mode(trial: RpiTrial, valid: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    bits = trial.tactile[valid][-1]
    return sum(1 << (len(bits) - 1 - k) for k in range(len(bits)) if bits[k])


def _notes(left_out: int) -> list[str]:
    notes = [
        "weighted: angles count by 35 mm/rad; E is its mean square, as in the thesis (5.1).",
        "fixel, laboratory's slips: gravity 9.810 mm/s^2, 16 friction directions, steps of 1/30 s"
        " with the driver one step ahead; compared with the laboratory's stored simulation.",
    ]
    if left_out:
        notes.append(f"{left_out} trials have no actuator path or fixel positions: left out.")
    return notes
