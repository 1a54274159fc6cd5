"""Compute the sensitivity of pushes to their start, and order them by it."""

from __future__ import annotations

import hashlib
import json
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.formats import load_scene
from fixel.formats.scene_model import scene_content
from fixel.model import Experiment, Scene
from fixel.model.fields import instance
from fixel.model.selection import ExperimentQuery
from fixel.model.space import split_label
from fixel.progress import ProgressOption, show_progress
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model, stated_name
from fixel.simulation.simulate import SceneWithMethod
from fixel.simulation.stepper import AbstractStepper
from fixel.simulation.trust import permit
from fixel.uncertainty.indices import indices_of
from fixel.uncertainty.outcomes import FLAGS, Sensitivity, sensitivity_of
from fixel.uncertainty.push import push_of
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.uncertainty.starts import StartError
from fixel.workflows.analysis import Analysis, StoredAnalysis, store_analysis
from fixel.workflows.calibration.stored import (
    CalibratedValues,
    load_values,
    newest_calibration,
)
from fixel.workflows.figures import Picture
from fixel.workflows.sensitivity.report import analysis_of, arrays_of, pictures_of
from fixel.workflows.sensitivity.request import Finding, SensitivityRequest, Subject

SCENE_ENDINGS: Final = (".yaml", ".yml", ".json")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityAnswer:
    """Sensitivity of pushes, with the push to avoid first in front.

    Attributes
    ----------
    findings : tuple of Finding
    skipped : dict of str to str
        Pushes that could not be analysed, and why.
    analysis : Analysis
    pictures : tuple of Picture
    kept : StoredAnalysis, optional
        Analysis stored in a project.
    """

    findings: tuple[Finding, ...]
    skipped: Mapping[str, str]
    analysis: Analysis
    pictures: tuple[Picture, ...]
    kept: StoredAnalysis | None


def sensitivity(
    scene: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    start: StartError,
    model: Mapping[str, float] | None = None,
    *,
    samples: int = 1000,
    vary: Mapping[str, tuple[float, float]] | None = None,
    indices: bool = False,
    base: int = 128,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressOption = None,
) -> Sensitivity:
    """Compute how errors of the start pose grow in a push.

    Parameters
    ----------
    scene : Scene, SceneFile, path or Experiment
        Push of one free body by at most one pusher. A scene file's motion model and step apply.
    start : StartError
        Distribution of the start pose about that of the scene.
    model : mapping of str to float or Calibration, optional
        Parameters [SI]; by default the scene's own values.
    samples : int
        Number of perturbed starts, at least 50.
    vary : mapping of str to (float, float), optional
        Bounds of further uncertain parameters for the indices [SI]; by default the intervals of a
        calibration.
    indices : bool
        Whether to compute Sobol indices: the shares of the spread of the end that come from each
        uncertain input. This takes ``base (n_input + 2)`` more simulations and the package SALib.
    base : int
        Base samples of the indices, a power of two.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration, else `Dynamic()`.
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
    Sensitivity
        Growth of the start error, separate outcomes, and the word for both: `.flag`.

    Raises
    ------
    InvalidInput
        The scene has several free bodies or pushers, hardly any start has an outcome, or a
        parameter is not known.

    References
    ----------
    :cite:t:`rpi2011`; :cite:t:`saltelli2010`.

    Examples
    --------
    >>> from fixel.testing.scenes import micro_push
    >>> from fixel.units import deg, um
    >>> start = StartError(x=5*um, y=5*um, theta=0.5*deg, kind="uniform")
    >>> found = sensitivity(micro_push(1), start, samples=60)
    >>> found.flag
    'insensitive'
    """
    instance(start, StartError, "start", "a StartError")
    permit(motion)
    push = push_of(scene, model, motion)
    ranges = dict(push.intervals if vary is None else vary)
    with show_progress(progress, "simulating starts") as report:
        method: dict[str, Any] = {
            "values": push.values,
            "motion": push.motion,
            "stepper": stepper or push.stepper,
            "seed": seed,
            "threads": threads,
            "progress": report,
        }
        ensemble = simulate_starts(push.scene, start, samples, **method)
        found = sensitivity_of(ensemble)
        if not indices:
            return found
        report.stage = "computing indices"
        return replace(found, indices=indices_of(push.scene, start, ranges, base, **method))


def analyse_sensitivity(
    things: Sequence[str],
    request: SensitivityRequest,
    project: Callable[[], Project],
    *,
    command: str = "",
    ready: Callable[[Scene], None] | None = None,
) -> SensitivityAnswer:
    """Analyse stored experiments or scene files; store the result if there is a project.

    Parameters
    ----------
    things : sequence of str
        Keys of experiments, or scene files; by default all experiments with a scene.
    request : SensitivityRequest
    project : callable
        Opens the project; not called for scene files without a calibration.
    command : str
        Command as typed.
    ready : callable, optional
        Called with the first scene before anything is simulated.

    Raises
    ------
    InvalidInput
        Nothing can be simulated.
    """
    begun = clock.perf_counter()
    files = [thing for thing in things if is_scene_file(thing)]
    stored = len(files) < len(things) or not things or request.calibration is not None
    opened = project() if stored else None
    if opened is not None and request.calibration is None:
        with opened.store() as store:
            newest = newest_calibration(store, engine=request.engine)
            request = replace(request, calibration=newest)
    if request.engine and request.calibration is None:
        request = replace(request, engine=stated_name(request.engine))
    subjects, skipped = _subjects(things, request, opened)
    if not subjects:
        why = "; ".join(f"{key}: {reason}" for key, reason in list(skipped.items())[:3])
        raise InvalidInput(
            "experiments", found=why or "none", expected="a push that can be simulated"
        )
    if ready is not None:
        ready(subjects[0].scene)
    found = []
    for subject in subjects:
        try:
            found.append(Finding(subject, _analysed(subject, request)))
        except InvalidInput as problem:
            if len(subjects) == 1:
                raise
            skipped[subject.key] = str(problem)
    if not found:
        raise InvalidInput("experiments", found=next(iter(skipped.values())), expected="an outcome")
    found.sort(key=_badness)
    pictures = pictures_of(found)
    analysis = analysis_of(found, skipped, request, command, clock.perf_counter() - begun)
    kept = None if opened is None else store_analysis(opened, analysis, pictures, arrays_of(found))
    return SensitivityAnswer(
        findings=tuple(found),
        skipped=skipped,
        analysis=analysis if kept is None else kept.analysis,
        pictures=tuple(pictures),
        kept=kept,
    )


def store_sensitivity(project: Project, found: Sensitivity) -> StoredAnalysis:
    """Store the sensitivity of one push in a project, named by a mark of its scene."""
    own = found.prediction
    if own.error is None:
        raise InvalidInput("what", found="no start error", expected="a result of fixel.sensitivity")
    scene = json.dumps(scene_content(own.scene), sort_keys=True)
    values = {name: float(x) for name, x in own.parameters.items() if np.ndim(x) == 0}
    subject = Subject(
        key=f"scene-{hashlib.sha256(scene.encode()).hexdigest()[:8]}",
        id=None,
        scene=own.scene,
        values=values,
        ranges={},
        motion=motion_model(own.motion),
        stepper=None,
        banner="",
    )
    request = SensitivityRequest(
        error=own.error,
        samples=len(own.drawn),
        values=values,
        indices=found.indices is not None,
        seed=own.seed,
    )
    every = [Finding(subject, found)]
    analysis = analysis_of(every, {}, request, "", 0.0)
    return store_analysis(project, analysis, pictures_of(every), arrays_of(every))


def is_scene_file(thing: str) -> bool:
    """Whether this is the name of a scene file, not of an experiment."""
    return thing.lower().endswith(SCENE_ENDINGS)


def _badness(finding: Finding) -> tuple[int, float, str]:
    own = finding.sensitivity
    return FLAGS.index(own.flag), -max(own.amplification, own.gain), finding.subject.key


def _analysed(subject: Subject, request: SensitivityRequest) -> Sensitivity:
    return sensitivity(
        subject.scene,
        request.error,
        subject.values,
        samples=request.samples,
        vary=subject.ranges,
        indices=request.indices,
        base=request.base,
        motion=subject.motion,
        stepper=subject.stepper,
        seed=request.seed,
        threads=request.threads,
    )


# --- pushes to analyse --------------------------------------------------------------------------


def _subjects(
    things: Sequence[str], request: SensitivityRequest, project: Project | None
) -> tuple[list[Subject], dict[str, str]]:
    if project is None:
        return [_of_file(thing, request, None) for thing in things], {}
    with project.store() as store:
        model = None
        if request.calibration is not None:
            model = load_values(store, request.calibration, engine=request.engine)
        ids = {} if things else _all(store)
        for thing in things:
            if not is_scene_file(thing):
                ids[thing] = store.find(thing)
        subjects = [_of_file(t, request, model) for t in things if is_scene_file(t)]
        skipped = {}
        for key, number in ids.items():
            try:
                subjects.append(_of_experiment(number, store.experiment(number), request, model))
            except InvalidInput as problem:
                if len(things) == 1:
                    raise
                skipped[key] = str(problem)
    return subjects, skipped


def _all(store: Store) -> dict[str, int]:
    return {summary.key: summary.id for summary in store.experiments(ExperimentQuery()).rows}


def _of_file(thing: str, request: SensitivityRequest, model: CalibratedValues | None) -> Subject:
    file = load_scene(Path(thing))
    values = {} if model is None else model.values({"experiment": thing})
    return Subject(
        key=Path(thing).stem,
        id=None,
        scene=file.scene,
        values=values | dict(request.values),
        ranges=_ranges(model, values) | dict(request.ranges),
        motion=motion_model(request.engine or file.motion) if model is None else model.motion,
        stepper=file.stepper,
        banner="",
    )


def _of_experiment(
    number: int, experiment: Experiment, request: SensitivityRequest, model: CalibratedValues | None
) -> Subject:
    target = target_of(experiment)
    scene = replace(target.case.scene, duration=float(target.case.times[-1]))
    values = {} if model is None else model.values(target.conditions)
    return Subject(
        key=experiment.key,
        id=number,
        scene=scene,
        values=values | dict(request.values),
        ranges=_ranges(model, values) | dict(request.ranges),
        motion=motion_model(request.engine or None) if model is None else model.motion,
        stepper=None,
        banner="" if experiment.real else f"SIMULATED by {experiment.simulated_by}",
    )


def _ranges(
    model: CalibratedValues | None, values: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Intervals of a calibration, if the data determine both ends."""
    found: dict[str, tuple[float, float]] = {}
    for estimate in model.record.estimates if model is not None else ():
        name, _ = split_label(estimate.label)
        low, high = estimate.low, estimate.high
        held = low is not None and high is not None and low < high
        if held and values.get(name) == estimate.value and not name.startswith("start_"):
            found[name] = (float(low), float(high))  # type: ignore[arg-type]
    return found
