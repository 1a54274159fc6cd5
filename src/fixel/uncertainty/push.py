"""Push to simulate many times: a scene or experiment with the values of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from os import PathLike
from typing import NamedTuple

from fixel.calibration.target import target_of
from fixel.model import Experiment, Parameters, Scene
from fixel.model.records import Estimate
from fixel.model.space import meets, split_label
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.simulate import SceneWithMethod, scene_file
from fixel.simulation.stepper import AbstractStepper
from fixel.typing import FloatArray
from fixel.uncertainty.predictive import CalibratedModel


class Push(NamedTuple):
    """Scene with the parameters and the motion model to simulate it with."""

    scene: Scene
    times: FloatArray | None  # (n_time,) instants of the measured poses [s]
    conditions: Mapping[str, str | float]
    values: dict[str, float]
    motion: AbstractMotionModel
    intervals: Mapping[str, tuple[float, float]]  # of a calibration, where the data set both ends
    stepper: AbstractStepper | None  # of a scene file


def push_of(
    what: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    model: Mapping[str, float] | None = None,
    motion: AbstractMotionModel | str | None = None,
) -> Push:
    """Return the push of a scene, or of an experiment up to its last useful pose.

    Parameters are by default the scene's own values, and the motion model that of a calibration or
    scene file, else dynamic. An experiment without a scene and an unknown parameter raise
    `InvalidInput`.
    """
    times: FloatArray | None = None
    conditions: Mapping[str, str | float] = {}
    stepper: AbstractStepper | None = None
    own_motion = None
    if isinstance(what, Experiment):
        target = target_of(what)
        times = target.case.times
        scene = replace(target.case.scene, duration=float(target.case.times[-1]))
        conditions = target.conditions
    elif isinstance(what, Scene):
        scene = what
    else:
        file = scene_file(what, "a Scene, a scene file or an Experiment")
        scene, own_motion, stepper = file.scene, file.motion, file.stepper
    calibrated: object = model
    if not isinstance(calibrated, CalibratedModel):
        method = motion_model(motion or own_motion)
        return Push(scene, times, conditions, dict(Parameters(model or {})), method, {}, stepper)
    values = calibrated.values_for(**conditions)
    intervals = intervals_of(calibrated.estimates.values(), conditions)
    method = motion_model(motion or calibrated.motion)
    return Push(scene, times, conditions, values, method, intervals, stepper)


def intervals_of(
    estimates: Iterable[Estimate], conditions: Mapping[str, str | float]
) -> dict[str, tuple[float, float]]:
    """Return the intervals of parameters under conditions, where the data determine both ends."""
    found: dict[str, Estimate] = {}
    for own in estimates:
        name, where = split_label(own.label)
        if meets(conditions, where) and not name.startswith("start_"):
            found.setdefault(name, own)
    ends = ((name, own.low, own.high) for name, own in found.items())
    return {k: (a, b) for k, a, b in ends if a is not None and b is not None and a < b}
