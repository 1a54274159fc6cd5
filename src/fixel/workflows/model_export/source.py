"""Sources of exported models: scenes with their parameters, and the experiments behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats import SceneFile, load_scene
from fixel.model import Experiment, Scene
from fixel.model.records import Estimate
from fixel.simulation import AbstractMotionModel, AbstractStepper, Dynamic
from fixel.simulation.motion import OtherEngine, motion_model
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration, values_under
from fixel.workflows.calibration.stored import load_values

SAMPLES: Final = 100  # poses of a scene without measurements
Exportable = Scene | SceneFile | Experiment | Calibration | Project | str | PathLike[str]


class SourceCase(NamedTuple):
    """Scene with parameters, and the measured motion if there is one."""

    key: str  # of its experiment; empty for a scene
    scene: Scene
    times: FloatArray  # (n,) [s]
    values: Mapping[str, float]  # parameters by name, also those of engines
    measured: FloatArray | None = None  # (n, 3) poses at the times [m, m, rad]


class ModelSource(NamedTuple):
    """Cases, of which the first is exported, with their estimates and motion model."""

    kind: str  # "scene", "experiment" or "calibration"
    name: str
    cases: Sequence[SourceCase]
    estimates: Sequence[Estimate] = ()
    motion: AbstractMotionModel = Dynamic()
    stepper: AbstractStepper | None = None
    calibration_id: int | None = None
    held_out: Sequence[SourceCase] = ()


def source_of(
    what: Exportable,
    calibration: int | None = None,
    held_out: Iterable[Experiment] = (),
) -> ModelSource:
    """Return the source of an export; raise where there is no scene.

    Parameters
    ----------
    what : Scene, SceneFile, path, Experiment, Calibration or Project
    calibration : int, optional
        Id of a calibration of a project; by default the newest for several experiments.
    held_out : iterable of Experiment
        Experiments that the calibration has not used.
    """
    if calibration is not None and not isinstance(what, Project):
        raise InvalidInput(
            "calibration", found=calibration, expected="an id only together with a project"
        )
    values: Callable[[Experiment], Mapping[str, float]] = _no_values
    if isinstance(what, Project):
        found, values = _stored(what, calibration)
    elif isinstance(what, Calibration):
        found, values = _calibrated(what), what.values_for
    elif isinstance(what, Experiment):
        found = ModelSource("experiment", what.key, [_case(what, {})])
    else:
        found = _scene(what)
    used = {case.key for case in found.cases}
    others = tuple(held_out)
    for experiment in others:
        if experiment.key in used:
            raise InvalidInput(
                "held_out",
                found=experiment.key,
                expected="experiments that the calibration has not used",
            )
    return found._replace(held_out=[_case(own, values(own)) for own in others])


def _no_values(experiment: Experiment) -> Mapping[str, float]:
    return {}


def _scene(what: Scene | SceneFile | str | PathLike[str]) -> ModelSource:
    if isinstance(what, str | PathLike):
        what = load_scene(str(what))
    file = what if isinstance(what, SceneFile) else SceneFile(scene=what)
    scene = file.scene.complete()
    times = np.linspace(0.0, scene.duration, SAMPLES + 1)[1:]
    return ModelSource(
        "scene",
        scene.bodies[0].name if scene.bodies else "scene",
        [SourceCase("", scene, times, {})],
        motion=motion_model(file.motion),
        stepper=None if file.step is None else file.stepper,
    )


def _calibrated(fit: Calibration) -> ModelSource:
    ids = fit.run.ids
    return ModelSource(
        "calibration",
        fit.request.name or f"{len(fit.targets)} experiments",
        [
            SourceCase(target.key, *target.case, values_under(fit, target.conditions), target.pose)
            for target in fit.targets
        ],
        estimates=list(fit.estimates.values()),
        motion=_own_motion(fit.motion),
        calibration_id=ids[fit.number] if ids else None,
    )


def _stored(
    project: Project, calibration_id: int | None
) -> tuple[ModelSource, Callable[[Experiment], Mapping[str, float]]]:
    with project.store() as store:
        one = load_values(store, calibration_id)
        experiments = [store.experiment(number) for number in sorted(one.members)]
    source = ModelSource(
        "calibration",
        project.settings.name,
        [_case(own, one.values_for(own)) for own in experiments],
        estimates=one.record.estimates,
        motion=_own_motion(one.motion),
        calibration_id=one.id,
    )
    return source, one.values_for


def _case(experiment: Experiment, values: Mapping[str, float]) -> SourceCase:
    target = target_of(experiment)
    return SourceCase(target.key, *target.case, values, target.pose)


def _own_motion(motion: AbstractMotionModel) -> AbstractMotionModel:
    """Return a motion model of fixel itself, also for a calibration of another engine."""
    return Dynamic() if isinstance(motion, OtherEngine) else motion
