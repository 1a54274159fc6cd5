"""How sensitive pushes are to their start: fans, indices, and an order of what to avoid first."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.database.query import Query
from fixel.database.store import Store
from fixel.drawing.sensitivity import Bars, FanChart, IndicesChart
from fixel.errors import InvalidInput
from fixel.exchange import load_scene
from fixel.kernels.arrays import FloatArray
from fixel.model import Experiment, Parameters, Scene
from fixel.simulation import AbstractMotionModel, Dynamic
from fixel.simulation.stepper import AbstractStepper
from fixel.uncertainty.fan import Fan, fan_of
from fixel.uncertainty.indices import Indices, indices_of
from fixel.uncertainty.outcomes import FLAGS, Sensitivity, sensitivity_of
from fixel.uncertainty.starts import StartError
from fixel.workflows.analysis import Analysis, Kept, TextTable, keep
from fixel.workflows.calibrated import Calibrated, calibrated, parted
from fixel.workflows.pictures import Picture
from fixel.workflows.simulate import Method, parts

Told = Callable[[int, int], None]

SCENE_ENDINGS: Final = (".yaml", ".yml", ".json")
MOST_PICTURES: Final = 12  # of the pushes to avoid first; the table has all

MEANING: Final[Mapping[str, str]] = {
    FLAGS[0]: "its outcomes fall apart into groups",
    FLAGS[1]: "some starts that lie side by side end far apart",
    FLAGS[2]: "an error of the start at least doubles",
    FLAGS[3]: "an error of the start stays about as it is, or shrinks",
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityRequest:
    """What is asked.

    Parameters
    ----------
    error : StartError
    samples : int
        Perturbed starts a push.
    values : mapping of str to float
        Parameters, over those of a calibration.
    ranges : mapping of str to (float, float)
        What is uncertain besides, for the indices; over the intervals of a calibration.
    calibration : int, optional
        Id; the scene's own values where left out.
    indices : bool
    base : int
        Base samples of the indices, a power of two.
    seed : int
    threads : int, optional
    """

    error: StartError
    samples: int = 1000
    values: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    calibration: int | None = None
    indices: bool = False
    base: int = 128
    seed: int = 0
    threads: int | None = None

    def question(self, keys: Sequence[str]) -> dict[str, Any]:
        """As plain content."""
        return {
            "of": list(keys),
            "error": [*self.error.size.tolist(), self.error.kind],
            "samples": self.samples,
            "values": dict(self.values),
            "ranges": {name: list(interval) for name, interval in self.ranges.items()},
            "calibration": self.calibration,
            "indices": self.base if self.indices else None,
            "seed": self.seed,
        }


class Subject(NamedTuple):
    """A push to look at."""

    key: str
    id: int | None  # of a stored experiment
    scene: Scene
    values: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    motion: AbstractMotionModel
    stepper: AbstractStepper | None
    banner: str


class Finding(NamedTuple):
    """One push, judged."""

    subject: Subject
    fan: Fan
    sensitivity: Sensitivity
    indices: Indices | None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivityAnswer:
    """Pushes, the one to avoid first in front.

    Attributes
    ----------
    findings : tuple of Finding
    skipped : dict of str to str
        What could not be looked at, and why.
    analysis : Analysis
    pictures : tuple of Picture
    kept : Kept, optional
        Where a project keeps it.
    """

    findings: tuple[Finding, ...]
    skipped: Mapping[str, str]
    analysis: Analysis
    pictures: tuple[Picture, ...]
    kept: Kept | None


def analyse_sensitivity(
    things: Sequence[str],
    request: SensitivityRequest,
    project: Callable[[], Project],
    *,
    command: str = "",
    progress: Callable[[str], Told | None] | None = None,
    ready: Callable[[Scene], None] | None = None,
) -> SensitivityAnswer:
    """Look at stored experiments or scene files, and keep the answer where there is a project.

    Parameters
    ----------
    things : sequence of str
        Keys of experiments, or scene files; all experiments with a scene where left out.
    request : SensitivityRequest
    project : callable
        Opens the project; not called for scene files alone without a calibration.
    command : str
        What was typed.
    progress : callable, optional
        Gives, for a name, what is told how many of how many starts are done.
    ready : callable, optional
        Given the first scene before anything is simulated.

    Raises
    ------
    InvalidInput
        Nothing that can be simulated.
    """
    begun = clock.perf_counter()
    files = [thing for thing in things if is_scene_file(thing)]
    stored = len(files) < len(things) or not things or request.calibration is not None
    opened = project() if stored else None
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
    pictures = _pictures(found[:MOST_PICTURES])
    analysis = _analysis(found, skipped, request, command, clock.perf_counter() - begun)
    kept = None if opened is None else keep(opened, analysis, pictures, _arrays(found))
    return SensitivityAnswer(
        findings=tuple(found),
        skipped=skipped,
        analysis=analysis if kept is None else kept.analysis,
        pictures=tuple(pictures),
        kept=kept,
    )


def is_scene_file(thing: str) -> bool:
    """Whether this is the name of a scene file, and no experiment's."""
    return thing.lower().endswith(SCENE_ENDINGS)


def _badness(finding: Finding) -> tuple[int, float, str]:
    own = finding.sensitivity
    return FLAGS.index(own.flag), -max(own.amplification, own.gain), finding.subject.key


def _look(subject: Subject, request: SensitivityRequest, told: Told | None) -> Finding:
    method: dict[str, Any] = {
        "values": subject.values,
        "motion": subject.motion,
        "stepper": subject.stepper,
        "seed": request.seed,
        "threads": request.threads,
        "progress": told,
    }
    fan = fan_of(subject.scene, request.error, request.samples, **method)
    judged = sensitivity_of(fan)
    indices = None
    if request.indices:
        indices = indices_of(subject.scene, request.error, subject.ranges, request.base, **method)
    return Finding(subject, fan, judged, indices)


# --- what is looked at --------------------------------------------------------------------------


def _subjects(
    things: Sequence[str], request: SensitivityRequest, project: Project | None
) -> tuple[list[Subject], dict[str, str]]:
    if project is None:
        return [_of_file(thing, request, None) for thing in things], {}
    with project.store() as store:
        model = None
        if request.calibration is not None:
            model = calibrated(store, request.calibration)
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
    return {summary.key: summary.id for summary in store.experiments(Query()).summaries}


def _of_file(thing: str, request: SensitivityRequest, model: Calibrated | None) -> Subject:
    file = load_scene(Path(thing))
    motion, stepper, _ = parts(file, Method())
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
    number: int, experiment: Experiment, request: SensitivityRequest, model: Calibrated | None
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
    model: Calibrated | None, values: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Intervals of a calibration, where the data set both ends."""
    found: dict[str, tuple[float, float]] = {}
    for estimate in model.record.estimates if model is not None else ():
        name, _ = parted(estimate.label)
        low, high = estimate.low, estimate.high
        held = low is not None and high is not None and low < high
        if held and values.get(name) == estimate.value and not name.startswith("start_"):
            found[name] = (float(low), float(high))  # type: ignore[arg-type]
    return found


# --- what is said -------------------------------------------------------------------------------


def _analysis(
    found: Sequence[Finding],
    skipped: Mapping[str, str],
    request: SensitivityRequest,
    command: str,
    seconds: float,
) -> Analysis:
    keys = [finding.subject.key for finding in found]
    one = found[0]
    title = keys[0] if len(keys) == 1 else f"{len(keys)} pushes"
    return Analysis(
        kind="sensitivity",
        title=f"Sensitivity to the start: {title}",
        question=request.question(sorted(keys)),
        headline=tuple(_headline(found, request)),
        warnings=tuple(_warnings(found, skipped)),
        tables=tuple(_tables(found)),
        methods=tuple(_methods(one, request)),
        numbers={
            "start_error": {
                "x_m": request.error.x,
                "y_m": request.error.y,
                "theta_rad": request.error.theta,
                "kind": request.error.kind,
            },
            "samples": request.samples,
            "pushes": [_numbers(finding) for finding in found],
            "skipped": dict(skipped),
        },
        calibrations=() if request.calibration is None else (request.calibration,),
        experiments=tuple(f.subject.id for f in found if f.subject.id is not None),
        command=command,
        seed=request.seed,
        seconds=seconds,
    )


def _headline(found: Sequence[Finding], request: SensitivityRequest) -> list[str]:
    said = []
    if len(found) > 1:
        counts = {flag: sum(f.sensitivity.flag == flag for f in found) for flag in FLAGS}
        told = ", ".join(f"{n} {flag}" for flag, n in counts.items() if n)
        said.append(f"Of {len(found)} pushes: {told}.")
    for finding in found[:3]:
        own = finding.sensitivity
        said.append(
            f"{finding.subject.key}: {own.flag}: {MEANING[own.flag]}. Starts"
            f" {request.error.written()} end {1e3 * own.after.position:.3g} mm and"
            f" {math.degrees(own.after.angle):.3g} deg (rms) from their mean: the spread grows"
            f" {own.amplification:.2g} times, a small error up to {own.gain:.2g} times."
        )
        if len(own.share) > 1:
            shares = ", ".join(f"{share:.0%}" for share in own.share)
            said.append(
                f"{finding.subject.key} has {len(own.share)} outcomes ({shares}), up to"
                f" {1e3 * own.apart:.3g} mm apart, turns counted at {1e3 * own.arm:.3g} mm/rad."
            )
        said += _largest_share(finding)
    return said


def _largest_share(finding: Finding) -> list[str]:
    """Which input the outcome that varies most owes most of its spread to."""
    own = finding.indices
    if own is None or not (own.deviation > 0.0).any():
        return []
    weight = np.array([1.0, 1.0, finding.sensitivity.arm])
    k = int(np.argmax(own.deviation * weight))
    j = int(np.argmax(own.total[k]))
    return [
        f"{finding.subject.key}: most of the spread {own.outcomes[k]} comes from"
        f" {own.factors[j].name} (total index {own.total[k, j]:.2f} +-"
        f" {own.total_error[k, j]:.2f})."
    ]


def _warnings(found: Sequence[Finding], skipped: Mapping[str, str]) -> list[str]:
    said = []
    for finding in found:
        failed = sum(finding.sensitivity.failed.values())
        if failed:
            why = "; ".join(f"{n} x {r}" for r, n in finding.sensitivity.failed.items())
            n = len(finding.fan.reasons)
            said.append(f"{finding.subject.key}: {failed} of {n} starts have no outcome: {why}.")
        if finding.fan.moved_apart > 0.0:
            said.append(
                f"{finding.subject.key}: {finding.fan.moved_apart:.0%} of the starts would overlap"
                " a neighbour and were moved beside it."
            )
        if finding.indices is not None and float(finding.indices.total_error.max()) > 0.2:
            said.append(
                f"{finding.subject.key}: some indices are uncertain by more than 0.2; ask for more"
                " samples."
            )
    said += [f"{key} was left out: {reason}" for key, reason in skipped.items()]
    return said


def _tables(found: Sequence[Finding]) -> list[TextTable]:
    head = (
        "push", "flag", "amplification", "gain", "spread [mm]", "spread [deg]", "outcomes",
        "contact modes",
    )  # fmt: skip
    tables = [TextTable(title="Pushes, to avoid first", head=head, rows=tuple(map(_row, found)))]
    for finding in found:
        if finding.indices is not None:
            tables.append(_index_table(finding.subject.key, finding.indices))
    return tables


def _row(finding: Finding) -> tuple[str, ...]:
    own = finding.sensitivity
    return (
        finding.subject.key,
        own.flag,
        f"{own.amplification:.2f}",
        f"{own.gain:.2f}",
        f"{1e3 * own.after.position:.4g}",
        f"{math.degrees(own.after.angle):.4g}",
        " + ".join(f"{share:.0%}" for share in own.share),
        " ".join(f"{mode}: {share:.0%}" for mode, share in own.modes.items()),
    )


def _index_table(key: str, own: Indices) -> TextTable:
    rows = [
        (
            outcome,
            factor.name,
            f"{own.first[k, j]:.3f} +- {own.first_error[k, j]:.3f}",
            f"{own.total[k, j]:.3f} +- {own.total_error[k, j]:.3f}",
        )
        for k, outcome in enumerate(own.outcomes)
        for j, factor in enumerate(own.factors)
    ]
    return TextTable(
        title=f"Sobol indices of {key}",
        head=("outcome", "input", "first order", "total"),
        rows=tuple(rows),
    )


def _methods(one: Finding, request: SensitivityRequest) -> list[str]:
    said = [
        f"The outcome of each push was simulated ({one.fan.motion}) for {request.samples} starts"
        f" {request.error.written()}, drawn as a scrambled Sobol sequence; starts that would"
        " overlap a neighbour were moved out the shortest way.",
        "Amplification is the root mean square spread of end poses over that of starts, turns"
        " counted at the body's radius of gyration; outcomes are groups of end poses with a gap"
        " between them that a cloud without one shows with a chance of 0.1 %.",
    ]
    if one.indices is not None:
        said.append(
            "Sobol indices were estimated by the method of Saltelli et al. (2010) with SALib from"
            f" {one.indices.evaluations} simulations a push, intervals by bootstrap."
        )
    return said


def _numbers(finding: Finding) -> dict[str, Any]:
    found: dict[str, Any] = {
        "key": finding.subject.key,
        "experiment_id": finding.subject.id,
        **finding.sensitivity.summary(),
        "moved_apart": finding.fan.moved_apart,
        "nominal_end": finding.fan.nominal[-1].tolist(),
        "values": dict(Parameters(finding.subject.values)),
    }
    if finding.indices is not None:
        found["indices"] = finding.indices.summary()
    return found


def _pictures(found: Sequence[Finding]) -> list[Picture]:
    pictures = []
    for k, finding in enumerate(found, 1):
        own, fan, subject = finding.sensitivity, finding.fan, finding.subject
        stem = f"{k:02d}-" + "".join(c if c.isalnum() else "-" for c in subject.key)
        chart = FanChart(
            title=f"{subject.key}: {own.flag}",
            scene=subject.scene,
            drawn=fan.drawn[fan.ended],
            end=fan.end,
            nominal=fan.nominal[-1],
            outcome=own.outcome,
            share=own.share,
        )
        pictures.append(
            Picture(
                f"{stem}-fan",
                chart,
                subject.banner,
                f"End poses of {subject.key} over starts {fan.error.written()}: {own.flag},"
                f" amplification {own.amplification:.2g}. Colours are outcomes; the black outline"
                " is the end without an error.",
            )
        )
        if finding.indices is not None:
            pictures.append(_index_picture(stem, subject, finding.indices))
    return pictures


def _index_picture(stem: str, subject: Subject, own: Indices) -> Picture:
    bars = [
        Bars(
            outcome,
            own.units[k],
            float(own.deviation[k]),
            own.first[k],
            own.first_error[k],
            own.total[k],
            own.total_error[k],
        )
        for k, outcome in enumerate(own.outcomes)
    ]
    names = [factor.name for factor in own.factors]
    return Picture(
        f"{stem}-indices",
        IndicesChart(title=f"{subject.key}: where the spread comes from", names=names, bars=bars),
        subject.banner,
        f"Sobol indices of the end of {subject.key} with 95 % intervals; above each panel the"
        " standard deviation that is shared out.",
    )


def _arrays(found: Sequence[Finding]) -> dict[str, FloatArray]:
    arrays: dict[str, FloatArray] = {}
    for k, finding in enumerate(found[:MOST_PICTURES], 1):
        arrays[f"drawn_{k}"] = finding.fan.drawn
        arrays[f"pose_{k}"] = finding.fan.pose
        arrays[f"ended_{k}"] = finding.fan.ended.astype(np.float64)
    return arrays
