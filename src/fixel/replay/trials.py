"""Replay of grasp acquisition trials (`rpi_2dgad`): a square, an actuator and three fixels."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from fixel.calibration.target import ON_CLOCK
from fixel.datasets.rpi_2dgad import FRAME_RATE, LabSimulation, Rpi2dgad, lab_simulation
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import Experiment, Parameters, PathDrive, Scene, Trajectory, Tripod, pose_error
from fixel.replay import base
from fixel.simulation import Simulation, StewartTrinkle, simulate
from fixel.simulation.motion import motion_model
from fixel.typing import BoolArray, FloatArray

# Length by which angles count in the error of the thesis [m/rad] (section 5.1: "a scale of 35").
ANGLE_LENGTH = 35e-3

# Settings of the laboratory's MATLAB simulator, only to reproduce its stored simulation: gravity of
# 9.810 mm/s^2, friction polygons of 16 directions, steps of one video frame with the driver one
# step ahead (mechanics.md, sections 0 and 2.8).
LAB_GRAVITY = 9.81e-3
LAB_DIRECTIONS = 16
LAB_STEP = 1.0 / FRAME_RATE

OBJECT = "object"
INCOMPLETE = "no actuator path or fixel positions"


class TrialOutcome(NamedTuple):
    """Rows of one trial, and the curves of its figure."""

    trial: Experiment
    rows: list[base.Row]
    curves: dict[str, Trajectory]
    actuator: FloatArray  # (n, 3)


@final
class TrialReplay(base.AbstractReplay):
    """Complete trials along the measured actuator path, and as the laboratory simulated them."""

    def __init__(self, folder: Path, request: base.ReplayRequest) -> None:
        self.folder, self.request = folder, request
        experiments = list(Rpi2dgad().read(folder).experiments())
        complete = [e for e in experiments if e.pusher is not None]
        if not complete:
            raise DatasetMissing(folder, "an exp<number>_setup.json of at least one trial")
        every = [*complete, *(e for e in experiments if e.pusher is None)]
        names = [experiment.name for experiment in every]
        fits = base.matching({"experiment_id": names}, request.select, len(every))
        n = len(complete)
        chosen = [trial for trial, wanted in zip(complete, fits[:n], strict=True) if wanted]
        if not chosen:
            raise InvalidInput(
                "select experiment_id",
                found="a trial without actuator path and fixel positions",
                expected="a complete trial: " + ", ".join(names[:n]),
            )
        self.left_out = int(fits[n:].sum())
        chosen = [chosen[k] for k in base.spread(len(chosen), request.limit)]
        self.parts = [(f"experiment {trial.name}", 1, trial) for trial in chosen]

    def simulate(self, item: Experiment) -> TrialOutcome:
        """Simulate a trial along both recorded paths of the actuator, and as the laboratory did."""
        settings = self._settings(item)
        gravity = settings.pop("gravity")
        motion = motion_model(self.request.motion or "dynamic")
        track, useful = item.trajectory, _useful(item)
        time = track.time[useful] - track.time[useful][0]
        measured = track.pose[useful]
        felt = item.channel("tactile")
        assert felt is not None
        felt_mode = _bits(felt.values[useful][-1] > 0.5)
        marker, smoothed = recorded_paths(item)
        curves = {"measured": Trajectory(time=time, pose=measured)}
        given = Parameters({n: settings[n] for n in self.request.settings if n in settings})
        rows: list[base.Row] = []
        for path, label in ((marker, "actuator marker"), (smoothed, "smoothed actuator")):
            scene = replace(trial_scene(item, measured[0], time, path[useful]), gravity=gravity)
            simulation = simulate(scene, given, motion=motion, output_interval=LAB_STEP)
            reached = time <= simulation.duration * (1.0 + 1e-9)
            pose = simulation[OBJECT].at(time)
            row = _row(item.name, "fixel", label, "measured", pose[reached], measured[reached])
            row["status"] = simulation.status
            row["contact_mode"] = contact_mode(simulation.touching, len(scene.fixels))
            row["contact_mode_measured"] = felt_mode
            rows.append(row)
            if path is marker:
                curves["fixel"] = Trajectory(time=time[reached], pose=pose[reached])
        lab = lab_simulation(self.folder, int(item.name))
        if lab is not None:
            stored = lab.pose[np.isin(lab.time, track.time[useful])]
            row = _row(item.name, "laboratory", "smoothed actuator", "measured", stored, measured)
            row["contact_mode_measured"] = felt_mode
            curves["laboratory"] = Trajectory(time=time, pose=stored)
            repeated = as_the_lab_did(item, lab)
            own = repeated.pose[OBJECT]
            again = _row(
                item.name, "fixel, laboratory's slips", "smoothed actuator", "laboratory", own,
                lab.pose[: len(own)],
            )  # fmt: skip
            again["status"] = repeated.status
            rows += [row, again]
        return TrialOutcome(item, rows, curves, marker[useful])

    def result(self, outcomes: list[TrialOutcome]) -> base.Replay:
        """List the rows of all trials."""
        rows = [row for outcome in outcomes for row in outcome.rows]
        first = outcomes[0]
        notes = [
            "weighted: with angles weighted by 35 mm/rad; E is its mean square, as in the thesis "
            "(5.1).",
            "fixel, laboratory's slips: gravity 9.810 mm/s^2, 16 friction directions, steps of 1/30"
            " s with the driver one step ahead; compared with the laboratory's stored simulation.",
        ]
        if self.left_out:
            notes.append(f"{self.left_out} trials were skipped: {INCOMPLETE}.")
        settings = {f"experiment_{o.trial.name}": self._settings(o.trial) for o in outcomes}
        gravity = [own.pop("gravity") for own in settings.values()]
        return base.Replay(
            dataset="rpi_2dgad",
            pushes=rows,
            groups=[],
            left_out={INCOMPLETE: self.left_out} if self.left_out else {},
            not_solved=sum(row["status"] not in ("converged", "stored") for row in rows),
            settings={
                **settings,
                "gravity": gravity[0],
                "motion": self.request.motion or "dynamic",
                "angle_length_m": ANGLE_LENGTH,
            },
            notes=notes,
            figure=partial(base.trial_figure, first.trial, first.curves, first.actuator),
        )

    def _settings(self, trial: Experiment) -> dict[str, float]:
        """Values of the laboratory, replaced by requested ones."""
        scene = _scene(trial)
        support = scene.bodies[0].support
        assert isinstance(support, Tripod)
        nominal = {
            "tripod_radius": support.radius,
            "mu_support": support.friction,
            "mu_pusher": scene.pushers[0].friction,
            **({"mu_fixel": scene.fixels[0].friction} if scene.fixels else {}),
            "gravity": scene.gravity,
        }
        return base.settings_from(nominal, self.request.settings)


def _scene(trial: Experiment) -> Scene:
    if trial.scene is None:
        why = next((flag.detail for flag in trial.flags if flag.name == "no-scene"), "no scene")
        raise InvalidInput(f"experiment {trial.name}", found=f"none ({why})", expected="a scene")
    return trial.scene


def _useful(trial: Experiment) -> BoolArray:
    """Mask (n,) of the frames between start and end of useful data."""
    time = trial.trajectory.time
    assert trial.effective is not None
    first, last = trial.effective
    return np.asarray((time >= first - ON_CLOCK) & (time <= last + ON_CLOCK))


def recorded_paths(trial: Experiment) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 3) of the actuator: by its marker, and after the laboratory's smoother."""
    smoothed = trial.channel("actuator-filtered")
    assert trial.pusher is not None
    assert smoothed is not None
    marker = trial.pusher.pose
    return marker, np.column_stack((smoothed.values, marker[:, 2]))


def trial_scene(trial: Experiment, start: FloatArray, time: FloatArray, path: FloatArray) -> Scene:
    """Build the scene of a trial with another start and path, and no limit of force.

    The path has times (n,) from 0 on [s] and poses (n, 3) of the actuator [m, m, rad].
    """
    scene = _scene(trial)
    drive = PathDrive(waypoints=np.column_stack((time, path)))
    return replace(
        scene,
        bodies=(replace(scene.bodies[0], pose=start),),
        pushers=(replace(scene.pushers[0], pose=path[0], drive=drive),),
        duration=float(time[-1]),
    )


def as_the_lab_did(trial: Experiment, lab: LabSimulation, *, leading: bool = True) -> Simulation:
    """Repeat the laboratory's stored simulation of a trial, including its mistakes.

    The driver is a step ahead of the object, as in the laboratory's code, if it is `leading`.
    """
    place = lab.actuator
    if leading:
        place = np.concatenate((place[1:], 2.0 * place[-1:] - place[-2:-1]))
    time: FloatArray = np.arange(len(place), dtype=np.float64) * LAB_STEP
    angle = np.full(len(place), _scene(trial).pushers[0].pose[2])
    scene = replace(
        trial_scene(trial, lab.pose[0], time, np.column_stack((place, angle))),
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
    return _bits(np.array([f"fixel-{k + 1}" in names for k in range(n_fixel)]))


def _bits(touched: BoolArray) -> int:
    """Number of a contact mode; the last fixel is the lowest bit."""
    return int(touched @ (1 << np.arange(len(touched))[::-1]))


def _row(
    name: str, model: str, path: str, against: str, pose: FloatArray, reference: FloatArray
) -> base.Row:
    n = min(len(pose), len(reference))
    position, angle = pose_error(pose[:n], reference[:n])
    weighted = weighted_error(pose[:n], reference[:n]) * 1e3
    return {
        "experiment_id": int(name),
        "model": model,
        "path": path,
        "against": against,
        "status": "stored",
        "frames": n,
        "position_mm_rms": base.rms(position) * 1e3,
        "angle_deg_rms": float(np.degrees(base.rms(angle))),
        "weighted_mm_rms": base.rms(weighted),
        "error_mm2": float(np.mean(weighted**2)),
        "position_mm_final": float(position[-1]) * 1e3,
        "angle_deg_final": float(np.degrees(abs(angle[-1]))),
        "contact_mode": None,
        "contact_mode_measured": None,
    }
