"""Compare stored experiments with simulations, and summarise their numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, Final

import numpy as np

from fixel.calibration.target import clock_start, errors_of, scene_of, squared_error, useful_poses
from fixel.errors import InvalidInput
from fixel.model import Channel, Experiment, Parameters, Provenance, Trajectory
from fixel.model.experiment import unit_of
from fixel.model.records import SimulationRecord
from fixel.simulation import AbstractMotionModel, AbstractStepper, Simulation, simulate
from fixel.simulation.result import finite_track
from fixel.testbed.imperfections import touching
from fixel.typing import FloatArray

SAMPLES: Final = 200  # samples of a simulation, for an experiment with few poses
NOISE: Final = 1e-3  # [m], shortest stride that counts in the length of a path


@dataclass(frozen=True, slots=True, kw_only=True)
class PathComparison:
    """Simulated path of an experiment, compared with the measurement."""

    experiment: Experiment
    status: str  # status of the simulation, as in `Simulation.status`
    simulated: Trajectory  # poses of the object, on the experiment's clock
    pusher: Trajectory | None  # simulated poses of the pusher, on the same clock
    # Simulated contacts with each fixel, on the same clock; None if they are not known.
    contacts: Channel | None
    contact_mode: str  # simulated contact mode at the end, one digit per fixel
    # (n,) Measured instants within `effective` [s], without the first measured pose: there the
    # simulation starts, so its error is zero by construction.
    time: FloatArray
    # (n,) Distance from the measured to the simulated pose at these instants [m].
    position: FloatArray
    angle: FloatArray  # (n,) angle from the measured to the simulated pose, wrapped [rad]

    @property
    def complete(self) -> bool:
        """Whether the simulation reached its end; only then does it have errors."""
        return self.status == "converged"

    @property
    def position_rms(self) -> float | None:
        """Root mean square of `position` [m]."""
        return float(np.sqrt(np.mean(self.position**2))) if self.complete else None

    @property
    def final_position(self) -> float | None:
        """Distance at the last measured pose [m]."""
        return float(self.position[-1]) if self.complete else None

    @property
    def final_angle(self) -> float | None:
        """Angle at the last measured pose [rad]."""
        return float(self.angle[-1]) if self.complete else None

    @property
    def error_mm2(self) -> float | None:
        """E of the thesis: mean of squared errors [mm^2]; None if the simulation stopped early."""
        return squared_error(self.position, self.angle) if self.complete else None

    @property
    def same_contact_mode(self) -> bool | None:
        """Agreement with the measured contact mode; None if unknown or not simulated."""
        measured = self.experiment.contact_mode
        known = measured and self.contact_mode and self.complete
        return self.contact_mode == measured if known else None

    def errors(self) -> dict[str, Any]:
        """Return the errors as plain values, for `--json`."""
        return {
            "status": self.status,
            "frames": len(self.time),
            "from_s": float(self.time[0]),
            "to_s": float(self.time[-1]),
            "position_rms_m": self.position_rms,
            "final_position_m": self.final_position,
            "final_angle_rad": self.final_angle,
            "error_mm2": self.error_mm2,
            "contact_mode": {
                "measured": self.experiment.contact_mode,
                "simulated": self.contact_mode,
                "same": self.same_contact_mode,
            },
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison(PathComparison):
    """Simulation of an experiment by fixel, compared with the measurement."""

    parameters: Parameters
    simulation: Simulation

    def summary(self) -> dict[str, Any]:
        """Return all results as plain values, for `--json`."""
        simulation = self.simulation
        return {
            "experiment": self.experiment.key,
            "real": self.experiment.real,
            "parameters": dict(self.parameters),
            "stopped_at": simulation.stopped_at,
            "advice": simulation.advice,
            **self.errors(),
            "method": dict(simulation.method),
            "wall_time_s": simulation.wall_time_s,
        }

    def record(self, experiment_id: int, command: str = "") -> SimulationRecord:
        """Return the record for a project; `command` is the command as typed."""
        method = {
            name: value if isinstance(value, str | int | float) else str(value)
            for name, value in self.simulation.method.items()
            if value is not None
        }
        return SimulationRecord(
            experiment_id=experiment_id,
            parameters=self.parameters,
            provenance=Provenance(version=version("fixel"), command=command),
            trajectory=self.simulated,
            pusher=self.pusher,
            method=method,
            status=self.status,
            contact_mode=self.contact_mode,
            error_mm2=self.error_mm2,
        )


def compare_run(
    experiment: Experiment,
    parameters: Parameters | None = None,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
) -> RunComparison:
    """Simulate an experiment with a scene from its first pose on, and compare the poses.

    `parameters` replace values of the scene. The motion model is `Dynamic()` and the stepper
    `Adaptive()`, unless they are given.
    """
    scene = scene_of(experiment)
    time = experiment.trajectory.time[useful_poses(experiment)]
    parameters = parameters or Parameters()
    start = clock_start(experiment, scene)
    duration = float(time[-1]) - start
    if not duration > 0.0:
        raise InvalidInput(
            f"experiment {experiment.key}.trajectory",
            found="no measured pose after the start",
            expected="motion to compare with",
        )
    simulation = simulate(
        scene,
        parameters,
        motion=motion,
        stepper=stepper,
        duration=duration,
        output_interval=_interval(experiment.trajectory.time, duration),
    )
    simulated = finite_track(simulation, experiment.object_name, start)
    contacts = _contacts(simulation, experiment.object_name, start)
    last = [] if contacts is None else contacts.values[-1]
    time, position, angle = errors_of(experiment, simulated)
    return RunComparison(
        experiment=experiment,
        status=simulation.status,
        parameters=parameters,
        simulation=simulation,
        simulated=simulated,
        pusher=finite_track(simulation, scene.pushers[0].name, start) if scene.pushers else None,
        contacts=contacts,
        contact_mode="".join(str(int(touch)) for touch in last),
        time=time,
        position=position,
        angle=angle,
    )


def compare_path(experiment: Experiment, record: SimulationRecord) -> PathComparison:
    """Compare a simulation by another program with an experiment, which needs no scene."""
    time, position, angle = errors_of(experiment, record.trajectory)
    return PathComparison(
        experiment=experiment,
        status=record.status,
        simulated=record.trajectory,
        pusher=record.pusher,
        contacts=None,
        contact_mode=record.contact_mode,
        time=time,
        position=position,
        angle=angle,
    )


def _interval(time: FloatArray, duration: float) -> float:
    """Interval between samples of the simulation [s]: a frame, or less if frames are few."""
    frame = float(np.median(np.diff(time))) if len(time) > 1 else duration
    return min(frame, duration / SAMPLES) if len(time) < SAMPLES // 10 else min(frame, duration)


def _contacts(simulation: Simulation, name: str, start: float) -> Channel | None:
    """Return contacts of a body with each fixel, sample by sample, like a tactile channel."""
    # Another engine does not tell its contacts.
    if not simulation.scene.fixels or "engine" in simulation.method:
        return None
    return Channel.of_fixels(start + simulation.time, touching(simulation, name))


# --- numbers of an experiment -----------------------------------------------------------------


def summary(experiment: Experiment) -> dict[str, Any]:
    """Return an experiment's numbers as plain values, for `--json`: metres, radians, seconds."""
    track = experiment.trajectory
    pose = track.pose
    flags = [({"name": f.name, "detail": f.detail}, f.fault) for f in experiment.flags]
    return {
        "dataset": experiment.dataset,
        "name": experiment.name,
        "real": experiment.real,
        "simulated_by": experiment.simulated_by,
        "frames": len(track.time),
        "rate_hz": frame_rate(track),
        "duration_s": experiment.duration,
        "effective_s": None if experiment.effective is None else list(experiment.effective),
        "start": pose[0].tolist(),
        "end": pose[-1].tolist(),
        "travelled_m": travelled(track),
        "turned_rad": float(np.unwrap(pose[:, 2])[-1] - pose[0, 2]),
        "contact_mode": experiment.contact_mode,
        "fixels": [] if experiment.scene is None else [f.name for f in experiment.scene.fixels],
        "has_scene": experiment.scene is not None,
        "has_pusher": experiment.pusher is not None,
        "conditions": dict(experiment.conditions),
        "flags": [marked for marked, fault in flags if fault],
        "remarks": [marked for marked, fault in flags if not fault],
        "provenance": asdict(experiment.provenance),
        "channels": [
            {
                "name": channel.name,
                "columns": list(channel.columns),
                "units": [unit_of(column) for column in channel.columns],
                "readings": len(channel.time),
            }
            for channel in experiment.channels
        ],
        "video": experiment.video,
    }


def frame_rate(track: Trajectory) -> float | None:
    """Frames per second [Hz], counting lost ones; None for start and end alone."""
    return float(1.0 / np.median(np.diff(track.time))) if len(track.time) > 2 else None


def travelled(track: Trajectory, noise: float = NOISE) -> float:
    """Length of a path [m], in strides of at least `noise` [m], so that noise adds nothing."""
    here, length = track.pose[0, :2], 0.0
    for place in track.pose[1:, :2]:
        stride = float(np.hypot(*(place - here)))
        if stride >= noise:
            here, length = place, length + stride
    return length + float(np.hypot(*(track.pose[-1, :2] - here)))
