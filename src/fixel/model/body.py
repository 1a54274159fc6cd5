"""Free bodies and springs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

from fixel.errors import InvalidInput
from fixel.model.fields import Comparable, instance, name_of, positive, settle, vector
from fixel.model.shape import Shape
from fixel.model.support import Ellipsoid, NoSupport, Support, support_points
from fixel.typing import FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spring(Comparable):
    """Spring of zero rest length that pulls the centre of mass to a point of the world.

    Parameters
    ----------
    stiffness : float
        Stiffness of the spring [N/m].
    anchor : (2,) array_like
        Point in the world [m].
    """

    stiffness: float
    anchor: FloatArray

    def __post_init__(self) -> None:
        settle(
            self,
            stiffness=positive(self.stiffness, "spring.stiffness", "N/m"),
            anchor=vector(self.anchor, "spring.anchor", "x [m], y [m]"),
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body(Comparable):
    """Free body on the plane.

    Parameters
    ----------
    name : str
        Name, unique in its scene.
    shape : Shape
        Shape in the frame of the body.
    mass : float
        Mass [kg].
    pose : (3,) array_like
        Pose of the frame of the shape in the world, at t = 0 [m, m, rad].
    support : Support
        Support on the plane.
    inertia : float, optional
        Moment of inertia about the centre of mass [kg m^2]. Default: that of uniform density about
        the centroid, even if the centre of mass lies elsewhere.
    centre_of_mass : (2,) array_like, optional
        Centre of mass in the frame of the shape [m]. Default: the centroid.
    velocity : (3,) array_like
        Twist of the centre of mass at t = 0, world axes [m/s, m/s, rad/s].
    force : (3,) array_like
        Constant wrench on the centre of mass, world axes [N, N, N m], as on a tilted table.
    spring : Spring, optional
        Spring between the centre of mass and a point of the world.
    """

    name: str
    shape: Shape
    mass: float
    pose: FloatArray
    support: Support = field(default_factory=NoSupport)
    inertia: float | None = None
    centre_of_mass: FloatArray | None = None
    velocity: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    force: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    spring: Spring | None = None

    def __post_init__(self) -> None:
        name_of(self.name, "body.name")
        try:
            self._check()
        except InvalidInput as problem:
            raise problem.within(f"body {self.name!r}") from None

    def _check(self) -> None:
        instance(self.shape, Shape, "shape", "a Polygon or a Disk")
        inertia, com = self.inertia, self.centre_of_mass
        settle(
            self,
            mass=positive(self.mass, "mass", "kg"),
            pose=vector(self.pose, "pose", "x [m], y [m], angle [rad]"),
            inertia=None if inertia is None else positive(inertia, "inertia", "kg m^2"),
            centre_of_mass=None if com is None else vector(com, "centre_of_mass", "x [m], y [m]"),
            velocity=vector(self.velocity, "velocity", "vx [m/s], vy [m/s], omega [rad/s]"),
            force=vector(self.force, "force", "fx [N], fy [N], tau [N m]"),
        )
        instance(self.support, Support, "support", "a support, or NoSupport()")
        instance(self.spring, Spring | None, "spring", "a Spring, or None")
        _refuse_tipping(self)

    @property
    def com(self) -> FloatArray:
        """Centre of mass (2,) in the frame of the shape [m]."""
        return self.shape.centroid if self.centre_of_mass is None else self.centre_of_mass

    @property
    def moment_of_inertia(self) -> float:
        """Moment of inertia about the centre of mass [kg m^2]."""
        return self.mass * self.shape.unit_inertia if self.inertia is None else self.inertia


def _refuse_tipping(body: Body) -> None:
    """Compute the loads, so that an impossible support raises here and not later."""
    if not isinstance(body.support, Ellipsoid):
        support_points(body.support, body.shape, body.com, body.mass, 1.0)
