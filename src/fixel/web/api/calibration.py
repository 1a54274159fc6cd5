"""Calibrations: stored and running ones; begin, stop and resume a calibration."""

from __future__ import annotations

import math
from typing import Annotated, Final

from fastapi import APIRouter, Query
from pydantic import Field

from fixel.model.records import Estimate
from fixel.web.context import Context
from fixel.web.values import Answer, Array, FilterText, Finite, Id, Number
from fixel.web.views import calibration_form, job_list
from fixel.web.views.calibration_form import CalibrationForm, CalibrationOffer
from fixel.web.views.calibration_progress import CalibrationProgress, LiveProgress
from fixel.workflows import jobs
from fixel.workflows.calibration import detail
from fixel.workflows.calibration.commands import python_of
from fixel.workflows.calibration.detail import (
    CalibrationDetail,
    CalibrationSummary,
    Residual,
    Start,
)

MAX_LISTED: Final = 500

router = APIRouter(prefix="/calibrations", tags=["calibrations"])


class CalibrationList(Answer):
    """All of them."""

    calibrations: list[CalibrationSummary]
    total: int
    running: list[CalibrationProgress]
    unreadable: list[str] = Field(description="why jobs of others cannot be shown")


class ProfileCurve(Answer):
    """Profile likelihood of one unknown: rise above the least with the others fitted."""

    label: str
    unit: str
    values: list[float]
    rises: list[Finite]
    slice_values: list[float] = Field(description="the same with the others held")
    slice_rises: list[Finite]
    low: float | None
    high: float | None
    threshold: float = Field(description="rise at the ends of the interval")


class Sibling(Answer):
    """Another calibration of the same run."""

    id: int
    name: str


class StoredCalibration(Answer):
    """One stored calibration."""

    id: int
    name: str
    unit: str = Field(description="of errors: mm^2 or mm")
    level: float = Field(description="of the intervals")
    parameters: list[Estimate]
    residuals: list[Residual] = Field(description="the worst first")
    worst: list[Residual]
    objective: Array | None = Field(description="mean error at every evaluation; inf where failed")
    starts: list[Start] = Field(description="the best first; empty where there was one")
    curves: list[ProfileCurve]
    misfit: list[str] = Field(description="warning that the model is wrong by more than the noise")
    noise: str
    note: str
    ended: str
    method: dict[str, str | float]
    siblings: list[Sibling]
    complete: bool = Field(description="whether its job is there, with profiles and starts")
    command: str
    python: str


class CalibrationJob(Answer):
    """A job."""

    name: str
    state: str
    left_out: dict[str, str] = Field(default_factory=dict, description="experiments and reasons")
    stored: list[int] = Field(default_factory=list)


@router.get("", summary="All calibrations, those of one run together")
def calibrations(
    context: Context,
    limit: Annotated[int, Query(ge=1, le=MAX_LISTED)] = 100,
    offset: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0,
) -> CalibrationList:
    # First: calibrations that are done become stored.
    running, unreadable = context.calibrations.unfinished()
    every = detail.list_calibrations(context.store)
    return CalibrationList(
        calibrations=every[offset : offset + limit],
        total=len(every),
        running=[*running],
        unreadable=[str(problem) for problem in unreadable],
    )


@router.get("/offer", summary="What can be calibrated")
def offer(
    context: Context,
    filter: Annotated[FilterText, Query()] = "",
    experiments: Annotated[list[Id] | None, Query(max_length=2000)] = None,
) -> CalibrationOffer:
    return calibration_form.offer(context.store, filter, experiments or ())


@router.post("", summary="Begin one, in a process of its own")
def start(context: Context, form: CalibrationForm) -> CalibrationJob:
    request = form.request()
    request.check()
    chosen = form.selection(context.store)
    with job_list.job_slot(context.project.folder):
        folder = calibration_form.begin(context.project, chosen, request)
    progress = context.calibrations.look(folder)
    return CalibrationJob(
        name=folder.name,
        state=progress.state,
        left_out=dict(chosen.left_out),
        stored=progress.stored,
    )


@router.get("/jobs/{name}", summary="How far one is, and its objective")
def live(
    context: Context, name: str, since: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0
) -> LiveProgress:
    return context.calibrations.look(context.calibrations.folder(name), since)


@router.post("/jobs/{name}/stop", summary="Stop one; what is finished is kept")
def stop(context: Context, name: str) -> CalibrationJob:
    folder = context.calibrations.folder(name)
    return CalibrationJob(name=name, state=jobs.cancel(folder).state)


@router.post("/jobs/{name}/resume", summary="Go on with one that was stopped or lost")
def resume(context: Context, name: str) -> CalibrationJob:
    folder = context.calibrations.folder(name)
    with job_list.job_slot(context.project.folder):
        return CalibrationJob(name=name, state=calibration_form.go_on(folder).state)


@router.get("/{number}", summary="One of them")
def calibration(context: Context, number: Number) -> StoredCalibration:
    one = context.calibration(number)
    if not one.complete:
        context.calibration.cache_clear()  # its job may be restored
    return StoredCalibration(
        id=one.id,
        name=one.record.name,
        unit=one.unit,
        level=one.level,
        parameters=one.rows,
        residuals=one.residuals,
        worst=one.worst,
        objective=one.objective if len(one.objective) else None,
        starts=one.starts,
        curves=_curves(one),
        misfit=one.misfit,
        noise=one.noise,
        note=one.note,
        ended=str(one.record.method.get("ended", "")),
        method={k: v for k, v in one.record.method.items() if v == v and v not in (math.inf,)},
        siblings=[Sibling(id=id_, name=name) for id_, name in one.siblings],
        complete=one.complete,
        command=one.record.provenance.command,
        python=python_of(context.folder, one.id),
    )


def _curves(one: CalibrationDetail) -> list[ProfileCurve]:
    return [
        ProfileCurve(
            label=curve.label,
            unit=curve.unit,
            values=curve.values.tolist(),
            rises=curve.deviances.tolist(),
            slice_values=curve.slice_values.tolist(),
            slice_rises=curve.slice_deviances.tolist(),
            low=curve.low,
            high=curve.high,
            threshold=curve.threshold,
        )
        for curve in one.curves
    ]
