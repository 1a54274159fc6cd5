"""Motions of one experiment, and simulations of it with parameters that the user changes."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from fastapi import APIRouter, Query
from pydantic import Field

from fixel.web.context import Context
from fixel.web.values import Answer, Id, Number, RequestBody
from fixel.web.views.live_comparison import (
    ComparedSimulation,
    NewSimulations,
    ParameterSlider,
    StoredSet,
)
from fixel.web.views.motion_views import Animation, animation_of_experiment

MAX_AT_ONCE: Final = 50  # about a second of work
MAX_SIMULATIONS: Final = 8
Value = Annotated[Number, Field(allow_inf_nan=False)]

router = APIRouter()


class ComparisonOffer(Answer):
    """Parameters and stored sets for a comparison."""

    experiment: str
    sliders: list[ParameterSlider]
    sets: list[StoredSet]


class ComparisonRequest(RequestBody):
    """Parameters and motion model of a simulation."""

    parameters: dict[str, Value] = Field(default_factory=dict, max_length=64)
    motion: str = Field(
        "dynamic",
        max_length=200,
        description="dynamic, quasistatic, first-order, or an engine such as mujoco:step=0.001",
    )


class NominalRequest(RequestBody):
    """Experiments to simulate."""

    ids: list[Id] = Field(min_length=1, max_length=MAX_AT_ONCE)


@router.get(
    "/experiments/{number}/motion",
    summary="Get the measured motion and stored simulations of an experiment",
    tags=["motion"],
)
def motion(
    context: Context,
    number: Id,
    simulation: Annotated[
        list[Id],
        Query(
            max_length=MAX_SIMULATIONS,
            description="ids of stored simulations of the experiment; may be repeated",
        ),
    ] = [],  # noqa: B006
) -> Animation:
    stored = [context.comparison.simulated(number, one) for one in simulation]
    return animation_of_experiment(context.comparison.experiment(number), stored)


@router.get(
    "/experiments/{number}/comparison",
    summary="List parameter sets to compare an experiment with",
    tags=["compare"],
)
def comparison_offer(context: Context, number: Id) -> ComparisonOffer:
    known = context.comparison
    return ComparisonOffer(
        experiment=known.experiment(number).key,
        sets=known.sets(number),
        sliders=known.sliders(number),
    )


@router.post(
    "/experiments/{number}/comparison",
    summary="Simulate an experiment with other parameters",
    tags=["compare"],
)
def compare(context: Context, number: Id, wanted: ComparisonRequest) -> ComparedSimulation:
    return context.comparison.compared(number, wanted.parameters, wanted.motion, context.folder)


@router.get(
    "/experiments/{number}/simulations/{simulation}",
    summary="Get a stored simulation",
    tags=["compare"],
)
def stored_simulation(context: Context, number: Id, simulation: Id) -> ComparedSimulation:
    return context.comparison.stored(number, simulation, context.folder)


@router.post("/experiments/{number}/simulations", summary="Store a simulation", tags=["compare"])
def keep_simulation(
    context: Context, number: Id, wanted: ComparisonRequest
) -> dict[Literal["id"], int]:
    kept = context.comparison.keep(number, wanted.parameters, wanted.motion, context.folder)
    return {"id": kept}


@router.post(
    "/experiments/simulate",
    summary="Simulate experiments with nominal values and store the results, if not stored yet",
    tags=["compare"],
)
def simulate_nominal(context: Context, wanted: NominalRequest) -> NewSimulations:
    return context.comparison.keep_nominal(wanted.ids, context.folder)
