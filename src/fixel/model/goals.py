"""Goals of a push or grasp: conditions on the motion of a body, with signed margins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, pi
from typing import Annotated, Any, ClassVar, Final, NamedTuple, final

import numpy as np
import shapely
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, check_name
from fixel.model import fields
from fixel.model.bodies import POSE, Body
from fixel.model.overlap import overlaps
from fixel.model.scene import Scene
from fixel.model.shape import Disk, Polygon, placed, rotated
from fixel.model.trajectory import wrapped
from fixel.typing import BoolArray, FloatArray

# Gap up to which a body counts as touching a fixel, as a share of the body's size. A simulated
# contact is closed to about 1e-6 of it. Also the default tolerance of regions and lines.
TOUCHING: Final = 1e-3

# Smallest margin: that of a simulation without a finite pose. Larger values would let a failed
# simulation outrank one that ended far away.
MIN_MARGIN: Final = -1e6

CHUNK: Final = 1 << 15  # poses at a time, which bounds the memory of margins to about 100 MB


class BodyTrack(NamedTuple):
    """Motion of one body in n simulations, on which goals are judged.

    Examples
    --------
    >>> BodyTrack.of_ends([[0.1, 0.0, 0.0]]).pose.shape
    (1, 1, 3)
    """

    pose: FloatArray  # (n, n_time, 3) poses in time, the last one at the end [m, m, rad]
    stalled: BoolArray | None = None  # (n,) whether the drive stalled at the end
    force: FloatArray | None = None  # (n,) largest force of the drive [N]
    # (n, n_fixel, 3) displacements of fixels [m, m, rad], whose rotations are not used.
    fixels: FloatArray | None = None

    @classmethod
    def of_ends(cls, poses: ArrayLike) -> BodyTrack:
        """Return the track of end poses (n, 3) alone [m, m, rad]."""
        return cls(fields.numbers(poses, "poses").reshape(-1, 1, 3))


Tracks = BodyTrack | Mapping[str, BodyTrack]


class Goal(fields.Comparable, ABC):
    """Base class of goals: a condition with a signed margin.

    `margin` is 1 at the target, 0 at the tolerance and negative beyond it; always finite.

    Examples
    --------
    >>> from fixel import PoseRegion
    >>> from fixel.testing.scenes import pushed_square
    >>> near = PoseRegion((0.1, 0.0, 0.0), position=0.01)
    >>> near.margin(pushed_square(), BodyTrack.of_ends([(0.1, 0, 0), (0.105, 0, 0), (0.12, 0, 0)]))
    array([ 1. ,  0.5, -1. ])
    """

    __slots__ = ()

    @abstractmethod
    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins in units of the tolerance.

        Parameters
        ----------
        scene : Scene
        track : BodyTrack or mapping of str to BodyTrack
            Motion of the only free body, or of each free body by name.

        Returns
        -------
        (n,) float64
            At least zero where the goal is met, never NaN [-]. A motion that ends at a pose that is
            not finite has the margin -1e6.

        Raises
        ------
        InvalidInput
            The scene has no such fixel or body, or the track has no forces or stalls and the goal
            needs them.
        """

    def met(self, scene: Scene, track: Tracks) -> BoolArray:
        """Return whether the goal is met, (n,) bool: where its margin is at least zero."""
        return np.asarray(self.margin(scene, track) >= 0.0)

    @property
    @abstractmethod
    def clauses(self) -> tuple[Clause, ...]:
        """Conditions on one body that the goal consists of."""


def as_goal(goal: Goal) -> Goal:
    """Return a goal; raise for another type."""
    fields.instance(goal, Goal, "goal", "a goal, such as PoseRegion or Seated")
    return goal


class Clause(Goal):
    """Base class of conditions on the poses of one body."""

    __slots__ = ()
    whole_motion: ClassVar[bool] = False  # whether more than the end counts
    body: str | None

    @property
    def clauses(self) -> tuple[Clause, ...]:
        """The condition itself."""
        return (self,)

    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins (n,) in units of the tolerance, as `Goal.margin`."""
        body, own = body_of(scene, self.body), track_of(scene, self.body, track)
        pose = own.pose if self.whole_motion else own.pose[:, -1:]
        flat = np.asarray(pose, np.float64).reshape(-1, 3)
        values = np.full(len(flat), MIN_MARGIN)
        valid = np.flatnonzero(np.isfinite(flat).all(axis=1))
        for first in range(0, len(valid), CHUNK):
            rows = valid[first : first + CHUNK]
            moved = None if own.fixels is None else own.fixels[rows // pose.shape[1]]
            margins = self._margins(scene, body, flat[rows], moved)
            values[rows] = np.maximum(margins, MIN_MARGIN)
        return np.asarray(values.reshape(pose.shape[:2]).min(axis=1))

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        """Return the margins (n,) of poses (n, 3), with displacements (n, n_fixel, 3) of fixels."""
        raise NotImplementedError


@final
@dataclass(frozen=True, slots=True, eq=False)
class PoseRegion(Clause):
    """Goal that a body ends near a pose.

    The margin is the smaller one of position and angle: 1 at the pose, 0 at the tolerance.

    Parameters
    ----------
    pose : (3,) array_like
        Pose of the body's frame in the world [m, m, rad].
    position : float, optional
        Largest distance of the centroid from its position at `pose` [m]; any position by default.
    angle : float, optional
        Largest difference of angles [rad]; any angle by default.
    symmetry : int
        Number of rotations about the centroid by which the outline covers itself: 4 for a square.
        The poses rotated by these are as good.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Raises
    ------
    InvalidInput
        A tolerance is not positive, or both are missing, or `symmetry` is below 1.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import deg, mm
    >>> goal = PoseRegion((32 * mm, 0.0, 0.0), position=2 * mm, angle=5 * deg)
    >>> simulate(pushed_square()).meets(goal)
    False
    """

    pose: Annotated[FloatArray, fields.Value(fields.vector, POSE)]
    position: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    angle: Annotated[float | None, fields.Value(fields.positive, "rad")] = None
    symmetry: int = 1
    body: str | None = None

    def __post_init__(self) -> None:
        fields.check_fields(self, "goal")
        fields.settle(self, symmetry=fields.whole(self.symmetry, "goal.symmetry"))
        if self.position is None and self.angle is None:
            found, expected = "a pose without tolerances", "position=, angle= or both"
            raise InvalidInput("goal.pose", found=found, expected=expected)

    def targets(self, body: Body) -> FloatArray:
        """Return the poses (symmetry, 3) that look like the goal's [m, m, rad]."""
        angle = self.pose[2] + np.arange(self.symmetry) * (2.0 * pi / self.symmetry)
        centre = placed(body.shape.centroid, self.pose)
        offset = centroids(body, np.column_stack((np.zeros((self.symmetry, 2)), angle)))
        return np.column_stack((centre - offset, angle))

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        margin = np.ones(len(poses))
        if self.position is not None:
            apart = centroids(body, poses) - placed(body.shape.centroid, self.pose)
            margin -= np.hypot(*apart.T) / self.position
        if self.angle is not None:
            off = np.abs(wrapped(self.symmetry * (poses[:, 2] - self.pose[2]))) / self.symmetry
            margin = np.minimum(margin, 1.0 - off / self.angle)
        return margin

    def __str__(self) -> str:
        within = [] if self.position is None else [length(self.position)]
        within += [] if self.angle is None else [f"{degrees(self.angle):.3g} deg"]
        x, y, angle = self.pose
        return (
            f"{self.body or 'the part'} within {' and '.join(within)} of"
            f" ({1e3 * x:.4g}, {1e3 * y:.4g}) mm, {degrees(angle):.4g} deg"
        )


@final
@dataclass(frozen=True, slots=True, init=False, eq=False)
class Seated(Clause):
    """Goal that a body touches all of the named fixels at the end.

    The margin is 1 for a closed gap and 0 for one as wide as the tolerance.

    Parameters
    ----------
    *fixels : str
        Names of the fixels, one at least.
    only : bool
        Whether the body must not touch any other fixel.
    stalled : bool
        Whether the drive must have stalled at the end, as it does where it presses the body against
        the fixels.
    tolerance : float, optional
        Largest gap that counts as contact [m]; by default 0.1 % of the size of the body.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(Seated("fixel-1"))
    True
    """

    fixels: tuple[str, ...]
    only: bool = False
    stalled: bool = False
    tolerance: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    body: str | None = None

    def __init__(
        self,
        *fixels: str,
        only: bool = False,
        stalled: bool = False,
        tolerance: float | None = None,
        body: str | None = None,
    ) -> None:
        if not fixels or not all(fixels):
            raise InvalidInput("fixels", found=repr(fixels), expected="names of fixels")
        fixels = fields.texts(fixels, "fixels")
        tolerance = fields.optional_positive(tolerance, "goal.tolerance", "m")
        fields.settle(
            self, fixels=fixels, only=only, stalled=stalled, tolerance=tolerance, body=body
        )

    def __repr__(self) -> str:
        named = {"only": self.only, "stalled": self.stalled}
        parts = [repr(name) for name in self.fixels]
        parts += [f"{name}=True" for name, value in named.items() if value]
        optional = {"tolerance": self.tolerance, "body": self.body}
        parts += [f"{name}={value!r}" for name, value in optional.items() if value is not None]
        return f"Seated({', '.join(parts)})"

    def __str__(self) -> str:
        only = " and no other" if self.only else ""
        stalled = ", with the drive stalled" if self.stalled else ""
        return f"{self.body or 'the part'} touching {', '.join(self.fixels)}{only}{stalled}"

    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins (n,) in units of the tolerance, as `Goal.margin`."""
        margin = super(Seated, self).margin(scene, track)
        if not self.stalled:
            return margin
        stalled = track_of(scene, self.body, track).stalled
        if stalled is None:
            found, expected = "no stalls of the drive", "those of simulations"
            raise InvalidInput("track", found=found, expected=expected)
        return np.minimum(margin, np.where(stalled, 1.0, -1.0))

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        tolerance = tolerance_of(self.tolerance, body)
        known = [fixel.name for fixel in scene.fixels]
        for name in self.fixels:
            check_fixel(name, scene)
        margin = np.ones(len(poses))
        for name in known if self.only else self.fixels:
            gap = gap_to(scene, body, name, poses, fixels) / tolerance
            margin = np.minimum(margin, 1.0 - gap if name in self.fixels else gap - 1.0)
        return margin


@final
@dataclass(frozen=True, slots=True, eq=False)
class Inside(Clause):
    """Goal that the outline of a body ends inside a region.

    The margin is 1 where the outline touches the border from inside, more where it is clear of it,
    and 0 where it protrudes by the tolerance.

    Parameters
    ----------
    region : Polygon or (n, 2) array_like
        Region in the world [m], convex or not: a slot, a channel, a tray.
    tolerance : float, optional
        Largest protrusion [m]; by default 0.1 % of the size of the body.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import Polygon, simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> tray = [(-0.1, -0.1), (0.2, -0.1), (0.2, 0.2), (-0.1, 0.2)]
    >>> simulate(pushed_square()).meets(Inside(tray))
    True
    """

    region: Polygon
    tolerance: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    body: str | None = None

    def __post_init__(self) -> None:
        region: Any = self.region
        fields.settle(self, region=region if isinstance(region, Polygon) else Polygon(region))
        fields.check_fields(self, "goal")

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        return 1.0 + _clearance(self.region, body, poses) / tolerance_of(self.tolerance, body)

    def __str__(self) -> str:
        return f"{self.body or 'the part'} inside {box_text(self.region)}"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Beyond(Clause):
    """Goal that a body, or one point of it, ends beyond a line.

    The margin is 1 on the line, more beyond it, and 0 where the body is short by the tolerance.

    Parameters
    ----------
    line : (2, 2) array_like
        Two points of the line in the world [m]; the goal is on the left of the way from the first
        to the second.
    feature : (2,) array_like, optional
        Point in the frame of the body [m]; by default the whole outline must be beyond the line.
    tolerance : float, optional
        Largest distance by which it may fall short [m]; by default 0.1 % of the size of the body.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square()).meets(Beyond([(0.02, 0.0), (0.02, -1.0)], feature=(0.0, 0.0)))
    True
    """

    line: Annotated[FloatArray, fields.Value(fields.table, "x [m], y [m]")]
    feature: Annotated[FloatArray | None, fields.Value(fields.vector, "x [m], y [m]")] = None
    tolerance: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    body: str | None = None

    def __post_init__(self) -> None:
        fields.check_fields(self, "goal")
        if self.line.shape != (2, 2) or not np.ptp(self.line, axis=0).any():
            found = self.line.tolist()
            raise InvalidInput("goal.line", found=found, expected="two different points")

    @property
    def half_plane(self) -> tuple[FloatArray, FloatArray]:
        """Unit normal (1, 2) towards the goal, and its offset (1,) [m]."""
        along = (self.line[1] - self.line[0]) / np.hypot(*(self.line[1] - self.line[0]))
        inward = np.array([[-along[1], along[0]]])
        return inward, inward @ self.line[0]

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        points = _points(body) if self.feature is None else self.feature[None]
        radius = _round(body) if self.feature is None else 0.0
        distance = _least_distance(points, poses, *self.half_plane) - radius
        return 1.0 + distance / tolerance_of(self.tolerance, body)

    def __str__(self) -> str:
        (a, b), (c, d) = (1e3 * self.line).tolist()
        what = self.body or "the part"
        point = "" if self.feature is None else " with its feature"
        return f"{what}{point} left of the line ({a:.4g}, {b:.4g}) to ({c:.4g}, {d:.4g}) mm"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Contact(Clause):
    """Event that a body touches a fixel at any time, for `never=`.

    The margin is negative where it happens, and grows with the smallest gap.

    Parameters
    ----------
    fixel : str
        Name of the fixel.
    tolerance : float, optional
        Largest gap that counts as contact [m]; by default 0.1 % of the size of the body.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import AllOf, Seated, simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(AllOf(Seated("fixel-1"), never=[Contact("fixel-2")]))
    True
    """

    whole_motion: ClassVar[bool] = True
    fixel: str
    tolerance: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    body: str | None = None

    def __post_init__(self) -> None:
        fields.check_fields(self, "goal")

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        gap = gap_to(scene, body, self.fixel, poses, fixels)
        return gap / tolerance_of(self.tolerance, body) - 1.0

    def __str__(self) -> str:
        return f"{self.body or 'the part'} touching {self.fixel}"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Exit(Clause):
    """Event that the outline of a body leaves a region at any time, for `never=`.

    Parameters
    ----------
    region : Polygon or (n, 2) array_like
        Region in the world [m], such as the field of view of the camera or the plate.
    tolerance : float, optional
        Largest protrusion [m]; by default 0.1 % of the size of the body.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import AllOf, PoseRegion, simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> plate = [(-0.1, -0.1), (0.2, -0.1), (0.2, 0.2), (-0.1, 0.2)]
    >>> near = PoseRegion((0.03, -0.015, 0.0), position=0.01)
    >>> simulate(pushed_square()).meets(AllOf(near, never=[Exit(plate)]))
    True
    """

    whole_motion: ClassVar[bool] = True
    region: Polygon
    tolerance: Annotated[float | None, fields.Value(fields.positive, "m")] = None
    body: str | None = None

    def __post_init__(self) -> None:
        inside = Inside(self.region, self.tolerance)
        fields.settle(self, region=inside.region, tolerance=inside.tolerance)

    def _margins(
        self, scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None
    ) -> FloatArray:
        return Inside(self.region, self.tolerance)._margins(scene, body, poses, fixels)

    def __str__(self) -> str:
        return f"{self.body or 'the part'} leaving {box_text(self.region)}"


@final
@dataclass(frozen=True, slots=True, eq=False)
class ForceAbove(Clause):
    """Event that the force of the drive exceeds a limit at any time, for `never=`.

    Parameters
    ----------
    newton : float
        Limit [N].
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import AllOf, Seated, simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(AllOf(Seated("fixel-1"), never=[ForceAbove(1e3)]))
    True
    """

    whole_motion: ClassVar[bool] = True
    newton: Annotated[float, fields.Value(fields.positive, "N")]
    body: str | None = None

    def __post_init__(self) -> None:
        fields.settle(self, newton=fields.positive(self.newton, "goal.force_above", "N"))

    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins (n,) in units of the limit, as `Goal.margin`."""
        force = track_of(scene, self.body, track).force
        if force is None:
            raise InvalidInput("track", found="no forces", expected="those of simulations")
        margin = 1.0 - np.asarray(force, np.float64) / self.newton
        return np.maximum(np.where(np.isnan(margin), MIN_MARGIN, margin), MIN_MARGIN)

    def __str__(self) -> str:
        return f"a force above {self.newton:g} N"


@final
@dataclass(frozen=True, slots=True, init=False, eq=False)
class AllOf(Goal):
    """Goal that requires all of several goals at the end, and that events never happen.

    The margin is the smallest one.

    Parameters
    ----------
    *goals : Goal
        Goals, one at least.
    never : Clause or sequence of Clause
        Events that must not happen at any time: `Contact`, `Exit` and `ForceAbove`.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(AllOf(Seated("fixel-1"), Seated("fixel-2")))
    False
    """

    goals: tuple[Goal, ...]
    never: tuple[Clause, ...]

    def __init__(
        self, *goals: Goal, never: Clause | tuple[Clause, ...] | list[Clause] = ()
    ) -> None:
        fields.instance(never, Goal | tuple | list, "goal.never", "events")
        never = (never,) if isinstance(never, Goal) else tuple(never)
        for index, event in enumerate(never):
            if not isinstance(event, Contact | Exit | ForceAbove):
                expected = "Contact, Exit or ForceAbove"
                raise InvalidInput(f"goal.never[{index}]", found=repr(event), expected=expected)
        fields.settle(self, goals=_wanted(goals), never=never)

    @property
    def clauses(self) -> tuple[Clause, ...]:
        """Conditions on one body, first those of the goals, then the events."""
        return (*(clause for goal in self.goals for clause in goal.clauses), *self.never)

    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins (n,): the smallest of all, as `Goal.margin`."""
        every = [goal.margin(scene, track) for goal in (*self.goals, *self.never)]
        return np.asarray(np.min(every, axis=0))

    def __repr__(self) -> str:
        parts = [repr(goal) for goal in self.goals]
        parts += [f"never={list(self.never)!r}"] if self.never else []
        return f"AllOf({', '.join(parts)})"

    def __str__(self) -> str:
        text = " and ".join(_bracketed(goal) for goal in self.goals)
        return text + "".join(f", never {event}" for event in self.never)


@final
@dataclass(frozen=True, slots=True, init=False, eq=False)
class AnyOf(Goal):
    """Goal that requires at least one of several goals at the end.

    The margin is the largest one.

    Parameters
    ----------
    *goals : Goal
        Goals, one at least.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(AnyOf(Seated("fixel-1"), Seated("fixel-3")))
    True
    """

    goals: tuple[Goal, ...]

    def __init__(self, *goals: Goal) -> None:
        fields.settle(self, goals=_wanted(goals))

    @property
    def clauses(self) -> tuple[Clause, ...]:
        """Conditions on one body of all the goals."""
        return tuple(clause for goal in self.goals for clause in goal.clauses)

    def margin(self, scene: Scene, track: Tracks) -> FloatArray:
        """Compute signed margins (n,): the largest of all, as `Goal.margin`."""
        return np.asarray(np.max([goal.margin(scene, track) for goal in self.goals], axis=0))

    def __repr__(self) -> str:
        return f"AnyOf({', '.join(map(repr, self.goals))})"

    def __str__(self) -> str:
        return " or ".join(_bracketed(goal) for goal in self.goals)


# --- shared ---------------------------------------------------------------------------------------


def events_in(goal: Goal, scene: Scene, track: BodyTrack) -> tuple[str, ...]:
    """Return the first event of a goal that happened in each of n runs; empty where none did."""
    found = np.full(len(track.pose), "", object)
    for event in goal.clauses:
        if event.whole_motion:
            found[(found == "") & ~event.met(scene, track)] = str(event)
    return tuple(found)


def body_of(scene: Scene, name: str | None) -> Body:
    """Return a free body by name, or the only one."""
    if name is None and len(scene.bodies) == 1:
        return scene.bodies[0]
    for body in scene.bodies:
        if body.name == name:
            return body
    names = ", ".join(body.name for body in scene.bodies)
    found = "no name" if name is None else repr(name)
    raise InvalidInput("goal.body", found=found, expected=f"one of {names}")


def track_of(scene: Scene, name: str | None, track: Tracks) -> BodyTrack:
    """Return the track of a body among those of a scene."""
    return track if isinstance(track, BodyTrack) else track[body_of(scene, name).name]


def tolerance_of(tolerance: float | None, body: Body) -> float:
    """Return a tolerance [m], by default a share of the size of the body."""
    if tolerance is not None:
        return tolerance
    return TOUCHING * float(np.ptp(body.shape.outline, axis=0).max())


def check_fixel(name: str, scene: Scene) -> None:
    """Raise `InvalidInput` if a scene has no such fixel."""
    names = [fixel.name for fixel in scene.fixels]
    if not names:
        raise InvalidInput("goal.fixels", found=repr(name), expected="a fixel of the scene")
    check_name("goal.fixels", name, names)


def centroids(body: Body, poses: FloatArray) -> FloatArray:
    """Return the positions (n, 2) of a body's centroid at poses (n, 3) [m]."""
    return np.asarray(poses[:, :2] + rotated(body.shape.centroid, poses[:, 2]))


def gap_to(
    scene: Scene, body: Body, name: str, poses: FloatArray, fixels: FloatArray | None = None
) -> FloatArray:
    """Return the gaps (n,) of a body at poses (n, 3) to a fixel [m], negative in overlap.

    `fixels` (n, n_fixel, 3) are displacements of the fixels from their places in the scene.
    """
    check_fixel(name, scene)
    k = [fixel.name for fixel in scene.fixels].index(name)
    if fixels is not None:
        poses = poses - fixels[:, k] * (1.0, 1.0, 0.0)
    return -overlaps(body.shape, poses, scene.fixels[k].shape, scene.fixels[k].pose).depth


def touching(
    scene: Scene, body: Body, poses: FloatArray, fixels: FloatArray | None = None
) -> BoolArray:
    """Return the contacts (n, n_fixel) of a body with the fixels of its scene at poses (n, 3).

    `fixels` (n, n_fixel, 3) are displacements of the fixels from their places in the scene.
    """
    tolerance = tolerance_of(None, body)
    gaps = [gap_to(scene, body, fixel.name, poses, fixels) for fixel in scene.fixels]
    return np.array([gap < tolerance for gap in gaps], bool).reshape(len(gaps), len(poses)).T


def _clearance(region: Polygon, body: Body, poses: FloatArray) -> FloatArray:
    """Return the distances (n,) of a body inside a region to its border [m], negative outside.

    Exact for convex regions. A region that is not convex is its hull without pockets: the distance
    to a pocket is that of `overlaps`, exact in sign.
    """
    clearance = _least_distance(_points(body), poses, *hull_lines(region)) - _round(body)
    if not region.is_convex:
        ring = shapely.Polygon(region.vertices)
        pockets = shapely.get_parts(ring.convex_hull.difference(ring))
        least = 1e-12 * region.area  # rounding leaves slivers of about 1e-16
        for pocket in (p for p in pockets if p.area > least):
            shape = Polygon(shapely.get_coordinates(pocket)[:-1])
            depth = overlaps(body.shape, poses, shape, np.zeros(3)).depth
            clearance = np.minimum(clearance, -depth)
    return clearance


def hull_lines(region: Polygon) -> tuple[FloatArray, FloatArray]:
    """Return inward unit normals (m, 2) of the hull of a region, and their offsets (m,) [m].

    A point is inside where its product with each normal is at least the offset.
    """
    hull = shapely.MultiPoint(region.vertices).convex_hull
    corners = Polygon(shapely.get_coordinates(hull)[:-1]).vertices
    edge = np.roll(corners, -1, axis=0) - corners
    inward = np.column_stack((-edge[:, 1], edge[:, 0])) / np.hypot(*edge.T)[:, None]
    return inward, (inward * corners).sum(axis=1)


def _least_distance(
    points: FloatArray, poses: FloatArray, inward: FloatArray, offset: FloatArray
) -> FloatArray:
    """Return the least distance (n,) of a body's points (k, 2) from lines, over points and lines.

    `inward` (m, 2) are unit normals, `offset` (m,) their products with points of the lines.
    """
    place = poses[:, None, :2] + rotated(points, poses[:, None, 2])  # (n, k, 2)
    least = np.full(len(poses), np.inf)
    for normal, own in zip(inward, offset, strict=True):
        least = np.minimum(least, (place @ normal).min(axis=1) - own)
    return least


def _points(body: Body) -> FloatArray:
    return np.zeros((1, 2)) if isinstance(body.shape, Disk) else body.shape.vertices


def _round(body: Body) -> float:
    return body.shape.radius if isinstance(body.shape, Disk) else 0.0


def _wanted(goals: tuple[Any, ...]) -> tuple[Goal, ...]:
    for index, goal in enumerate(goals):
        if not isinstance(goal, Goal) or isinstance(goal, Contact | Exit | ForceAbove):
            expected = "a goal; events belong into AllOf(..., never=[...])"
            raise InvalidInput(f"goal[{index}]", found=repr(goal), expected=expected)
    if not goals:
        raise InvalidInput("goal", found="no goals", expected="one at least")
    return goals


def _bracketed(goal: Goal) -> str:
    return f"({goal})" if isinstance(goal, AllOf | AnyOf) else str(goal)


def box_text(region: Polygon) -> str:
    """Return the extent of a region as text."""
    low, high = 1e3 * region.vertices.min(axis=0), 1e3 * region.vertices.max(axis=0)
    return f"x {low[0]:.4g} to {high[0]:.4g} mm, y {low[1]:.4g} to {high[1]:.4g} mm"


def length(value: float) -> str:
    """Return a length [m] as text, in millimetres or micrometres."""
    return f"{1e3 * value:.3g} mm" if value >= 1e-4 else f"{1e6 * value:.3g} um"
