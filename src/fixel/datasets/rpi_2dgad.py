"""Importer of RPI's 2dgad trials: planar grasp acquisition against three fixels.

Source: the RPI thesis and the laboratory's public Testbed2D tree. Only experiment 141 is complete,
with the path of the actuator and the positions of the fixels.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel import model
from fixel.datasets import base, files
from fixel.errors import FixelError, InvalidInput
from fixel.model.records import SimulationRecord
from fixel.typing import FloatArray, IntArray

DATASET: Final = "rpi-2dgad"
OBJECT, ACTUATOR = "object", "actuator"
EXPERIMENTS = "experiments.csv"
TRACKS = ("object_trajectory.csv.gz", "object_trajectory.csv")

SIMULATED = ("author_simulation_trajectory.csv.gz", "author_simulation_trajectory.csv")
ID: Final = "experiment_id"
WHOLE = ("object_id", "final_contact_mode_experiment", "start_frame", "end_frame")
POSE = ("x_mm", "y_mm", "theta_rad", "z_mm")
ORIENTATION: Final = "actuator.orientation_rad"

FRAME_RATE: Final = 30.0  # frame rate of the overhead camera [1/s]

# Maximum force of the actuator's screw drive [N].
FORCE_LIMIT = 34.3

N_FIXEL = 3
INVALID_MODE = 8

# Number of the object whose outline was not recovered, only its height.
OUTLINE_UNKNOWN = 17


class Rpi2dgad(base.Importer):
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
        return files.has_files(source, TRACKS, (EXPERIMENTS,))

    def _plan(self, source: Path, options: Mapping[str, object]) -> base.ImportPlan:
        listed, unread = files.read_table(files.only_file(source, EXPERIMENTS), torn=True).sound(
            ID, (), (ID, *WHOLE), once=True
        )
        folder, problems = _read(source, listed)
        names = listed.columns[ID]
        for name in sorted({*folder.complete, *folder.broken} - {*names, *unread}):
            file = f"exp{name}_setup.json"
            stranger = InvalidInput(file, found="no such row", expected=f"one in {EXPERIMENTS}")
            problems[file] = folder.broken.get(name, stranger)
        failed = {**folder.untracked, **folder.broken}
        rows = [
            row for row, name in enumerate(names) if name in folder.complete or name not in failed
        ]
        sound = [names[row] for row in rows]
        lost = {name: failed[name] for name in names if name not in sound}
        problems |= base.named(DATASET, unread | lost)
        whole = sorted(int(name) for name in sound if name in folder.complete)
        return base.ImportPlan(
            DATASET,
            source,
            _understood(len(rows), len(folder.tracks.frame), whole),
            [f"{DATASET}/{name}" for name in sound],
            lambda k: _experiment(folder, rows[k]),
            problems,
            lambda k, experiment: _simulation(folder, rows[k], experiment),
        )


def _understood(n: int, n_frames: int, whole: list[int]) -> tuple[str, ...]:
    known = ", ".join(map(str, whole)) or "none"
    return (
        f"{n} experiments, {n_frames} video frames at {FRAME_RATE:g} Hz; the clock of each starts"
        " at its first frame.",
        "Positions from mm to m, angles in rad, in the calibrated frame of the plate; z is the"
        " height of the object above the plate and no angle.",
        "Contact modes from 3 bits: 4 is fixel 1, 2 is fixel 2, 1 is fixel 3; 8 means invalid.",
        f"Complete with actuator, fixels and tactile signals: {known}; the others have the object"
        " alone (no-actuator, no-fixels) and no scene.",
        "The actuator is the marker as seen: the smoothed one runs on after it has stalled"
        " (actuator-filter-runs-on) and is a channel.",
        f"Scenes: the authors' calibrated parameters as nominal friction, force limit"
        f" {FORCE_LIMIT:g} N.",
        "Simulated trajectories of the authors are stored as simulations of the experiments;"
        " filtered ones are not imported.",
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
        return files.member(self.setup, path, self.setup_file)

    def points(self, path: str) -> FloatArray:
        """Return points (n, 2) of the setup [m]."""
        return _points(self.value(path), self.setup_file)


class _Tracks(NamedTuple):
    """Poses of the object in several experiments, measured or simulated."""

    path: Path
    frame: IntArray  # (n,)
    poses: FloatArray  # (n, 4) x, y, angle, height [m, m, rad, m]
    rows: Mapping[str, NDArray[np.intp]]  # of each experiment
    problems: files.Problems  # of experiments with a damaged row


class _Folder(NamedTuple):
    """Content of the folder, with the reasons for which experiments cannot be built."""

    path: Path
    listed: files.CsvRows
    complete: Mapping[str, _Trial]
    broken: files.Problems  # of experiments with a setup that cannot be read
    tracks: _Tracks
    untracked: files.Problems  # of experiments without a trajectory
    simulated: _Tracks  # by the laboratory
    provenance: Callable[[Path], model.Provenance]


def _read(source: Path, listed: files.CsvRows) -> tuple[_Folder, files.Problems]:
    """Load the files of a folder; return also the problems of files that no experiment needs."""
    complete, broken, problems = _complete(source)
    path = files.only_file(source, *TRACKS)
    names = listed.columns[ID]
    try:
        tracks = _tracks(path)
        short = files.missing_rows(tracks.rows, path.name, listed, ID)
        untracked = short | tracks.problems
    except FixelError as problem:  # complete trials do not need it
        if not complete:
            raise
        tracks, untracked = _no_tracks(path), dict.fromkeys(names, problem)
    file = next((source / name for name in SIMULATED if (source / name).is_file()), None)
    simulated = _no_tracks(source)
    if file is not None:
        with base.collected(problems, file.name, file.name):
            simulated = _tracks(file)
    return _Folder(
        source, listed, complete, broken, tracks, untracked, simulated, cache(base.origin_of)
    ), problems


def _tracks(path: Path) -> _Tracks:
    """Load a table of poses of several experiments."""
    with base.guarded(path.name):
        table, problems = files.read_table(path, torn=True).sound(ID, POSE, ("frame",))
        poses = table.stacked(*POSE) * (files.MM, files.MM, 1.0, files.MM)
        return _Tracks(
            path, table.whole_numbers("frame"), poses, files.rows_of(table, ID), problems
        )


def _no_tracks(path: Path) -> _Tracks:
    return _Tracks(path, np.zeros(0, np.int64), np.zeros((0, 4)), {}, {})


def _complete(folder: Path) -> tuple[dict[str, _Trial], files.Problems, files.Problems]:
    """Load all complete trials of a folder; return also those with an error, and other files."""
    trials: dict[str, _Trial] = {}
    broken: files.Problems = {}
    strange: files.Problems = {}
    for path in sorted(folder.glob("exp*_setup.json")):
        match = re.fullmatch(r"exp(\d+)_setup\.json", path.name)
        if match is None:
            expected = "exp<number>_setup.json"
            strange[path.name] = InvalidInput(
                path.name, found="a name without a number", expected=expected
            )
            continue
        with base.collected(broken, match[1], path.name):
            trials[match[1]] = _trial(folder, int(match[1]))
    return trials, broken, strange


def _trial(folder: Path, number: int) -> _Trial:
    setup_file = f"exp{number}_setup.json"
    setup = files.read_json(folder / setup_file)
    frames = files.read_table(files.only_file(folder, f"exp{number}_frames.csv"))
    files.increasing(frames.numbers("time_s"), frames.source)
    fixels = _points(files.member(setup, "fixel_positions_mm", setup_file), setup_file)
    tactile = frames.stacked(*(f"tactile_{k + 1}" for k in range(len(fixels))))
    return _Trial(
        source=frames.source,
        setup=setup,
        setup_file=setup_file,
        frame=frames.whole_numbers("frame"),
        pose=_poses(frames, "object_x_mm", "object_y_mm", "object_theta_rad"),
        marker=frames.stacked("actuator_marker_x_mm", "actuator_marker_y_mm") * files.MM,
        filtered=frames.stacked("actuator_x_mm", "actuator_y_mm") * files.MM,
        tactile=(tactile > 0.5).astype(np.float64),
        fixels=fixels,
    )


def _poses(table: files.CsvRows, *columns: str) -> FloatArray:
    return table.stacked(*columns) * (files.MM, files.MM, 1.0)


def _points(points: object, source: str) -> FloatArray:
    try:
        return np.asarray(points, dtype=np.float64).reshape(-1, 2) * files.MM
    except (TypeError, ValueError):
        raise InvalidInput(source, found=points, expected="pairs of numbers [mm]") from None


class LabSimulation(NamedTuple):
    """Simulation of a trial by the laboratory's own simulator; not measured."""

    time: FloatArray  # (n,) on the clock of the experiment [s]
    pose: FloatArray  # (n, 3) of the object [m, m, rad]
    actuator: FloatArray  # (n, 2) position of the driver, which was its input [m]


def lab_simulation(folder: Path, number: int) -> LabSimulation | None:
    """Load the laboratory's simulation of a complete trial; None if it was not stored."""
    path = folder / _lab_file(number)
    if not path.is_file():
        return None
    frames = files.read_table(files.only_file(folder, f"exp{number}_frames.csv"))
    first = int(frames.whole_numbers("frame")[0])
    rows = files.read_table(path)
    return LabSimulation(
        _time(rows.whole_numbers("frame"), first),
        _poses(rows, "object_x_mm", "object_y_mm", "object_theta_rad"),
        rows.stacked("actuator_x_mm", "actuator_y_mm") * files.MM,
    )


def _lab_file(number: int) -> str:
    return f"exp{number}_author_simulation.csv"


def _experiment(folder: _Folder, row: int) -> model.Experiment:
    """Build the experiment in a row of the list."""
    trial = folder.complete.get(folder.listed.columns[ID][row])
    return _track(folder, row) if trial is None else _whole(folder, row, trial)


def _simulation(folder: _Folder, row: int, experiment: model.Experiment) -> SimulationRecord | None:
    """Return the laboratory's simulation of an experiment, on the clock of the experiment."""
    # Imported here: it loads the simulator, which no other importer needs.
    from fixel.calibration.target import errors_of, squared_error

    name, pusher = experiment.name, None
    lab = lab_simulation(folder.path, int(name)) if name in folder.complete else None
    if lab is not None:
        path = folder.path / _lab_file(int(name))
        trajectory = base.trajectory_of(lab.time, lab.pose)
        angle = np.full((len(lab.time), 1), folder.complete[name].value(ORIENTATION))
        pusher = model.Trajectory(time=lab.time, pose=np.hstack((lab.actuator, angle)))
    elif name in folder.simulated.problems:
        raise folder.simulated.problems[name]
    elif name in folder.simulated.rows:
        own, path = folder.simulated.rows[name], folder.simulated.path
        trial = folder.complete.get(name)
        frames = folder.tracks.frame[folder.tracks.rows[name]] if trial is None else trial.frame
        first = int(frames[0])
        trajectory = base.trajectory_of(
            _time(folder.simulated.frame[own], first), folder.simulated.poses[own, :3]
        )
    else:
        return None
    modes = folder.listed.columns.get("final_contact_mode_author_sim")
    return SimulationRecord(
        experiment_id=0,
        parameters=model.Parameters(),
        provenance=folder.provenance(path),
        trajectory=trajectory,
        pusher=pusher,
        method={"simulated_by": "laboratory"},
        contact_mode=_mode(int(modes[row]))[0] if modes and modes[row].isdecimal() else "",
        error_mm2=squared_error(*errors_of(experiment, trajectory)[1:]),
    )


def _track(folder: _Folder, row: int) -> model.Experiment:
    """Build an experiment from the tracked object alone."""
    name = folder.listed.columns[ID][row]
    own = folder.tracks.rows[name]
    frame, poses = folder.tracks.frame[own], folder.tracks.poses[own]
    object_id, mode, start, end = (int(folder.listed.columns[column][row]) for column in WHOLE)
    time = _time(frame, int(frame[0]))
    digits, flags = _mode(mode)
    if object_id == OUTLINE_UNKNOWN:
        flags = (
            *flags,
            base.remark("no-shape", f"the outline of object {object_id} was not recovered"),
        )
    return model.Experiment(
        dataset=DATASET,
        name=name,
        real=True,
        provenance=folder.provenance(folder.tracks.path),
        object_name=OBJECT,
        trajectory=base.trajectory_of(time, poses[:, :3]),
        height=float(poses[0, 3]),
        contact_mode=digits,
        effective=_effective(frame, start, end),
        conditions={"object_id": float(object_id)},
        flags=(
            *flags,
            base.remark("no-actuator", "the path of the actuator was not recorded"),
            base.remark("no-fixels", "the positions of the fixels were not recorded"),
        ),
    )


def _whole(folder: _Folder, row: int, trial: _Trial) -> model.Experiment:
    """Build an experiment with actuator, fixels and tactile signals."""
    digits, flags = _mode(trial.value("final_contact_mode"))
    first = int(trial.frame[0])
    effective = _effective(trial.frame, trial.value("start_frame"), trial.value("end_frame"))
    time = _time(trial.frame, first)
    angle: FloatArray = np.full(len(time), trial.value(ORIENTATION))
    marker = np.column_stack((time, trial.marker, angle))
    scene, why_not = base.scene_or_flag(lambda: _scene(trial, marker, effective[1]))
    runs_on = float(np.hypot(*(trial.filtered - trial.marker).T).max())
    n_fixel = len(trial.fixels)
    return model.Experiment(
        dataset=DATASET,
        name=str(int(folder.listed.columns[ID][row])),
        real=True,
        provenance=folder.provenance(folder.path / trial.source),
        object_name=OBJECT,
        trajectory=base.trajectory_of(time, trial.pose),
        pusher=model.Trajectory(time=time, pose=marker[:, 1:]),
        scene=scene,
        height=_height(trial.value("object").get("height_mm")),
        pusher_height=_height(trial.value("actuator").get("height_mm")),
        fixel_height=_height(trial.setup.get("fixel_height_mm")),
        channels=(
            model.Channel.of_fixels(time, trial.tactile),
            model.Channel(
                name="actuator-filtered", time=time, columns=("x_m", "y_m"), values=trial.filtered
            ),
        ),
        contact_mode=digits if not digits or n_fixel == N_FIXEL else "",
        effective=effective,
        conditions={"object_id": float(folder.listed.whole_numbers("object_id")[row])},
        flags=(
            *flags,
            *why_not,
            base.remark(
                "actuator-filter-runs-on",
                f"the smoothed path is up to {runs_on / files.MM:.2g} mm from the marker",
            ),
        ),
    )


def _scene(trial: _Trial, marker: FloatArray, duration: float) -> model.Scene:
    calibrated = "system_parameters_calibrated_by_authors"
    radius, mu_support, mu_actuator, mu_fixel = (
        trial.value(f"{calibrated}.{name}")
        for name in ("tripod_radius_mm", "mu_support", "mu_actuator", "mu_fixel")
    )
    fixel = model.Disk(trial.value("fixel_radius_mm") * files.MM)
    body = model.Body(
        name=OBJECT,
        shape=model.Polygon(trial.points("object.vertices_mm")),
        mass=trial.value("object.mass_kg"),
        inertia=trial.value("object.moment_of_inertia_kg_mm2") * files.MM**2,
        centre_of_mass=np.zeros(2),
        pose=trial.pose[0],
        support=model.Tripod(radius=radius * files.MM, friction=mu_support),
    )
    actuator = model.Pusher(
        name=ACTUATOR,
        shape=model.Polygon(trial.points("actuator.vertices_mm")),
        pose=marker[0, 1:],
        drive=model.PathDrive(waypoints=marker, force_limit=FORCE_LIMIT),
        friction=mu_actuator,
    )
    fixels = tuple(
        model.Fixel(
            name=f"fixel-{k + 1}", shape=fixel, pose=np.append(centre, 0.0), friction=mu_fixel
        )
        for k, centre in enumerate(trial.fixels)
    )
    return model.Scene(bodies=(body,), pushers=(actuator,), fixels=fixels, duration=duration)


def _mode(mode: int) -> tuple[str, tuple[model.Flag, ...]]:
    """Digits of fixels 1 to 3 from the authors' number, or a flag if it is invalid."""
    if mode < INVALID_MODE:
        return f"{mode:03b}", ()
    return "", (base.remark("contact-mode-invalid", f"the record has {mode}"),)


def _time(frame: NDArray[np.int64], first: int) -> FloatArray:
    return (frame - first) / FRAME_RATE


def _effective(frame: NDArray[np.int64], start: int, end: int) -> tuple[float, float]:
    if not frame[0] <= start <= end:
        found, expected = f"frames {start} to {end}", f"frames from {frame[0]} on"
        raise InvalidInput(EXPERIMENTS, found=found, expected=expected)
    return float((start - frame[0]) / FRAME_RATE), float((end - frame[0]) / FRAME_RATE)


def _height(height: float | None) -> float | None:
    return None if height is None else height * files.MM
