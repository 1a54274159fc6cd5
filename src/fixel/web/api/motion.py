"""Motions of one experiment, with all data to draw them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from fixel.model import Disk
from fixel.model.shape import Shape
from fixel.web.api._values import Array, Id, Number
from fixel.web.views.live_comparison import CompareDesk
from fixel.web.views.motion_views import MotionView, Story, story_of_experiment

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

MAX_SIMULATIONS = 8


class ShapeOut(BaseModel):
    """An outline in its own frame: a polygon or a disk."""

    polygon_m: list[list[float]] | None = Field(description="corners x, y")
    disk_m: float | None = Field(description="radius")

    @classmethod
    def of(cls, shape: Shape) -> ShapeOut:
        """Return the outline of a shape."""
        if isinstance(shape, Disk):
            return cls(polygon_m=None, disk_m=shape.radius)
        return cls(polygon_m=shape.vertices.tolist(), disk_m=None)


class ThingOut(BaseModel):
    """Something on the plate."""

    name: str
    role: Literal["object", "body", "pusher", "fixel"] = Field(
        description="the object is the body whose motion is compared"
    )
    shape: ShapeOut
    pose: list[float] = Field(description="at the start: x [m], y [m], angle [rad]")


class ContactsOut(BaseModel):
    """All contacts of all samples."""

    sample: Array = Field(description="(n,) which sample of the motion; not decreasing")
    pair: Array = Field(description="(n, 2) indices into the things")
    point_m: Array = Field(description="(n, 2) in the world")
    force_n: Array = Field(description="(n, 2) on the first of the pair, world axes")


class TouchOut(BaseModel):
    """Which fixels are touched."""

    names: list[str]
    time_s: Array
    values: Array = Field(description="(n, n_fixel) 1 where touched, NaN without a reading")


class ErrorsOut(BaseModel):
    """Errors of a simulation against the measurement."""

    time_s: Array
    position_m: Array
    angle_rad: Array = Field(description="from measured to simulated")


class MotionOut(BaseModel):
    """One way everything moved."""

    id: str
    label: str
    kind: Literal["measured", "simulated"]
    time_s: Array
    pose: dict[str, Array] = Field(
        description="by name of what moves: (n, 3) x [m], y [m], angle [rad], angles continuous"
    )
    contacts: ContactsOut | None
    touch: TouchOut | None
    errors: ErrorsOut | None
    status: str = Field(description="of the simulation: converged, or what went wrong")
    advice: str = Field(description="what to do about it")

    @classmethod
    def of(cls, motion: MotionView) -> MotionOut:
        """Return a motion as a document."""
        contacts, touch, errors = motion.contacts, motion.touch, motion.errors
        return cls(
            id=motion.id,
            label=motion.label,
            kind=motion.kind,
            time_s=Array.of(motion.time),
            pose={name: Array.of(pose) for name, pose in motion.pose.items()},
            contacts=contacts
            and ContactsOut(
                sample=Array.of(contacts.sample, "<i4"),
                pair=Array.of(contacts.pair, "<i4"),
                point_m=Array.of(contacts.point),
                force_n=Array.of(contacts.force),
            ),
            touch=touch
            and TouchOut(
                names=[column.removesuffix("_bool").replace("_", " ") for column in touch.columns],
                time_s=Array.of(touch.time),
                values=Array.of(touch.values),
            ),
            errors=errors
            and ErrorsOut(
                time_s=Array.of(errors.time),
                position_m=Array.of(errors.position),
                angle_rad=Array.of(errors.angle),
            ),
            status=motion.status,
            advice=motion.advice,
        )


class StoryOut(BaseModel):
    """Motions of the same things, to be drawn together."""

    title: str
    object: str = Field(description="name of the thing whose motion is compared")
    reference_m: list[float] = Field(description="its centre of mass, in its frame")
    things: list[ThingOut]
    box_m: list[float] = Field(description="x, y of the lower left and upper right of all of it")
    motions: list[MotionOut]

    @classmethod
    def of(cls, story: Story) -> StoryOut:
        """Return a story as a document."""
        return cls(
            title=story.title,
            object=story.object_name,
            reference_m=story.reference.tolist(),
            things=[
                ThingOut(
                    name=thing.name,
                    role=thing.role,
                    shape=ShapeOut.of(thing.shape),
                    pose=thing.pose.tolist(),
                )
                for thing in story.things
            ],
            box_m=story.box.tolist(),
            motions=[MotionOut.of(motion) for motion in story.motions],
        )


Simulations = Annotated[
    list[Id],
    Query(
        alias="simulation",
        max_length=MAX_SIMULATIONS,
        description="ids of stored simulations of it; may be repeated",
    ),
]


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/experiments/{number}/motion`."""
    found = APIRouter(tags=["motion"])
    at_hand = CompareDesk(desk.store)

    @found.get(
        "/experiments/{number}/motion", summary="What moved, and what simulations made of it"
    )
    def motion(number: Number, simulation: Simulations = []) -> StoryOut:  # noqa: B006
        stored = [at_hand.simulated(number, one) for one in simulation]
        return StoryOut.of(story_of_experiment(at_hand.experiment(number), stored))

    return found
