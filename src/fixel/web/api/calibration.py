"""Calibrations: stored and running ones."""

from __future__ import annotations

from typing import Annotated, Final

from fastapi import APIRouter, Query
from fastapi.responses import Response
from pydantic import Field

from fixel.web.context import Context
from fixel.web.values import Answer, Id, Whole
from fixel.web.views import calibration_views
from fixel.web.views.calibration_views import LiveProgress

MAX_LISTED: Final = 500

router = APIRouter(prefix="/calibrations", tags=["calibrations"])


class CalibrationList(Answer):
    """All of them."""

    calibrations: list[calibration_views.CalibrationSummary]
    total: int
    running: list[LiveProgress]
    unreadable: list[str] = Field(description="reasons why other jobs cannot be shown")


@router.get("", summary="List calibrations, grouped by run")
def calibrations(
    context: Context,
    limit: Annotated[Whole, Query(ge=1, le=MAX_LISTED)] = 100,
    offset: Annotated[Whole, Query(ge=0, le=2**31 - 1)] = 0,
) -> CalibrationList:
    # First: calibrations that are done become stored.
    running, unreadable = context.calibrations.unfinished()
    every = calibration_views.list_calibrations(context.store)
    return CalibrationList(
        calibrations=every[offset : offset + limit],
        total=len(every),
        running=running,
        unreadable=[str(problem) for problem in unreadable],
    )


@router.get("/jobs/{name}", summary="Get the progress and the objective of a calibration")
def live(context: Context, name: str) -> LiveProgress:
    return context.calibrations.look(context.calibrations.folder(name))


@router.get("/{number}", summary="Get a calibration")
def calibration(context: Context, number: Id) -> calibration_views.StoredCalibration:
    return context.calibration_detail(number)


@router.get(
    "/{number}/{kind}.png",
    summary="Get a plot of a calibration: search, starts or profiles",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}},
)
def plot(context: Context, number: Id, kind: str) -> Response:
    return Response(context.calibration_plot(number, kind), media_type="image/png")
