"""Options that several capabilities share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.simulation.motion import AbstractMotionModel

Seed = Annotated[int, Door(least=0)]
MotionName = Annotated["AbstractMotionModel | str | None", Door(plain=str | None, metavar="MODEL")]
