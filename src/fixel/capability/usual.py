"""Options that several capabilities share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.simulation.motion import AbstractMotionModel

Seed = Annotated[int, Door(least=0)]
MotionName = Annotated["AbstractMotionModel | str | None", Door(plain=str | None, metavar="MODEL")]

# Options that select experiments; their meaning is in the docstring of each function.
Dataset = Annotated[str, Door(metavar="NAME")]
Where = Annotated[tuple[str, ...], Door(metavar="FILTER")]
Flagged = Annotated[bool, Door(flag="--all")]
Names = Annotated[Sequence[str], Door(plain=tuple[str, ...], metavar="NAME[,NAME]", commas=True)]
