"""Measured poses that simulations of an experiment are compared with, and their repetitions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput, no_experiments
from fixel.model import Experiment, LineDrive, Scene, Trajectory, pose_error
from fixel.model.fields import instance
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import BoolArray, FloatArray

ANGLE_SCALE: Final = 35.0  # [mm/rad], length that the thesis's E counts an angle as
ON_CLOCK: Final = 1e-9  # [s]; ends of `effective` are rounded like frames, but not by the same sum
MEMBERS_A_GROUP: Final = 5  # experiments for each value of a condition that a sample is spread over
SAME_POSE: Final = 1e-9  # [m or rad]; no camera measures a planned pose so well


class Target(NamedTuple):
    """Part of an experiment that simulations are compared with."""

    key: str  # dataset/name
    conditions: Mapping[str, str | float]  # and "experiment", the key
    case: RolloutCase  # scene, and measured instants on the clock of the scene
    pose: FloatArray  # (n_sample, 3) measured poses at these
    starts_measured: bool = False  # whether the scene begins at the first measured pose


def target_of(experiment: Experiment) -> Target:
    """Return the target of an experiment.

    It must have a scene, a measured pose after the first within `effective`, and motion.
    """
    scene = scene_of(experiment)
    useful = useful_poses(experiment)
    start, track = clock_start(experiment, scene), experiment.trajectory
    time, pose = track.time[useful] - start, track.pose[useful]
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
        np.allclose(pose_error(scene.bodies[0].pose, track.pose[0]), 0.0, atol=SAME_POSE),
    )


def targets_of(experiments: Iterable[Experiment | Target]) -> list[Target]:
    """Return the targets of several experiments with names of their own, at least one."""
    instance(experiments, Iterable, "experiments", "a list of experiments")
    targets = dict[str, Target]()
    for own in experiments:
        instance(own, Experiment | Target, "experiments", "experiments")
        if own.key in targets:
            expected = "different names, as by dataclasses.replace(experiment, name=...)"
            raise InvalidInput("experiments", found=f"{own.key} twice", expected=expected)
        targets[own.key] = own if isinstance(own, Target) else target_of(own)
    if not targets:
        raise no_experiments()
    return [*targets.values()]


def scene_of(experiment: Experiment) -> Scene:
    """Return the scene of an experiment, or raise `InvalidInput` with the details of its flags."""
    if experiment.scene is None:
        reasons = "; ".join(flag.detail for flag in experiment.flags if flag.detail)
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="no scene" + (f": {reasons}" if reasons else ""),
            expected="an experiment with a scene of object, pusher and fixels",
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
        found = f"no measured pose from {first:g} to {last:g} s"
        expected = "at least one pose after the first"
        raise InvalidInput(f"experiment {experiment.key}.effective", found=found, expected=expected)
    return useful


def errors_of(
    experiment: Experiment, simulated: Trajectory
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return measured instants (n,) within `effective` [s], and the errors of simulated poses
    there: distance [m], and wrapped angle [rad]."""
    useful = useful_poses(experiment)
    time = experiment.trajectory.time[useful]
    return time, *pose_error(simulated.at(time), experiment.trajectory.pose[useful])


def squared_error(position: FloatArray, angle: FloatArray) -> float:
    """E of the thesis: mean of squared distances [m] and angles (n,), at 35 mm/rad [mm^2]."""
    return float(np.mean((1e3 * position) ** 2 + (ANGLE_SCALE * angle) ** 2))


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


# Conditions that may differ between repetitions of an experiment.
_OWN: Final = ("experiment", "repetition")
# Conditions that number experiments.
NUMBERING: Final = (*_OWN, "step")
TRUTH: Final = "truth_"  # prefix of conditions that no real laboratory could know


def same_configuration(target: Target) -> str:
    """Return a label that repetitions of an experiment share; its key if it is no repetition."""
    if "repetition" not in target.conditions:
        return target.key
    kept = {
        name: value
        for name, value in target.conditions.items()
        if name not in _OWN and not name.startswith(TRUTH)
    }
    return repr(sorted(kept.items()))


def repetitions(targets: Sequence[Target], *, ends: bool = False) -> list[FloatArray]:
    """Return poses (n_repetition, n_frame, 3) of each repeated experiment, at common instants.

    A camera loses different frames each time, so the k-th frames of repetitions do not correspond.
    Poses are interpolated between frames, over the time that all repetitions cover; or only the
    last pose of each is returned, if nothing else is compared.
    """
    groups: dict[str, list[Target]] = {}
    for target in targets:
        groups.setdefault(same_configuration(target), []).append(target)
    repeated = [group for group in groups.values() if len(group) > 1]
    if ends:
        return [np.array([target.pose[-1:] for target in group]) for group in repeated]
    found = [_at_the_same_instants(group) for group in repeated]
    return [rows for rows in found if rows.size]


def _at_the_same_instants(group: Sequence[Target]) -> FloatArray:
    clocks = [target.case.times for target in group]
    first, last = max(clock[0] for clock in clocks), min(clock[-1] for clock in clocks)
    instants = clocks[0][(clocks[0] >= first) & (clocks[0] <= last)]
    rows = []
    for clock, target in zip(clocks, group, strict=True):
        pose = np.column_stack((target.pose[:, :2], np.unwrap(target.pose[:, 2])))
        rows.append(np.column_stack([np.interp(instants, clock, column) for column in pose.T]))
    return np.array(rows)


def spread_sample(
    conditions: Sequence[Mapping[str, str | float]], count: int, seed: int
) -> list[int]:
    """Return the indices of `count` random experiments, in which every condition has its share."""
    groups: dict[tuple[tuple[str, str], ...], list[int]] = {}
    kinds = _grouping(conditions)
    for k, own in enumerate(conditions):
        key = tuple((name, str(own.get(name, ""))) for name in kinds)
        groups.setdefault(key, []).append(k)
    draw = np.random.default_rng(seed)
    # Shuffled within each group, then taken at even distances along all groups one after another:
    # each gives its share, to one experiment.
    order = [k for key in sorted(groups) for k in draw.permutation(groups[key]).tolist()]
    first = draw.random()
    places = ((first + np.arange(count)) * len(conditions) / count).astype(int)
    return sorted(order[place] for place in places.tolist())


def _grouping(conditions: Sequence[Mapping[str, str | float]]) -> list[str]:
    """Conditions that sort experiments into groups, not those that number them."""
    names = sorted({name for own in conditions for name in own})
    most = max(1, len(conditions) // MEMBERS_A_GROUP)
    return [
        name for name in names if 1 < len({str(own.get(name, "")) for own in conditions}) <= most
    ]
