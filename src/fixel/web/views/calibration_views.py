"""Calibrations for pages: the list, all about a stored one, and the progress of a running one."""

from __future__ import annotations

import math
import threading
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator, Field

from fixel.calibration.optimiser import AbstractOptimiser
from fixel.calibration.result import FitKind
from fixel.calibration.search import NEARLY
from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.engine_names import is_engine
from fixel.errors import FixelError, NotStored
from fixel.io.atomic import each_readable
from fixel.jobs import folder as files
from fixel.model.records import CalibrationRecord, Estimate, estimate_table
from fixel.trust import repeatable
from fixel.web.values import Answer, Array, Finite
from fixel.workflows import jobs
from fixel.workflows.analysis import Analysis
from fixel.workflows.calibration.calibration import Calibration, collect
from fixel.workflows.calibration.execution import LiveSearch
from fixel.workflows.calibration.plan import plan_in
from fixel.workflows.calibration.request import command_of
from fixel.workflows.calibration.stored import add_to_project, stored_calibration, stored_in_run

WORST: Final = 3
PLOTS: Final = ("search", "starts", "profiles")
_drawing = threading.Lock()
PYTHON: Final = """import fixel

calibration = fixel.Project({folder!r}).calibrations[{number}]
for one in calibration.estimates:
    print(one.label, one.value, one.low, one.high, one.verdict)  # SI
print(calibration.parameters)  # best fit, for prediction
"""
EARLIER: Final = (
    "stored by an earlier version of fixel, without the results of its searches; calibrate again "
    "to see them"
)


Curve = Annotated[list[Finite], BeforeValidator(np.ndarray.tolist)]


class Residual(Answer):
    """An experiment, and how far the simulation is from it."""

    id: int
    key: str
    before: Finite
    after: Finite


class Start(Answer):
    """End of one of several searches."""

    error: Finite
    point: list[float] = Field(description="values in the order of `parameters`")
    evaluations: int
    good: bool = Field(description="whether the error is the smallest or nearly so")


class ProfileCurve(Answer):
    """Profile likelihood of one unknown: rise above the least with the others fitted."""

    label: str
    unit: str
    values: Curve
    rises: Curve = Field(validation_alias="deviances")
    slice_values: Curve = Field(description="values of the parameter with the others fixed")
    slice_rises: Curve = Field(validation_alias="slice_deviances")
    low: float | None
    high: float | None
    threshold: float = Field(description="increase of the objective at the ends of the interval")


class Sibling(Answer):
    """Another calibration of the same run."""

    id: int
    name: str


class StoredCalibration(Answer):
    """One stored calibration."""

    id: int
    name: str
    unit: str = Field(description="unit of the errors: mm^2 or mm")
    level: float | None = Field(
        default=None, description="confidence level of the intervals; null if it was not stored"
    )
    parameters: list[Estimate]
    residuals: list[Residual] = Field(description="errors of the experiments, the largest first")
    worst: list[Residual]
    objective: Array | None = Field(description="mean error of each evaluation; inf if it failed")
    starts: list[Start] = Field(
        default=[],
        description="results of the starts, the smallest error first; empty if there was one start",
    )
    curves: list[ProfileCurve] = Field(default=[])
    misfit: list[str] = Field(description="warning that the model is wrong by more than the noise")
    noise: str = ""
    note: str = ""
    ended: str
    method: dict[str, str | float]
    siblings: list[Sibling] = Field(default=[])
    complete: bool = Field(description="whether profiles and starts were stored with it")
    command: str
    python: str
    # For the page only: its report, and its method and origin by name.
    analysis: Analysis = Field(exclude=True)
    facts: dict[str, str] = Field(exclude=True)


def load_detail(project: Project, store: Store, calibration_id: int) -> StoredCalibration:
    """Load everything about a stored calibration."""
    record = store.calibration(calibration_id)
    try:
        fit = stored_in_run(project, calibration_id, record)
        known = _of_record(record) if fit is None else _of_fit(fit, store)
    except FixelError as problem:  # what is stored can be shown all the same
        fit, known = None, _of_record(record, str(problem))
    origin, method, tried = record.provenance, record.method, record.evaluations
    known["facts"] |= {
        "stored": f"{origin.created[:10]} {origin.created[11:16]} UTC",
        "fixel": origin.version,
        "job": str(method.get("job", "none")),
    }
    keys = {row.id: row.key for row in store.experiments(ALL_EXPERIMENTS).rows}
    ids = [member.experiment_id for member in record.members]
    before = [None] * len(ids) if fit is None else fit.nominal_errors.tolist()
    residuals = [
        Residual(id=id_, key=keys.get(id_, f"experiment {id_}"), before=start, after=error)
        for id_, start, error in zip(ids, before, record.errors, strict=True)
    ]
    residuals.sort(key=lambda one: -math.inf if one.after is None else -one.after)
    share = len(ids) if method.get("combine") == "sum" else 1
    return StoredCalibration(
        id=calibration_id,
        name=record.name,
        unit=record.error_unit,
        residuals=residuals,
        worst=residuals[:WORST],
        objective=None if tried is None or not len(tried.error) else tried.error / share,
        misfit=record.misfit,
        ended=str(method.get("ended", "")),
        method={k: v for k, v in method.items() if isinstance(v, str) or math.isfinite(v)},
        complete=fit is not None,
        command=repeatable(origin.command),
        python=PYTHON.format(folder=str(project.folder.resolve()), number=calibration_id),
        **known,
    )


def _of_fit(fit: Calibration, store: Store) -> dict[str, Any]:
    """Return the fields that a record alone does not have."""
    found, trace, names = fit.found, fit.found.trace, store.calibration_summaries()
    # An earlier version stored the evaluations of several searches as one list.
    lacks_starts = fit.request.starts > 1 and trace is not None and not len(trace.starts)
    hidden = ("call", "command")  # the page has buttons for them
    return {
        "level": fit.level,
        "parameters": [one for one in fit.estimates.values() if one.bounds is not None],
        "starts": _starts(fit),
        "curves": found.profiles,
        "noise": found.noise,
        "note": EARLIER if lacks_starts else found.note,
        "siblings": [Sibling(id=k, name=names[k].name) for k in fit.run.ids if k in names],
        "analysis": fit.analysis,
        "facts": {k: v for k, v in fit.details.items() if k not in hidden},
    }


def plot(project: Project, calibration_id: int, kind: str) -> bytes:
    """Draw a plot of a stored calibration as PNG; raise `NotStored` if it has no such plot."""
    if kind not in PLOTS:
        raise NotStored(f"plot {kind!r} of calibration {calibration_id}")
    fit, picture = stored_calibration(project, calibration_id), BytesIO()
    with _drawing:  # Matplotlib draws in one thread
        np.ravel(fit.plot(kind))[0].figure.savefig(picture, format="png", dpi=150)
    return picture.getvalue()


def _of_record(record: CalibrationRecord, note: str = "") -> dict[str, Any]:
    """Return the same fields of a calibration whose experiments or job cannot be read."""
    known = {own.label: own for own in record.estimates}
    estimates = [
        replace(known.get(label) or Estimate(label=label, unit="", value=value), best_fit=value)
        for label, value in record.best_fit.items()
    ]
    analysis = Analysis(
        kind="calibrate",
        title=record.name,
        question={},
        headline=(record.name,),
        warnings=(*record.misfit, note),
        tables=(estimate_table(estimates, None),),
        notes=tuple(f"{own.label}: {own.reason}" for own in estimates if own.reason),
    )
    return {"parameters": estimates, "facts": {}, "note": note, "analysis": analysis}


def _starts(fit: Calibration) -> list[Start]:
    """Return the ends of several searches, best first; empty for a single search."""
    trace, ends, n = fit.found.trace, fit.found.ends, len(fit.found.members)
    if trace is None or not ends:
        return []
    counts = np.bincount(trace.starts, minlength=len(ends)).tolist()
    ordered = sorted(zip(ends, counts, strict=True), key=lambda pair: pair[0].error)
    best = ordered[0][0].error
    return [
        Start(
            error=fit.request.error_of_one(end.error, n),
            point=end.point.tolist(),
            evaluations=count,
            good=math.isfinite(end.error) and end.error <= best * (1.0 + NEARLY),
        )
        for end, count in ordered
    ]


class CalibrationSummary(Answer):
    """Result of one run of a calibration."""

    id: int = Field(description="id of the calibration to open")
    name: str
    how: str
    mode: str
    optimiser: str
    engine: str = Field(description="engine other than fixel's own, else empty")
    unit: str = Field(description="unit of the errors: mm^2 or mm")
    created_utc: str
    sets: int = Field(description="number of calibrations stored from the same run")
    experiments: int
    before: Finite = Field(description="mean error at the nominal values")
    after: Finite
    verdicts: dict[str, int] = Field(description="number of parameters by verdict")


def engine_of(record: CalibrationRecord) -> str:
    """Return the engine of a calibration with its version; empty for fixel's own."""
    return record.motion if is_engine(record.motion) else ""


def list_calibrations(store: Store) -> list[CalibrationSummary]:
    """Stored calibrations, those of one job together, the newest first."""
    jobs: dict[str, list[tuple[int, CalibrationRecord]]] = {}
    for calibration_id, record in store.calibration_summaries().items():
        name = str(record.method.get("job", f" {calibration_id}"))
        jobs.setdefault(name, []).append((calibration_id, record))
    found = [_listed(sets) for sets in jobs.values()]
    return sorted(found, key=lambda one: -one.id)


def _listed(sets: list[tuple[int, CalibrationRecord]]) -> CalibrationSummary:
    together = [pair for pair in sets if len(pair[1].members) > 1]
    calibration_id, record = together[-1] if together else sets[0]
    shown = [record] if together else [one for _, one in sets]
    before = [float(one.method.get("nominal_error", math.nan)) for one in shown]
    counts = Counter(own.word for own in record.estimates if own.verdict)
    return CalibrationSummary(
        id=calibration_id,
        name=record.name.partition(":")[0] if "job" in record.method else record.name,
        **{k: str(record.method.get(k, "")) for k in ("how", "mode", "optimiser")},
        engine=engine_of(record),
        unit=record.error_unit,
        created_utc=record.provenance.created,
        sets=len(sets),
        experiments=len({m.experiment_id for _, one in sets for m in one.members}),
        before=float(np.mean(before)),
        after=float(np.mean([np.mean(one.errors) for one in shown])),
        verdicts=counts if together or len(sets) == 1 else {},
    )


KIND: Final = "calibrate"  # capability of its jobs
SEARCHES: Final = ("all together", "squares")  # stages of searches by errors and by residuals
# Fields of the status of a job that are shown as they are.
OF_JOB: Final = ("name", "state", "ended", "reason", "note", "share", "started_utc")


class LiveProgress(Answer):
    """A calibration that is not stored yet, and how far it is."""

    name: str = Field(description="name of the job")
    label: str = Field(description="name of the calibration")
    mode: str
    optimiser: str
    experiments: int
    unknowns: list[str]
    unit: str
    state: str = Field(
        description="status of the job: queued, preparing, running, done, "
        "stopped, lost, failed, ..."
    )
    ended: bool
    reason: str
    stage: str = Field(description="part of the calibration that was computed last")
    note: str = Field(description="part that is computed now")
    evaluations: int
    most: int | None = Field(description="maximum number of evaluations")
    rate: float = Field(description="recent evaluations per second")
    left_s: float | None = Field(description="estimated remaining time [s]; null if unknown")
    at_most: bool = Field(
        description="whether `left_s` is an upper bound, since a search may converge earlier"
    )
    share: float | None = Field(description="share of the work that is done; null if unknown")
    best: float | None = Field(description="smallest mean error per experiment so far")
    start: float | None = Field(description="mean error per experiment at the nominal values")
    started_utc: str
    stored: list[int] = Field(description="ids of the stored calibrations")
    command: str
    objective: list[Finite] = Field(
        description="mean error of each evaluation; null if a simulation failed"
    )
    singles: list[Residual] = Field(
        description="results of the experiments calibrated so far, in mode each"
    )


class ProgressReader:
    """Reader of the progress of a project's calibrations, which reads only what is new."""

    def __init__(self, project: Project, store: Store) -> None:
        self._project, self._store, self._lock = project, store, threading.Lock()
        self._opened = lru_cache(None)(self._open)

    def _open(self, folder: Path) -> tuple[LiveSearch, list[int]]:
        """Return the search of a job, and the ids of its experiments."""
        plan = plan_in(folder)
        ids = [self._store.find(target.key) for target in plan.targets]
        return LiveSearch(plan, plan.task()), ids

    def folder(self, name: str) -> Path:
        """Return the folder of a calibration's job; raise if there is none of the name."""
        found = jobs.job_folders(self._project.folder).get(name)
        if found is None or jobs.capability_of(found) != KIND:
            raise NotStored(f"calibration job {name!r}", hint="the page Calibrations lists all")
        return found

    def _stored(self) -> dict[str, list[int]]:
        """Return the ids of stored calibrations by the name of their job."""
        found: dict[str, list[int]] = {}
        for k, record in self._store.calibration_summaries().items():
            found.setdefault(str(record.method.get("job")), []).append(k)
        return found

    def unfinished(self) -> tuple[list[LiveProgress], list[FixelError]]:
        """Return calibrations that are not stored yet, newest first, and errors of unreadable ones.

        Calibrations that are done become stored.
        """
        known, every = self._stored(), jobs.job_folders(self._project.folder)
        own = [f for k, f in every.items() if k not in known and jobs.capability_of(f) == KIND]
        newest = sorted(own, key=lambda folder: files.read_job(folder).made_utc, reverse=True)
        found, unreadable = each_readable(self.look, newest)
        return [seen for seen in found if not seen.stored], unreadable

    def look(self, folder: Path) -> LiveProgress:
        """Return the progress of one."""
        status, (live, ids) = jobs.status_of(folder), self._opened(folder)
        stored = self._stored().get(folder.name, []) if status.state == "done" else []
        with self._lock:
            if status.kept > live.n_read:
                live.read(folder / files.JOURNAL)
            if status.state == "done" and not stored:  # it was computed elsewhere
                run = collect(plan_in(folder), folder)
                stored = list(add_to_project(self._project, run).ids)
        plan, request, search = live.plan, live.plan.request, live.search
        errors = np.append(search.task.combined(search.nominal[None]), search.trace().errors)
        start, *objective = request.error_of_one(errors, len(ids)).tolist()
        # The job counts chunks, which have about the same number of evaluations each.
        searching = live.stage in SEARCHES and not status.ended
        rate = status.rate * len(objective) / max(1, status.kept) if searching else 0.0
        limit, left = None, None if status.ended else status.left_s
        if isinstance(method := request.made_search, AbstractOptimiser) and request.mode != "each":
            limit = request.max_evaluations or method.limit
        at_most = left is None and limit is not None and rate > 0.0
        if at_most and limit is not None:
            left = max(0.0, (limit - len(objective)) / rate)
        return LiveProgress(
            **{name: getattr(status, name) for name in OF_JOB},
            label=request.name,
            mode=request.mode,
            optimiser=request.optimiser.name,
            experiments=len(ids),
            unknowns=list(request.space.labels),
            unit=request.made_error.unit,
            stage=live.stage,
            evaluations=len(objective),
            most=limit,
            rate=rate,
            left_s=left,
            at_most=at_most,
            best=min(filter(math.isfinite, objective), default=None),
            start=start if math.isfinite(start) else None,
            stored=stored,
            command=command_of({**plan.asked, "project": self._project.folder}),
            objective=objective,
            singles=[
                Residual(id=ids[k], key=plan.targets[k].key, before=search.nominal[k], after=error)
                for one in live.found
                if one.how == FitKind.ALONE
                for k, error in zip(one.members, one.errors, strict=True)
            ],
        )
