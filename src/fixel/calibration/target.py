"""Measured poses that simulations of an experiment are compared with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.model import Experiment, LineDrive, Scene
from fixel.simulation.ensemble import RolloutCase
from fixel.typing import BoolArray, FloatArray

ON_CLOCK: Final = 1e-9  # [s]; ends of `effective` are rounded like frames, but not by the same sum


class Target(NamedTuple):
    """Part of an experiment that simulations are compared with."""

    key: str  # dataset/name
    conditions: Mapping[str, str | float]  # and "experiment", the key
    case: RolloutCase  # scene, and measured instants on the clock of the scene
    pose: FloatArray  # (n_sample, 3) measured poses at these


def target_of(experiment: Experiment) -> Target:
    """Return the target of an experiment.

    Raises
    ------
    InvalidInput
        There is no scene, no measured pose after the first within `effective`, or no motion.
    """
    scene = scene_of(experiment)
    useful = useful_poses(experiment)
    start = clock_start(experiment, scene)
    time = experiment.trajectory.time[useful] - start
    pose = experiment.trajectory.pose[useful]
    if not time[-1] > 0.0:
        raise InvalidInput(
            f"experiment {experiment.key}.trajectory",
            found="no measured pose after the start",
            expected="motion to compare with",
        )
    after = time > 0.0
    return Target(
        experiment.key,
        {**experiment.conditions, "experiment": experiment.key},
        RolloutCase(scene, time[after]),
        pose[after],
    )


def targets_of(experiments: Iterable[Experiment]) -> list[Target]:
    """Return the targets of several experiments, at least one."""
    targets = [target_of(experiment) for experiment in experiments]
    if not targets:
        raise InvalidInput(
            "experiments",
            found="none",
            expected="one at least",
            hint="see what there is: fixel list",
        )
    return targets


def scene_of(experiment: Experiment) -> Scene:
    """Return the scene of an experiment, or raise `InvalidInput` with the details of its flags."""
    if experiment.scene is None:
        reasons = "; ".join(flag.detail for flag in experiment.flags if flag.detail)
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="no scene" + (f": {reasons}" if reasons else ""),
            expected="one whose object, pusher and fixels are known",
            hint="fixel show has its path",
        )
    return experiment.scene


def useful_poses(experiment: Experiment) -> BoolArray:
    """Return a mask (n,) of the measured poses after the first within `effective`."""
    time = experiment.trajectory.time
    first, last = experiment.effective or (time[0], time[-1])
    useful = np.asarray((time >= first - ON_CLOCK) & (time <= last + ON_CLOCK))
    useful[0] = False
    if not useful.any():
        raise InvalidInput(
            f"experiment {experiment.key}.effective",
            found=f"no measured pose from {first:g} to {last:g} s",
            expected="one at least, after the first",
        )
    return useful


def clock_start(experiment: Experiment, scene: Scene) -> float:
    """Return the instant of the experiment's clock at which the clock of the scene starts [s].

    A measured path of the pusher is on the clock of the experiment. A planned line starts with
    the scene, and the recording may have started earlier.
    """
    planned = [pusher for pusher in scene.pushers if isinstance(pusher.drive, LineDrive)]
    if not planned:
        return 0.0
    first = experiment.effective[0] if experiment.effective else experiment.trajectory.time[0]
    return float(first)
