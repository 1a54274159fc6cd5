"""Ground truth at every frame of a film, to evaluate trackers."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.io.atomic import written_whole
from fixel.model import Trajectory
from fixel.model.chance import stream
from fixel.testbed.sensors import tactile_channel, touching
from fixel.typing import BoolArray, FloatArray
from fixel.vision.marks import Rig
from fixel.vision.render import Looks
from fixel.vision.render.bench import HAND
from fixel.vision.render.film import occlusion_of, poses_at
from fixel.vision.render.looks import light
from fixel.workflows.acquisition.film_shots import FilmScene

ARRAYS: Final = "truth.npz"
ABOUT: Final = "truth.json"


class Truth(NamedTuple):
    """Ground truth at every frame of a film.

    Attributes
    ----------
    time : (n,) float64
        [s]
    pose : dict of str to (n, 3) float64
        Poses of bodies and pushers in the middle of the exposure [m, m, rad].
    touches : (n, n_fixel) bool
        Whether the object touches each fixel of the scene.
    reading : (n,) int64
        Tactile byte as reported, with false and missed contacts; -1 without fixels.
    light : (n, 3) float64
        Factors of blue, green and red [-].
    covered : (n,) float64
        Fraction of the object's upper face under the hand [-].
    """

    time: FloatArray
    pose: dict[str, FloatArray]
    touches: BoolArray
    reading: NDArray[np.int64]
    light: FloatArray
    covered: FloatArray


def tracks_of(shot: FilmScene, lead: float) -> dict[str, Trajectory]:
    """Return the true trajectories on the clock of a film that begins with a rest [s]."""
    simulation = shot.simulation
    tracks = {}
    for name, pose in simulation.pose.items():
        known = np.isfinite(pose).all(axis=1)
        tracks[name] = Trajectory(time=lead + simulation.time[known], pose=pose[known])
    return tracks


def truth_of(
    shot: FilmScene, rig: Rig, looks: Looks, times: FloatArray, seed: int, lead: float
) -> Truth:
    """Compute the ground truth of a film at its frame times (n,) [s]."""
    tracks = tracks_of(shot, lead)
    occlusion = occlusion_of(shot.scene, rig, looks, times, seed)
    name = shot.scene.bodies[0].name
    covered = []
    for time in times.tolist():
        poses = poses_at(tracks, time, occlusion, shot.scene)
        covered.append(occlusion.share(poses.get(HAND), poses[name]))
    touches = _touches(shot, times - lead)
    return Truth(
        time=times,
        pose={name: track.at(times) for name, track in tracks.items()},
        touches=touches,
        reading=_readings(shot, rig, times, touches, seed),
        light=light(looks, times, seed),
        covered=np.array(covered),
    )


def write_truth(
    shot: FilmScene, truth: Truth, looks: Looks, seed: int, lead: float, folder: Path
) -> None:
    """Write `truth.npz` (frame by frame) and `truth.json`; trackers must not read them."""
    arrays: dict[str, Any] = {
        "time_s": truth.time,
        "touches": truth.touches,
        "reading": truth.reading,
        "light": truth.light,
        "covered": truth.covered,
        **{f"pose_{name}": pose for name, pose in truth.pose.items()},
    }
    with written_whole(folder / ARRAYS) as unfinished:
        np.savez_compressed(unfinished, **arrays)
    simulation = shot.simulation
    content = {
        "name": shot.name,
        "seed": seed,
        "testbed_seed": shot.testbed.seed,
        "looks": asdict(looks),
        "status": simulation.status,
        "motion_s": [lead, lead + float(simulation.time[-1])],
        "bodies": [body.name for body in shot.scene.bodies],
        "pushers": [pusher.name for pusher in shot.scene.pushers],
        "fixels": [fixel.name for fixel in shot.scene.fixels],
        "conditions": dict(shot.truth),
    }
    with written_whole(folder / ABOUT) as unfinished:
        unfinished.write_text(json.dumps(content, indent=1, allow_nan=False), encoding="utf-8")


def _touches(shot: FilmScene, times: FloatArray) -> BoolArray:
    """Contacts (n, n_fixel) at times of the simulation; the first sample before its start."""
    simulation = shot.simulation
    sample = np.searchsorted(simulation.time, times, side="right") - 1
    return np.asarray(touching(simulation)[np.clip(sample, 0, len(simulation.time) - 1)])


def _readings(
    shot: FilmScene, rig: Rig, times: FloatArray, touches: BoolArray, seed: int
) -> NDArray[np.int64]:
    """Tactile bytes (n,) as reported: one bit per coil, in the rig's order."""
    names = [fixel.name for fixel in shot.scene.fixels]
    if not names:
        return np.full(len(times), -1, np.int64)
    random = stream(seed, "film", "tactile", shot.name)
    wrong = shot.testbed.false_contact, shot.testbed.missed_contact
    reported = tactile_channel(times, touches, *wrong, random).values.astype(np.int64)
    total = np.zeros(len(times), np.int64)
    for bit, name in enumerate(rig.tactile):
        if name in names:
            total |= reported[:, names.index(name)] << bit
    return total
