"""Grasp acquisition trials of RPI's 2dgad database: a square pushed against three fixels.

Source: the RPI thesis and the laboratory's public Testbed2D tree. Only trials with an actuator path
and fixel positions can be replayed; experiment 141 is complete.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.raw.base import MM, increasing, member, read_json, read_table
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import Parameters, Polygon
from fixel.typing import FloatArray

EXPERIMENTS = "experiments.csv"
FRAME_RATE = 30.0  # frame rate of the overhead camera [1/s]


class LabSimulation(NamedTuple):
    """Simulation of a trial by the laboratory's own simulator; not measured."""

    frame: NDArray[np.int64]  # (n,)
    object_pose: FloatArray  # (n, 3) [m, m, rad]
    actuator: FloatArray  # (n, 2) driver position that was its input [m]


@final
@dataclass(frozen=True, slots=True)
class RpiTrial:
    """Complete trial of a grasp acquisition.

    Attributes
    ----------
    object_shape, actuator_shape : Polygon
        Digitised corners, in the frame of the tracked marker.
    mass, inertia : float
        Mass of the object and inertia about the origin of its frame [kg, kg m^2].
    fixel_radius : float
        Radius of the fixels [m].
    fixels : (n_fixel, 2) float64
        Centres of the fixels [m].
    actuator_angle : float
        Angle of the actuator, constant during the push [rad].
    parameters : Parameters
        Values calibrated by the laboratory.
    frame, time : (n,)
        Video frames, counted from 1, and their times [s].
    object_pose : (n, 3) float64
        Measured poses of the object [m, m, rad].
    marker, filtered : (n, 2) float64
        Positions of the actuator's marker, measured and after a constant-velocity Kalman smoother
        [m]. The smoothed ones overshoot after the actuator has stalled.
    tactile : (n, n_fixel) bool
        Whether each fixel sensed the object.
    start_frame, end_frame : int
        First frame with a moving actuator and last frame of useful data.
    contact_mode : int
        Contacts at the end; the bits of fixels 1, 2, 3 have the values 4, 2, 1.
    lab : LabSimulation or None
    """

    experiment_id: int
    object_shape: Polygon
    actuator_shape: Polygon
    mass: float
    inertia: float
    fixel_radius: float
    fixels: FloatArray
    actuator_angle: float
    parameters: Parameters
    frame: NDArray[np.int64]
    time: FloatArray
    object_pose: FloatArray
    marker: FloatArray
    filtered: FloatArray
    tactile: NDArray[np.bool_]
    start_frame: int
    end_frame: int
    contact_mode: int
    lab: LabSimulation | None


@final
@dataclass(frozen=True, slots=True)
class RpiTrials:
    """Complete trials of a folder, and the numbers of the incomplete ones."""

    name: ClassVar[str] = "rpi_2dgad"
    folder: Path
    trials: tuple[RpiTrial, ...]
    incomplete: tuple[int, ...]


def recognised(folder: Path) -> bool:
    """Whether a folder contains this dataset."""
    return (folder / EXPERIMENTS).is_file()


def read(folder: Path) -> RpiTrials:
    """Load all complete trials of a folder."""
    known = read_table(folder / EXPERIMENTS).numbers("experiment_id").astype(int).tolist()
    numbered = [
        int(match[1])
        for path in sorted(folder.glob("exp*_setup.json"))
        if (match := re.fullmatch(r"exp(\d+)_setup\.json", path.name))
    ]
    if not numbered:
        raise DatasetMissing(folder, "an exp<number>_setup.json of at least one trial")
    trials = tuple(_trial(folder, number) for number in numbered)
    return RpiTrials(folder, trials, tuple(sorted(set(known) - set(numbered))))


def _trial(folder: Path, number: int) -> RpiTrial:
    source = f"exp{number}_setup.json"
    setup = read_json(folder / source)
    frames_file = folder / f"exp{number}_frames.csv"
    if not frames_file.is_file():
        raise DatasetMissing(folder, frames_file.name)
    frames = read_table(frames_file)
    calibrated = member(setup, "system_parameters_calibrated_by_authors", source)
    n_fixel = len(member(setup, "fixel_positions_mm", source))
    tactile = [f"tactile_{k + 1}" for k in range(n_fixel)]
    return RpiTrial(
        experiment_id=number,
        object_shape=Polygon(_scaled(member(setup, "object.vertices_mm", source), source)),
        actuator_shape=Polygon(_scaled(member(setup, "actuator.vertices_mm", source), source)),
        mass=member(setup, "object.mass_kg", source),
        inertia=member(setup, "object.moment_of_inertia_kg_mm2", source) * MM**2,
        fixel_radius=member(setup, "fixel_radius_mm", source) * MM,
        fixels=_scaled(member(setup, "fixel_positions_mm", source), source),
        actuator_angle=member(setup, "actuator.orientation_rad", source),
        parameters=Parameters(
            tripod_radius=member(calibrated, "tripod_radius_mm", source) * MM,
            mu_support=member(calibrated, "mu_support", source),
            mu_pusher=member(calibrated, "mu_actuator", source),
            mu_fixel=member(calibrated, "mu_fixel", source),
        ),
        frame=frames.numbers("frame").astype(np.int64),
        time=increasing(frames.numbers("time_s"), frames.source),
        object_pose=frames.stacked("object_x_mm", "object_y_mm", "object_theta_rad") * _SI,
        marker=frames.stacked("actuator_marker_x_mm", "actuator_marker_y_mm") * MM,
        filtered=frames.stacked("actuator_x_mm", "actuator_y_mm") * MM,
        tactile=frames.stacked(*tactile) > 0.5,
        start_frame=member(setup, "start_frame", source),
        end_frame=member(setup, "end_frame", source),
        contact_mode=member(setup, "final_contact_mode", source),
        lab=_lab_simulation(folder / f"exp{number}_author_simulation.csv"),
    )


_SI = np.array([MM, MM, 1.0])


def _lab_simulation(path: Path) -> LabSimulation | None:
    if not path.is_file():
        return None
    rows = read_table(path)
    return LabSimulation(
        rows.numbers("frame").astype(np.int64),
        rows.stacked("object_x_mm", "object_y_mm", "object_theta_rad") * _SI,
        rows.stacked("actuator_x_mm", "actuator_y_mm") * MM,
    )


def _scaled(points: object, source: str) -> FloatArray:
    try:
        return np.asarray(points, dtype=np.float64).reshape(-1, 2) * MM
    except (TypeError, ValueError):
        raise InvalidInput(source, found=points, expected="pairs of numbers [mm]") from None
