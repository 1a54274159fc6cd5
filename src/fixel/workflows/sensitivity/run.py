"""Compute the sensitivity of pushes to their start, and order them by it."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.formats import load_scene
from fixel.model import Experiment, Scene
from fixel.model.selection import ExperimentQuery
from fixel.simulation import Dynamic
from fixel.typing import ProgressCallback
from fixel.uncertainty.indices import indices_of
from fixel.uncertainty.outcomes import FLAGS, sensitivity_of
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.workflows.analysis import Analysis, StoredAnalysis, store_analysis
from fixel.workflows.calibration.stored import (
    CalibratedValues,
    load_values,
    newest_calibration,
    split_label,
)
from fixel.workflows.figures import Picture
from fixel.workflows.sensitivity.report import analysis_of, arrays_of, pictures_of
from fixel.workflows.sensitivity.request import Finding, SensitivityRequest, Subject
from fixel.workflows.simulation import SimulationMethod, parts

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


def analyse_sensitivity(
    things: Sequence[str],
    request: SensitivityRequest,
    project: Callable[[], Project],
    *,
    command: str = "",
    progress: Callable[[str], ProgressCallback | None] | None = None,
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
    progress : callable, optional
        Returns the progress callback for the starts of a push with this name.
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
            request = replace(request, calibration=newest_calibration(store))
    subjects, skipped = _subjects(things, request, opened)
    if not subjects:
        why = "; ".join(f"{key}: {reason}" for key, reason in list(skipped.items())[:3])
        raise InvalidInput("experiments", found=why or "none", expected="one that can be simulated")
    if ready is not None:
        ready(subjects[0].scene)
    found = []
    for subject in subjects:
        told = progress(subject.key) if progress is not None else None
        try:
            found.append(_look(subject, request, told))
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


def is_scene_file(thing: str) -> bool:
    """Whether this is the name of a scene file, not of an experiment."""
    return thing.lower().endswith(SCENE_ENDINGS)


def _badness(finding: Finding) -> tuple[int, float, str]:
    own = finding.sensitivity
    return FLAGS.index(own.flag), -max(own.amplification, own.gain), finding.subject.key


def _look(subject: Subject, request: SensitivityRequest, told: ProgressCallback | None) -> Finding:
    method: dict[str, Any] = {
        "values": subject.values,
        "motion": subject.motion,
        "stepper": subject.stepper,
        "seed": request.seed,
        "threads": request.threads,
        "progress": told,
    }
    ensemble = simulate_starts(subject.scene, request.error, request.samples, **method)
    judged = sensitivity_of(ensemble)
    indices = None
    if request.indices:
        indices = indices_of(subject.scene, request.error, subject.ranges, request.base, **method)
    return Finding(subject, ensemble, judged, indices)


# --- pushes to analyse --------------------------------------------------------------------------


def _subjects(
    things: Sequence[str], request: SensitivityRequest, project: Project | None
) -> tuple[list[Subject], dict[str, str]]:
    if project is None:
        return [_of_file(thing, request, None) for thing in things], {}
    with project.store() as store:
        model = None
        if request.calibration is not None:
            model = load_values(store, request.calibration)
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
    motion, stepper, _ = parts(file, SimulationMethod())
    values = {} if model is None else model.values({"experiment": thing})
    return Subject(
        key=Path(thing).stem,
        id=None,
        scene=file.scene,
        values=values | dict(request.values),
        ranges=_ranges(model, values) | dict(request.ranges),
        motion=motion if model is None else model.motion,
        stepper=stepper,
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
        motion=Dynamic() if model is None else model.motion,
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
