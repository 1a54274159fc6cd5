"""Calibrations: stored and running ones; begin, stop and resume a calibration."""

from __future__ import annotations

import dataclasses
import math
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field, StringConstraints

from fixel.model.space import Unknown
from fixel.web.api._values import Array, Id, Number, RequestBody, Text
from fixel.web.views import calibration_form, job_list
from fixel.web.views.calibration_progress import Watch
from fixel.workflows import jobs
from fixel.workflows.calibration import detail
from fixel.workflows.calibration.commands import command_of, python_of
from fixel.workflows.calibration.run import sampled

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext
    from fixel.web.views.calibration_progress import CalibrationProgress
    from fixel.workflows.calibration.detail import CalibrationDetail, CalibrationSummary, Residual

MAX_LISTED: Final = 500
MAX_KEPT: Final = 64  # calibrations in memory; what is stored never changes

Filter = Annotated[Text, Field(max_length=1000)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Mode = Literal["each", "joint", "campaign"]
Optimiser = Literal["pattern-search", "nelder-mead", "cma-es", "least-squares"]


class ListedOut(BaseModel):
    """Result of one run of a calibration."""

    id: int = Field(description="of the calibration to open")
    name: str
    how: str
    mode: str
    optimiser: str
    unit: str = Field(description="of the errors: mm^2 or mm")
    created_utc: str
    sets: int = Field(description="calibrations that came of it")
    experiments: int
    before: float | None = Field(description="mean error at the nominal values")
    after: float | None
    verdicts: dict[str, int] = Field(description="how many unknowns have each")


class RunningOut(BaseModel):
    """A calibration that is not stored yet, and how far it is."""

    name: str = Field(description="of its job")
    label: str = Field(description="as it was named")
    mode: str
    optimiser: str
    experiments: int
    unknowns: list[str]
    unit: str
    state: str = Field(description="queued, preparing, running, done, stopped, lost, failed, ...")
    ended: bool
    reason: str
    stage: str = Field(description="what was computed last")
    evaluations: int
    most: int | None = Field(description="evaluations after which the search ends at the latest")
    rate: float = Field(description="evaluations a second, lately")
    left_s: float | None = Field(description="at that rate; none where nobody knows")
    at_most: bool = Field(description="whether it may end earlier: searches end when they stand")
    share: float | None = Field(description="of the work that is done; none where nobody knows")
    best: float | None = Field(description="mean error of an experiment")
    start: float | None = Field(description="the same at the nominal values")
    started_utc: str
    stored: list[int] = Field(description="ids of the calibrations it became")
    command: str


class SingleOut(BaseModel):
    """An experiment with parameters of its own."""

    id: int
    before: float | None
    after: float | None


class LiveOut(RunningOut):
    """The same with the objective."""

    since: int
    objective: list[float | None] = Field(
        description="mean error at every evaluation from `since`; none where a simulation failed"
    )
    singles: list[SingleOut] = Field(description="experiments calibrated by themselves, so far")


class CalibrationsOut(BaseModel):
    """All of them."""

    calibrations: list[ListedOut]
    total: int
    running: list[RunningOut]
    unreadable: list[str] = Field(description="why jobs of others cannot be shown")


class EstimateOut(BaseModel):
    """An unknown, in SI units."""

    label: str
    unit: str
    value: float = Field(description="value to quote, inside its interval")
    best_fit: float = Field(
        description="value that predicts best; not the true one of a wrong model"
    )
    low: float | None = Field(description="end of the interval; none where the data set none")
    high: float | None
    bounds: tuple[float, float] | None = Field(description="of the search")
    before: float | None
    verdict: str
    reason: str


class ResidualOut(BaseModel):
    """An experiment, and how far the simulation is from it."""

    id: int
    key: str
    before: float | None
    after: float | None


class StartOut(BaseModel):
    """End of one of several searches."""

    error: float | None
    point: list[float] = Field(description="in the order of `parameters`")
    evaluations: int
    good: bool = Field(description="as good as the best, or nearly")


class CurveOut(BaseModel):
    """Profile likelihood of one unknown: rise above the least with the others fitted."""

    label: str
    unit: str
    values: list[float]
    rises: list[float | None]
    slice_values: list[float] = Field(description="the same with the others held")
    slice_rises: list[float | None]
    low: float | None
    high: float | None
    threshold: float = Field(description="rise at the ends of the interval")


class SiblingOut(BaseModel):
    """Another calibration of the same run."""

    id: int
    name: str


class CalibrationOut(BaseModel):
    """One stored calibration."""

    id: int
    name: str
    unit: str = Field(description="of errors: mm^2 or mm")
    level: float = Field(description="of the intervals")
    parameters: list[EstimateOut]
    residuals: list[ResidualOut] = Field(description="the worst first")
    worst: list[ResidualOut]
    objective: Array | None = Field(description="mean error at every evaluation; inf where failed")
    starts: list[StartOut] = Field(description="the best first; empty where there was one")
    curves: list[CurveOut]
    misfit: list[str] = Field(description="warning that the model is wrong by more than the noise")
    noise: str
    note: str
    ended: str
    method: dict[str, str | float]
    siblings: list[SiblingOut]
    complete: bool = Field(description="whether its job is there, with profiles and starts")
    command: str
    python: str


class OfferedOut(BaseModel):
    """A parameter one may search for, in SI units."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    start: float
    usual: bool


class OptimiserOut(BaseModel):
    """A search."""

    name: str
    meaning: str


class OfferOut(BaseModel):
    """Experiments, parameters and searches for a calibration."""

    experiments: int
    faulty: int = Field(description="that match too, and are left out for faults in their data")
    unknowns: list[OfferedOut]
    optimisers: list[OptimiserOut]


class UnknownIn(RequestBody):
    """A parameter to search for, in SI units."""

    name: Annotated[Text, Field(min_length=1, max_length=80)]
    low: Finite
    high: Finite
    start: Finite


class CalibrationIn(RequestBody):
    """A calibration to begin."""

    filter: Filter = Field(default="", description="as on the page Experiments")
    experiments: list[Id] = Field(
        default_factory=list, max_length=20_000, description="in place of the filter"
    )
    name: Name = "calibration"
    mode: Mode = "joint"
    unknowns: list[UnknownIn] = Field(min_length=1, max_length=64)
    optimiser: Optimiser = "pattern-search"
    starts: Annotated[int, Field(ge=1, le=100)] = 1
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    most_evaluations: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    verdicts: bool = True
    budget_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = Field(
        default=None, description="computing time of search and verdicts; mode joint only"
    )
    sample: Annotated[int, Field(ge=1, le=2**31 - 1)] | None = Field(
        default=None, description="size of a random sample, spread over the conditions"
    )


class BegunOut(BaseModel):
    """A job."""

    name: str
    state: str
    left_out: dict[str, str] = Field(default_factory=dict, description="experiments and reasons")
    stored: list[int] = Field(default_factory=list)


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/calibrations`."""
    found = APIRouter(prefix="/calibrations", tags=["calibrations"])
    watch = Watch(desk.project)

    @lru_cache(maxsize=MAX_KEPT)
    def at_hand(number: int) -> CalibrationDetail:
        return detail.tell(desk.project, desk.store, number)

    @found.get("", summary="All calibrations, those of one run together")
    def calibrations(
        limit: Annotated[int, Query(ge=1, le=MAX_LISTED)] = 100,
        offset: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0,
    ) -> CalibrationsOut:
        running, unreadable = watch.unfinished()  # first: calibrations that are done become stored
        every = detail.listed(desk.store)
        return CalibrationsOut(
            calibrations=[_listed(one) for one in every[offset : offset + limit]],
            total=len(every),
            running=[RunningOut(**_running(one, desk)) for one in running],
            unreadable=[str(problem) for problem in unreadable],
        )

    @found.get("/offer", summary="What can be calibrated")
    def offer(
        filter: Annotated[Text, Query(max_length=1000)] = "",
        experiments: Annotated[list[Id] | None, Query(max_length=2000)] = None,
    ) -> OfferOut:
        answer = calibration_form.offer(desk.store, filter, experiments or ())
        return OfferOut(
            experiments=len(answer.ids),
            faulty=answer.faulty,
            unknowns=[
                OfferedOut(
                    name=one.unknown.name,
                    unit=one.unit,
                    meaning=one.meaning,
                    low=one.unknown.low,
                    high=one.unknown.high,
                    start=one.unknown.nominal,
                    usual=one.usual,
                )
                for one in answer.unknowns
            ],
            optimisers=[
                OptimiserOut(name=n, meaning=m) for n, m in calibration_form.OPTIMISERS.items()
            ],
        )

    @found.post("", summary="Begin one, in a process of its own")
    def start(wanted: CalibrationIn) -> BegunOut:
        entries = [
            Unknown(name=one.name, low=one.low, high=one.high, nominal=one.start)
            for one in wanted.unknowns
        ]
        request = calibration_form.request_from(
            wanted.name, wanted.mode, entries, wanted.optimiser, wanted.most_evaluations,
            starts=wanted.starts, seed=wanted.seed, verdicts=wanted.verdicts,
            budget=wanted.budget_s,
        )  # fmt: skip
        request.check()
        chosen = calibration_form.chosen_from(desk.store, wanted.filter, wanted.experiments)
        if wanted.sample is not None:
            chosen = sampled(chosen, wanted.sample, wanted.seed)
        with job_list.room(desk.project.folder):
            folder = calibration_form.begin(desk.project, desk.store, chosen, request)
        seen = watch.look(folder)
        return BegunOut(
            name=folder.name,
            state=seen.status.state,
            left_out=dict(chosen.left_out),
            stored=seen.stored,
        )

    @found.get("/jobs/{name}", summary="How far one is, and its objective")
    def live(name: str, since: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0) -> LiveOut:
        seen = watch.look(watch.folder(name), since)
        return LiveOut(
            **_running(seen, desk),
            since=since,
            objective=[_finite(error) for error in seen.objective],
            singles=[
                SingleOut(
                    id=seen.experiments[place],
                    before=_finite(seen.nominal[place]) if place < len(seen.nominal) else None,
                    after=_finite(error),
                )
                for place, error in sorted(seen.alone.items())
            ],
        )

    @found.post("/jobs/{name}/stop", summary="Stop one; what is finished is kept")
    def stop(name: str) -> BegunOut:
        folder = watch.folder(name)
        return BegunOut(name=name, state=jobs.cancel(folder).state)

    @found.post("/jobs/{name}/resume", summary="Go on with one that was stopped or lost")
    def resume(name: str) -> BegunOut:
        folder = watch.folder(name)
        with job_list.room(desk.project.folder):
            return BegunOut(name=name, state=calibration_form.go_on(folder).state)

    @found.get("/{number}", summary="One of them")
    def calibration(number: Number) -> CalibrationOut:
        one = at_hand(number)
        if not one.complete:
            at_hand.cache_clear()  # its job may be restored
        return _whole(one, desk)

    return found


def _listed(one: CalibrationSummary) -> ListedOut:
    content = one._asdict()
    return ListedOut(created_utc=content.pop("created"), **content)


def _running(one: CalibrationProgress, desk: ProjectContext) -> dict[str, Any]:
    status, request = one.status.status, one.request
    left = status.left_s
    at_most = left is None and one.most is not None and one.rate > 0.0
    if at_most and one.most is not None:
        left = (one.most - one.evaluations) / one.rate
    keys = [str(number) for number in one.experiments]
    return {
        "name": one.name,
        "label": request.name,
        "mode": request.mode,
        "optimiser": request.optimiser.name,
        "experiments": len(one.experiments),
        "unknowns": list(request.space.labels),
        "unit": request.made_error.unit,
        "state": one.status.state,
        "ended": one.status.ended,
        "reason": status.reason,
        "stage": one.stage,
        "evaluations": one.evaluations,
        "most": one.most,
        "rate": one.rate,
        "left_s": None if one.status.ended or left is None else max(0.0, left),
        "at_most": at_most,
        "share": status.share,
        "best": one.best,
        "start": one.start,
        "started_utc": status.started_utc,
        "stored": one.stored,
        "command": command_of(desk.folder, request, keys),
    }


def _whole(one: CalibrationDetail, desk: ProjectContext) -> CalibrationOut:
    record = one.record
    return CalibrationOut(
        id=one.id,
        name=record.name,
        unit=one.unit,
        level=one.level,
        parameters=[EstimateOut(**dataclasses.asdict(row)) for row in one.rows],
        residuals=[_residual(residual) for residual in one.residuals],
        worst=[_residual(residual) for residual in one.worst],
        objective=Array.of(one.objective) if len(one.objective) else None,
        starts=[
            StartOut(**start._asdict() | {"error": _finite(start.error)}) for start in one.starts
        ],
        curves=[
            CurveOut(
                label=curve.label,
                unit=one.units.get(curve.label, ""),
                values=curve.values.tolist(),
                rises=[_finite(rise) for rise in curve.deviances.tolist()],
                slice_values=curve.slice_values.tolist(),
                slice_rises=[_finite(rise) for rise in curve.slice_deviances.tolist()],
                low=curve.low,
                high=curve.high,
                threshold=curve.threshold,
            )
            for curve in one.curves
        ],
        misfit=one.misfit,
        noise=one.noise,
        note=one.note,
        ended=str(record.method.get("ended", "")),
        method={k: v for k, v in record.method.items() if v == v and v not in (math.inf,)},
        siblings=[SiblingOut(id=number, name=name) for number, name in one.siblings],
        complete=one.complete,
        command=record.provenance.command,
        python=python_of(desk.folder, one.id),
    )


def _residual(residual: Residual) -> ResidualOut:
    return ResidualOut(**residual._asdict())


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
