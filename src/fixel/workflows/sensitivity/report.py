"""Pushes of a sensitivity analysis, and its report: sentences, tables, charts."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.result import CalibratedValues
from fixel.database.project import Project
from fixel.drawing.sensitivity import indices_chart, sensitivity_chart
from fixel.errors import InvalidInput
from fixel.formats.scene_file import scene_content
from fixel.model import Experiment, Parameters, Scene
from fixel.model.parameters import info_of
from fixel.model.selection import ExperimentQuery
from fixel.simulation import AbstractMotionModel
from fixel.simulation.motion import motion_model, stated_name
from fixel.simulation.stepping import AbstractStepper
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import StartError
from fixel.uncertainty.outcomes import FLAGS, MEANING, Sensitivity
from fixel.uncertainty.prediction import intervals_of, push_of
from fixel.workflows.analysis import (
    Analysis,
    AnalysisReport,
    Picture,
    StoredAnalysis,
    StoredAnswer,
    banner_over,
    store_analysis,
)
from fixel.workflows.calibration.stored import load_values, newest_calibration
from fixel.workflows.sentences import rounded, sentences

JSON: Final = ("folder", "files")  # what `--json` has besides numbers
MAX_SENTENCES: Final = 3  # pushes with sentences in the headline
MAX_PICTURES: Final = 12  # of the pushes to avoid first; the table has all


def report_of(answer: RankedPushes) -> AnalysisReport:
    """Return headline, warnings, tables, charts and numbers, the push to avoid first in front."""
    found, error = answer.findings, answer.error
    first = found[0].sensitivity
    keys = [finding.subject.key for finding in found]
    title = keys[0] if len(keys) == 1 else f"{len(keys)} pushes"
    more = () if first.indices is None else ("saltelli2010", "herman2017")
    samples = len(first.prediction.drawn)
    analysis = Analysis(
        kind="sensitivity",
        title=f"Sensitivity to the start: {title}",
        question={"experiments": sorted(finding.subject.source for finding in found)},
        headline=_headline(found, error),
        warnings=sentences("sensitivity", "warnings", found=found, skipped=answer.skipped),
        tables=tuple(_tables(found)),
        methods=sentences("sensitivity", "methods", one=found[0], samples=samples, error=error),
        references=("asme2006", *more),
        numbers={
            "start_error": {
                "x_m": error.x,
                "y_m": error.y,
                "theta_rad": error.theta,
                "kind": error.kind,
            },
            "samples": samples,
            "pushes": [_numbers(finding) for finding in found],
            "skipped": dict(answer.skipped),
        },
        calibrations=() if answer.calibration is None else (answer.calibration,),
        experiments=tuple(f.subject.id for f in found if f.subject.id is not None),
        seed=first.prediction.seed,
    )
    return AnalysisReport(analysis, pictures_of(found), arrays_of(found))


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    own = done.result.findings[0].sensitivity
    if not done.drawn:
        return [*done.again, "--plot", "sensitivity"]
    if own.indices is None:
        return [*done.again, "--indices"]
    if done.folder is not None:
        return ["report"]
    return [*done.again, "--samples", str(10 * len(own.prediction.reasons))]


def store_sensitivity(project: Project, found: Sensitivity) -> StoredAnalysis:
    """Store the sensitivity of one push in a project, named by a mark of its scene."""
    own = found.prediction
    if own.error is None:
        raise InvalidInput("what", found="no start error", expected="a result of fixel.sensitivity")
    scene = json.dumps(scene_content(own.scene), sort_keys=True)
    values = {name: float(x) for name, x in own.parameters.items() if np.ndim(x) == 0}
    key = f"scene-{hashlib.sha256(scene.encode()).hexdigest()[:8]}"
    subject = Subject(key, key, own.scene, values, {}, motion_model(own.motion))
    report = report_of(RankedPushes([Finding(subject, found)], {}, own.error))
    mark = {"samples": hashlib.sha256(own.pose.tobytes()).hexdigest()}
    analysis = report.analysis.model_copy(update={"question": report.analysis.question | mark})
    return store_analysis(project, analysis, report.pictures, report.arrays)


def _headline(found: Sequence[Finding], error: StartError) -> tuple[str, ...]:
    counts = Counter(finding.sensitivity.flag for finding in found)
    words = [
        f"{counts[flag]} {flag if counts[flag] == 1 else flag.replace('bifurcates', 'bifurcate')}"
        for flag in FLAGS
        if flag in counts
    ]
    return sentences(
        "sensitivity",
        "headline",
        keys=[finding.subject.key for finding in found],
        found=found[:MAX_SENTENCES],
        counts=", ".join(words),
        meaning=MEANING,
        error=error,
        largest=[_largest_share(finding) for finding in found[:MAX_SENTENCES]],
    )


def _largest_share(finding: Finding) -> dict[str, Any]:
    """Input that causes most of the spread of the most variable outcome; empty if none does."""
    own = finding.sensitivity.indices
    if own is None or not (own.deviation > 0.0).any():
        return {}
    weight = np.array([1.0, 1.0, finding.sensitivity.arm])
    k = int(np.argmax(own.deviation * weight))
    j = int(np.argmax(own.total[k]))
    return {
        "outcome": own.outcomes[k],
        "name": own.factors[j].name,
        "total": own.total[k, j],
        "error": own.total_error[k, j],
    }


def _tables(found: Sequence[Finding]) -> list[Table]:
    head = (
        *("push", "flag", Column("amplification", format=".2f"), Column("gain", format=".2f")),
        *("spread [mm]", "spread [deg]", "outcomes", "contact modes"),
    )
    rows = [
        (
            finding.subject.key,
            own.flag,
            own.amplification,
            own.gain,
            rounded(1e3 * own.after.position, 4),
            rounded(math.degrees(own.after.angle), 4),
            " + ".join(f"{share:.0%}" for share in own.share),
            " ".join(f"{mode}: {share:.0%}" for mode, share in own.modes.items()),
        )
        for finding, own in ((finding, finding.sensitivity) for finding in found)
    ]
    some = [
        (f.subject.key, f.sensitivity.indices) for f in found if f.sensitivity.indices is not None
    ]
    return [
        Table(head, rows, title="Pushes, the most sensitive first", left=2),
        *(indices.table(f"Sobol indices of {key}") for key, indices in some),
    ]


def _numbers(finding: Finding) -> dict[str, Any]:
    found: dict[str, Any] = {
        "key": finding.subject.key,
        "experiment_id": finding.subject.id,
        "motion": finding.sensitivity.prediction.motion,
        **finding.sensitivity.summary(),
        "moved_apart": finding.sensitivity.prediction.moved_apart,
        "nominal_end": finding.sensitivity.prediction.nominal[-1].tolist(),
        "values": dict(Parameters(finding.subject.values)),
    }
    if finding.sensitivity.indices is not None:
        found["indices"] = finding.sensitivity.indices.summary()
    return found


def pictures_of(found: Sequence[Finding]) -> list[Picture]:
    """Draw charts of the pushes to avoid first."""
    pictures = []
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        own, subject = finding.sensitivity, finding.subject
        ensemble = own.prediction
        stem = f"{k:02d}-" + "".join(c if c.isalnum() else "-" for c in subject.key)
        chart = sensitivity_chart(own, f"{subject.key}: {own.flag}")
        known = {"key": subject.key, "own": own, "ensemble": ensemble}
        (caption,) = sentences("sensitivity", "ensemble_caption", **known)
        pictures.append(Picture(f"{stem}-ensemble", chart, subject.banner, caption))
        if own.indices is not None:
            bars = indices_chart(own, f"{subject.key}: sources of the spread")
            (caption,) = sentences("sensitivity", "indices_caption", key=subject.key)
            pictures.append(Picture(f"{stem}-indices", bars, subject.banner, caption))
    return pictures


def arrays_of(found: Sequence[Finding]) -> dict[str, FloatArray]:
    """Return the starts and poses shown in the charts."""
    arrays: dict[str, FloatArray] = {}
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        arrays[f"drawn_{k}"] = finding.sensitivity.prediction.drawn
        arrays[f"pose_{k}"] = finding.sensitivity.prediction.pose
        arrays[f"ended_{k}"] = finding.sensitivity.prediction.ended.astype(np.float64)
    return arrays


SCENE_ENDINGS: Final = (".yaml", ".yml", ".json")


class Subject(NamedTuple):
    """Push to analyse."""

    key: str
    source: str  # key, or scene file
    scene: Scene
    values: dict[str, float]
    ranges: Mapping[str, tuple[float, float]]
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


def selected(
    project: Project | None, asked: Any
) -> tuple[list[Subject], dict[str, str], int | None]:
    """Load the pushes of a request, and the reasons why other experiments cannot be simulated.

    The id of the calibration that is used is returned, too, which is by default the newest. If
    nothing can be simulated, `InvalidInput` is raised.
    """
    for name in asked.vary or ():
        info_of(name, f"vary {name}")
    number, engine = asked.calibration, asked.engine or ""
    if project is not None and number is None:
        with project.store() as store:
            number = newest_calibration(store, engine=engine)
    if engine and number is None:
        engine = stated_name(engine)
    own = {"calibration": number, "engine": engine, "values": Parameters(asked.values or {})}
    subjects, skipped = _subjects(project, asked.model_copy(update=own))
    if not subjects:
        why = "; ".join(f"{key}: {reason}" for key, reason in list(skipped.items())[:3])
        raise InvalidInput(
            "experiments",
            found=f"none ({why})" if why else "none",
            expected="a push that can be simulated",
        )
    return subjects, skipped, number


def by_flag(finding: Finding) -> tuple[int, float, str]:
    """Return the key by which the push to avoid first comes first."""
    own = finding.sensitivity
    return FLAGS.index(own.flag), -max(own.amplification, own.gain), finding.subject.key


def is_scene_file(thing: str) -> bool:
    """Whether this is the name of a scene file, not of an experiment."""
    return thing.lower().endswith(SCENE_ENDINGS)


def _subjects(project: Project | None, own: Any) -> tuple[list[Subject], dict[str, str]]:
    files = [thing for thing in own.experiments if is_scene_file(thing)]
    if project is None:
        return [_subject(thing, own, None) for thing in files], {}
    with project.store() as store:
        model = None
        if own.calibration is not None:
            model = load_values(store, own.calibration, engine=own.engine)
        ids = {thing: store.find(thing) for thing in own.experiments if thing not in files}
        if not own.experiments:
            ids = {one.key: one.id for one in store.experiments(ExperimentQuery()).rows}
        subjects = [_subject(thing, own, model) for thing in files]
        skipped = {}
        for key, number in ids.items():
            try:
                subjects.append(_subject(store.experiment(number), own, model, number))
            except InvalidInput as problem:
                if len(own.experiments) == 1:
                    raise
                skipped[key] = str(problem)
    return subjects, skipped


def _subject(
    what: str | Experiment, own: Any, model: CalibratedValues | None, number: int | None = None
) -> Subject:
    """Return the push of a scene file or of an experiment, with the values of a calibration."""
    push, banner = push_of(what, None, own.engine or None), ""
    key, source = Path(str(what)).stem, str(what)
    conditions: Mapping[str, str | float] = {"experiment": source}
    if isinstance(what, Experiment):
        key = source = what.key
        conditions, banner = push.conditions, banner_over([what])
    values = {} if model is None else model.values(conditions)
    estimates = () if model is None else model.record.estimates
    return Subject(
        key=key,
        source=source,
        scene=push.scene,
        values=values | dict(own.values),
        ranges=intervals_of(estimates, conditions) | dict(own.vary or {}),
        motion=push.motion if model is None else model.motion,
        id=number,
        stepper=push.stepper,
        banner=banner,
    )
