"""Fixels: fixed pegs, walls and slots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, fraction, instance, name_of, non_negative, settle, vector
from fixel.model.shape import Shape
from fixel.typing import FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fixel(Comparable):
    """Fixed body.

    Parameters
    ----------
    name : str
        Name, unique in its scene.
    shape : Shape
        Shape in its own frame.
    pose : (3,) array_like
        Pose of its frame in the world [m, m, rad].
    friction : float
        Coefficient of friction against every free body [-].
    restitution : float
        Coefficient of restitution, from 0 to 1 [-].
    """

    name: str
    shape: Shape
    pose: FloatArray
    friction: float
    restitution: float = 0.0

    def __post_init__(self) -> None:
        name_of(self.name, "fixel.name")
        try:
            instance(self.shape, Shape, "shape", "a Polygon or a Disk")
            settle(
                self,
                pose=vector(self.pose, "pose", "x [m], y [m], angle [rad]"),
                friction=non_negative(self.friction, "friction"),
                restitution=fraction(self.restitution, "restitution"),
            )
        except InvalidInput as problem:
            raise problem.within(f"fixel {self.name!r}") from None
