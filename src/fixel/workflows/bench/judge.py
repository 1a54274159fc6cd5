"""Track a recorded attempt and find reasons to repeat it; called in a process of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.formats.recording import SCENE_FILE, open_recording
from fixel.formats.scene_file import load_scene
from fixel.model import Experiment, LineDrive, PlannedExperiment, Scene
from fixel.model.trajectory import pose_error
from fixel.workflows.acquisition.overlay import Tolerance
from fixel.workflows.acquisition.track import track_film

REST: Final = 0.3  # [s] at the end in which the part must be at rest
MOVED: Final = 0.3e-3  # [m] in that time that counts as motion
UNSEEN: Final = 0.5  # [s] without a pose of the part, which a hand or the head hides
SHORT: Final = 0.97  # share of the planned travel below which the drive was overloaded


class TrackedAttempt(NamedTuple):
    """Experiment of an attempt, and reasons to repeat it."""

    experiment: Experiment
    reasons: tuple[str, ...]


def track_attempt(
    folder: Path, row: PlannedExperiment, number: int, dataset: str, tolerance: Tolerance
) -> TrackedAttempt:
    """Track the recording of an attempt with its rig and scene, and judge it.

    `tolerance` is the largest allowed deviation of the start. A recording that cannot be tracked
    raises `InvalidInput` with the reason.
    """
    found = track_film(folder, dataset=dataset, name=row.name).experiment
    conditions = {**row.conditions, **found.conditions, "attempt": float(number)}
    experiment = replace(found, conditions=conditions)
    planned = load_scene(folder / SCENE_FILE).scene
    return TrackedAttempt(experiment, tuple(_reasons(experiment, planned, folder, tolerance)))


def _reasons(
    experiment: Experiment, planned: Scene, folder: Path, tolerance: Tolerance
) -> Iterator[str]:
    recording = open_recording(folder)
    end = recording.end
    if end is None:
        yield "the recording was interrupted"
    elif end.lost:
        yield f"{end.lost} frames were lost"
    yield from (f"{flag.name}: {flag.detail}" for flag in experiment.flags if flag.fault)
    track, drive = experiment.trajectory, planned.pushers[0].drive
    seen = (0.0, *track.time, recording.time[-1] - recording.time[0])
    if (unseen := float(np.diff(seen).max())) > UNSEEN:
        yield f"the part was not seen for {unseen:.1f} s"
    last = track.pose[track.time >= track.time[-1] - REST, :2]
    moved = float(np.hypot(*np.ptp(last, axis=0)))
    if moved > MOVED:
        yield f"the part still moved by {1e3 * moved:.1f} mm in the last {REST:g} s"
    apart, turned = map(abs, pose_error(track.pose[0], planned.bodies[0].pose))
    if apart > tolerance.distance or turned > tolerance.angle:
        yield f"the part began {1e3 * apart:.1f} mm and {math.degrees(turned):.1f} deg off"
    if experiment.effective is None:
        yield "the head did not move"
    elif "1" not in experiment.contact_mode and isinstance(drive, LineDrive):
        # A head that holds a part against a fixel stops early.
        wanted = drive.distance(planned.duration)
        travel = float(experiment.conditions.get("travel_m", wanted))
        if travel < SHORT * wanted:
            yield f"the head moved {1e3 * travel:.1f} of {1e3 * wanted:.1f} mm: overload"
