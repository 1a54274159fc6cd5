"""Tracking of rendered films against the truth they were rendered from, on one core."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.figures import Figure, Size, at_least, at_most
from fixel.formats.rig_file import rig_of
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.model import pose_error
from fixel.testing.scenes import grasp, micro_push
from fixel.vision.frame import opencv
from fixel.vision.tracking import FilmTracks, PartTrack, track
from fixel.workflows.acquisition import film_experiments
from fixel.workflows.acquisition.track import open_film

# [m] that no pose that is believed may be off by: two pixels, on the bench and under the microscope
OUTLIER, SMALL_OUTLIER = 1e-3, 10e-6


class Case(NamedTuple):
    """A film, and what its parts must reach: position [m], angle [rad]."""

    name: str
    rig: str
    looks: str
    position: float
    angle: float


CASES = (
    Case("tags", "thesis-tags", "thesis", 0.15e-3, np.radians(0.15)),
    Case("stickers", "thesis-stickers", "thesis", 0.3e-3, np.radians(0.3)),
    Case("tags, hard", "thesis-tags", "hard", 0.3e-3, np.radians(0.3)),
    Case("stickers, hard", "thesis-stickers", "hard", 0.6e-3, np.radians(0.6)),
    Case("microscope", "microscope", "microscope", 2e-6, np.radians(0.1)),
)
PROBE = 3e-6  # [m]
SPEED = 120.0  # [frames/s]


def run(size: Size) -> list[Figure]:
    """Every case: errors, gaps, outliers, and frames a second with decoding."""
    opencv().setNumThreads(1)
    frames = None if size.rollouts >= 500 else 4
    with tempfile.TemporaryDirectory() as folder:
        figures = []
        for number, case in enumerate(CASES):
            figures += _case(case, Path(folder) / str(number), frames, size.repeats)
    return figures


def _case(case: Case, folder: Path, frames: int | None, repeats: int) -> list[Figure]:
    small = case.rig == "microscope"
    folder.mkdir()
    planned = (
        SceneFile(scene=micro_push(), motion="quasistatic")
        if small
        else SceneFile(scene=grasp(), motion="dynamic")
    )
    save_scene(planned, folder / "planned.yaml")
    shot = folder / "film"
    # The hand would lie over all of a film that is only for seeing whether everything runs.
    changes = () if frames is None or small else ("occlusion=0",)
    film_experiments(
        [str(folder / "planned.yaml")],
        out=shot,
        rig=case.rig,
        looks=case.looks,
        frames=frames,
        changes=changes,
    )
    recording, rig = open_film(shot), rig_of(shot / "rig.yaml")
    truth = np.load(shot / "truth.npz")
    rates = []
    runs = max(min(repeats, 3), 2) if frames is None else 1  # the first one compiles
    for _ in range(runs):
        start = time.process_time()
        tracked = track(recording.frames(), rig, planned.scene)
        rates.append(len(tracked.time) / (time.process_time() - start))
    figures = []
    for name, part in tracked.parts.items():
        figures += _errors(case, name, part, truth[f"pose_{name}"], small=small)
    limit, words = (SMALL_OUTLIER, "10 um") if small else (OUTLIER, "1 mm")
    found = _unflagged(tracked, truth, limit)
    return [
        *figures,
        Figure(f"tracking, {case.name}, unflagged beyond {words}", "-", (found,), at_most(0.0)),
        Figure(
            f"tracking, {case.name}, speed with decoding",
            "frames/s",
            tuple(rates[1:] or rates),
            at_least(SPEED),
        ),
    ]


def _errors(
    case: Case, name: str, part: PartTrack, truth: np.ndarray, *, small: bool
) -> list[Figure]:
    position, angle = pose_error(part.pose[part.good], truth[part.good])
    rms = [float(np.sqrt(np.mean(error**2))) for error in (position, angle)]
    label = f"tracking, {case.name}, {name}"
    unit, factor = ("um", 1e6) if small else ("mm", 1e3)
    most = PROBE if name == "probe" else case.position
    gaps = 100.0 * float(np.mean(~part.good))
    figures = [
        Figure(f"{label}, position RMS", unit, (factor * rms[0],), at_most(factor * most)),
        Figure(f"{label}, frames without a pose", "%", (gaps,)),
    ]
    if name != "probe":
        limit = at_most(float(np.degrees(case.angle)))
        figures.insert(1, Figure(f"{label}, angle RMS", "deg", (float(np.degrees(rms[1])),), limit))
    return figures


def _unflagged(tracked: FilmTracks, truth: np.lib.npyio.NpzFile, limit: float) -> float:
    """How many poses that are believed are off by more than a limit [m]."""
    return float(
        sum(
            int((pose_error(part.pose, truth[f"pose_{name}"])[0][part.good] > limit).sum())
            for name, part in tracked.parts.items()
        )
    )
