"""Experiments of a posterior, its samples, and predictions with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.assess import Frames, noise_from_repeated
from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import Noise, check_noise, noise_from_differences, noise_from_residuals
from fixel.calibration.objective import Comparer
from fixel.calibration.result import CalibratedValues, NearOptimal, near_best
from fixel.calibration.study import box_of
from fixel.calibration.target import Target, target_of
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput, no_experiments
from fixel.model import Experiment
from fixel.model.selection import ExperimentQuery
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import motion_model
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import ModelError
from fixel.uncertainty.likelihood import LogLikelihood, camera_noise
from fixel.uncertainty.posterior import NestedSampling, Posterior
from fixel.uncertainty.prediction import Prediction
from fixel.uncertainty.repetition import predict_repetition
from fixel.workflows.calibration.stored import load_values, newest_calibration, searched_space

# Noise assumed by the rough fit from which the noise is estimated.
FIRST_NOISE: Final = Noise(position_m=5e-4, angle_rad=5e-3)
ROUGH_FIT: Final = LeastSquares(loss="soft_l1", width=3.0, starts=4, most_iterations=20)


class SampledExperiments(NamedTuple):
    """Experiments of a project to sample and predict: those used, then those held out."""

    ids: list[int]
    experiments: list[Experiment]
    n_used: int
    comparer: Comparer
    calibration: CalibratedValues | None
    compared: CalibratedValues | None  # the same, or the newest one with the first experiment


class ExperimentPrediction(NamedTuple):
    """Experiment with draws of its predicted motion."""

    id: int
    experiment: Experiment
    target: Target
    held_out: bool
    prediction: Prediction
    levels: tuple[float, float]  # of the smallest bounds that contain the last position and angle


class Uncertainty(NamedTuple):
    """Result of an uncertainty analysis."""

    posterior: Posterior
    # Predictions of the experiments used, then of those held out.
    predicted: tuple[ExperimentPrediction, ...]
    requested: int  # number of effective samples that was requested
    near: NearOptimal | None = None  # near-optimal sets among the calibration's evaluations
    calibration: CalibratedValues | None = None
    # The same, or else the newest one with the first experiment as a member; differences to the
    # posterior are reported as warnings.
    compared: CalibratedValues | None = None

    @property
    def held_out(self) -> tuple[ExperimentPrediction, ...]:
        """Experiments that were only predicted."""
        return tuple(one for one in self.predicted if one.held_out)


def selected(project: Project, asked: Any) -> SampledExperiments:
    """Load the experiments of a request, with the parameters and the motion model to compare by."""
    with project.store() as store:
        one = None if asked.calibration is None else load_values(store, asked.calibration)
        ids = _ids(store, asked.experiments, one)
        held = list(dict.fromkeys(map(store.find, dict.fromkeys(asked.held_out))))
        if set(ids) & set(held):
            found = "an experiment from which the posterior is computed"
            raise InvalidInput("held_out", found=found, expected="others")
        experiments = [store.experiment(number) for number in (*ids, *held)]
        compared = one or _newest(store, ids[0])
    targets = [target_of(experiment) for experiment in experiments]
    used, motion = targets[: len(ids)], asked.motion
    space = searched_space(project, one, [target.case.scene for target in used], asked.fit)
    space = space.under([target.conditions for target in used])
    if motion is None and one is not None:
        motion = one.motion.name
    comparer = Comparer(targets, space, motion=motion_model(motion))
    return SampledExperiments([*ids, *held], experiments, len(ids), comparer, one, compared)


def sample(
    comparer: Comparer,
    n_used: int,
    stated: Noise | None,
    noise: Noise | None,
    model_error: bool | ModelError,
    samples: int,
    seed: int,
    progress: ProgressOption,
) -> tuple[Posterior, FloatArray]:
    """Return the posterior of the first experiments of a comparer, and the point of a rough fit.

    The noise is by default the one `stated` for a calibration, else estimated.
    """
    check_noise(noise)
    members, used = list(range(n_used)), comparer.targets[:n_used]
    usual = ModelError.usual(used[0].case.scene.bodies[0].shape) if model_error else None
    own = model_error if isinstance(model_error, ModelError) else usual
    with show_progress(progress, "sampling") as report:
        residuals = Frames(comparer, np.asarray(members, np.int64)).residuals(FIRST_NOISE)
        rough = ROUGH_FIT.start(box_of(comparer.space), seed)
        point = np.asarray(fit(rough, residuals).point)
        known = noise or stated or _noise(comparer, members, point, own is not None)
        likelihood = LogLikelihood(comparer, members, known, own)
        likelihood.count_starts(point, noise or stated or noise_from_differences(used))
        found = NestedSampling(samples=samples).sample(likelihood, likelihood.prior, seed, report)
    return replace(
        found,
        space=comparer.space,
        noise=known,
        model_error=own,
        motion=comparer.ensemble.motion.name,
        experiments=tuple(target.key for target in used),
        known=KnownPushes.of(used),
    ), point


def with_predictions(
    own: SampledExperiments, found: Posterior, requested: int, point: FloatArray | None = None
) -> Uncertainty:
    """Predict the experiments of a posterior, and those that are held out.

    The number of effective samples was `requested`. A rough fit `point` (n_free,) is for the
    near-optimal sets of a calibration.
    """
    predicted = []
    for k, (number, experiment) in enumerate(zip(own.ids, own.experiments, strict=True)):
        target, held_out = own.comparer.targets[k], k >= own.n_used
        prediction = predict_repetition(own.comparer, k, found)
        if held_out and found.known is not None:
            prediction = replace(prediction, unseen=found.known.texts(target))
        levels = prediction.levels_of(target.pose[-1])
        predicted.append(
            ExperimentPrediction(number, experiment, target, held_out, prediction, levels)
        )
    tried = None if own.calibration is None else own.calibration.record.evaluations
    near = None
    if point is not None and tried is not None:
        near = near_best(tried, own.comparer.residuals_at(list(range(own.n_used)), point))
    return Uncertainty(found, tuple(predicted), requested, near, own.calibration, own.compared)


def predicted_by(project: Project, found: Posterior) -> Uncertainty:
    """Return a posterior with predictions of its experiments, which the project has."""
    with project.store() as store:
        ids = [store.find(key) for key in found.experiments]
        experiments = [store.experiment(number) for number in ids]
        compared = _newest(store, ids[0])
    targets = [target_of(experiment) for experiment in experiments]
    comparer = Comparer(targets, found.searched, motion=motion_model(found.motion))
    own = SampledExperiments(ids, experiments, len(ids), comparer, None, compared)
    return with_predictions(own, found, len(found.points))


def _newest(store: Store, experiment: int) -> CalibratedValues | None:
    known = newest_calibration(store, experiment)
    return None if known is None else load_values(store, known)


def _ids(store: Store, keys: Sequence[str], one: CalibratedValues | None) -> list[int]:
    if keys:
        return list(dict.fromkeys(map(store.find, dict.fromkeys(keys))))
    if one is not None:
        return sorted(one.members)
    listed = store.experiments(ExperimentQuery(limit=2)).rows
    if len(listed) == 1:
        return [listed[0].id]
    raise no_experiments(expected="at least one, or a calibration whose experiments are used")


def _noise(comparer: Comparer, members: list[int], point: FloatArray, of_camera: bool) -> Noise:
    """Return the noise of the camera alone, or of all residuals of a rough fit."""
    if of_camera:
        return camera_noise(comparer, members, point)
    own = np.asarray(members, np.int64)
    repeated = noise_from_repeated(comparer, own)
    if repeated is not None:
        return repeated
    series = comparer.residuals_at(own, point)
    if not series:
        found = "no experiment that could be simulated"
        expected = "an experiment from which the noise can be estimated"
        hint = "state the noise: noise=..."
        raise InvalidInput("noise", found=found, expected=expected, hint=hint)
    return noise_from_residuals(series, len(point))
