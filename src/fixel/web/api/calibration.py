"""Calibrations: stored and running ones; begin, stop and resume a calibration."""

from __future__ import annotations

from typing import Annotated, Final

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import Field

from fixel.web.context import Context
from fixel.web.values import Answer, FilterText, Id, Number
from fixel.web.views import calibration_form, job_list
from fixel.web.views.calibration_detail import (
    CalibrationSummary,
    StoredCalibration,
    list_calibrations,
)
from fixel.web.views.calibration_form import CalibrationForm, CalibrationOffer
from fixel.web.views.calibration_progress import CalibrationProgress, LiveProgress
from fixel.workflows import jobs

MAX_LISTED: Final = 500

router = APIRouter(prefix="/calibrations", tags=["calibrations"])


class CalibrationList(Answer):
    """All of them."""

    calibrations: list[CalibrationSummary]
    total: int
    running: list[CalibrationProgress]
    unreadable: list[str] = Field(description="reasons why other jobs cannot be shown")


class CalibrationJob(Answer):
    """A job."""

    name: str
    state: str
    left_out: dict[str, str] = Field(
        default_factory=dict, description="reason by skipped experiment"
    )
    stored: list[int] = Field(default_factory=list)


@router.get("", summary="List calibrations, grouped by run")
def calibrations(
    context: Context,
    limit: Annotated[int, Query(ge=1, le=MAX_LISTED)] = 100,
    offset: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0,
) -> CalibrationList:
    # First: calibrations that are done become stored.
    running, unreadable = context.calibrations.unfinished()
    every = list_calibrations(context.store)
    return CalibrationList(
        calibrations=every[offset : offset + limit],
        total=len(every),
        running=[*running],
        unreadable=[str(problem) for problem in unreadable],
    )


@router.get("/offer", summary="List parameters, methods and experiments for a calibration")
def offer(
    context: Context,
    filter: Annotated[FilterText, Query()] = "",
    experiments: Annotated[list[Id] | None, Query(max_length=2000)] = None,
) -> CalibrationOffer:
    return calibration_form.offer(context.store, filter, experiments or ())


@router.post("", summary="Start a calibration in a separate process")
def start(context: Context, form: CalibrationForm) -> CalibrationJob:
    chosen = form.selection(context.store)
    plan = form.plan(chosen)
    with job_list.job_slot(context.project.folder):
        folder = calibration_form.begin(context.project, plan)
    progress = context.calibrations.look(folder)
    return CalibrationJob(
        name=folder.name,
        state=progress.state,
        left_out=dict(chosen.left_out),
        stored=progress.stored,
    )


@router.get("/jobs/{name}", summary="Get the progress and the objective of a calibration")
def live(
    context: Context, name: str, since: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0
) -> LiveProgress:
    return context.calibrations.look(context.calibrations.folder(name), since)


@router.post("/jobs/{name}/stop", summary="Stop a calibration; finished evaluations stay stored")
def stop(context: Context, name: str) -> CalibrationJob:
    folder = context.calibrations.folder(name)
    return CalibrationJob(name=name, state=jobs.cancel(folder).state)


@router.post("/jobs/{name}/resume", summary="Resume a calibration that was stopped or lost")
def resume(context: Context, name: str) -> CalibrationJob:
    folder = context.calibrations.folder(name)
    with job_list.job_slot(context.project.folder):
        return CalibrationJob(name=name, state=calibration_form.go_on(folder).state)


@router.get("/{number}", summary="Get a calibration")
def calibration(context: Context, number: Number) -> StoredCalibration:
    return context.calibration_detail(number).answer


@router.get(
    "/{number}/{kind}.png",
    summary="Get a plot of a calibration: search, starts or profiles",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}},
)
def plot(context: Context, number: Number, kind: str) -> Response:
    return Response(context.calibration_plot(number, kind), media_type="image/png")
