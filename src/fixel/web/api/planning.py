"""Scene of the page of plans, and trials of a plan on the simulated testbed."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from fixel.errors import NotStored
from fixel.web.context import Context
from fixel.web.values import Answer, Text
from fixel.web.views.plan_view import PlanScene, plan_scene, trials_of
from fixel.workflows.analysis import find_analysis
from fixel.workflows.planning.execute import run_on_testbed
from fixel.workflows.planning.report import FILE

router = APIRouter(prefix="/plan", tags=["planning"])

Key = Annotated[Text, Field(min_length=1, max_length=200)]


class PlanTrialAnswer(Answer):
    """Trials of a stored plan, as lines of text."""

    lines: list[str]


@router.get("/scene", summary="Get the part, the start and the fixels of an experiment")
def scene(context: Context, experiment: Key) -> PlanScene:
    return plan_scene(context.store.experiment(context.store.find(experiment)).scene)


@router.post("/{name}/trials", summary="Carry out a plan 20 times on the simulated testbed")
def trials(context: Context, name: str) -> PlanTrialAnswer:
    own = find_analysis(context.project, name, "plan")
    if own is None or not (own.folder / FILE).is_file():
        raise NotStored(f"plan {name!r}", hint="/analyses lists all")
    run_on_testbed(own.folder / FILE, trials=20)
    return PlanTrialAnswer(lines=trials_of(own.folder))
