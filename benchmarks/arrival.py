"""Poses lost where the same pictures arrive at uneven times, and what tracking costs then."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.figures import Figure, Size, at_most
from fixel.formats.rig_file import rig_of
from fixel.formats.scene_file import SceneFile, save_scene
from fixel.model import pose_error
from fixel.testing.scenes import grasp
from fixel.typing import FloatArray
from fixel.vision.frame import Frame, opencv
from fixel.vision.tracking import track
from fixel.workflows.acquisition import film_experiments
from fixel.workflows.acquisition.track import Film, open_film

MEANS: Final = (0.0, 0.005, 0.015, 0.03)  # [s] by which frames are held up
SHARES: Final = (1.0, 0.3)  # of the frames
SEEDS: Final = range(3)


def run(size: Size) -> list[Figure]:
    """A rendered film of tags, its time stamps rewritten."""
    opencv().setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        planned, shot = Path(folder) / "planned.yaml", Path(folder) / "film"
        save_scene(SceneFile(scene=grasp(), motion="dynamic"), planned)
        frames = None if size.rollouts >= 500 else 12
        film_experiments([str(planned)], out=shot, frames=frames, changes=("occlusion=0",))
        made, rig = open_film(shot), rig_of(shot / "rig.yaml")
        truth = np.load(shot / "truth.npz")
        track(made.frames(), rig)  # compiles
        figures = []
        for mean in MEANS:
            for share in SHARES if mean else SHARES[:1]:
                lost, worst, cost = [], [], []
                for seed in SEEDS if mean else SEEDS[:1]:
                    begun = time.process_time()
                    tracked = track(_held_up(made, mean, share, seed), rig)
                    cost.append((time.process_time() - begun) / len(tracked.time))
                    for name, part in tracked.parts.items():
                        off, _ = pose_error(part.pose[part.good], truth[f"pose_{name}"][part.good])
                        lost.append(float((~part.good).sum()))
                        worst.append(1e3 * float(off.max()))
                label = f"arrival, {1e3 * mean:g} ms mean, {share:.0%} of frames"
                figures += [
                    Figure(f"{label}, poses lost", "-", (max(lost),), at_most(0.0)),
                    Figure(f"{label}, worst error", "mm", (max(worst),)),
                    Figure(f"{label}, CPU time a frame", "ms", tuple(1e3 * c for c in cost)),
                ]
        return figures


def arrivals(taken: FloatArray, mean: float, share: float, seed: int) -> FloatArray:
    """(n,) arrival of frames taken at (n,), some held up by an exponential time; in order [s]."""
    rng = np.random.default_rng(seed)
    held = rng.exponential(mean, len(taken)) if mean else np.zeros(len(taken))
    held[rng.random(len(taken)) >= share] = 0.0
    return np.asarray(np.maximum.accumulate(taken + held) + 1e-6 * np.arange(len(taken)))


def _held_up(made: Film, mean: float, share: float, seed: int) -> Iterator[Frame]:
    taken = np.array([frame.time for frame in made.frames()])
    for at, frame in zip(arrivals(taken, mean, share, seed), made.frames(), strict=True):
        frame.time = float(at)
        yield frame
