"""Predict how a push ends when its start, parameters and model are uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.known_pushes import KnownPushes, push_target
from fixel.calibration.objective import Comparer
from fixel.calibration.target import target_of
from fixel.errors import InvalidInput
from fixel.model import Experiment, Scene
from fixel.model.fields import instance, non_negative, whole
from fixel.model.goals import touching
from fixel.parts.fit import NAMES
from fixel.parts.model import PartModel
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel, QuasiStatic
from fixel.simulation.simulate import SceneWithMethod
from fixel.simulation.stepping import AbstractStepper
from fixel.trust import permit
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import LABEL, ModelError, StartError, draw_walks, shares_of_way
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prediction import Prediction, Push, push_of
from fixel.uncertainty.repetition import predict_repetition
from fixel.uncertainty.run_to_run import RunChanges, RunToRun, contact_friction, rest_at
from fixel.uncertainty.start_ensemble import simulate_starts

MAX_SAMPLES = 1_000_000


def predict(
    scene: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    model: Mapping[str, float] | Posterior | PartModel | None = None,
    *,
    start: StartError | None = None,
    model_error: bool | float | None = None,
    run_to_run: RunToRun | None = None,
    times: ArrayLike | None = None,
    samples: int = 1000,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressOption = None,
) -> Prediction:
    """Predict the motion and the end of a push whose start or parameters are uncertain.

    Parameters
    ----------
    scene : Scene, SceneFile, path or Experiment
        Push of one free body by at most one pusher. A scene file's motion model and step apply.
    model : mapping of str to float, Calibration, Posterior or PartModel, optional
        Parameters [SI]; by default the scene's own values. Of a posterior or a part model, every
        run has the parameters of another sample.
    start : StartError, optional
        Distribution of the start pose about that of the scene. By default the start is exact; that
        of an experiment predicted with a posterior has the noise of its camera, as in
        `fixel uncertainty`.
    model_error : bool or float, optional
        Standard deviation of the model's own error at the end of the motion [m]; True for that of
        the posterior. By default, that of the posterior if it has one, for a part model that with
        the median error on left-out parts, and none for fixed parameters.
    run_to_run : RunToRun, optional
        Scatter between runs of the same push, which replaces the model error: it acts inside the
        simulation, and grows with how far the part moves and turns.
    times : (n_time,) array_like, optional
        Instants of the path [s]; by default those of the experiment, or twelve up to the end.
    samples : int
        Number of runs.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration or posterior, quasi-static for a part
        model, else `Dynamic()`.
    stepper : AbstractStepper, optional
        Stepper; `Adaptive()` by default.
    seed : int
        Seed of the random numbers.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    Prediction
        Poses of all runs; ``.probability(goal)``, ``.modes``, ``.bands()``, ``.region()``.

    Raises
    ------
    InvalidInput
        Nothing is uncertain, the scene has several free bodies or pushers, it cannot be simulated
        without an error, or a parameter is not known.

    Examples
    --------
    >>> from fixel.model import Seated
    >>> from fixel.testing.scenes import grasp
    >>> from fixel.units import deg, mm
    >>> error = StartError(x=1*mm, y=1*mm, theta=2*deg, kind="uniform")
    >>> ends = predict(grasp("seated"), {"mu_support": 0.3}, start=error, samples=40)
    >>> ends.probability(Seated("fixel-1"))
    1.00 (0.91 to 1.00, n = 40)
    """
    whole(samples, "samples", 2, MAX_SAMPLES)
    permit(motion)
    instance(start, StartError | None, "start", "a StartError")
    instance(run_to_run, RunToRun | None, "run_to_run", "a RunToRun")
    if run_to_run is not None and model_error:
        found = "also a scatter between runs"
        raise InvalidInput("model_error", found=found, expected="one of the two")
    as_measured = start is None and times is None and run_to_run is None
    if isinstance(model, Posterior) and isinstance(scene, Experiment) and as_measured:
        return _repetition(scene, model, motion, model_error, samples, seed, threads)
    uncertain = start is not None or bool(model_error) or run_to_run is not None
    push, values, best, tau = _parameters(scene, model, motion, uncertain, samples, seed)
    push, runs = push._replace(stepper=stepper or push.stepper), None
    if run_to_run is not None:
        runs = _runs(run_to_run, push.scene, start, values, samples, seed)
        values, tau = runs.values, None
        usual = contact_friction(push.scene)
        best = {name: best.get(name, usual.get(name, 0.0)) for name in values}
    elif not isinstance(model_error, bool | None):
        tau = np.full(samples, non_negative(model_error, "model_error", "m"))
    elif model_error is False:
        tau = None
    elif model_error and tau is None:
        raise _no_model_error()
    with show_progress(progress, "simulating") as report:
        ends = simulate_starts(
            push.scene,
            start,
            samples,
            drawn=None if runs is None else runs.start,
            values=values,
            nominal=best,
            times=push.times if times is None else times,
            motion=push.motion,
            stepper=push.stepper,
            seed=seed,
            threads=threads,
            progress=report,
        )
    drift = _drift(ends, tau, best, push) if runs is None else _rest(ends, runs)
    return replace(ends, unseen=_unseen(model, scene, push.scene), drift=drift)


def _runs(
    scatter: RunToRun,
    scene: Scene,
    start: StartError | None,
    values: Mapping[str, ArrayLike],
    samples: int,
    seed: int,
) -> RunChanges:
    """Draw runs with their scatter, and with the errors of the start."""
    table = {name: np.broadcast_to(np.asarray(x, float), samples) for name, x in values.items()}
    runs = scatter.drawn(samples, seed=seed, scene=scene, values=table)
    own = np.zeros((samples, 3)) if start is None else start.samples(samples, seed)
    return runs._replace(start=runs.start + own)


def _rest(found: Prediction, runs: RunChanges) -> FloatArray:
    """Return the remainder (n, n_time, 3) of runs; zero for those that end against a fixel."""
    body = found.scene.bodies[0]
    free = ~np.any(touching(found.scene, body, found.pose[:, -1]), axis=1)
    turned = found.pose[:, :, 2] - found.start[:, None, 2]
    rest = [rest_at(runs.rest, column) for column in turned.T]
    return np.asarray(np.stack(rest, axis=1) * free[:, None, None])


def _parameters(
    scene: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    model: Mapping[str, float] | Posterior | PartModel | None,
    motion: AbstractMotionModel | str | None,
    uncertain: bool,
    samples: int,
    seed: int,
) -> tuple[Push, Mapping[str, ArrayLike], Mapping[str, float], FloatArray | None]:
    """Return a push with parameters for every run: fixed ones, or samples of their distribution."""
    if isinstance(model, PartModel):
        push = push_of(scene, None, motion or QuasiStatic())
        labels = model.labels(scene if isinstance(scene, Experiment) else push.scene)
        best = model.distribution(labels.get(model.surface, ""), labels.get(model.part, ""))
        tau = np.full(samples, model.typical_deviation) if model.typical_error else None
        nominal = dict(zip(NAMES, best.mean.tolist(), strict=True))
        return (push, model.samples(samples, seed, **labels), nominal, tau)
    if isinstance(model, Posterior):
        push = push_of(scene, None, motion or model.motion)
        own = model.under(push.conditions)
        rows = np.resize(np.random.default_rng(seed).permutation(len(own.points)), samples)
        values = own.values(own.points[rows], push.conditions)
        likeliest = own.values(own.best[None], push.conditions)
        nominal = {name: float(x[0]) for name, x in likeliest.items()}
        tau = own.points[rows, -1] if own.labels[-1] == LABEL else None
        return (push, values, nominal, tau)
    if not uncertain:
        found = "no start error, no posterior and no model error"
        hint = "simulate() computes the one end; or give start=StartError(x=, y=, theta=, kind=)"
        raise InvalidInput("start", found=found, expected="at least one uncertain input", hint=hint)
    push = push_of(scene, model, motion)
    return (push, push.values, push.values, None)


def _unseen(model: object, of: object, scene: Scene) -> tuple[str, ...]:
    """Return what no experiment of the model has; nothing for values without experiments."""
    what = of if isinstance(of, Experiment) else scene
    if isinstance(model, PartModel):
        return model.unseen(what, **model.labels(what))
    known: KnownPushes | None = getattr(model, "known", None)
    return () if known is None else known.texts(push_target(what, {}))


def _repetition(
    experiment: Experiment,
    posterior: Posterior,
    motion: AbstractMotionModel | str | None,
    model_error: bool | float | None,
    samples: int,
    seed: int,
    threads: int | None,
) -> Prediction:
    """Predict a repetition from the same measured start, as `fixel uncertainty` does."""
    push = push_of(experiment, None, motion or posterior.motion)
    posterior = posterior.under(push.conditions)
    error = None if model_error is False else posterior.model_error
    if not isinstance(model_error, bool | None):
        error = ModelError.usual(push.scene.bodies[0].shape)
        tau = np.full((len(posterior.points), 1), non_negative(model_error, "model_error", "m"))
        posterior = replace(posterior, points=np.hstack((posterior.points, tau)))
    elif model_error and error is None:
        raise _no_model_error()
    posterior = replace(posterior, model_error=error)
    target = target_of(experiment)
    comparer = Comparer([target], posterior.searched, motion=push.motion, threads=threads)
    found = predict_repetition(comparer, 0, posterior, draws=samples, seed=seed)
    return replace(found, unseen=_unseen(posterior, experiment, target.case.scene))


def _no_model_error() -> InvalidInput:
    found = "True, without a posterior with model error"
    expected = "its standard deviation at the end of the motion [m]"
    return InvalidInput("model_error", found=found, expected=expected)


def _drift(
    found: Prediction, tau: FloatArray | None, best: Mapping[str, float], push: Push
) -> FloatArray | None:
    """Draw errors of the model (n, n_time, 3) with standard deviations tau (n,) at the end of the
    motion [m], of which the instants may be the beginning."""
    if tau is None:
        return None
    scene, way = push.scene, found.nominal
    error = ModelError.usual(scene.bodies[0].shape)
    if found.time[-1] < scene.duration * (1.0 - 1e-9):
        values = {name: best.get(name, np.mean(x)) for name, x in found.parameters.items()}
        how: Any = {"motion": push.motion, "stepper": push.stepper, "values": values}
        times = np.append(found.time, scene.duration)
        way = simulate_starts(scene, None, 1, times=times, **how).nominal
    share = shares_of_way(scene.bodies[0].pose, way, error.angle_scale)[: len(found.time)]
    return draw_walks(share, tau, error.sides, np.random.default_rng([found.seed, 1]))
