"""Pushes of a sensitivity analysis: where they come from, and their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats import load_scene
from fixel.model import Experiment, Parameters, Scene
from fixel.model.parameters import info_of
from fixel.model.selection import ExperimentQuery
from fixel.model.space import split_label
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model, stated_name
from fixel.simulation.stepper import AbstractStepper
from fixel.uncertainty.outcomes import FLAGS, Sensitivity
from fixel.uncertainty.starts import StartError
from fixel.workflows.calibration.stored import CalibratedValues, load_values, newest_calibration

Ranges = Mapping[str, tuple[float, float]]


SCENE_ENDINGS: Final = (".yaml", ".yml", ".json")


class PushSelection(NamedTuple):
    """Pushes to analyse, and the source of their parameters."""

    project: Project | None
    things: Sequence[str]  # keys of experiments, or scene files; empty for all experiments
    calibration: int | None  # id; of stored experiments by default the newest
    engine: str  # whose newest calibration is used, and that simulates scene files
    values: Mapping[str, float]  # override those of a calibration
    ranges: Ranges  # further inputs of the indices; override a calibration's intervals


class Subject(NamedTuple):
    """Push to analyse."""

    key: str
    source: str  # key, or scene file
    scene: Scene
    values: dict[str, float]
    ranges: Ranges
    motion: AbstractMotionModel
    id: int | None = None  # id of a stored experiment
    stepper: AbstractStepper | None = None
    banner: str = ""


class Finding(NamedTuple):
    """Sensitivity of one push."""

    subject: Subject
    sensitivity: Sensitivity


class RankedPushes(NamedTuple):
    """Sensitivity of pushes, with the push to avoid first in front."""

    findings: Sequence[Finding]
    skipped: Mapping[str, str]  # pushes that could not be analysed, and why
    error: StartError
    calibration: int | None = None  # id of the calibration whose parameters were used


def selected(own: PushSelection) -> tuple[PushSelection, list[Subject], dict[str, str]]:
    """Load the pushes to analyse.

    Returns
    -------
    PushSelection
        The same, with the calibration that is used by default.
    list of Subject
    dict from str to str
        Experiments that cannot be simulated, and why.

    Raises
    ------
    InvalidInput
        Nothing can be simulated.
    """
    for name in own.ranges:
        info_of(name)
    own = own._replace(values=Parameters(own.values))
    if own.project is not None and own.calibration is None:
        with own.project.store() as store:
            own = own._replace(calibration=newest_calibration(store, engine=own.engine))
    if own.engine and own.calibration is None:
        own = own._replace(engine=stated_name(own.engine))
    subjects, skipped = _subjects(own)
    if not subjects:
        why = "; ".join(f"{key}: {reason}" for key, reason in list(skipped.items())[:3])
        raise InvalidInput(
            "experiments", found=why or "none", expected="a push that can be simulated"
        )
    return own, subjects, skipped


def by_flag(finding: Finding) -> tuple[int, float, str]:
    """Return the key by which the push to avoid first comes first."""
    own = finding.sensitivity
    return FLAGS.index(own.flag), -max(own.amplification, own.gain), finding.subject.key


def is_scene_file(thing: str) -> bool:
    """Whether this is the name of a scene file, not of an experiment."""
    return thing.lower().endswith(SCENE_ENDINGS)


def _subjects(own: PushSelection) -> tuple[list[Subject], dict[str, str]]:
    files = [thing for thing in own.things if is_scene_file(thing)]
    if own.project is None:
        return [_of_file(thing, own, None) for thing in files], {}
    with own.project.store() as store:
        model = None
        if own.calibration is not None:
            model = load_values(store, own.calibration, engine=own.engine)
        ids = {thing: store.find(thing) for thing in own.things if thing not in files}
        if not own.things:
            ids = {one.key: one.id for one in store.experiments(ExperimentQuery()).rows}
        subjects = [_of_file(thing, own, model) for thing in files]
        skipped = {}
        for key, number in ids.items():
            try:
                subjects.append(_of_experiment(number, store.experiment(number), own, model))
            except InvalidInput as problem:
                if len(own.things) == 1:
                    raise
                skipped[key] = str(problem)
    return subjects, skipped


def _of_file(thing: str, own: PushSelection, model: CalibratedValues | None) -> Subject:
    file = load_scene(Path(thing))
    values = {} if model is None else model.values({"experiment": thing})
    subject = _subject(Path(thing).stem, file.scene, own, model, values)
    motion = motion_model(own.engine or file.motion) if model is None else subject.motion
    return subject._replace(source=thing, motion=motion, stepper=file.stepper)


def _of_experiment(
    number: int, experiment: Experiment, own: PushSelection, model: CalibratedValues | None
) -> Subject:
    target = target_of(experiment)
    scene = replace(target.case.scene, duration=float(target.case.times[-1]))
    values = {} if model is None else model.values(target.conditions)
    banner = "" if experiment.real else f"SIMULATED by {experiment.simulated_by}"
    return _subject(experiment.key, scene, own, model, values)._replace(id=number, banner=banner)


def _subject(
    key: str,
    scene: Scene,
    own: PushSelection,
    model: CalibratedValues | None,
    values: dict[str, float],
) -> Subject:
    return Subject(
        key=key,
        source=key,
        scene=scene,
        values=values | dict(own.values),
        ranges=_ranges(model, values) | dict(own.ranges),
        motion=motion_model(own.engine or None) if model is None else model.motion,
    )


def _ranges(model: CalibratedValues | None, values: Mapping[str, float]) -> dict[str, Any]:
    """Intervals of a calibration, if the data determine both ends."""
    found = {}
    for estimate in model.record.estimates if model is not None else ():
        name, _ = split_label(estimate.label)
        low, high = estimate.low, estimate.high
        held = low is not None and high is not None and low < high
        if held and values.get(name) == estimate.value and not name.startswith("start_"):
            found[name] = (low, high)
    return found
