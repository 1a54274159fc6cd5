"""Store the calibrations of a project, and load them as results or as values to simulate with."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, overload

import numpy as np

from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.objective import MeanSquare, root_mean
from fixel.calibration.result import (
    CalibratedValues,
    CalibrationResult,
    FitKind,
    ParameterSet,
    set_content,
    set_of,
)
from fixel.calibration.search import CalibrationSearch
from fixel.calibration.study import Trace
from fixel.calibration.target import Target, target_of
from fixel.calibration.usual_parameters import default_unknowns, searched_unknowns
from fixel.database.project import DATABASE, Project
from fixel.database.store import Store
from fixel.engine_names import EngineName
from fixel.errors import InvalidInput, NotStored, StoreRefused, reason_of
from fixel.io.atomic import INVALID_CONTENT, readable
from fixel.io.document import plain_numbers
from fixel.jobs.work import Answers, Round
from fixel.model import LoadMap, Parameters, Provenance, Scene
from fixel.model.records import CalibrationRecord, Evaluations, Member
from fixel.model.space import ParameterSpace, Unknown, split_label
from fixel.table import Column, Table
from fixel.trust import repeatable
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.plan import load_task, outcome_bytes, outcome_of, plan_in, rounds
from fixel.workflows.calibration.request import (
    NAMED,
    CalibrationRequest,
    NamedOptions,
    command_of,
    options_of,
)

RUN: Final = "run"  # in the method of a record: checksum that all calibrations of a run share
EARLIER: Final = {"faulty": "flagged"}  # names of options in records of earlier versions
SEARCHED: Final = "unknowns"  # in the method of earlier records: the parameters, as JSON
VERSION: Final = 1  # of stored requests; those without one are as of version 1


def load_values(
    store: Store, calibration_id: int | None = None, engine: str = ""
) -> CalibratedValues:
    """Load a stored calibration: by its id, or else the newest that the engine simulated.

    Without an id, those for several experiments come first, as in `newest_calibration`. Means
    computed by the growth of a domain are selected only by their id.
    """
    own = newest_calibration(store, engine=engine) if calibration_id is None else calibration_id
    if own is None:
        by, option = (f" by {engine}", f" --engine {engine}") if engine else ("", "")
        absent, hint = f"none stored{by}", f"calibrate first: fixel calibrate{option}"
        raise InvalidInput("calibration", found=absent, expected="at least one", hint=hint)
    found = CalibratedValues(own, store.calibration(own))
    if engine and not EngineName.of(engine).fits(found.motion.name):
        raise InvalidInput(
            f"calibration {own}", found=f"one by {found.motion.name}", expected=f"one by {engine}"
        )
    return found


def known_pushes(store: Store, one: CalibratedValues) -> KnownPushes:
    """Return the parts, surfaces, laboratories, sides and speeds that a calibration has used."""
    targets = []
    for number in sorted(one.members):
        with suppress(InvalidInput):  # without a scene it cannot have been used
            targets.append(target_of(store.experiment(number)))
    return KnownPushes.of(targets)


def newest_calibration(store: Store, experiment: int | None = None, engine: str = "") -> int | None:
    """Return the id of the calibration that `load_values` loads by default; None without any.

    An experiment must be a member, and an engine must have simulated, with any version and choices
    that are not named; empty for any engine or motion model.
    """
    every = (CalibratedValues(*own) for own in reversed(store.calibration_summaries().items()))
    known = [
        one
        for one in every
        if one.record.method.get("how") != FitKind.GROWTH
        and (experiment is None or experiment in one.members)
        and (not engine or EngineName.of(engine).fits(one.motion.name))
    ]
    return next((one.id for one in sorted(known, key=lambda one: not one.is_for_several)), None)


def searched_space(
    project: Project,
    one: CalibratedValues | None,
    scenes: Sequence[Scene],
    settings: Sequence[str] = (),
) -> ParameterSpace:
    """Return the bounds that a calibration searched, with its result as the start.

    Of calibrations that earlier versions stored without bounds, the usual bounds of their
    parameters are returned. Parameters of `--fit` come first; without a calibration, the usual
    ones are returned.
    """
    if settings or one is None:
        own = searched_unknowns(settings, scenes) or default_unknowns(scenes)
        return ParameterSpace(unknowns=tuple(own))
    record, found = one.record, one.record.best_fit
    if record.request is not None or SEARCHED in record.method:
        with readable(project.folder / DATABASE):
            space = request_in(record).space
    else:
        space = _usual_space(one, found, scenes)
    start = zip(space.labels, space.nominal.tolist(), strict=True)
    return space.started_at([found.get(label, value) for label, value in start])


def request_in(record: CalibrationRecord) -> CalibrationRequest:
    """Return the request of a record; of an earlier version, without the level."""
    if record.request is not None:
        content = dict(record.request)
        if content.pop("version", VERSION) > VERSION:
            raise InvalidInput("a newer version of fixel stored its request")
        return CalibrationRequest.model_validate(content)
    method = dict(record.method)
    searched = json.loads(str(method.get(SEARCHED, "[]")))
    kinds = dict.fromkeys(NAMED, "unknown") | {"error": MeanSquare.name}
    named = {
        kind: NamedOptions(
            name=str(method.get(kind, usual)),
            options={k.removeprefix(f"{kind}."): v for k, v in method.items()
                     if k.startswith(f"{kind}.")},
        )
        for kind, usual in kinds.items()
    }  # fmt: skip
    own = {k: v for k, v in method.items() if k in CalibrationRequest.model_fields}
    unknowns = searched or [Unknown.fixed(name, value) for name, value in record.parameters.items()]
    return CalibrationRequest.model_validate(
        {
            **own,
            **named,
            "name": record.name.partition(":")[0],
            "unknowns": unknowns,
            "seed": record.provenance.seed or 0,
            "level": None,
            "verdicts": bool(record.estimates),
        }
    )


def _usual_space(
    one: CalibratedValues, found: Mapping[str, float], scenes: Sequence[Scene]
) -> ParameterSpace:
    """Return the usual bounds, widened to the result; raise if a parameter has none."""
    held = {e.label for e in one.record.estimates if e.verdict == "frozen"}
    unknowns = []
    for label, value in found.items():
        name, where = split_label(label)
        if where:
            absent = f"no bounds of {label}, which only some experiments share"
            expected, hint = "conditions and bounds", "calibrate again, or name the parameters"
            raise InvalidInput(f"calibration {one.id}", found=absent, expected=expected, hint=hint)
        (unknown,) = searched_unknowns([name], scenes)
        low, high = min(unknown.low, value), max(unknown.high, value)
        unknowns.append(replace(unknown, low=low, high=high, nominal=value, frozen=label in held))
    return ParameterSpace(unknowns=tuple(unknowns))


# --- runs ---------------------------------------------------------------------------------------


@overload
def add_to_project(project: Project, found: Calibration) -> Calibration: ...
@overload
def add_to_project(project: Project, found: Calibrations) -> Calibrations: ...
def add_to_project(
    project: Project, found: Calibration | Calibrations
) -> Calibration | Calibrations:
    """Store the calibrations of a run in a project that has its experiments; return them with ids.

    Of a calibration, all of its run are stored; those that are known already are not stored again.
    """
    run = found.run if isinstance(found, Calibration) else found
    with project.store() as store:
        experiments = stored_ids(store, run.targets, known=bool(run.asked))
        asked = dict(run.asked or options_of(run.request, experiments))
        asked["project"] = str(project.folder.resolve())
        run = replace(run, asked=asked, command=run.command or command_of(asked))
        ids = store.add_calibrations([*_records(run, experiments)], _mark)
    stored = replace(run, ids=tuple(ids))
    return stored[found.number] if isinstance(found, Calibration) else stored


def stored_ids(store: Store, targets: Sequence[Target], *, known: bool = False) -> list[int]:
    """Return the ids of experiments; unless they are known, a store must have the same poses."""
    ids = [store.find(target.key) for target in targets]
    for own, number in [] if known else zip(targets, ids, strict=True):
        if not np.array_equal(target_of(store.experiment(number)).pose, own.pose):
            found = f"other measurements of {own.key}"
            raise InvalidInput("project", found=found, expected="a project with the same")
    return ids


def stored_rounds(
    project: Project | None, *, inputs: Path, **_: Any
) -> Generator[Round, Answers, bytes]:
    """Calibrate in rounds of chunks; store the result in the project, if there is one."""
    result = yield from rounds(CalibrationSearch(load_task(inputs)).steps())
    if project is not None:
        folder = inputs.parent
        run = Calibrations(**vars(plan_in(folder)), outcome=outcome_of(result), folder=folder)
        with suppress(NotStored):  # a job of another project, whose experiments this one lacks
            add_to_project(project, run)
    return result


def stored_in_run(project: Project, number: int, record: CalibrationRecord) -> Calibration | None:
    """Load a stored calibration with all others of its run.

    There is none if an earlier version stored it without its request.
    """
    if record.request is None:
        return None
    with project.store() as store:
        summaries = store.calibration_summaries().items()
        own = [k for k, other in summaries if other.method.get(RUN) == record.method.get(RUN)]
        records = {k: store.calibration(k) for k in own if k != number}
        same = {k: other for k, other in records.items() if other.request == record.request}
        run = _from_records(store, same | {number: record})
        return run[run.ids.index(number)] if number in run.ids else None


def stored_calibration(project: Project, number: int) -> Calibration:
    """Load a stored calibration.

    It equals the one that was stored, if its run has no other; else it is the only one of its run.
    If an earlier version stored it without its request, the level of its intervals, its noise and
    its profiles are unknown.
    """
    with project.store() as store:
        record = store.calibration(number)
        if record.method.get("mode") == "growth":
            reason = f"calibration {number} is a mean of others, by fixel domain growth: no search"
            hint = f"use its values: fixel compare EXPERIMENT --calibration {number}"
            raise StoreRefused(reason, hint=hint)
        return _from_records(store, {number: record})[0]


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
            raise InvalidInput("its result has other experiments or parameters than its request")
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
            command=repeatable(ordered[0].provenance.command),
            asked={EARLIER.get(k, k): own for k, own in result.get("asked", {}).items()},
            left_out=dict(result.get("left_out", {})),
            ids=ids,
        )
    except INVALID_CONTENT as problem:
        raise StoreRefused(
            f"calibration {min(records)} is damaged: {reason_of(problem)}",
            hint="list all errors: fixel db check",
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
        misfit=tuple(record.misfit),
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


def _mark(record: CalibrationRecord) -> tuple[object, ...]:
    """Return what a record of a run, however often it is computed, has alone in a project."""
    members = tuple(member.experiment_id for member in record.members)
    return record.method.get(RUN), record.method.get("how"), members


def _records(run: Calibrations, experiments: Sequence[int]) -> Iterator[CalibrationRecord]:
    """Yield the record of each calibration of a run."""
    request, outcome, unit = run.request, run.outcome, run.request.made_error.unit
    plain, found = request.model_dump_json(), [replace(one, seconds=0.0) for one in outcome.found]
    same = outcome_bytes(replace(outcome, found=tuple(found)))  # however long it took
    checksum = hashlib.sha256(plain.encode() + same).hexdigest()[:16]
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
                "nominal": plain_numbers(fit.nominal_errors),
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
    rows = [(on, {k: getattr(own, k).tolist() for k in names}) for own, on in found.items()]
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
