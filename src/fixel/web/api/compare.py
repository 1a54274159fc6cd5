"""Simulations of one experiment with parameters that the user changes."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Annotated, Final, Literal

from fastapi import APIRouter
from pydantic import BaseModel, BeforeValidator, Field

from fixel.formats.trajectory_file import plain_numbers
from fixel.web.api._values import Id, Number, RequestBody
from fixel.web.api.motion import MotionOut
from fixel.web.views import live_comparison

if TYPE_CHECKING:
    from fixel.model import Experiment
    from fixel.web.project import ProjectContext

MAX_AT_ONCE: Final = 50  # about a second of work
MotionName = Literal["dynamic", "quasistatic", "first-order"]
# A part that is thrown to infinity has an infinite error, but JSON has no such number.
Finite = Annotated[float | None, BeforeValidator(plain_numbers)]
Value = Annotated[float, Field(allow_inf_nan=False)]


class SliderOut(BaseModel):
    """A parameter that may be changed."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    nominal: float = Field(description="of the experiment's scene")


class SetOut(BaseModel):
    """Values that can be selected for comparison."""

    id: str
    label: str
    kind: Literal["nominal", "calibration", "simulation"]
    parameters: dict[str, float] = Field(description="in place of the scene's own values; SI")
    motion: str = Field(description="motion model")
    error_mm2: float | None = Field(description="the thesis's E, where it is known already")


class DeskOut(BaseModel):
    """Parameters and stored sets for a comparison."""

    experiment: str
    sliders: list[SliderOut]
    sets: list[SetOut]


class CompareIn(RequestBody):
    """Parameters and motion model of a simulation."""

    parameters: dict[str, Value] = Field(default_factory=dict, max_length=64)
    motion: MotionName = "dynamic"


class ComparedOut(BaseModel):
    """A simulation of the experiment, and how far it is from what was measured."""

    motion: MotionOut
    position_rms_m: Finite = Field(description="none where the simulation stopped early")
    final_position_m: Finite
    final_angle_rad: Finite
    error_mm2: Finite = Field(description="the thesis's E, angles counted at 35 mm/rad")
    contact_mode: str = Field(description="at the end, a digit a fixel")
    measured_contact_mode: str
    command: str = Field(description="what to type for the same")
    python: str
    wall_time_s: float | None = Field(description="of the simulation alone; none of a stored one")


class SimulateIn(RequestBody):
    """Experiments to simulate."""

    ids: list[Id] = Field(min_length=1, max_length=MAX_AT_ONCE)


class NewSimulationsOut(BaseModel):
    """Result per experiment; those that have such a simulation, or no scene, are in neither."""

    stored: list[int] = Field(description="experiments")
    refused: dict[int, str] = Field(description="experiments and reasons")


class KeptOut(BaseModel):
    """A stored simulation."""

    id: Id


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/experiments/{number}/comparison`."""
    found = APIRouter(tags=["compare"])
    at_hand = live_comparison.CompareDesk(desk.store)
    threading.Thread(target=live_comparison.warm_up, name="fixel-warm-up", daemon=True).start()

    @found.get("/experiments/{number}/comparison", summary="What there is to compare it with")
    def offered(number: Number) -> DeskOut:
        return DeskOut(
            experiment=at_hand.experiment(number).key,
            sets=[SetOut(**one._asdict() | {"parameters": dict(one.parameters)})
                  for one in at_hand.sets(number)],
            sliders=[
                SliderOut(
                    name=one.name,
                    unit=one.unit,
                    meaning=live_comparison.meaning_of(one.name),
                    low=one.low,
                    high=one.high,
                    nominal=one.nominal,
                )
                for one in at_hand.sliders(number)
            ],
        )  # fmt: skip

    @found.post("/experiments/{number}/comparison", summary="Simulate it with other parameters")
    def compared(number: Number, wanted: CompareIn) -> ComparedOut:
        held = at_hand.compared(number, wanted.parameters, wanted.motion)
        return _answered(held, at_hand.experiment(number), desk)

    @found.get("/experiments/{number}/simulations/{simulation}", summary="A stored simulation")
    def stored(number: Number, simulation: Number) -> ComparedOut:
        held = at_hand.stored(number, simulation)
        return _answered(held, at_hand.experiment(number), desk)

    @found.post("/experiments/{number}/simulations", summary="Keep such a simulation")
    def keep(number: Number, wanted: CompareIn) -> KeptOut:
        command = live_comparison.command_of(
            at_hand.experiment(number), desk.folder, wanted.parameters, wanted.motion
        )
        command = f"{command} --save"
        return KeptOut(id=at_hand.keep(number, wanted.parameters, wanted.motion, command))

    @found.post(
        "/experiments/simulate", summary="Keep simulations with nominal values, where there is none"
    )
    def simulate(wanted: SimulateIn) -> NewSimulationsOut:
        return NewSimulationsOut(**at_hand.keep_nominal(wanted.ids, desk.folder)._asdict())

    return found


def _answered(
    held: live_comparison.ComparedSimulation, experiment: Experiment, desk: ProjectContext
) -> ComparedOut:
    same = experiment, desk.folder, held.parameters, held.method
    return ComparedOut(
        motion=MotionOut.of(held.motion),
        position_rms_m=held.position_rms,
        final_position_m=held.final_position,
        final_angle_rad=held.final_angle,
        error_mm2=held.error_mm2,
        contact_mode=held.contact_mode,
        measured_contact_mode=experiment.contact_mode,
        command=live_comparison.command_of(*same),
        python=live_comparison.python_of(*same),
        wall_time_s=held.wall_time,
    )
