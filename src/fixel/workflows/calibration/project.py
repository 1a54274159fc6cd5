"""Experiments of a project to calibrate, and the calibrations that it stores."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, final, overload

import numpy as np

from fixel.calibration.objective import root_mean
from fixel.calibration.result import CalibrationResult, FitKind, ParameterSet, set_content, set_of
from fixel.calibration.study import Trace
from fixel.calibration.target import Target, spread_sample, target_of
from fixel.database.project import SETTINGS, Project, check_known_names
from fixel.database.store import Store
from fixel.errors import InvalidInput, StoreRefused
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import INVALID_CONTENT, readable
from fixel.io.lock import FileLock
from fixel.jobs import folder as files
from fixel.model import LoadMap, Parameters, Provenance
from fixel.model.records import CalibrationRecord, Evaluations, Member
from fixel.model.selection import ExperimentQuery
from fixel.model.space import ParameterSpace
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration, Calibrations, collect, finite
from fixel.workflows.calibration.parameter_options import command_of, options_of
from fixel.workflows.calibration.plan import job_of, outcome_bytes, plan_in
from fixel.workflows.calibration.stored import VERSION, misfit_of, request_in

STORED: Final = "stored.json"  # ids of the calibrations, once they are stored
RUN: Final = "run"  # in the method of a record: checksum that all calibrations of a run share
EARLIER: Final = {"faulty": "flagged"}  # names of options in records of earlier versions


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentSelection:
    """Experiments to calibrate."""

    ids: list[int]
    targets: list[Target]
    left_out: Mapping[str, str]  # reasons why others cannot be compared, by key
    # Number of experiments that these were drawn from at random; None where they are all.
    sample_of: int | None = None

    def __iter__(self) -> Iterator[Target]:
        return iter(self.targets)


def select_experiments(
    store: Store, keys: Sequence[str], query: ExperimentQuery
) -> ExperimentSelection:
    """Select experiments by name, or by what they have in common.

    Named ones must be fit for it, and count once under whatever names; of a listing, those that are
    not are left out with a reason.
    """
    ids = list(dict.fromkeys(store.find(key) for key in keys))
    if not ids:
        ids = [summary.id for summary in store.experiments(query).rows]
        if not ids:
            check_known_names(store, query)
    targets: dict[int, Target] = {}
    left_out: dict[str, str] = {}
    for experiment_id in ids:
        experiment = store.experiment(experiment_id)
        try:
            targets[experiment_id] = target_of(experiment)
        except InvalidInput as problem:
            if keys:
                raise
            left_out[experiment.key] = str(problem)
    if not targets:
        reason = next(iter(left_out.values()), "")
        raise InvalidInput(
            "experiments",
            found=f"none to calibrate with{f' ({reason})' if reason else ''}",
            expected="one at least with a scene and measured poses",
            hint="fixel list shows all experiments",
        )
    return ExperimentSelection(ids=list(targets), targets=list(targets.values()), left_out=left_out)


def draw_sample(chosen: ExperimentSelection, count: int, seed: int) -> ExperimentSelection:
    """Return `count` random experiments of those chosen, or all of fewer ones.

    Every condition has the same share of them as before.
    """
    n = len(chosen.ids)
    if count >= n:
        return chosen
    kept = spread_sample([target.conditions for target in chosen.targets], count, seed)
    ids, targets = zip(*((chosen.ids[k], chosen.targets[k]) for k in kept), strict=True)
    return replace(chosen, ids=list(ids), targets=list(targets), sample_of=n)


def stored_points(project: Project, space: ParameterSpace) -> list[list[float]]:
    """Values of the free parameters in all stored calibrations that have them, each set once."""
    labels = space.labels
    points: dict[tuple[float, ...], None] = {}
    with project.store() as store:
        for record in store.calibration_summaries().values():
            best = record.best_fit
            if all(label in best for label in labels):
                points[tuple(best[label] for label in labels)] = None
    return [list(point) for point in points]


@overload
def add_to_project(project: Project, found: Calibration) -> Calibration: ...
@overload
def add_to_project(project: Project, found: Calibrations) -> Calibrations: ...
def add_to_project(
    project: Project, found: Calibration | Calibrations
) -> Calibration | Calibrations:
    """Store the calibrations of a run in a project that has its experiments; return them with ids.

    Of a calibration, all of its run are stored. Those of a job are stored once.
    """
    run = found.run if isinstance(found, Calibration) else found
    with project.store() as store:
        experiments = [store.find(key) for key in run.outcome.keys]
        words = [str(number) for number in experiments]
        usual = options_of(run.request, words) | {"project": str(project.folder.resolve())}
        asked = run.asked or usual
        run = replace(run, asked=asked, command=run.command or command_of(asked))
        if run.folder is None:
            ids = [store.add_calibration(record) for record in _records(run, experiments)]
        else:
            ids = _stored_once(store, run, experiments, run.folder)
    stored = replace(run, ids=tuple(ids))
    return stored[found.number] if isinstance(found, Calibration) else stored


def collected(project: Project, folder: Path) -> Calibrations:
    """Return the calibrations of a finished job in a project; store them if necessary.

    It raises `JobRefused` while another process stores them.
    """
    return add_to_project(project, collect(plan_in(folder), folder))


def store_result(folder: Path) -> None:
    """Store the result of a finished job in the project that contains its folder, if one does.

    The process may be killed at any moment: the next one that inspects the job does the rest.
    """
    place = folder.resolve().parents[1]
    if (place / SETTINGS).is_file():
        collected(Project(place), folder)


def stored_in_run(project: Project, number: int, record: CalibrationRecord) -> Calibration | None:
    """Load a stored calibration with all others of its run.

    There is none if an earlier version stored it and the folder of its job is gone.
    """
    if record.request is None:
        folder = job_of(project, record)
        if not ((folder / files.RESULT).is_file() and (folder / STORED).is_file()):
            return None
        run = collect(plan_in(folder), folder)
        run = add_to_project(project, replace(run, command=record.provenance.command))
        return run.stored_as(number)
    with project.store() as store:
        summaries = store.calibration_summaries().items()
        own = [k for k, other in summaries if other.method.get(RUN) == record.method.get(RUN)]
        records = {k: store.calibration(k) for k in own if k != number}
        same = {k: other for k, other in records.items() if other.request == record.request}
        return _from_records(store, same | {number: record}).stored_as(number)


def stored_calibration(project: Project, number: int) -> Calibration:
    """Load a stored calibration.

    It equals the one that was stored, if its run has no other; else it is the only one of its run.
    If an earlier version stored it and its job is gone, the level of its intervals, its noise and
    its profiles are unknown.
    """
    with project.store() as store:
        record = store.calibration(number)
        fit = stored_in_run(project, number, record) if record.request is None else None
        return _from_records(store, {number: record})[0] if fit is None else fit


def _from_records(store: Store, records: Mapping[int, CalibrationRecord]) -> Calibrations:
    """Return the calibrations of one run with what their records have."""
    try:
        found: dict[int, tuple[int, CalibrationRecord]] = {}  # by place in the run, each once
        for number, record in records.items():
            found[int((record.result or {}).get("place", 0))] = number, record
        ids, ordered = zip(*(found[place] for place in sorted(found)), strict=True)
        members = dict.fromkeys(m.experiment_id for record in ordered for m in record.members)
        places = {experiment_id: k for k, experiment_id in enumerate(members)}
        maps = {
            record.members[k].experiment_id: LoadMap(**own)
            for record in ordered
            for on, own in (record.result or {}).get("load_maps", ())
            for k in on
        }
        targets = [_on_map(target_of(store.experiment(k)), maps.get(k)) for k in members]
        nominal = np.full(len(targets), math.nan)
        sets = []
        for record in ordered:
            own = tuple(places[m.experiment_id] for m in record.members)
            nominal[list(own)] = _nominal(record)
            sets.append(replace(_set_of(record), members=own))
        request, result = request_in(ordered[0]), ordered[0].result or {}
        n_free = len(request.space.labels)
        if any((len(s.errors), len(s.point)) != (len(s.members), n_free) for s in sets):
            raise ValueError("its result has other experiments or parameters than its request")
        return Calibrations(
            request=request,
            outcome=CalibrationResult(
                keys=tuple(target.key for target in targets),
                labels=request.space.labels,
                nominal=nominal,
                found=tuple(sets),
            ),
            targets=targets,
            source=str(result.get("source", "")),
            command=ordered[0].provenance.command,
            asked={EARLIER.get(k, k): own for k, own in result.get("asked", {}).items()},
            left_out=dict(result.get("left_out", {})),
            ids=ids,
        )
    except INVALID_CONTENT as problem:
        said = " ".join(str(problem).split())[:200]
        raise StoreRefused(
            f"calibration {min(records)} is damaged: {said}", hint="list all errors: fixel db check"
        ) from problem


def _nominal(record: CalibrationRecord) -> FloatArray:
    """Errors (n_member,) before the calibration; NaN where a record has only their mean."""
    if record.result is not None:
        known = np.array(record.result["nominal"], np.float64)
        return np.where(np.isnan(known), math.inf, known)
    mean = float(record.method.get("nominal_error", math.nan))
    return np.full(len(record.members), mean if len(record.members) == 1 else math.nan)


def _set_of(record: CalibrationRecord) -> ParameterSet:
    """Return the parameter set of a record; of an earlier version, without noise and profiles."""
    if record.result is not None:
        return set_of(record.result["set"], record.evaluations)
    method, evaluations = record.method, record.evaluations
    point = np.array([record.best_fit[label] for label in request_in(record).space.labels])
    trace = None
    if evaluations is not None:
        best = float(evaluations.error.min(initial=math.inf))
        tried, reasons = (evaluations.values, evaluations.error), list(evaluations.reasons)
        trace = Trace(point, best, *tried, reasons, str(method.get("ended", "")))
    return ParameterSet(
        how=FitKind(str(method.get("how", FitKind.DIRECT))),
        members=(),
        point=point,
        errors=np.array(record.errors),
        trace=trace,
        estimates=record.estimates,
        misfit=tuple(misfit_of(record)),
        misfit_ratio=float(method.get("misfit_ratio", math.nan)),
    )


def list_calibrations(project: Project) -> Table:
    """Return the stored calibrations of a project, the newest first."""
    rows = []
    with project.store() as store:
        summaries = store.calibration_summaries()
    for number, record in reversed(summaries.items()):
        error = root_mean(np.array(record.errors), record.error_unit)
        verdicts = Counter(own.word for own in record.estimates if own.word not in ("", "frozen"))
        said = ", ".join(f"{n} {word}" for word, n in verdicts.items())
        rows.append((number, record.name, len(record.errors), error, said or "-"))
    error_column = Column("error", "mm", ".3g")
    return Table(("id", "calibration", "experiments", error_column, "verdicts"), rows, left=2)


def stored_ids(folder: Path) -> list[int]:
    """Load the ids of the calibrations that a job has stored so far."""
    path = folder / STORED
    if not path.is_file():
        return []
    with readable(path):
        return [int(number) for number in json.loads(path.read_text())]


def _stored_once(
    store: Store, run: Calibrations, experiments: Sequence[int], folder: Path
) -> list[int]:
    """Store what a job found; return the ids, those of an earlier call if it is stored."""
    path = folder / STORED
    known = stored_ids(folder)
    if len(known) == len(run):
        return known
    # A page and a command may see the end of a job at the same moment.
    with FileLock(folder / f"{STORED}.lock", f"the result of {folder}"):
        known = stored_ids(folder)
        # One after the other, each noted at once: a crash between costs one doubled record at most.
        for record in list(_records(run, experiments))[len(known) :]:
            known.append(store.add_calibration(record))
            with written_whole(path) as temporary:
                temporary.write_text(json.dumps(known))
    return known


def _records(run: Calibrations, experiments: Sequence[int]) -> Iterator[CalibrationRecord]:
    """Yield the record of each calibration of a run."""
    request, outcome, unit = run.request, run.outcome, run.request.made_error.unit
    plain = request.model_dump_json()
    checksum = hashlib.sha256(plain.encode() + outcome_bytes(outcome)).hexdigest()[:16]
    for place, fit in enumerate(run):
        one, trace = fit.found, fit.found.trace
        # Values that all members share; the others are among the estimates.
        shared = {u.name: fit[u.label] for u in request.space.unknowns if not u.where}
        yield CalibrationRecord(
            name=f"{request.name}: {fit.subject}, {one.how}",
            parameters=Parameters(shared),
            members=tuple(
                Member.of(experiments[m], 1.0, error, unit)
                for m, error in zip(one.members, one.errors.tolist(), strict=True)
            ),
            provenance=Provenance(version=version("fixel"), command=run.command, seed=request.seed),
            method={**_method(fit), RUN: checksum},
            evaluations=None
            if trace is None
            else Evaluations(
                names=outcome.labels,
                values=trace.points,
                error=trace.errors,
                reasons=tuple(trace.reasons),
                unit=unit.replace("^", ""),
            ),
            estimates=tuple(
                own for k, own in fit.estimates.items() if one.estimates or k not in shared
            ),
            request={"version": VERSION, **json.loads(plain)},
            result={
                "place": place,
                "set": set_content(replace(one, members=tuple(range(len(one.members))))),
                "nominal": [finite(error) for error in fit.nominal_errors.tolist()],
                "source": run.source,
                "asked": dict(run.asked),
                "left_out": dict(run.left_out),
                **_load_maps(fit.targets),
            },
        )


def _load_maps(targets: Sequence[Target]) -> dict[str, Any]:
    """Return the maps of tables under experiments, each with the places of its experiments."""
    found: dict[LoadMap, list[int]] = {}
    for k, target in enumerate(targets):
        if (own := target.case.scene.plane.load_map) is not None:
            found.setdefault(own, []).append(k)
    names = ("origin", "cell", "log_load")
    rows = [
        (on, {name: getattr(own, name).tolist() for name in names}) for own, on in found.items()
    ]
    return {"load_maps": rows} if rows else {}


def _on_map(target: Target, load_map: LoadMap | None) -> Target:
    if load_map is None:
        return target
    scene = target.case.scene
    scene = replace(scene, plane=replace(scene.plane, load_map=load_map))
    return target._replace(case=target.case._replace(scene=scene))


def _method(fit: Calibration) -> dict[str, str | float]:
    """Return the method for lists; everything about it is in the request."""
    one, folder = fit.found, fit.run.folder
    return {
        "how": one.how,
        "error_unit": fit.request.made_error.unit,
        "seconds": one.seconds,
        "nominal_error": float(fit.nominal_errors.mean()),
        "ended": one.ended,
        **({} if folder is None else {"job": folder.name}),
        **({"misfit": "\n".join(one.misfit)} if one.misfit else {}),
        **({"misfit_ratio": one.misfit_ratio} if math.isfinite(one.misfit_ratio) else {}),
        **fit.request.listed(),
    }
