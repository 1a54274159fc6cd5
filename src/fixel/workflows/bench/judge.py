"""Track a recorded attempt and find reasons to repeat it; called in a process of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.formats.recording import open_recording
from fixel.formats.scene_file import load_scene
from fixel.model import Experiment, LineDrive, PlannedExperiment, Scene
from fixel.model.trajectory import wrapped
from fixel.workflows.acquisition.overlay import Tolerance
from fixel.workflows.acquisition.track import SCENE_FILE, track_film

REST: Final = 0.3  # [s] at the end in which the part must be at rest
MOVED: Final = 0.3e-3  # [m] in that time that counts as motion
SHORT: Final = 0.97  # share of the planned travel below which the drive was overloaded


class TrackRequest(NamedTuple):
    """Attempt to track."""

    folder: Path  # its recording, with rig and scene
    row: PlannedExperiment
    number: int  # number of the attempt
    dataset: str
    tolerance: Tolerance  # largest allowed deviation of the start


class TrackedAttempt(NamedTuple):
    """Experiment of an attempt, and reasons to repeat it."""

    experiment: Experiment
    reasons: tuple[str, ...]
    seconds: float  # duration of tracking [s]


def track_attempt(request: TrackRequest) -> TrackedAttempt:
    """Track the recording of an attempt and judge it.

    Raises
    ------
    InvalidInput
        A recording that cannot be tracked; with the reason.
    """
    begun = time.monotonic()
    row = request.row
    found = track_film(request.folder, dataset=request.dataset, name=row.name).experiment
    conditions = {**row.conditions, **found.conditions, "attempt": float(request.number)}
    experiment = replace(found, conditions=conditions)
    planned = load_scene(request.folder / SCENE_FILE).scene
    reasons = tuple(_reasons(experiment, planned, request.folder, request.tolerance))
    return TrackedAttempt(experiment, reasons, time.monotonic() - begun)


def _reasons(
    experiment: Experiment, planned: Scene, folder: Path, tolerance: Tolerance
) -> Iterator[str]:
    end = open_recording(folder).end
    if end is None:
        yield "the recording was interrupted"
    elif end.lost:
        yield f"{end.lost} frames were lost"
    yield from (f"{flag.name}: {flag.detail}" for flag in experiment.flags if flag.fault)
    track = experiment.trajectory
    last = track.pose[track.time >= track.time[-1] - REST, :2]
    moved = float(np.hypot(*np.ptp(last, axis=0)))
    if moved > MOVED:
        yield f"the part still moved by {1e3 * moved:.1f} mm in the last {REST:g} s"
    off = track.pose[0] - planned.bodies[0].pose
    apart, turned = float(np.hypot(*off[:2])), abs(float(wrapped(off[2])))
    if apart > tolerance.distance or turned > tolerance.angle:
        yield f"the part began {1e3 * apart:.1f} mm and {math.degrees(turned):.1f} deg off"
    if experiment.effective is None:
        yield "the head did not move"
    elif "1" not in experiment.contact_mode and (wanted := planned_travel(planned)):
        # A head that holds a part against a fixel stops early.
        travel = float(experiment.conditions.get("travel_m", wanted))
        if travel < SHORT * wanted:
            yield f"the head moved {1e3 * travel:.1f} of {1e3 * wanted:.1f} mm: overload"


def planned_travel(scene: Scene) -> float:
    """Return the distance that the head of a scene moves [m]; 0 for a path."""
    drive = scene.pushers[0].drive
    return drive.distance(scene.duration) if isinstance(drive, LineDrive) else 0.0
