"""RPI's trials with nearly equal starts, until contact with fixels of unknown position."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.model import Body, Experiment, LineDrive, Polygon, Pusher, Scene, Tripod
from fixel.typing import BoolArray, FloatArray
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.uncertainty.starts import StartError, even_points

NAMES: Final = ("126", "127", "129", "130", "132", "134", "136")

# Square and head of trial 141 on the same rig, and the head's speed there [m/s].
SQUARE: Final = np.array([[-53.8, 53.4], [-53.8, -53.4], [53.4, -53.4], [53.4, 53.4]]) * 1e-3
HEAD: Final = np.array([[-14.3, -14.3], [14.3, -14.3], [14.3, 14.3], [-14.3, 14.3]]) * 1e-3
SPEED: Final = 9.24e-3
MASS: Final = 0.2564

# Range of the head's centre along the side of the square, with at least 1 mm of contact [m].
HEAD_PLACE: Final = (-66e-3, 66e-3)
FRICTION: Final = {
    "mu_pusher": (0.15, 0.6),
    "tripod_radius": (25e-3, 50e-3),
    "friction_centre_x": (-5e-3, 5e-3),
    "friction_centre_y": (-5e-3, 5e-3),
}

MOVED: Final = 0.5e-3  # [m], displacement from which the object counts as moving
AFTER: Final = 1.0  # [s] of motion, before any trial has met a fixel
START_FRAMES: Final = 30  # number of frames before the motion, whose mean is the start


class AlikeGroup(NamedTuple):
    """Trials with nearly the same start pose of the object."""

    name: str
    start: FloatArray  # (n, 3) measured [m, m, rad]
    end: FloatArray  # (n, 3) measured after a second of motion
    error: StartError

    def predicted(self, n: int) -> tuple[FloatArray, BoolArray]:
        """Predict poses (n, 3) after a second of motion, for any place of the head, and a mask."""
        names = ("registration_x", *FRICTION)
        ranges = np.array([HEAD_PLACE, *FRICTION.values()])
        shares = even_points(n, len(names) + 3, seed=6)
        # Shuffle, since neighbours in a Sobol sequence are not independent trials.
        shares = np.random.default_rng(9).permutation(shares)
        values = {
            name: low + (high - low) * shares[:, k]
            for k, (name, (low, high)) in enumerate(zip(names, ranges, strict=True))
        }
        drawn = np.random.default_rng(10).standard_normal((n, 3)) * self.error.size
        scene = _scene(self.start.mean(axis=0))
        fan = simulate_starts(scene, self.error, drawn=drawn, values=values, times=[scene.duration])
        return fan.pose[:, -1], fan.ended


def alike_group(folder: Path) -> AlikeGroup:
    """Load trials 126 to 136 of the square, whose starts are within a millimetre."""
    found = {e.name: e for e in Rpi2dgad().read(folder).experiments() if e.name in NAMES}
    pairs = [_start_and_end(found[name]) for name in NAMES if name in found]
    start, end = (np.array(poses) for poses in zip(*pairs, strict=True))
    spread = start.std(axis=0, ddof=1)
    error = StartError(
        x=float(spread[0]), y=float(spread[1]), theta=float(spread[2]), kind="normal"
    )
    return AlikeGroup("2dgad 126-136, first second of motion", start, end, error)


def _start_and_end(experiment: Experiment) -> tuple[FloatArray, FloatArray]:
    time, pose = experiment.trajectory.time, experiment.trajectory.pose
    still = pose[:START_FRAMES].mean(axis=0)
    first = int(np.argmax(np.hypot(*(pose - still)[:, :2].T) > MOVED))
    last = int(np.searchsorted(time, time[first] + AFTER))
    return still, pose[last - 1 : last + 2].mean(axis=0)


def _scene(start: FloatArray) -> Scene:
    """Scene in which the head moves along -y, as in trial 141, from just above the square."""
    square, head = Polygon(SQUARE), Polygon(HEAD)
    top = 53.6e-3 + 14.3e-3 + 0.6e-3
    body = Body(
        name="square",
        shape=square,
        mass=MASS,
        pose=start,
        support=Tripod(radius=37e-3, friction=0.46),
    )
    pusher = Pusher(
        name="head",
        shape=head,
        pose=np.array([start[0], start[1] + top, 0.0]),
        drive=LineDrive(direction=np.array([0.0, -1.0]), speed=SPEED),
        friction=0.36,
    )
    return Scene(bodies=(body,), pushers=(pusher,), duration=AFTER + 0.06)
