"""Importer of RPI's 2dgad trials: planar grasp acquisition, with one complete trial."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.base import (
    Importer,
    ImportPlan,
    Origin,
    refuse_giants,
    refuse_repeated,
    remark,
    rows_of,
    scene_or_flag,
    whole_numbers,
)
from fixel.datasets.raw import rpi_2dgad
from fixel.datasets.raw.base import MM, CsvRows, only_file, read_json, read_table
from fixel.datasets.raw.rpi_2dgad import EXPERIMENTS, FRAME_RATE, RpiTrial
from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Channel,
    Disk,
    Experiment,
    Fixel,
    Flag,
    PathDrive,
    Provenance,
    Pusher,
    Scene,
    Trajectory,
    Tripod,
)
from fixel.typing import FloatArray

DATASET: Final = "rpi-2dgad"
OBJECT, ACTUATOR = "object", "actuator"
TRACKS = ("object_trajectory.csv.gz", "object_trajectory.csv")

# Maximum force of the actuator's screw drive [N].
FORCE_LIMIT = 34.3

N_FIXEL = 3
INVALID_MODE = 8

# Number of the object whose outline was not recovered, only its height.
OUTLINE_UNKNOWN = 17


@final
class Rpi2dgad(Importer):
    """Importer of grasp acquisition trials filmed from above."""

    name = DATASET
    title = "RPI 2dgad: grasp acquisition against three fixels (2011)"
    licence = "none stated; reference data, not to be passed on"
    citation = (
        "L. Zhang, J. Betz, J. Trinkle, Comparison of simulated and experimental grasping actions"
        " in the plane, 2010"
    )

    def recognised(self, source: Path) -> bool:
        """Whether a folder has experiments.csv and a table of the tracked object."""
        return rpi_2dgad.recognised(source) and any((source / name).is_file() for name in TRACKS)

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        listed = read_table(only_file(source, EXPERIMENTS))
        tracks_file = only_file(source, *TRACKS)
        tracks = read_table(tracks_file)
        refuse_giants(tracks, "x_mm", "y_mm", "z_mm", "theta_rad")
        frame = whole_numbers(tracks, "frame")
        readings = tracks.stacked("x_mm", "y_mm", "theta_rad", "z_mm") * (MM, MM, 1.0, MM)
        numbers = whole_numbers(listed, "experiment_id").tolist()
        refuse_repeated(map(str, numbers), listed.source, "experiment_id")
        rows = rows_of(whole_numbers(tracks, "experiment_id").astype(np.str_))
        for row, number in enumerate(numbers):
            if str(number) not in rows:
                raise InvalidInput(
                    f"{listed.source}, row {row + 1}",
                    found=f"experiment {number}, which {tracks.source} lacks",
                    expected="a tracked object for every experiment",
                )
        complete = {trial.experiment_id: trial for trial in _complete(source)}
        whole = sorted(set(complete) & set(numbers))
        origin = Origin()

        def make() -> Iterator[Experiment]:
            for row, number in enumerate(numbers):
                if number in complete:
                    frames = source / f"exp{number}_frames.csv"
                    yield _whole(source, listed, row, complete[number], origin.of(frames))
                else:
                    own = rows[str(number)]
                    yield _track(listed, row, frame[own], readings[own], origin.of(tracks_file))

        return ImportPlan(
            DATASET, source, _understood(len(numbers), len(tracks), whole), len(numbers), make
        )


def _understood(n: int, n_frames: int, whole: list[int]) -> tuple[str, ...]:
    named = ", ".join(map(str, whole)) or "none"
    return (
        f"{n} experiments, {n_frames} video frames at {FRAME_RATE:g} Hz; the clock of each starts"
        " at its first frame.",
        "Positions from mm to m, angles in rad, in the calibrated frame of the plate; z is the"
        " height of the object above the plate and no angle.",
        "Contact modes from 3 bits: 4 is fixel 1, 2 is fixel 2, 1 is fixel 3; 8 means invalid.",
        f"Complete with actuator, fixels and tactile signals: {named}; the others have the object"
        " alone (no-actuator, no-fixels) and no scene.",
        "The actuator is the marker as seen: the smoothed one runs on after it has stalled"
        " (actuator-filter-runs-on) and is a channel.",
        f"Scenes: the authors' calibrated parameters as nominal friction, force limit"
        f" {FORCE_LIMIT:g} N.",
        "Simulated and filtered trajectories of the authors are no experiments and are left out.",
    )


def _complete(folder: Path) -> tuple[RpiTrial, ...]:
    if next(folder.glob("exp*_setup.json"), None) is None:
        return ()
    return rpi_2dgad.read(folder).trials


def _track(
    listed: CsvRows,
    row: int,
    frame: NDArray[np.int64],
    readings: FloatArray,
    provenance: Provenance,
) -> Experiment:
    """Build an experiment from the tracked object alone: x, y, angle, height at frames."""
    number, object_id = (
        _whole_number(listed, name, row) for name in ("experiment_id", "object_id")
    )
    time = _time(frame, int(frame[0]))
    digits, flags = _mode(_whole_number(listed, "final_contact_mode_experiment", row))
    start, end = (_whole_number(listed, name, row) for name in ("start_frame", "end_frame"))
    if object_id == OUTLINE_UNKNOWN:
        flags = (*flags, remark("no-shape", f"the outline of object {object_id} was not recovered"))
    return Experiment(
        dataset=DATASET,
        name=str(number),
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=_trajectory(time, readings[:, :3]),
        height=float(readings[0, 3]),
        contact_mode=digits,
        effective=_effective(frame, start, end),
        conditions={"object_id": float(object_id)},
        flags=(
            *flags,
            remark("no-actuator", "the path of the actuator was not kept"),
            remark("no-fixels", "where the fixels stood was not kept"),
        ),
    )


def _whole(
    folder: Path, listed: CsvRows, row: int, trial: RpiTrial, provenance: Provenance
) -> Experiment:
    """Build an experiment with actuator, fixels and tactile signals."""
    setup = read_json(only_file(folder, f"exp{trial.experiment_id}_setup.json"))
    digits, flags = _mode(trial.contact_mode)
    effective = _effective(trial.frame, trial.start_frame, trial.end_frame)
    time = _time(trial.frame, int(trial.frame[0]))
    angle: FloatArray = np.full(len(time), trial.actuator_angle)
    marker = np.column_stack((time, trial.marker, angle))
    scene, why_not = scene_or_flag(lambda: _scene(trial, marker, effective[1]))
    runs_on = float(np.hypot(*(trial.filtered - trial.marker).T).max())
    n_fixel = len(trial.fixels)
    return Experiment(
        dataset=DATASET,
        name=str(trial.experiment_id),
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=_trajectory(time, trial.object_pose),
        pusher=Trajectory(time=time, pose=marker[:, 1:]),
        scene=scene,
        height=_height(setup["object"].get("height_mm")),
        pusher_height=_height(setup["actuator"].get("height_mm")),
        fixel_height=_height(setup.get("fixel_height_mm")),
        channels=(
            Channel(
                name="tactile",
                time=time,
                columns=tuple(f"fixel_{k + 1}_bool" for k in range(n_fixel)),
                values=trial.tactile.astype(np.float64),
            ),
            Channel(
                name="actuator-filtered", time=time, columns=("x_m", "y_m"), values=trial.filtered
            ),
        ),
        contact_mode=digits if not digits or n_fixel == N_FIXEL else "",
        effective=effective,
        conditions={"object_id": float(_whole_number(listed, "object_id", row))},
        flags=(
            *flags,
            *why_not,
            remark(
                "actuator-filter-runs-on",
                f"the smoothed path is up to {runs_on / MM:.2g} mm from the marker",
            ),
        ),
    )


def _scene(trial: RpiTrial, marker: FloatArray, duration: float) -> Scene:
    parameters = trial.parameters
    return Scene(
        bodies=(
            Body(
                name=OBJECT,
                shape=trial.object_shape,
                mass=trial.mass,
                inertia=trial.inertia,
                centre_of_mass=np.zeros(2),
                pose=trial.object_pose[0],
                support=Tripod(
                    radius=parameters["tripod_radius"], friction=parameters["mu_support"]
                ),
            ),
        ),
        pushers=(
            Pusher(
                name=ACTUATOR,
                shape=trial.actuator_shape,
                pose=marker[0, 1:],
                drive=PathDrive(waypoints=marker, force_limit=FORCE_LIMIT),
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
        duration=duration,
    )


def _mode(mode: int) -> tuple[str, tuple[Flag, ...]]:
    """Digits of fixels 1 to 3 from the authors' number, or a flag if it is invalid."""
    if mode < INVALID_MODE:
        return f"{mode:03b}", ()
    return "", (remark("contact-mode-invalid", f"the record says {mode}"),)


def _time(frame: NDArray[np.int64], first: int) -> FloatArray:
    return (frame - first) / FRAME_RATE


def _effective(frame: NDArray[np.int64], start: int, end: int) -> tuple[float, float]:
    if not frame[0] <= start <= end:
        raise InvalidInput(
            EXPERIMENTS, found=f"frames {start} to {end}", expected=f"frames from {frame[0]} on"
        )
    return float((start - frame[0]) / FRAME_RATE), float((end - frame[0]) / FRAME_RATE)


def _trajectory(time: FloatArray, pose: FloatArray) -> Trajectory:
    return Trajectory(time=time, pose=np.column_stack((pose[:, :2], np.unwrap(pose[:, 2]))))


def _height(height: float | None) -> float | None:
    return None if height is None else height * MM


def _whole_number(table: CsvRows, column: str, row: int) -> int:
    return int(whole_numbers(table, column)[row])
