"""Importer of RPI's 2dgad trials: planar grasp acquisition against three fixels.

Source: the RPI thesis and the laboratory's public Testbed2D tree. Only experiment 141 is complete,
with the path of the actuator and the positions of the fixels.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.base import (
    Importer,
    ImportPlan,
    Origin,
    remark,
    scene_or_flag,
    trajectory_of,
)
from fixel.datasets.files import (
    MM,
    CsvRows,
    increasing,
    member,
    only_file,
    read_json,
    read_table,
    refuse_repeated,
    rows_of,
)
from fixel.errors import DatasetMissing, InvalidInput
from fixel.model import (
    Body,
    Channel,
    Disk,
    Experiment,
    Fixel,
    Flag,
    PathDrive,
    Polygon,
    Provenance,
    Pusher,
    Scene,
    Trajectory,
    Tripod,
)
from fixel.typing import FloatArray, IntArray

DATASET: Final = "rpi-2dgad"
OBJECT, ACTUATOR = "object", "actuator"
EXPERIMENTS = "experiments.csv"
TRACKS = ("object_trajectory.csv.gz", "object_trajectory.csv")

FRAME_RATE: Final = 30.0  # frame rate of the overhead camera [1/s]

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
    licence = "none stated; reference data, not for redistribution"
    citation = (
        "L. Zhang, J. Betz, J. Trinkle, Comparison of simulated and experimental grasping actions"
        " in the plane, 2010"
    )

    def recognised(self, source: Path) -> bool:
        """Whether a folder has experiments.csv and a table of the tracked object."""
        tracked = any((source / name).is_file() for name in TRACKS)
        return tracked and (source / EXPERIMENTS).is_file()

    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        listed = read_table(only_file(source, EXPERIMENTS))
        tracks_file = only_file(source, *TRACKS)
        tracks = read_table(tracks_file)
        frame = tracks.whole_numbers("frame")
        readings = tracks.stacked("x_mm", "y_mm", "theta_rad", "z_mm") * (MM, MM, 1.0, MM)
        numbers = listed.whole_numbers("experiment_id").tolist()
        refuse_repeated(map(str, numbers), listed.source, "experiment_id")
        tracked = tracks.whole_numbers("experiment_id").astype(np.str_)
        rows = rows_of(tracked, tracks.source, [*map(str, numbers)], listed.source)
        complete = _complete(source)
        whole = sorted(set(complete) & set(numbers))
        origin = Origin()

        def make() -> Iterator[Experiment]:
            for row, number in enumerate(numbers):
                if number in complete:
                    trial = complete[number]
                    yield _whole(number, trial, listed, row, origin.of(source / trial.source))
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
        "Simulated and filtered trajectories of the authors are not imported.",
    )


class _Trial(NamedTuple):
    """Files of a complete trial; n video frames, counted from 1."""

    source: str  # name of the table of frames
    setup: dict[str, Any]
    setup_file: str
    frame: IntArray  # (n,)
    pose: FloatArray  # (n, 3) measured poses of the object [m, m, rad]
    marker: FloatArray  # (n, 2) measured positions of the actuator's marker [m]
    # The same after a constant-velocity Kalman smoother; overshoots after the actuator has stalled.
    filtered: FloatArray
    tactile: FloatArray  # (n, n_fixel) whether each fixel sensed the object, 0 or 1
    fixels: FloatArray  # (n_fixel, 2) centres [m]

    def value(self, path: str) -> Any:
        """Return a value of the setup, such as `"object.mass_kg"`."""
        return member(self.setup, path, self.setup_file)

    def points(self, path: str) -> FloatArray:
        """Return points (n, 2) of the setup [m]."""
        return _points(self.value(path), self.setup_file)


def _complete(folder: Path) -> dict[int, _Trial]:
    """Load all complete trials of a folder, by their numbers."""
    numbered = [
        int(match[1])
        for path in sorted(folder.glob("exp*_setup.json"))
        if (match := re.fullmatch(r"exp(\d+)_setup\.json", path.name))
    ]
    return {number: _trial(folder, number) for number in numbered}


def _trial(folder: Path, number: int) -> _Trial:
    setup_file = f"exp{number}_setup.json"
    setup = read_json(folder / setup_file)
    frames = _frames(folder, number)
    increasing(frames.numbers("time_s"), frames.source)
    fixels = _points(member(setup, "fixel_positions_mm", setup_file), setup_file)
    tactile = frames.stacked(*(f"tactile_{k + 1}" for k in range(len(fixels))))
    return _Trial(
        source=frames.source,
        setup=setup,
        setup_file=setup_file,
        frame=frames.whole_numbers("frame"),
        pose=_poses(frames, "object_x_mm", "object_y_mm", "object_theta_rad"),
        marker=frames.stacked("actuator_marker_x_mm", "actuator_marker_y_mm") * MM,
        filtered=frames.stacked("actuator_x_mm", "actuator_y_mm") * MM,
        tactile=(tactile > 0.5).astype(np.float64),
        fixels=fixels,
    )


def _frames(folder: Path, number: int) -> CsvRows:
    name = f"exp{number}_frames.csv"
    if not (folder / name).is_file():
        raise DatasetMissing(folder, name)
    return read_table(folder / name)


def _poses(table: CsvRows, *columns: str) -> FloatArray:
    return table.stacked(*columns) * (MM, MM, 1.0)


def _points(points: object, source: str) -> FloatArray:
    try:
        return np.asarray(points, dtype=np.float64).reshape(-1, 2) * MM
    except (TypeError, ValueError):
        raise InvalidInput(source, found=points, expected="pairs of numbers [mm]") from None


class LabSimulation(NamedTuple):
    """Simulation of a trial by the laboratory's own simulator; not measured."""

    time: FloatArray  # (n,) on the clock of the experiment [s]
    pose: FloatArray  # (n, 3) of the object [m, m, rad]
    actuator: FloatArray  # (n, 2) position of the driver, which was its input [m]


def lab_simulation(folder: Path, number: int) -> LabSimulation | None:
    """Load the laboratory's simulation of a complete trial; None if it was not stored."""
    path = folder / f"exp{number}_author_simulation.csv"
    if not path.is_file():
        return None
    first = int(_frames(folder, number).whole_numbers("frame")[0])
    rows = read_table(path)
    return LabSimulation(
        _time(rows.whole_numbers("frame"), first),
        _poses(rows, "object_x_mm", "object_y_mm", "object_theta_rad"),
        rows.stacked("actuator_x_mm", "actuator_y_mm") * MM,
    )


def _track(
    listed: CsvRows,
    row: int,
    frame: NDArray[np.int64],
    readings: FloatArray,
    provenance: Provenance,
) -> Experiment:
    """Build an experiment from the tracked object alone: x, y, angle, height at frames."""
    number, object_id, mode, start, end = (
        int(listed.whole_numbers(name)[row])
        for name in (
            "experiment_id",
            "object_id",
            "final_contact_mode_experiment",
            "start_frame",
            "end_frame",
        )
    )
    time = _time(frame, int(frame[0]))
    digits, flags = _mode(mode)
    if object_id == OUTLINE_UNKNOWN:
        flags = (*flags, remark("no-shape", f"the outline of object {object_id} was not recovered"))
    return Experiment(
        dataset=DATASET,
        name=str(number),
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=trajectory_of(time, readings[:, :3]),
        height=float(readings[0, 3]),
        contact_mode=digits,
        effective=_effective(frame, start, end),
        conditions={"object_id": float(object_id)},
        flags=(
            *flags,
            remark("no-actuator", "the path of the actuator was not recorded"),
            remark("no-fixels", "the positions of the fixels were not recorded"),
        ),
    )


def _whole(
    number: int, trial: _Trial, listed: CsvRows, row: int, provenance: Provenance
) -> Experiment:
    """Build an experiment with actuator, fixels and tactile signals."""
    digits, flags = _mode(trial.value("final_contact_mode"))
    first = int(trial.frame[0])
    effective = _effective(trial.frame, trial.value("start_frame"), trial.value("end_frame"))
    time = _time(trial.frame, first)
    angle: FloatArray = np.full(len(time), trial.value("actuator.orientation_rad"))
    marker = np.column_stack((time, trial.marker, angle))
    scene, why_not = scene_or_flag(lambda: _scene(trial, marker, effective[1]))
    runs_on = float(np.hypot(*(trial.filtered - trial.marker).T).max())
    n_fixel = len(trial.fixels)
    return Experiment(
        dataset=DATASET,
        name=str(number),
        real=True,
        provenance=provenance,
        object_name=OBJECT,
        trajectory=trajectory_of(time, trial.pose),
        pusher=Trajectory(time=time, pose=marker[:, 1:]),
        scene=scene,
        height=_height(trial.value("object").get("height_mm")),
        pusher_height=_height(trial.value("actuator").get("height_mm")),
        fixel_height=_height(trial.setup.get("fixel_height_mm")),
        channels=(
            Channel(
                name="tactile",
                time=time,
                columns=tuple(f"fixel_{k + 1}_bool" for k in range(n_fixel)),
                values=trial.tactile,
            ),
            Channel(
                name="actuator-filtered", time=time, columns=("x_m", "y_m"), values=trial.filtered
            ),
        ),
        contact_mode=digits if not digits or n_fixel == N_FIXEL else "",
        effective=effective,
        conditions={"object_id": float(listed.whole_numbers("object_id")[row])},
        flags=(
            *flags,
            *why_not,
            remark(
                "actuator-filter-runs-on",
                f"the smoothed path is up to {runs_on / MM:.2g} mm from the marker",
            ),
        ),
    )


def _scene(trial: _Trial, marker: FloatArray, duration: float) -> Scene:
    calibrated = "system_parameters_calibrated_by_authors"
    radius, mu_support, mu_actuator, mu_fixel = (
        trial.value(f"{calibrated}.{name}")
        for name in ("tripod_radius_mm", "mu_support", "mu_actuator", "mu_fixel")
    )
    fixel = Disk(trial.value("fixel_radius_mm") * MM)
    body = Body(
        name=OBJECT,
        shape=Polygon(trial.points("object.vertices_mm")),
        mass=trial.value("object.mass_kg"),
        inertia=trial.value("object.moment_of_inertia_kg_mm2") * MM**2,
        centre_of_mass=np.zeros(2),
        pose=trial.pose[0],
        support=Tripod(radius=radius * MM, friction=mu_support),
    )
    actuator = Pusher(
        name=ACTUATOR,
        shape=Polygon(trial.points("actuator.vertices_mm")),
        pose=marker[0, 1:],
        drive=PathDrive(waypoints=marker, force_limit=FORCE_LIMIT),
        friction=mu_actuator,
    )
    fixels = tuple(
        Fixel(name=f"fixel-{k + 1}", shape=fixel, pose=np.append(centre, 0.0), friction=mu_fixel)
        for k, centre in enumerate(trial.fixels)
    )
    return Scene(bodies=(body,), pushers=(actuator,), fixels=fixels, duration=duration)


def _mode(mode: int) -> tuple[str, tuple[Flag, ...]]:
    """Digits of fixels 1 to 3 from the authors' number, or a flag if it is invalid."""
    if mode < INVALID_MODE:
        return f"{mode:03b}", ()
    return "", (remark("contact-mode-invalid", f"the record has {mode}"),)


def _time(frame: NDArray[np.int64], first: int) -> FloatArray:
    return (frame - first) / FRAME_RATE


def _effective(frame: NDArray[np.int64], start: int, end: int) -> tuple[float, float]:
    if not frame[0] <= start <= end:
        raise InvalidInput(
            EXPERIMENTS, found=f"frames {start} to {end}", expected=f"frames from {frame[0]} on"
        )
    return float((start - frame[0]) / FRAME_RATE), float((end - frame[0]) / FRAME_RATE)


def _height(height: float | None) -> float | None:
    return None if height is None else height * MM
