"""Push to simulate many times: a scene or experiment with the values of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

from fixel.calibration.target import target_of
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters, Scene
from fixel.model.fields import instance
from fixel.model.records import Estimate
from fixel.simulation.motion import MOTION_MODELS, AbstractMotionModel, Dynamic
from fixel.typing import FloatArray


@runtime_checkable
class CalibratedModel(Protocol):
    """Calibrated parameters with the motion model that they belong to; `Calibration` is one."""

    @property
    def motion(self) -> AbstractMotionModel: ...
    @property
    def estimates(self) -> Mapping[str, Estimate]: ...
    def values_for(self, /, **conditions: str | float) -> dict[str, float]: ...


class Push(NamedTuple):
    """Scene with the parameters and the motion model to simulate it with."""

    scene: Scene
    times: FloatArray | None  # (n_time,) instants of the measured poses [s]
    conditions: Mapping[str, str | float]
    values: dict[str, float]
    motion: AbstractMotionModel
    intervals: Mapping[str, tuple[float, float]]  # of a calibration, where the data set both ends


def push_of(
    what: Scene | Experiment,
    model: Mapping[str, float] | None = None,
    motion: AbstractMotionModel | str | None = None,
) -> Push:
    """Return the push of a scene, or of an experiment up to its last useful pose.

    Parameters
    ----------
    what : Scene or Experiment
    model : mapping of str to float or Calibration, optional
        Parameters; by default the scene's own values.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of a calibration, else dynamic.

    Raises
    ------
    InvalidInput
        An experiment has no scene, or a parameter is not known.
    """
    if isinstance(what, Experiment):
        target = target_of(what)
        times: FloatArray | None = target.case.times
        scene = replace(target.case.scene, duration=float(target.case.times[-1]))
        conditions = target.conditions
    else:
        instance(what, Scene, "scene", "a Scene or an Experiment")
        times, scene, conditions = None, what, {}
    calibrated: object = model
    if not isinstance(calibrated, CalibratedModel):
        return Push(
            scene, times, conditions, dict(Parameters(model or {})), motion_named(motion), {}
        )
    values = calibrated.values_for(**conditions)
    intervals = {
        name: (own.low, own.high)
        for name, own in calibrated.estimates.items()
        if own.low is not None
        and own.high is not None
        and name in values
        and own.low < own.high
        and not name.startswith("start_")
    }
    return Push(
        scene, times, conditions, values, motion_named(motion or calibrated.motion), intervals
    )


def motion_named(motion: AbstractMotionModel | str | None) -> AbstractMotionModel:
    """Return a motion model by its name, or as it is; dynamic by default."""
    if motion is None:
        return Dynamic()
    if not isinstance(motion, str):
        return motion
    for model in MOTION_MODELS:
        if model.name == motion:
            return model()
    names = ", ".join(model.name for model in MOTION_MODELS)
    raise InvalidInput("motion", found=repr(motion), expected=f"one of {names}")
