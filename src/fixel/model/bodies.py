"""Bodies of a scene: free bodies and springs, pushers and their prescribed motions, fixels."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field
from math import hypot, inf, pi
from typing import TYPE_CHECKING, Annotated, Final, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.model.fields import (
    Comparable,
    Value,
    check_fields,
    finite,
    fraction,
    frozen,
    instance,
    name_of,
    non_negative,
    positive,
    settle,
    table,
    vector,
)
from fixel.model.shape import Shape
from fixel.model.support import Ellipsoid, NoSupport, Support, support_points
from fixel.typing import ArrayField, FloatArray, OptionalArrayField

# Largest deviation of the length of a direction from 1 at which it is not scaled: a few roundings
# of a float64, so that scaling a direction twice changes no bit.
UNIT_LENGTH = 1e-15
POSE: Final = "x [m], y [m], angle [rad]"


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Spring(Comparable):
    """Spring of zero rest length that pulls the centre of mass to a point of the world.

    Parameters
    ----------
    stiffness : float
        Stiffness of the spring [N/m].
    anchor : (2,) array_like
        Point in the world [m].
    """

    stiffness: Annotated[float, Value(positive, "N/m")]
    anchor: Annotated[FloatArray, Value(vector, "x [m], y [m]")]

    def __post_init__(self) -> None:
        check_fields(self, "spring")


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
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
        Pose of the frame of the shape in the world, at t = 0 [m, m, rad]; the origin by default.
    support : Support
        Support on the plane; none by default.
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

    Examples
    --------
    >>> from fixel.model import Polygon, Tripod
    >>> part = Body("part", Polygon.rectangle(0.1, 0.1), mass=0.15,
    ...             support=Tripod(radius=0.038, friction=0.25))
    >>> round(part.moment_of_inertia, 6)
    0.00025
    """

    name: str
    shape: Shape
    _: KW_ONLY
    mass: Annotated[float, Value(positive, "kg")]
    pose: Annotated[ArrayField, Value(vector, POSE)] = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    support: Support = field(default_factory=NoSupport)
    inertia: Annotated[float | None, Value(positive, "kg m^2")] = None
    centre_of_mass: Annotated[OptionalArrayField, Value(vector, "x [m], y [m]")] = None  # type: ignore[assignment]
    velocity: Annotated[ArrayField, Value(vector, "vx [m/s], vy [m/s], omega [rad/s]")] = (
        0.0,
        0.0,
        0.0,
    )  # type: ignore[assignment]
    force: Annotated[ArrayField, Value(vector, "fx [N], fy [N], tau [N m]")] = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    spring: Spring | None = None

    def __post_init__(self) -> None:
        with _named(self, "body"):
            check_fields(self)
            instance(self.support, Support, "support", "a support, or NoSupport()")
            instance(self.spring, Spring | None, "spring", "a Spring, or None")
            if not isinstance(self.support, Ellipsoid):  # an impossible one raises here, not later
                support_points(self.support, self.shape, self.com, self.mass, 1.0)

    @property
    def com(self) -> FloatArray:
        """Centre of mass (2,) in the frame of the shape [m]."""
        return self.shape.centroid if self.centre_of_mass is None else self.centre_of_mass

    @property
    def moment_of_inertia(self) -> float:
        """Moment of inertia about the centre of mass [kg m^2]."""
        return self.mass * self.shape.unit_inertia if self.inertia is None else self.inertia


@contextmanager
def _named(thing: Body | Pusher | Fixel, kind: str) -> Iterator[None]:
    """Check name and shape of a body; its name is part of the errors of the block."""
    name_of(thing.name, f"{kind}.name")
    try:
        instance(thing.shape, Shape, "shape", "a Polygon or a Disk")
        yield
    except InvalidInput as problem:
        raise problem.within(f"{kind} {thing.name!r}") from None


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LineDrive(Comparable):
    """Straight motion without rotation, at constant speed.

    Parameters
    ----------
    direction : (2,) array_like
        Direction in world axes; scaled to length 1. Default: along x.
    speed : float
        Speed [m/s], not negative.
    travel : float
        Distance after which the drive stops [m]; by default infinite.
    force_limit : float, optional
        Force along the direction at which the drive stalls [N]. Default: a rigid drive.

    Examples
    --------
    >>> from fixel.units import mm
    >>> LineDrive((0, -2), speed=20 * mm).direction
    array([ 0., -1.])
    """

    direction: Annotated[ArrayField, Value(vector, "x, y")] = (1.0, 0.0)  # type: ignore[assignment]
    _: KW_ONLY
    speed: Annotated[float, Value(non_negative, "m/s")]
    travel: Annotated[float, Value(non_negative, "m")] = inf
    force_limit: Annotated[float | None, Value(positive, "N")] = None

    def __post_init__(self) -> None:
        check_fields(self, "drive", ("travel",) if self.travel == inf else ())
        length = hypot(*self.direction)
        if length == 0.0:
            hint = "for a drive at rest, use any direction and speed 0"
            raise InvalidInput("drive.direction", found="(0, 0)", expected="a direction", hint=hint)
        if abs(length - 1.0) > UNIT_LENGTH:
            settle(self, direction=frozen(self.direction / length))

    def distance(self, duration: float) -> float:
        """Return the distance moved in `duration` seconds, if nothing stops the drive [m].

        Examples
        --------
        >>> LineDrive(speed=0.02, travel=0.05).distance(2.0)
        0.04
        """
        return min(self.travel, self.speed * non_negative(duration, "duration", "s"))


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathDrive(Comparable):
    """Measured path, linear between its waypoints, at rest before the first and after the last.

    Parameters
    ----------
    waypoints : (n, 4) array_like
        Rows of increasing time [s] and pose in the world [m, m, rad]. Angles are continuous: they
        change by at most half a turn from one waypoint to the next.
    force_limit : float, optional
        Force at which the drive stalls [N]. Default: a rigid drive.

    Examples
    --------
    >>> drive = PathDrive([(0.0, 0.0, 0.0, 0.0), (1.0, 0.02, 0.0, 0.0)])
    >>> drive.pose_at(0.5)
    array([0.01, 0.  , 0.  ])
    """

    waypoints: Annotated[FloatArray, Value(table, f"t [s], {POSE}")]
    _: KW_ONLY
    force_limit: Annotated[float | None, Value(positive, "N")] = None

    if TYPE_CHECKING:  # what may be given; the fields are what is kept

        def __init__(self, waypoints: ArrayLike, *, force_limit: float | None = None) -> None: ...

    def __post_init__(self) -> None:
        check_fields(self, "drive")
        _check_times(self.waypoints[:, 0])
        _check_angles(self.waypoints[:, 3])

    def pose_at(self, time: float) -> FloatArray:
        """Return the pose (3,) of the path at a time [m, m, rad]."""
        instants, time = self.waypoints[:, 0], finite(time, "time", "s")
        return np.array([np.interp(time, instants, column) for column in self.waypoints.T[1:]])


Drive = LineDrive | PathDrive


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Pusher(Comparable):
    """Driven body.

    Without a drive it is a template: a scene with it cannot be simulated until the measured path
    of an experiment is filled in.

    Parameters
    ----------
    name : str
        Name, unique in its scene.
    shape : Shape
        Shape in its own frame.
    pose : (3,) array_like or None
        Pose of its frame in the world, at t = 0 [m, m, rad]. A `PathDrive` determines the start, so
        that None is allowed and other values are replaced.
    drive : Drive or None
        Prescribed motion; None: a template.
    friction : float
        Coefficient of friction against every free body [-].
    restitution : float
        Coefficient of restitution, from 0 to 1 [-].

    Examples
    --------
    >>> from fixel.model import Disk
    >>> finger = Pusher("finger", Disk(0.005), pose=(-0.055, 0.02, 0.0), friction=0.3,
    ...                 drive=LineDrive(speed=0.02))
    >>> Pusher("finger", Disk(0.005), friction=0.3).is_template
    True
    """

    name: str
    shape: Shape
    _: KW_ONLY
    pose: Annotated[ArrayField, Value(vector, POSE)] = None  # type: ignore[assignment]
    drive: Drive = None  # type: ignore[assignment]
    friction: Annotated[float, Value(non_negative)]
    restitution: Annotated[float, Value(fraction)] = 0.0

    def __post_init__(self) -> None:
        with _named(self, "pusher"):
            settle(self, pose=self._start())
            check_fields(self, leave_out=("pose",))

    @property
    def is_template(self) -> bool:
        """Whether it has no drive, so that it cannot be simulated."""
        drive: object = self.drive
        return drive is None

    def _start(self) -> FloatArray:
        given: object = self.pose
        pose = None if given is None else vector(self.pose, "pose", POSE)
        if self.is_template:
            return pose  # type: ignore[return-value]
        instance(self.drive, LineDrive | PathDrive, "drive", "a LineDrive or a PathDrive")
        if isinstance(self.drive, PathDrive):
            return frozen(self.drive.pose_at(0.0))
        if pose is None:
            raise InvalidInput("pose", found=None, expected=POSE)
        return pose


def _check_times(instants: FloatArray) -> None:
    steps = np.diff(instants)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        motion = "has decreasing times" if steps[row - 1] < 0.0 else "has repeated times"
        found = f"t = {instants[row]:g} s after {instants[row - 1]:g} s: the path {motion}"
        expected = "increasing times"
        hint = "sort the rows by time and drop repeated ones"
        raise InvalidInput(f"drive.waypoints[{row}]", found=found, expected=expected, hint=hint)


def _check_angles(angle: FloatArray) -> None:
    steps = np.abs(np.diff(angle))
    if (steps > pi).any():
        row = int(np.argmax(steps > pi)) + 1
        found = f"an angle of {angle[row]:g} rad after {angle[row - 1]:g} rad"
        expected = "a change of at most half a turn between samples"
        hint = "unwrap the angles first, for example with numpy.unwrap"
        raise InvalidInput(f"drive.waypoints[{row}]", found=found, expected=expected, hint=hint)


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
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

    Examples
    --------
    >>> from fixel.model import Disk
    >>> Fixel("fixel-1", Disk(0.005), pose=(0.1, 0.0, 0.0), friction=0.2).pose
    array([0.1, 0. , 0. ])
    """

    name: str
    shape: Shape
    _: KW_ONLY
    pose: Annotated[FloatArray, Value(vector, POSE)]
    friction: Annotated[float, Value(non_negative)]
    restitution: Annotated[float, Value(fraction)] = 0.0

    if TYPE_CHECKING:  # what may be given; the fields are what is kept

        def __init__(
            self,
            name: str,
            shape: Shape,
            *,
            pose: ArrayLike,
            friction: float,
            restitution: float = 0.0,
        ) -> None: ...

    def __post_init__(self) -> None:
        with _named(self, "fixel"):
            check_fields(self)
