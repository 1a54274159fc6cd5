"""Sample the posterior of experiments' parameters, and predict paths and final poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from fixel.calibration.assess import Frames, noise_from_repeated
from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import Noise, noise_from_residuals
from fixel.calibration.objective import Comparer
from fixel.calibration.study import box_of
from fixel.calibration.target import Target, target_of, targets_of
from fixel.calibration.usual_parameters import Space, default_unknowns, search_space
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model import Experiment
from fixel.model.records import CalibrationRecord
from fixel.model.selection import ExperimentQuery
from fixel.model.space import ParameterSpace, Unknown
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.trust import permit
from fixel.typing import FloatArray
from fixel.uncertainty.discrepancy import ModelError
from fixel.uncertainty.likelihood import LogLikelihood, camera_noise
from fixel.uncertainty.near_optimal import NearOptimal, near_optimal, rise_of
from fixel.uncertainty.posterior import NestedSampling, Posterior, SamplerProgress
from fixel.uncertainty.prediction import Prediction
from fixel.uncertainty.repetition import predict_repetition
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.parameter_options import searched_unknowns
from fixel.workflows.calibration.stored import (
    CalibratedValues,
    load_values,
    newest_calibration,
    searched_space,
)

# Noise assumed by the rough fit from which the noise is estimated.
FIRST_NOISE: Final = Noise(position_m=5e-4, angle_rad=5e-3)
FIRST_STARTS: Final = 4
DRAWS: Final = 400


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyRequest:
    """Options of an uncertainty analysis.

    Parameters
    ----------
    experiments : tuple of str
        Ids or names; by default those of the calibration.
    held_out : tuple of str
        Experiments that are only predicted.
    calibration : int, optional
        Id of a stored calibration: gives parameters, motion model and evaluations.
    fit : tuple of str
        `NAME[=LOW:HIGH[:START]]`, as for `fixel calibrate`.
    motion : str, optional
        Name of the motion model; by default that of the calibration, else `dynamic`.
    noise : (float, float), optional
        Standard deviations of the camera [m, rad]; estimated by default.
    model_error : bool
        Whether to include the model's own error as a term.
    samples, seed : int
    """

    experiments: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    calibration: int | None = None
    fit: tuple[str, ...] = ()
    motion: str | None = None
    noise: tuple[float, float] | None = None
    model_error: bool = True
    samples: int = 1000
    seed: int = 0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentPrediction:
    """Experiment with draws of its predicted motion.

    Attributes
    ----------
    id : int
    experiment : Experiment
    target : Target
    held_out : bool
    prediction : Prediction
    levels : (float, float)
        Levels of the smallest bounds that contain the measured last pose: position, angle.
    """

    id: int
    experiment: Experiment
    target: Target
    held_out: bool
    prediction: Prediction
    levels: tuple[float, float]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """Result of an uncertainty analysis.

    Attributes
    ----------
    request : UncertaintyRequest
    space : ParameterSpace
    posterior : Posterior
    predicted : tuple of ExperimentPrediction
        Predictions of the experiments used, then of those held out.
    near : NearOptimal, optional
        Near-optimal sets among the calibration's evaluations, with the names of their columns.
    near_names : tuple of str
    motion : str
    calibration : CalibratedValues, optional
    compared : CalibratedValues, optional
        The same, or else the newest one with the first experiment as a member; differences to the
        posterior are reported as warnings.
    """

    request: UncertaintyRequest
    space: ParameterSpace
    posterior: Posterior
    predicted: tuple[ExperimentPrediction, ...]
    motion: str
    near: NearOptimal | None = None
    near_names: tuple[str, ...] = ()
    calibration: CalibratedValues | None = None
    compared: CalibratedValues | None = None

    @property
    def held_out(self) -> tuple[ExperimentPrediction, ...]:
        """Experiments that were only predicted."""
        return tuple(one for one in self.predicted if one.held_out)


def posterior(
    experiments: Experiment | Iterable[Experiment],
    parameters: Space | Calibration = None,
    *,
    noise: Noise | None = None,
    model_error: bool | ModelError = True,
    samples: int = 1000,
    motion: AbstractMotionModel | str | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressOption = None,
) -> Posterior:
    """Sample the probability distribution of parameters given experiments.

    Parameters
    ----------
    experiments : Experiment or sequence of Experiment
        Measured pushes, each with a scene.
    parameters : mapping, sequence of str, Calibration or None
        Parameters to infer, in SI units, as for `fixel.calibrate`. Priors are uniform within the
        bounds, or normal where a `Parameter` has a prior. A calibration gives its parameters with
        their bounds, and its motion model. By default the usual parameters of the scenes.
    noise : Noise, optional
        Standard deviations of measured poses; estimated by default.
    model_error : bool or ModelError
        Whether to include the error of the model itself, with a standard deviation that is
        inferred as the last unknown, `"model_error"` [m]. Without it, intervals are too narrow
        wherever the model is wrong.
    samples : int
        Number of effective samples, at least 10.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration, else `Dynamic()`.
    seed : int
        Seed of the random numbers.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    Posterior
        Samples of equal weight, quantiles, separate modes, and the evidence.

    Raises
    ------
    InvalidInput
        An experiment cannot be compared with a simulation, a parameter is not known or informed by
        no experiment, or dynesty is not installed.

    References
    ----------
    :cite:t:`skilling2006`; :cite:t:`speagle2020`; :cite:t:`kennedy2001`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(1, duration=0.3)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> found = posterior(pushes, space, model_error=False, samples=20, progress=False)
    >>> low, median, high = found.quantiles()[:, 0]
    >>> bool(low < 0.25 < high)
    True
    """
    permit(motion)
    own = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    targets = targets_of(own)
    if isinstance(parameters, Calibration):
        space = parameters.space
        motion = parameters.motion if motion is None else motion
        noise = parameters.noise if noise is None else noise
    else:
        space = search_space(parameters, targets)
    comparer = Comparer(targets, space, motion=motion_model(motion), threads=threads)
    error = model_error if isinstance(model_error, ModelError) else ModelError()
    found, _ = _sampled(
        comparer,
        list(range(len(targets))),
        noise,
        None if model_error is False else error,
        samples,
        seed,
        progress,
    )
    return found


def find_uncertainty(
    project: Project,
    request: UncertaintyRequest,
    progress: ProgressOption = None,
) -> Uncertainty:
    """Sample the posterior of experiments of a project, and predict with it.

    Raises
    ------
    InvalidInput
        Experiments that cannot be compared, parameters that no experiment informs, held-out
        experiments that are also used for the posterior, or dynesty missing.
    NotStored
        There is no such experiment or calibration.
    """
    with project.store() as store:
        one = None if request.calibration is None else load_values(store, request.calibration)
        ids = _ids(store, request, one)
        held = list(dict.fromkeys(store.find(key) for key in request.held_out))
        if set(ids) & set(held):
            raise InvalidInput(
                "held_out",
                found="an experiment from which the posterior is computed",
                expected="others",
            )
        experiments = [store.experiment(number) for number in (*ids, *held)]
        known = newest_calibration(store, ids[0]) if one is None else None
        compared = one if known is None else load_values(store, known)
    targets = [target_of(experiment) for experiment in experiments]
    unknowns = _unknowns(project, request, one, targets[: len(ids)])
    motion = _motion(request, one)
    space = ParameterSpace(unknowns=tuple(unknowns))
    comparer = Comparer(targets, space, motion=motion_model(motion))
    found, point = _sampled(
        comparer,
        list(range(len(ids))),
        None
        if request.noise is None
        else Noise(position_m=request.noise[0], angle_rad=request.noise[1]),
        ModelError() if request.model_error else None,
        request.samples,
        request.seed,
        progress,
    )
    predicted = tuple(
        _predicted(number, experiments[k], comparer, k, found, k >= len(ids))
        for k, number in enumerate((*ids, *held))
    )
    near, names = _near(one, comparer, list(range(len(ids))), point)
    return Uncertainty(
        request=replace(request, experiments=tuple(e.key for e in experiments[: len(ids)])),
        space=space,
        posterior=found,
        predicted=predicted,
        motion=motion,
        near=near,
        near_names=names,
        calibration=one,
        compared=compared,
    )


def predicted_by(project: Project, found: Posterior) -> Uncertainty:
    """Return a posterior with predictions of its experiments, which the project has."""
    noise = found.noise
    with project.store() as store:
        ids = [store.find(key) for key in found.experiments]
        experiments = [store.experiment(number) for number in ids]
        known = newest_calibration(store, ids[0])
        compared = None if known is None else load_values(store, known)
    targets = [target_of(experiment) for experiment in experiments]
    comparer = Comparer(targets, found.searched, motion=motion_model(found.motion))
    return Uncertainty(
        request=UncertaintyRequest(
            experiments=found.experiments,
            motion=found.motion,
            noise=None if noise is None else (noise.position_m, noise.angle_rad),
            model_error=found.model_error is not None,
            samples=len(found.points),
            seed=found.seed,
        ),
        space=found.searched,
        posterior=found,
        predicted=tuple(
            _predicted(number, experiments[k], comparer, k, found, False)
            for k, number in enumerate(ids)
        ),
        motion=found.motion,
        compared=compared,
    )


def _ids(store: Store, request: UncertaintyRequest, one: CalibratedValues | None) -> list[int]:
    if request.experiments:
        return list(dict.fromkeys(store.find(key) for key in request.experiments))
    if one is not None:
        return sorted(one.members)
    listed = store.experiments(ExperimentQuery(limit=2)).rows
    if len(listed) == 1:
        return [listed[0].id]
    raise InvalidInput(
        "experiments",
        found="none",
        expected="at least one, or a calibration whose experiments are used",
        hint="fixel list shows all experiments",
    )


def _unknowns(
    project: Project,
    request: UncertaintyRequest,
    one: CalibratedValues | None,
    targets: Sequence[Target],
) -> list[Unknown]:
    """Return the requested parameters, a calibration's with its bounds, or the usual ones."""
    scenes = [target.case.scene for target in targets]
    if request.fit:
        return searched_unknowns(request.fit, scenes)
    if one is None:
        return default_unknowns(scenes)
    space = searched_space(project, one, scenes)
    return [u for u in space.unknowns if any(u.covers(t.conditions) for t in targets)]


def _motion(request: UncertaintyRequest, one: CalibratedValues | None) -> str:
    if request.motion is not None:
        return request.motion
    return "dynamic" if one is None else one.motion.name


def _sampled(
    comparer: Comparer,
    members: list[int],
    noise: Noise | None,
    error: ModelError | None,
    samples: int,
    seed: int,
    progress: ProgressOption,
) -> tuple[Posterior, FloatArray]:
    """Return the posterior of some experiments of a comparer, and the point of a rough fit."""
    with show_progress(progress, "sampling") as report:
        point = _rough_fit(comparer, members, seed)
        known = noise or _noise(comparer, members, point, error is not None)
        likelihood = LogLikelihood(comparer, members, known, error)
        sampling = NestedSampling(samples=samples)
        done = 0

        def show(now: SamplerProgress) -> None:
            nonlocal done
            done = max(done, min(round(1000.0 * now.share), 1000 if now.remaining == 0.0 else 999))
            report(done, 1000, f"{now.evaluations} points")

        found = sampling.sample(likelihood, likelihood.prior, seed, show)
    return replace(
        found,
        space=comparer.space,
        noise=known,
        model_error=error,
        motion=comparer.ensemble.motion.name,
        experiments=tuple(comparer.targets[k].key for k in members),
        known=KnownPushes.of([comparer.targets[k] for k in members]),
    ), point


def _rough_fit(comparer: Comparer, members: list[int], seed: int) -> FloatArray:
    residuals = Frames(comparer, np.asarray(members, np.int64)).residuals(FIRST_NOISE)
    search = LeastSquares(loss="soft_l1", width=3.0, starts=FIRST_STARTS, most_iterations=20)
    return np.asarray(fit(search.start(box_of(comparer.space), seed), residuals).point)


def _noise(comparer: Comparer, members: list[int], point: FloatArray, of_camera: bool) -> Noise:
    """Return the noise of the camera alone, or of all residuals of a rough fit."""
    if of_camera:
        return camera_noise(comparer, members, point)
    own = np.asarray(members, np.int64)
    return noise_from_repeated(comparer, own) or _left(comparer, own, point)


def _left(comparer: Comparer, members: np.ndarray, point: FloatArray) -> Noise:
    """Noise estimated from all residuals of the fit."""
    series = comparer.residuals_at(members, point)
    if not series:
        raise InvalidInput(
            "noise",
            found="no experiment that could be simulated",
            expected="an experiment from which the noise can be estimated",
            hint="state the noise: noise=...",
        )
    return noise_from_residuals(series, len(point))


def _predicted(
    number: int,
    experiment: Experiment,
    comparer: Comparer,
    member: int,
    posterior: Posterior,
    held_out: bool,
) -> ExperimentPrediction:
    target = comparer.targets[member]
    prediction = predict_repetition(
        comparer,
        member,
        posterior,
        draws=DRAWS,
        seed=posterior.seed,
    )
    if held_out and posterior.known is not None:
        prediction = replace(prediction, unseen=posterior.known.texts(target))
    return ExperimentPrediction(
        id=number,
        experiment=experiment,
        target=target,
        held_out=held_out,
        prediction=prediction,
        levels=prediction.levels_of(target.pose[-1]),
    )


def _near(
    one: CalibratedValues | None, comparer: Comparer, members: list[int], point: FloatArray
) -> tuple[NearOptimal | None, tuple[str, ...]]:
    """Near-optimal sets among the stored evaluations of a calibration."""
    record: CalibrationRecord | None = None if one is None else one.record
    if record is None or record.evaluations is None or not len(record.evaluations.error):
        return None, ()
    kept = record.evaluations
    if kept.unit != "mm2" or not np.isfinite(kept.error).any():
        return None, ()
    series = comparer.residuals_at(members, point)
    if not series:
        return None, ()
    from fixel.calibration.noise import correlation_time

    count = 3.0 * sum(map(len, series)) / correlation_time(series)
    least = float(kept.error[np.isfinite(kept.error)].min())
    rise = rise_of(least, count, len(kept.names))
    return near_optimal(np.array(kept.values), np.array(kept.error), rise), kept.names
