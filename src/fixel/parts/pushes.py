"""Recorded pushes of one part on one surface, ready for thousands of simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.contacts import Configurations
from fixel.calibration.objective import ANGLE_SCALE
from fixel.calibration.target import Target
from fixel.errors import InvalidInput
from fixel.model import Disk, PathDrive, Pusher, Scene, pose_error
from fixel.simulation import QuasiStatic, StewartTrinkle
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.pack import pusher_path
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import BoolArray, FloatArray, IntArray

# Quasi-static pushes do not depend on time: all are simulated at one speed, in steps of 1 mm.
PACE: Final = 10e-3  # [m/s]
STEP: Final = 0.1  # [s]
LOST: Final = 20e-3  # distance that a push counts that cannot be simulated [m]


class Ends(NamedTuple):
    """End poses of simulated pushes."""

    pose: FloatArray  # (n, 3) [m, m, rad]; the measured start where the simulation failed
    good: BoolArray  # (n,) whether it converged


@final
class PartPushes:
    """Pushes of one part on one surface.

    Parameters
    ----------
    targets : sequence of Target
        Pushes of one free body by one round pusher.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    """

    def __init__(self, targets: Sequence[Target], threads: int | None = None) -> None:
        self.targets = tuple(targets)
        for target in targets:
            _check(target)
        scenes = [paced(target.case.scene, float(target.case.times[-1])) for target in targets]
        self.start = np.array([scene.bodies[0].pose for scene in scenes])
        # A push that has not been made ends where it starts.
        self.end = np.array(
            [t.pose[-1] if len(t.pose) else x for t, x in zip(targets, self.start, strict=True)]
        )
        self.body = scenes[0].bodies[0]
        paths = [pusher_path(scene.pushers[0], scene.duration) for scene in scenes]
        self.tip_start = np.array([path[0, 1:3] for path in paths])
        self.tip_end = np.array([path[-1, 1:3] for path in paths])
        self.radius = float(getattr(scenes[0].pushers[0].shape, "radius", 0.0))
        cases = [RolloutCase(scene, np.array([scene.duration])) for scene in scenes]
        stepper = StewartTrinkle(step=STEP)
        self._ensemble = Ensemble(cases, QuasiStatic(), stepper, threads=threads)

    def __len__(self) -> int:
        return len(self.targets)

    def simulate(self, which: IntArray, values: Mapping[str, FloatArray]) -> Ends:
        """Simulate pushes `which` (n,) with parameters (n,) by name."""
        outcome = self._ensemble.simulate(which, values)
        good = outcome.converged
        return Ends(np.where(good[:, None], outcome.pose[:, -1], self.start[which]), good)

    def in_frame(self, points: FloatArray) -> FloatArray:
        """Return points (n, 2), one per push, in the part's frame at the start of the push [m]."""
        c, s = np.cos(self.start[:, 2]), np.sin(self.start[:, 2])
        x, y = (points - self.start[:, :2]).T
        return np.column_stack((c * x + s * y, c * y - s * x))

    def errors(self, which: IntArray, ends: FloatArray) -> FloatArray:
        """Return errors (n, 2) of end poses: position [m] and angle [rad]."""
        position, angle = pose_error(ends, self.end[which])
        return np.column_stack((position, np.abs(angle)))

    def configurations(self, which: IntArray) -> Configurations:
        """Return the intended pushes `which` (k,)."""
        return Configurations(
            self.body.shape,
            self.radius,
            self.start[which],
            self.tip_start[which],
            self.tip_end[which],
        )

    def distance(self, which: IntArray, ends: FloatArray, good: BoolArray) -> float:
        """Return the mean distance of end poses (n, 3) from the measured ones [m]; angles times
        their length, failures like a large error."""
        off = self.errors(which, ends)
        return float(np.where(good, off[:, 0] + ANGLE_SCALE * off[:, 1], LOST).mean())


def paced(scene: Scene, duration: float) -> Scene:
    """Return a scene whose pusher moves at the common pace, for quasi-static motion."""
    pusher = scene.pushers[0]
    path = pusher_path(pusher, duration)
    path = path[path[:, 0] <= duration]
    way = np.linalg.norm(np.diff(path[:, 1:3], axis=0), axis=1)
    way += ANGLE_SCALE * np.abs(np.diff(path[:, 3]))
    keep = np.concatenate(([True], way > 0.0))
    path, way = path[keep], way[way > 0.0]
    if len(path) < 2:
        raise InvalidInput("scene.pusher", found="a pusher at rest", expected="a pusher that moves")
    path[:, 0] = np.concatenate(([0.0], np.cumsum(way))) / PACE
    drive = PathDrive(path, force_limit=pusher.drive.force_limit)
    moving = Pusher(
        name=pusher.name,
        shape=pusher.shape,
        pose=path[0, 1:],
        drive=drive,
        friction=pusher.friction,
    )
    return replace(scene, pushers=(moving,), duration=float(path[-1, 0]))


def _check(target: Target) -> None:
    scene = target.case.scene
    if len(scene.bodies) != 1 or len(scene.pushers) != 1:
        raise InvalidInput(
            f"experiment {target.key}.scene",
            found=f"{len(scene.bodies)} free bodies and {len(scene.pushers)} pushers",
            expected="one part and one pusher",
        )
    if not isinstance(scene.pushers[0].shape, Disk):
        raise InvalidInput(
            f"experiment {target.key}.scene", found="a pusher that is not round", expected="a disk"
        )
