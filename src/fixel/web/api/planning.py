"""Plans of pushes, searched in a process of their own, and trials on the simulated testbed."""

from __future__ import annotations

import json
from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from fixel.errors import NotStored
from fixel.uncertainty.starts import Kind
from fixel.web.context import Context
from fixel.web.values import Answer, RequestBody, Text
from fixel.web.views.job_list import PageJob, job_slot, page_job
from fixel.web.views.plan_view import PlanScene, as_question, plan_scene, trials_of
from fixel.workflows import jobs
from fixel.workflows.analysis import load_with_errors
from fixel.workflows.capabilities import begin as begin_job
from fixel.workflows.planning.execute import run_on_testbed
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.run import PLAN

router = APIRouter(prefix="/plan", tags=["planning"])

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
Tolerance = Annotated[float, Field(gt=0.0, le=1e5, allow_inf_nan=False)]
Key = Annotated[Text, Field(min_length=1, max_length=200)]


class PlanForm(RequestBody):
    """A goal for the part of an experiment: a pose, or fixels to touch."""

    experiment: Key
    x_mm: Coordinate = 0.0
    y_mm: Coordinate = 0.0
    angle_deg: Coordinate = 0.0
    position_mm: Tolerance = 2.0
    tolerance_deg: Tolerance = 2.0
    symmetry: int = Field(1, ge=1, le=360)
    fixels: list[Key] = Field([], max_length=20, description="fixels to touch, instead of a pose")
    pushes: int = Field(1, ge=1, le=4, description="largest number of pushes")
    rig: bool = Field(False, description="placement and stroke on one axis, instead of pushes")
    start_mm: float = Field(0.5, ge=0.0, le=1e3, description="size of the error of x and y")
    start_deg: float = Field(0.5, ge=0.0, le=180.0, description="size of the error of the angle")
    start_kind: Kind = Field(description="half-widths (uniform) or standard deviations (normal)")
    rollouts: int = Field(
        PLAN.options["rollouts"].default, ge=1000, le=10_000_000, description="simulated pushes"
    )
    untrusted: bool = Field(False, description="allow pushes that resemble no experiment")


class PlanTrialAnswer(Answer):
    """Trials of a stored plan, as lines of text."""

    lines: list[str]


@router.get("/scene", summary="Get the part, the start and the fixels of an experiment")
def scene(context: Context, experiment: Key) -> PlanScene:
    return plan_scene(context.store.experiment(context.store.find(experiment)).scene)


@router.post("", summary="Search for a plan in a separate process")
def begin(context: Context, wanted: PlanForm) -> PageJob:
    scene(context, wanted.experiment)
    options = wanted.model_dump(include={"experiment", "rollouts", "untrusted"})
    request = PLAN.request({"goal": json.dumps(as_question(wanted)), **options})
    with job_slot(context.project.folder):
        folder = begin_job(PLAN, request, context.project)
    return PageJob.of(folder)


@router.get("/jobs/{name}", summary="Get the progress of a search")
def progress(context: Context, name: str) -> PageJob:
    return PageJob.of(page_job(context.project.folder, "plan", name))


@router.post("/jobs/{name}/stop", summary="Stop a search; finished simulations stay stored")
def stop(context: Context, name: str) -> PageJob:
    folder = page_job(context.project.folder, "plan", name)
    jobs.cancel(folder)
    return PageJob.of(folder)


@router.post("/{name}/trials", summary="Carry out a plan 20 times on the simulated testbed")
def trials(context: Context, name: str) -> PlanTrialAnswer:
    every, _ = load_with_errors(context.project, "plan")
    own = next((one.folder for one in every if one.folder.name == name), None)
    if own is None or not (own / FILE).is_file():
        raise NotStored(f"plan {name!r}", hint="/analyses lists all")
    run_on_testbed(own / FILE, trials=20)
    return PlanTrialAnswer(lines=trials_of(own))
