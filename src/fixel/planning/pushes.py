"""Pushes that a planner may choose, and their motions in the world."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Final, Literal, NamedTuple, final, get_args

import numpy as np
import shapely

from fixel.errors import InvalidInput, check_name, counted
from fixel.model import Body, Disk, LineDrive, PathDrive, Polygon, Pusher, Scene, Shape, rotated
from fixel.model.fields import (
    Value,
    check_fields,
    instance,
    name_of,
    non_negative,
    positive,
    settle,
    table,
    texts,
    vector,
    whole,
)
from fixel.model.overlap import overlaps
from fixel.model.scene import check_push
from fixel.planning.simplified import MANY
from fixel.simulation.vary import composed
from fixel.typing import BoolArray, FloatArray
from fixel.units import deg, mm

Range = tuple[float, float]
RANGE: Final = "lowest, largest"
Cost = Literal["pushes", "time", "length"]

MAX_PUSHES: Final = 4
TOOL: Final = "tool"  # name of the pusher of a plan
HALVINGS: Final = 40  # of the distance at which a tool touches the part
ARC: Final = 8  # waypoints of a push on which the tool turns
CLEARANCE: Final = 0.25  # from the part where the tool is put down, relative to the part's radius


@dataclass(frozen=True, slots=True)
class PlanPush:
    """Push of a part by a free tool, relative to the part."""

    # Point of the outline, as a share of the way round it, counter-clockwise from its first corner,
    # 0 to 1 [-].
    contact: float
    angle: float  # direction of the push, from the inward normal at that point [rad]
    length: float  # way of the tool after it has reached that point [m]
    turn: float = 0.0  # rotation of the tool on that way, counter-clockwise [rad]

    def __post_init__(self) -> None:
        non_negative(self.length, "push.length", "m")

    def __str__(self) -> str:
        """Return the push as text."""
        turn = f", turning by {self.turn / deg:+.1f} deg" if self.turn else ""
        return (
            f"contact at {100.0 * self.contact:.1f} % of the outline, {self.angle / deg:+.1f} deg"
            f" from the normal, {self.length / mm:.4g} mm{turn}"
        )


@dataclass(frozen=True, slots=True)
class RigPush:
    """Push on a rig with one straight axis: where the part is placed, and the stroke."""

    # Placement of the part, relative to its pose in the scene [m, m, rad].
    x: float
    y: float
    theta: float
    stroke: float  # travel of the pusher [m]
    # Displacements of fixels from their places in the scene [m].
    fixels: Mapping[str, tuple[float, float]]

    def __str__(self) -> str:
        """Return the push as text."""
        moved = "".join(
            f", {name} moved by {x / mm:+.3g}, {y / mm:+.3g} mm"
            for name, (x, y) in self.fixels.items()
        )
        return (
            f"part placed {self.x / mm:+.4g}, {self.y / mm:+.4g} mm and {self.theta / deg:+.2f} deg"
            f" from its pose in the scene, stroke {self.stroke / mm:.4g} mm{moved}"
        )


class PushMotions(NamedTuple):
    """Motions of n pushes in the world."""

    start: FloatArray  # (n, 3) planned poses of the part before the push [m, m, rad]
    path: FloatArray  # (n, n_waypoint, 4) time [s] and pose of the tool [m, m, rad]
    fixels: FloatArray | None  # (n, n_fixel, 3) displacements of fixels; None for none


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FreePushes:
    """Pushes by a tool that can be lifted and put down anywhere around the part.

    Parameters
    ----------
    most : int
        Largest number of pushes in sequence, 1 to 4.
    tool : Shape, optional
        Shape of the tool: a disk, or a polygon whose x axis points along the push. By default that
        of the scene's pusher, else a disk of 5 mm radius.
    length : (float, float), optional
        Range of the way after contact [m]; by default from a tenth of the part's radius to two.
    angle : float
        Largest angle between push and inward normal [rad].
    turn : (float, float), optional
        Range of the rotation of the tool on that way, counter-clockwise [rad]; by default it moves
        straight on. A tool that turns moves along an arc, in the direction of its x axis.
    clearance : float, optional
        Gap between tool and part where the tool is put down [m]; by default a quarter of the part's
        radius.
    retract : float, optional
        Way back before the tool is lifted [m]; by default the clearance.
    speed : float
        Speed of the tool [m/s].
    friction : float, optional
        Friction of the tool on the part [-]; by default that of the scene's pusher, else 0.25.
    force_limit : float, optional
        Force at which the drive stalls [N]; by default a rigid drive.
    cost : {"pushes", "time", "length"}
        Cost of which the least is chosen among plans of equal success without looks: the number of
        pushes, the time of the tool on its paths, or their length.
    obstacles : sequence of Polygon or (n, 2) array_like
        Regions in the world that neither part nor tool may touch [m]. They stop nothing in
        simulations: a run that touches one counts as a failure.
    keep : str or sequence of str
        Names of other parts that must stay where they are. A run that moves one counts as a
        failure; parts that are not named may be pushed.

    Examples
    --------
    >>> from fixel.units import mm
    >>> FreePushes(most=2, length=(5 * mm, 60 * mm)).most
    2
    """

    most: int = 1
    tool: Shape | None = None
    length: Range | None = None
    angle: Annotated[float, Value(non_negative, "rad")] = 30.0 * deg
    turn: Range | None = None
    clearance: Annotated[float | None, Value(positive, "m")] = None
    retract: Annotated[float | None, Value(non_negative, "m")] = None
    speed: Annotated[float, Value(positive, "m/s")] = 0.02
    friction: Annotated[float | None, Value(non_negative)] = None
    force_limit: Annotated[float | None, Value(positive, "N")] = None
    cost: Cost = "pushes"
    obstacles: tuple[Polygon, ...] = ()
    keep: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        whole(self.most, "choose.most", 1, MAX_PUSHES)
        instance(self.tool, Shape | None, "choose.tool", "a Polygon or a Disk")
        if self.length is not None:
            settle(self, length=_range(self.length, "choose.length", lowest=0.0))
        if self.turn is not None:
            settle(self, turn=_range(self.turn, "choose.turn"))
        check_fields(self, "choose")
        check_name("choose.cost", self.cost, get_args(Cost))
        settle(self, obstacles=_regions(self.obstacles), keep=texts(self.keep, "choose.keep"))
        if self.angle >= 0.5 * math.pi:
            found = f"{math.degrees(self.angle):.3g} deg"
            expected = "less than 90 deg from the inward normal"
            raise InvalidInput("choose.angle", found=found, expected=expected)

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Names of the three numbers of a push, four where the tool turns."""
        return ("contact", "angle", "length", *(() if self.turn is None else ("turn",)))

    def bounds(self, scene: Scene) -> tuple[FloatArray, FloatArray]:
        """Bounds of these numbers."""
        radius = float(scene.bodies[0].shape.radius)
        low, high = self.length or (0.1 * radius, 2.0 * radius)
        least, most = ((), ()) if self.turn is None else ((own,) for own in self.turn)
        return np.array([0.0, -self.angle, low, *least]), np.array([1.0, self.angle, high, *most])

    def prepared(self, scene: Scene) -> Scene:
        """Scene with the tool, which waits far from the part."""
        body = _part(scene, self.keep)
        own = scene.pushers[0] if scene.pushers else None
        friction = self.friction
        if friction is None:
            friction = 0.25 if own is None else own.friction
        tool = self._tool(scene)
        away = float(body.shape.radius + tool.radius) * 4.0
        x, y, _ = body.pose
        rest = PathDrive(
            [(0.0, x - away, y, 0.0), (away / self.speed, x - 2.0 * away, y, 0.0)],
            force_limit=self.force_limit,
        )
        name = TOOL if own is None else own.name
        return replace(
            scene, pushers=(Pusher(name, tool, drive=rest, friction=friction),), duration=1.0
        )

    def motions(self, scene: Scene, numbers: FloatArray, before: FloatArray) -> PushMotions:
        """Motions of pushes (n, d) of parts at planned poses `before` (n, 3)."""
        body, tool = scene.bodies[0], self._tool(scene)
        gap = self.clearance or CLEARANCE * float(body.shape.radius)
        back = gap if self.retract is None else self.retract
        point, inward = outline_points(body.shape, numbers[:, 0])
        heading = np.arctan2(inward[:, 1], inward[:, 0]) + numbers[:, 1]
        touch = _touching(body.shape, tool, point, inward, heading)
        ways = np.column_stack((np.full(len(numbers), -gap), numbers[:, 2], numbers[:, 2] - back))
        place = np.pad(ways[..., None], ((0, 0), (0, 0), (0, 2)))
        if self.turn is not None:
            ways, place = _on_arcs(ways, numbers[:, 3])
        own = composed(np.column_stack((touch, heading))[:, None], place)
        time = np.cumsum(
            np.column_stack((np.zeros(len(ways)), np.abs(np.diff(ways, axis=1)) / self.speed)),
            axis=1,
        )
        return PushMotions(before, np.dstack((time, composed(before[:, None], own))), None)

    def pushes(self, scene: Scene, numbers: FloatArray) -> tuple[PlanPush | RigPush, ...]:
        """Pushes of a plan (k, d)."""
        return tuple(PlanPush(c % 1.0, *own) for c, *own in numbers.tolist())

    def numbers(self, pushes: Sequence[PlanPush | RigPush]) -> FloatArray:
        """Numbers (k, d) of the pushes of a plan."""
        rows = []
        for push in pushes:
            instance(push, PlanPush, "first", "pushes of a free tool")
            *own, turn = astuple(push)
            if self.turn is None and turn:
                expected = "pushes that do not turn, as choose.turn is not given"
                raise InvalidInput("first", found=str(push), expected=expected)
            rows.append(own if self.turn is None else [*own, turn])
        return np.array(rows)

    def _tool(self, scene: Scene) -> Shape:
        if self.tool is not None:
            return self.tool
        return scene.pushers[0].shape if scene.pushers else Disk(5e-3)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RigPushes:
    """Placements of the part and strokes, for a rig whose pusher moves along one straight line.

    Parameters
    ----------
    x, y : (float, float)
        Ranges of the placement, relative to the part's pose in the scene [m].
    theta : (float, float)
        Range of its angle, relative to the same [rad].
    stroke : (float, float), optional
        Range of the pusher's travel [m]; by default its travel in the scene alone.
    fixels : mapping of str to ((float, float), (float, float))
        Ranges of the displacement of fixels along x and y [m]; others stay in place.
    retract : float
        Way back of the pusher before the end is judged [m]; 0 holds the part.
    cost : {"pushes", "time", "length"}
        Cost as for `FreePushes`.
    obstacles : sequence of Polygon or (n, 2) array_like
        Regions that neither part nor pusher may touch [m], as for `FreePushes`.
    keep : str or sequence of str
        Names of other parts that must stay where they are, as for `FreePushes`.

    Examples
    --------
    >>> from fixel.units import deg, mm
    >>> RigPushes(y=(-30 * mm, 30 * mm), theta=(-45 * deg, 45 * deg)).most
    1
    """

    x: Range = (0.0, 0.0)
    y: Range = (0.0, 0.0)
    theta: Range = (0.0, 0.0)
    stroke: Range | None = None
    fixels: Mapping[str, tuple[Range, Range]] | None = None
    retract: Annotated[float, Value(non_negative, "m")] = 0.0
    cost: Cost = "pushes"
    obstacles: tuple[Polygon, ...] = ()
    keep: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("x", "y", "theta"):
            settle(self, **{name: _range(getattr(self, name), f"choose.{name}")})
        if self.stroke is not None:
            settle(self, stroke=_range(self.stroke, "choose.stroke", lowest=0.0))
        if self.fixels is not None:
            instance(self.fixels, Mapping, "choose.fixels", "two ranges for each fixel, by name")
            moved = {}
            for name, own in self.fixels.items():
                where = f"choose.fixels {name_of(name, 'choose.fixels')!r}"
                rows = table(own, where, RANGE)
                if len(rows) != 2:
                    found = counted(len(rows), "range")
                    raise InvalidInput(where, found=found, expected="x and y")
                moved[name] = tuple(_range(one, where) for one in rows)
            settle(self, fixels=moved)
        check_fields(self, "choose")
        check_name("choose.cost", self.cost, get_args(Cost))
        settle(self, obstacles=_regions(self.obstacles), keep=texts(self.keep, "choose.keep"))

    @property
    def most(self) -> int:
        """Number of pushes: one."""
        return 1

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Names of the numbers of a push: placement, stroke, and displacements of fixels."""
        moved = (f"{name}.{axis}" for name in self.fixels or {} for axis in "xy")
        return ("x", "y", "theta", "stroke", *moved)

    def bounds(self, scene: Scene) -> tuple[FloatArray, FloatArray]:
        """Bounds of these numbers."""
        stroke = self.stroke or (_line(scene).travel,) * 2
        if not math.isfinite(stroke[1]):
            raise InvalidInput(
                "choose.stroke", found="infinite", expected="a range of strokes [m, m]"
            )
        moved = [one for pair in (self.fixels or {}).values() for one in pair]
        low, high = zip(self.x, self.y, self.theta, stroke, *moved, strict=True)
        return np.array(low), np.array(high)

    def prepared(self, scene: Scene) -> Scene:
        """Return the scene, whose pusher is the tool."""
        _part(scene, self.keep)
        known = [fixel.name for fixel in scene.fixels]
        for name in self.fixels or {}:
            check_name("choose.fixels", name, known)
        _line(scene)
        return scene

    def motions(self, scene: Scene, numbers: FloatArray, before: FloatArray) -> PushMotions:
        """Motions of pushes (n, d) of parts at planned poses `before` (n, 3)."""
        pusher, drive = scene.pushers[0], _line(scene)
        ways = np.column_stack((np.zeros(len(numbers)), numbers[:, 3]))
        if self.retract:
            ways = np.column_stack((ways, numbers[:, 3] - self.retract))
        place = pusher.pose[:2] + ways[:, :, None] * np.asarray(drive.direction)
        angle = np.full(place.shape[:2], pusher.pose[2])
        steps = np.maximum(np.abs(np.diff(ways, axis=1)) / drive.speed, 1e-9)
        time = np.cumsum(np.column_stack((np.zeros(len(ways)), steps)), axis=1)
        start = before + numbers[:, :3]
        return PushMotions(
            start, np.dstack((time, place, angle)), self._displacements(scene, numbers)
        )

    def pushes(self, scene: Scene, numbers: FloatArray) -> tuple[PlanPush | RigPush, ...]:
        """Pushes of a plan (1, d)."""
        found = []
        for row in numbers.tolist():
            moved = dict(
                zip(self.fixels or {}, zip(row[4::2], row[5::2], strict=True), strict=True)
            )
            x, y, theta, stroke = row[:4]
            found.append(RigPush(x, y, theta, stroke, moved))
        return tuple(found)

    def numbers(self, pushes: Sequence[PlanPush | RigPush]) -> FloatArray:
        """Numbers (1, d) of the push of a plan."""
        rows = []
        for push in pushes:
            instance(push, RigPush, "first", "placements on the rig")
            assert isinstance(push, RigPush)
            moved = [push.fixels.get(name, (0.0, 0.0)) for name in self.fixels or {}]
            rows.append([push.x, push.y, push.theta, push.stroke, *np.ravel(moved)])
        return np.array(rows)

    def _displacements(self, scene: Scene, numbers: FloatArray) -> FloatArray | None:
        if not self.fixels:
            return None
        known = [fixel.name for fixel in scene.fixels]
        found = np.zeros((len(numbers), len(known), 3))
        for k, name in enumerate(self.fixels):
            found[:, known.index(name), :2] = numbers[:, 4 + 2 * k : 6 + 2 * k]
        return found


PushChoice = FreePushes | RigPushes


def outline_points(shape: Shape, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return points (n, 2) at shares (n,) of the way round an outline, and their inward normals."""
    if isinstance(shape, Disk):
        angle = 2.0 * math.pi * share
        outward = np.column_stack((np.cos(angle), np.sin(angle)))
        return shape.radius * outward, -outward
    ring = np.asarray(shape.outline)
    edge = np.roll(ring, -1, axis=0) - ring
    size = np.hypot(*edge.T)
    end = np.cumsum(size)
    way = (share % 1.0) * end[-1]
    k = np.minimum(np.searchsorted(end, way, side="right"), len(ring) - 1)
    along = edge[k] / size[k, None]
    point = ring[k] + (way - end[k] + size[k])[:, None] * along
    return point, np.column_stack((-along[:, 1], along[:, 0]))


def _touching(
    part: Shape, tool: Shape, point: FloatArray, inward: FloatArray, heading: FloatArray
) -> FloatArray:
    """Return places (n, 2) of the tool's frame where it first touches the part on its way.

    A disk's centre lies on the normal of the contact; the front of another tool is centred on the
    line of the push.
    """
    if isinstance(tool, Disk):
        return np.asarray(point - tool.radius * inward)
    along = np.column_stack((np.cos(heading), np.sin(heading)))
    # Poses of the part in the frame of the tool, which lies at `point - way * along`.
    far = np.column_stack((-rotated(point, -heading), -heading))
    # From a tool that covers the point to one that is behind the part.
    axis = shapely.LineString([(-tool.radius, 0.0), (tool.radius, 0.0)])
    back, _, front, _ = axis.intersection(shapely.Polygon(tool.outline)).bounds
    low = np.full(len(point), 0.5 * (back + front))
    high = np.full(len(point), front + 2.0 * part.radius)
    solid, tools = shapely.Polygon(part.outline), rotated(tool.outline, heading[:, None])
    many = isinstance(part, Polygon) and len(part.outline) > MANY
    shapely.prepare(solid)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if many:  # a hundred times as fast as all pairs of convex pieces
            place = point - middle[:, None] * along
            inside = shapely.intersects(solid, shapely.polygons(tools + place[:, None]))
        else:
            poses = far + np.column_stack((middle, np.zeros((len(far), 2))))
            inside = overlaps(part, poses, tool, np.zeros(3)).depth > 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return np.asarray(point - high[:, None] * along)


def _on_arcs(ways: FloatArray, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ways (n, m) of tools that turn by angles (n,), and their poses (n, m, 3).

    `ways` (n, 3) go from the place where the tool is put down past the one where it touches, whose
    frame the poses are in, to the end, and back.
    """
    share = np.arange(ARC + 1) / ARC
    on, angle = ways[:, 1:2] * share, turn[:, None] * share
    chord = on * np.sinc(0.5 * angle / math.pi)
    arc = np.dstack((chord * np.cos(0.5 * angle), chord * np.sin(0.5 * angle), angle))
    straight = np.pad(ways[:, :, None], ((0, 0), (0, 0), (0, 2)))
    lifted = composed(arc[:, -1:], straight[:, 2:] - straight[:, 1:2])
    poses = np.concatenate((straight[:, :1], arc, lifted), axis=1)
    return np.column_stack((ways[:, 0], on, ways[:, 2])), poses


def scene_of_push(
    scene: Scene, start: FloatArray, path: FloatArray, others: FloatArray | None = None
) -> Scene:
    """Return the scene of one push: the part at `start` (3,), the tool on `path` (n, 4), and other
    parts at `others` (n_other, 3), by default their poses in the scene."""
    pusher = scene.pushers[0]
    poses = [start, *([own.pose for own in scene.bodies[1:]] if others is None else others)]
    drive = PathDrive(path, force_limit=pusher.drive.force_limit)
    return replace(
        scene,
        bodies=tuple(
            replace(own, pose=pose) for own, pose in zip(scene.bodies, poses, strict=True)
        ),
        pushers=(replace(pusher, pose=path[0, 1:], drive=drive),),
        duration=float(path[-1, 0]),
    )


def swept(path: FloatArray, steps: int = 24) -> FloatArray:
    """Return poses (n, k, 3) of the tool on the way along paths (n, m, 4) [m, m, rad]."""
    share = np.linspace(0.0, 1.0, steps)[:, None]
    waypoints = path[:, :, 1:].swapaxes(0, 1)
    ways = [a[:, None] + share * (b - a)[:, None] for a, b in pairwise(waypoints)]
    return np.concatenate(ways, axis=1)


def fixel_overlap(
    scene: Scene, shape: Shape, poses: FloatArray, fixels: FloatArray | None
) -> FloatArray:
    """Return the deepest overlap (n,) of a shape at poses (n, k, 3) with fixels [m]."""
    deepest = np.full(len(poses), -np.inf)
    for k, fixel in enumerate(scene.fixels):
        own = poses if fixels is None else poses - fixels[:, None, k] * (1.0, 1.0, 0.0)
        depth = overlaps(shape, own.reshape(-1, 3), fixel.shape, fixel.pose).depth
        deepest = np.maximum(deepest, depth.reshape(poses.shape[:2]).max(axis=1))
    return deepest


def touches(shape: Shape, poses: FloatArray, obstacles: Sequence[Polygon]) -> BoolArray:
    """Return whether a shape at any of some poses (n, k, 3) overlaps an obstacle, (n,)."""
    flat, found = poses.reshape(-1, 3), np.zeros(poses.shape[:2], bool)
    for own in obstacles:
        low, high = own.outline.min(axis=0) - shape.radius, own.outline.max(axis=0) + shape.radius
        near = np.flatnonzero(((flat[:, :2] > low) & (flat[:, :2] < high)).all(axis=1))
        found.flat[near] |= overlaps(shape, flat[near], own, np.zeros(3)).depth > 0.0
    return np.asarray(found.any(axis=1))


def _part(scene: Scene, keep: Sequence[str]) -> Body:
    """Return the part that is planned for, after checks of the scene and the other parts."""
    check_push(scene, pushers=(0, 1), several=True)
    known = [own.name for own in scene.bodies[1:]]
    for name in keep:
        check_name("choose.keep", name, known)
    return scene.bodies[0]


def _line(scene: Scene) -> LineDrive:
    drive = scene.pushers[0].drive if scene.pushers else None
    if not isinstance(drive, LineDrive) or drive.speed == 0.0:
        found = "no pusher with a LineDrive"
        expected = "a pusher that moves along a straight line"
        hint = "to plan pushes of a free tool, give choose=FreePushes()"
        raise InvalidInput("scene.pushers", found=found, expected=expected, hint=hint)
    return drive


def _regions(given: Any) -> tuple[Polygon, ...]:
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise InvalidInput("choose.obstacles", found=repr(given), expected="a list of polygons")
    found = []
    for k, own in enumerate(given):
        try:
            found.append(own if isinstance(own, Polygon) else Polygon(own))
        except InvalidInput as problem:
            raise problem.within(f"choose.obstacles[{k}]") from None
    return tuple(found)


def _range(given: Sequence[float], where: str, lowest: float = -math.inf) -> Range:
    low, high = vector(given, where, RANGE).tolist()
    if not lowest <= low <= high:
        expected = "an increasing range" + (" from 0 up" if lowest == 0.0 else "")
        raise InvalidInput(where, found=f"{low:g} to {high:g}", expected=expected)
    return low, high
