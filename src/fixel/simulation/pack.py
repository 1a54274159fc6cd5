"""Conversion of scenes and parameters to scaled arrays for the kernels.

Every scene has its own units: its characteristic length, speed and mass. Numbers in the kernels are
then of the same size for a part of 1.6 mm and a block of 107 mm.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from statistics import median
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.kernels import arrays as at, codes
from fixel.kernels.arrays import Batch, Model
from fixel.model import (
    Body,
    Ellipsoid,
    Fixel,
    LineDrive,
    Pusher,
    Scene,
    Shape,
    Tripod,
    rotated,
    support_points,
)
from fixel.simulation.geometry import contact_outline, pack_shapes
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepping import STEPPERS, AbstractStepper, Adaptive
from fixel.simulation.vary import AS_IT_IS, Elements, Variation, VariedScene, composed, vary
from fixel.typing import FloatArray, IntArray

# Share of the time in which the fastest body moves by one characteristic length; friction impulses
# over such a step are of order one in scaled units.
TYPICAL_STEP = 0.01

# [m/s] Slower motion counts as standing still.
SLOWEST = 1e-34
# Characteristic values whose squares and products do not overflow.
MIN_SCALE, MAX_SCALE = 1e-100, 1e100

# Of position in one adaptive step, in characteristic lengths: 95 % of random grasps then end
# within 0.1 mm and 0.1 degree of the converged result (docs/theory/stepping.md).
DEFAULT_TOLERANCE = 3e-5
# With n free bodies at least n^2 times this, up to a bound: a heap amplifies a micrometre in the
# start pose more than that.
HEAP_TOLERANCE, MAX_HEAP_TOLERANCE = 1e-7, 1e-3
SMALLEST_STEP = 1e-7  # of an adaptive stepper, scaled

Rows = TypeVar("Rows", bound=NDArray[Any])

RECENT_SCENES = 16  # whose arrays are stored, for calls that simulate a scene again


class Units(NamedTuple):
    """Characteristic values of one scene [m, s, kg], which are the units of numbers in the
    kernels."""

    length: float
    time: float
    mass: float

    @property
    def speed(self) -> float:
        return self.length / self.time

    @property
    def force(self) -> float:
        return self.mass * self.length / self.time**2

    @property
    def torque(self) -> float:
        return self.force * self.length


def characteristic_units(
    scene: Scene, speed: float | None = None, friction: Sequence[float] | None = None
) -> Units:
    """Compute the units of a scene: radius of gyration, fastest prescribed or initial motion (or a
    given `speed` [m/s]), mass or friction.

    `friction` is the largest friction force under each body [N], where it is known. Raises
    `InvalidInput` where products of speeds, sizes, masses and forces overflow.
    """
    try:
        units = _units(scene, speed, friction or _friction_forces(supports_of(scene), scene))
        scales = [*units, units.speed, units.force, units.torque]
    except (OverflowError, ZeroDivisionError):
        scales = [math.inf]
    if not all(MIN_SCALE < scale < MAX_SCALE for scale in scales):
        length = characteristic_length(scene)
        raise InvalidInput(
            "scene",
            found=f"a fastest motion of {fastest_motion(scene, length):.3g} m/s "
            f"of bodies of {length:.3g} m and {median(b.mass for b in scene.bodies):.3g} kg",
            expected="speeds, lengths and masses whose products can be computed",
        )
    return units


def _units(scene: Scene, speed: float | None, friction: Sequence[float]) -> Units:
    bodies = scene.bodies
    length = characteristic_length(scene)
    if speed is None:
        speed = fastest_motion(scene, length)
    mass = median(b.mass for b in bodies)
    forces = [f + math.hypot(*b.force[:2]) for f, b in zip(friction, bodies, strict=True)]
    force = median(forces)
    if speed < SLOWEST:
        # Without prescribed motion: the speed that the forces would cause over one length.
        speed = math.sqrt((force / mass if force > 0.0 else 1.0) * length)
    time = length / speed
    # Slow pushing: inertia is negligible against friction, which then sets the scale of impulses.
    mass = max(mass, TYPICAL_STEP * force * time**2 / length)
    return Units(length, time, mass)


def characteristic_length(scene: Scene) -> float:
    """Radius of gyration of the middle body [m]."""
    return median(math.sqrt(b.moment_of_inertia / b.mass) for b in scene.bodies)


def fastest_motion(scene: Scene, length: float) -> float:
    """Fastest motion of pushers, and of bodies at the start [m/s]; rotation at arm `length` [m]."""
    pushed = [_fastest(p, length) for p in scene.pushers]
    return max([*pushed, _fastest_body(scene, length)])


def _fastest_body(scene: Scene, length: float) -> float:
    own = [math.hypot(*b.velocity[:2]) + abs(float(b.velocity[2])) * length for b in scene.bodies]
    return max(own)


def _fastest(pusher: Pusher, length: float) -> float:
    if isinstance(pusher.drive, LineDrive):
        return pusher.drive.speed
    return float(_mean_speed(pusher.drive.waypoints, length))


def _mean_speed(path: FloatArray, length: float) -> FloatArray:
    """Mean speed (...) of paths (..., n, 4) [m/s]; measured ones are noisy."""
    steps = np.diff(path, axis=-2)
    rate = np.hypot(steps[..., 1], steps[..., 2]) + np.abs(steps[..., 3]) * length
    seconds = steps[..., 0].sum(axis=-1)
    return np.asarray(rate.sum(axis=-1) / np.where(seconds > 0.0, seconds, 1.0))


def _friction_forces(elements: Elements, scene: Scene) -> list[float]:
    """Compute the largest friction force under each body [N]."""
    end = np.searchsorted(elements.body, np.arange(len(scene.bodies) + 1)).tolist()
    return [float(elements.load[i:k] @ elements.friction[i:k]) for i, k in itertools.pairwise(end)]


def supports_of(scene: Scene) -> Elements:
    """Return the support friction elements of all free bodies."""
    parts: list[tuple[FloatArray, ...]] = []
    for body in scene.bodies:
        support = body.support
        if isinstance(support, Ellipsoid):
            points = (np.asarray(support.centre) - body.com)[None]
            of_one = (support.force, 1.0, support.torque / support.force)
            parts.append((points, *np.array(of_one)[:, None], np.zeros((1, 2))))
            continue
        points, loads, friction = support_points(
            support, body.shape, body.com, body.mass, scene.gravity
        )
        unit = points / support.radius if isinstance(support, Tripod) else np.zeros(points.shape)
        parts.append((points, loads, friction, np.zeros(len(points)), unit))
    own = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    curved = np.array([isinstance(body.support, Ellipsoid) for body in scene.bodies])
    kind = np.where(curved, codes.ELLIPSOID, codes.POINT)[own]
    return Elements(own, kind, *(np.concatenate(rows) for rows in zip(*parts, strict=True)))


class Pieces(NamedTuple):
    """Convex pieces of all bodies, in body frames (free bodies: from the centre of mass) [m]."""

    body: IntArray
    start: IntArray
    bound: FloatArray
    radius: FloatArray
    vertex: FloatArray
    edge_real: IntArray


def _items(scene: Scene) -> list[Body | Pusher | Fixel]:
    """List all bodies in the order of the kernels."""
    return [*scene.bodies, *scene.pushers, *scene.fixels]


class _Same:
    """Objects as the key of a cache: themselves, since hashing their arrays takes longer than
    packing them. No array of a scene can be written to."""

    __slots__ = ("ids", "objects")

    def __init__(self, *objects: object) -> None:
        self.objects: Any = objects
        self.ids = tuple(map(id, objects))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.ids == other.ids

    def __hash__(self) -> int:
        return hash(self.ids)


@functools.lru_cache(maxsize=RECENT_SCENES)
def _pieces(key: _Same, com: tuple[tuple[float, float], ...]) -> Pieces:
    """Return the pieces of shapes with these origins in their own frames, one after another."""
    shapes: tuple[Shape, ...] = key.objects
    packed = pack_shapes(map(contact_outline, shapes))
    start, radius = packed.piece_start, packed.piece_radius
    count = np.diff(start)
    body = np.repeat(np.arange(len(shapes)), np.diff(packed.shape_start))
    vertex = packed.vertex - np.repeat(np.array(com)[body], count, axis=0)
    low = np.minimum.reduceat(vertex, start[:-1])
    centre = 0.5 * (low + np.maximum.reduceat(vertex, start[:-1]))
    away = vertex - np.repeat(centre, count, axis=0)
    reach = np.maximum.reduceat(np.hypot(away[:, 0], away[:, 1]), start[:-1]) + radius
    return Pieces(body, start, np.column_stack((centre, reach)), radius, vertex, packed.edge_real)


def pair_tables(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return the friction and the restitution of all pairs of bodies of a scene, (n, n) each."""
    names, free = scene.names, len(scene.bodies)
    friction = np.zeros((len(names), len(names)))
    usual = np.zeros((len(names), len(names)))
    obstacles: list[Pusher | Fixel] = [*scene.pushers, *scene.fixels]
    for k, obstacle in enumerate(obstacles, start=free):
        friction[:free, k] = friction[k, :free] = obstacle.friction
        usual[:free, k] = usual[k, :free] = obstacle.restitution
    restitution = usual.copy() if scene.contact_friction else usual
    # Later writes override: names take precedence over patterns, earlier entries over later ones.
    for entry in sorted(reversed(scene.contact_friction), key=lambda entry: entry.is_literal):
        one, other = entry.named(names)
        covered = np.outer(one, other) | np.outer(other, one)
        covered[free:, free:] = False
        np.fill_diagonal(covered, False)
        friction[covered] = entry.friction
        given = entry.restitution
        restitution[covered] = usual[covered] if given is None else given
    return friction, restitution


def pusher_path(pusher: Pusher, duration: float) -> FloatArray:
    """Waypoints (n, 4) of a pusher: time [s], x, y [m], theta [rad]."""
    drive = pusher.drive
    if not isinstance(drive, LineDrive):
        return np.array(drive.waypoints, np.float64)
    x, y, theta = pusher.pose.tolist()
    along_x, along_y = drive.direction.tolist()
    if drive.speed == 0.0 or drive.travel == 0.0:
        rows = [[0.0, x, y, theta]]
        if drive.force_limit is not None:  # the line that it slips along, which it never begins
            later = duration + 1.0
            rows += [[later, x, y, theta], [later + 1.0, x + along_x, y + along_y, theta]]
        return np.array(rows)
    # A force-limited pusher may lag and need its line for longer than the duration
    # requires.
    seconds = min(drive.travel / drive.speed, max(duration, 1e-9))
    way = drive.speed * seconds
    end = [seconds, x + way * along_x, y + way * along_y, theta]
    return np.array([[0.0, x, y, theta], end])


def _drag(
    elements: Elements, n_free: int, limit: FloatArray, point: FloatArray, speed: float
) -> FloatArray:
    """Drag of every body for the first-order model: wrench per twist, from its friction ellipsoid.

    At the characteristic speed the wrench is on the ellipsoid: D = diag(f, f, tau^2 / f) / speed at
    the centre of friction, moved to the centre of mass. Shapes: limit (..., n), point (..., n, 2)
    -> (..., n_free, 3, 3).
    """
    lead = limit.shape[:-1]
    drag = np.zeros((*lead, n_free, 3, 3))
    for b in range(n_free):
        own = elements.body == b
        f = limit[..., own].sum(axis=-1)
        safe = np.where(f > 0.0, f, 1.0)
        centre = (limit[..., own, None] * point[..., own, :]).sum(axis=-2) / safe[..., None]
        arm = np.hypot(*np.moveaxis(point[..., own, :] - centre[..., None, :], -1, 0))
        arm = np.where(elements.kind[own] == codes.ELLIPSOID, elements.arm[..., own], arm)
        torque = (limit[..., own] * arm).sum(axis=-1)
        x, y = centre[..., 0], centre[..., 1]
        drag[..., b, 0, 0] = f
        drag[..., b, 1, 1] = f
        drag[..., b, 0, 2] = drag[..., b, 2, 0] = -f * y
        drag[..., b, 1, 2] = drag[..., b, 2, 1] = f * x
        drag[..., b, 2, 2] = torque**2 / safe + f * (x * x + y * y)
    return drag / speed


def check_motion(scene: Scene, motion_kind: int, friction: Sequence[float] | None = None) -> None:
    """Raise for a motion model that needs support friction if a body has none."""
    if motion_kind not in (codes.QUASI_STATIC, codes.FIRST_ORDER):
        return
    friction = _friction_forces(supports_of(scene), scene) if friction is None else friction
    for k, body in enumerate(scene.bodies):
        if friction[k] <= 0.0:
            found = f"no support friction under body {body.name!r}"
            expected = "support friction, for motion without inertia"
            hint = "give it a support with friction, or choose dynamic motion"
            raise InvalidInput(f"bodies[{k}].support", found=found, expected=expected, hint=hint)


class PackedBatch(NamedTuple):
    """Batch of rollouts of one scene, and the data to convert it back to SI units."""

    batch: Batch
    units: Units
    com: FloatArray  # (n_free, 2) centres of mass in their shape frames [m]
    outline: FloatArray | None  # (n, 3) pose of the outline in the frame of the poses


def pack(
    scene: Scene,
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    variation: Variation,
    n: int,
    duration: float,
) -> PackedBatch:
    """Pack the arrays of `n` rollouts of a scene, which last `duration` [s]."""
    if n == 1 and variation is AS_IT_IS and type(stepper) in STEPPERS:
        return _packed_once(_Same(scene), motion, stepper, duration)
    if variation.path is None:
        return Template(scene, motion, stepper).packed(variation, n, duration)
    # Units are those of the scene, whatever the paths of other runs; the longest step is that of
    # the path of each run.
    length = characteristic_length(scene)
    speed = np.maximum(_mean_speed(variation.path, length), _fastest_body(scene, length))
    packed = Template(scene, motion, stepper).packed(variation, n, duration)
    longer = np.divide(packed.units.speed, speed, out=np.ones(n), where=speed > SLOWEST)
    packed.batch.settings[:, at.LARGEST] *= longer
    return packed


@functools.lru_cache(maxsize=RECENT_SCENES)
def _packed_once(
    key: _Same, motion: AbstractMotionModel, stepper: AbstractStepper, duration: float
) -> PackedBatch:
    return Template(key.objects[0], motion, stepper).packed(AS_IT_IS, 1, duration)


class SceneArrays(NamedTuple):
    """Arrays of a scene under one kind of motion; in a batch, of rollouts that do not vary them.

    Nothing writes to them.
    """

    units: Units
    com: FloatArray  # (n_free, 2) centres of mass in their shape frames [m]
    elements: Elements
    friction: FloatArray  # (n_body, n_body)
    growing: NDArray[np.bool_]  # (n_piece,) whether a piece belongs to a pusher
    factors: FloatArray  # (n_row, n_column) of the friction map
    frame: FloatArray  # (4,) its scaled origin and cell
    model: Model  # scaled; without paths, and with a row for one rollout of `plane` and `map_frame`
    pose: FloatArray  # (n_body, 3) at time zero, scaled; of centres of mass for free bodies
    velocity: FloatArray  # (n_free, 3) scaled


@functools.lru_cache(maxsize=RECENT_SCENES)
def _scene_arrays(key: _Same, motion_kind: int, speed: float | None) -> SceneArrays:
    scene: Scene = key.objects[0]
    items = _items(scene)
    n_free, n_driven = len(scene.bodies), len(scene.pushers)
    elements = supports_of(scene)
    forces = _friction_forces(elements, scene)
    check_motion(scene, motion_kind, forces)
    units = characteristic_units(scene, speed, forces)
    origins = [item.com.tolist() if isinstance(item, Body) else [0.0, 0.0] for item in items]
    pieces = _pieces(_Same(*(item.shape for item in items)), tuple(map(tuple, origins)))
    com = np.array(origins[:n_free])
    friction, restitution = pair_tables(scene)
    own = scene.plane.friction_map
    factors = np.zeros((0, 0)) if own is None else own.factor
    frame = np.zeros(4) if own is None else np.concatenate((own.origin, own.cell))
    per_time = np.array([units.length, units.length, 1.0]) / units.time
    return SceneArrays(
        units=units,
        com=com,
        elements=elements,
        friction=friction,
        growing=(pieces.body >= n_free) & (pieces.body < n_free + n_driven),
        factors=factors,
        frame=frame / units.length,
        model=_constant_model(scene, units, pieces, elements, motion_kind)._replace(
            friction=friction.reshape(-1),
            restitution=restitution.reshape(-1),
            map_factor=np.array(factors).reshape(-1),
        ),
        pose=_scaled_poses(np.array([item.pose for item in items])[None], com, units.length),
        velocity=np.array([b.velocity for b in scene.bodies]) / per_time,
    )


def _constant_model(
    scene: Scene, units: Units, pieces: Pieces, elements: Elements, motion_kind: int
) -> Model:
    """Scale the bodies, drives, pieces and supports of a scene; other fields are empty."""
    bodies, length, force = scene.bodies, units.length, units.force
    point, limit, arm, drag = _scaled_supports(elements, len(bodies), units, motion_kind)
    limits = np.array([p.drive.force_limit or math.inf for p in scene.pushers])
    limited = np.isfinite(limits)
    drive_dof = np.where(limited, 3 * len(bodies) + np.cumsum(limited) - 1, -1)
    inertia = np.array([b.moment_of_inertia for b in bodies])
    return Model(
        mass=np.array([b.mass for b in bodies]) / units.mass,
        inertia=inertia / (units.mass * length**2),
        wrench=np.array([b.force for b in bodies]) / (force * np.array([1.0, 1.0, length])),
        spring=np.array([_spring(b, units) for b in bodies]),
        drag=drag,
        piece_body=pieces.body,
        piece_start=pieces.start,
        piece_bound=pieces.bound / length,
        piece_radius=pieces.radius / length,
        vertex=pieces.vertex / length,
        edge_real=pieces.edge_real,
        friction=np.zeros(0),
        restitution=np.zeros(0),
        element_body=elements.body,
        element_kind=elements.kind,
        element_point=point,
        element_limit=limit,
        element_ratio=arm,
        path_start=np.zeros(0, np.int64),
        path=np.zeros((0, 4)),
        force_limit=limits / force,
        drive_dof=drive_dof.astype(np.int64),
        plane=np.zeros((0, 3)),
        map_frame=np.zeros((0, 4)),
        map_factor=np.zeros(0),
        sides=0,
    )


def _scaled_supports(
    elements: Elements, n_free: int, units: Units, motion_kind: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Scale points, limits and arms of supports ([n,] n_element), and compute the drag of the
    bodies; rows of all rollouts one after another."""
    limit = elements.load * elements.friction
    drag = np.zeros((n_free, 3, 3))
    if motion_kind == codes.FIRST_ORDER:
        drag = _drag(elements, n_free, limit, elements.point, units.speed)
        scale = np.array([1.0, 1.0, units.length])
        drag = drag * (units.speed / units.force) / np.outer(scale, scale)
    return (
        np.ascontiguousarray(elements.point.reshape(-1, 2) / units.length),
        np.ascontiguousarray(limit.reshape(-1) / units.force),
        np.ascontiguousarray(elements.arm.reshape(-1) / units.length),
        np.ascontiguousarray(drag.reshape(-1, 3, 3)),
    )


def _scaled_poses(pose: FloatArray, com: FloatArray, length: float) -> FloatArray:
    """Scale poses (n, n_body, 3), with those of free bodies moved to their centres of mass; the
    result is new, and has the rows of all rollouts one after another."""
    n_free = len(com)
    pose[:, :n_free, :2] += rotated(com, pose[:, :n_free, 2])
    return np.ascontiguousarray(pose.reshape(-1, 3) / np.array([length, length, 1.0]))


class Template:
    """Scene as arrays, to be completed by the quantities that vary between rollouts, for a method
    and a characteristic speed [m/s], by default the scene's own."""

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotionModel,
        stepper: AbstractStepper,
        speed: float | None = None,
    ) -> None:
        self.scene = scene
        self.motion_kind = motion.kind
        self._arrays = _scene_arrays(_Same(scene), motion.kind, speed)
        self.units = self._arrays.units
        self._settings = _settings(stepper, self.units, len(scene.bodies))

    def packed(self, variation: Variation, n: int, duration: ArrayLike) -> PackedBatch:
        """Pack the arrays of `n` rollouts, with one duration [s] each or one for all.

        Rollouts may share arrays with each other and with other batches: they are for reading.
        """
        scene, units, own = self.scene, self.units, self._arrays
        model = own.model
        rows = _FamilyRows(n)
        varied = vary(scene, own.elements, own.friction, variation)
        elements, friction, ratio = varied.elements, varied.friction, varied.mass_ratio
        point, limit, arm, drag = self._supports(elements, rows, ratio is not None)
        rows.place(at.PAIR, len(own.friction) ** 2, own=friction.ndim == 3)
        radius, bound = self._radii(varied.growth, rows)
        rows.place(at.PIECE_START, len(model.piece_start))
        rows.place(at.VERTEX, len(model.vertex))
        rows.place(at.DRIVEN, len(scene.pushers))
        rows.place(at.PATH_START, len(scene.pushers) + 1)
        path, path_start = self._paths(variation, varied, float(np.max(duration)), rows)
        pose = self._poses(varied.start, variation.fixels, rows)
        rows.place(at.MAP, own.factors.size)
        settings = _repeated(self._settings, n)
        settings[:, at.DURATION] = np.asarray(duration) / units.time
        free, pair = rows.copies(at.FREE), rows.copies(at.PAIR)
        heavier = 1.0 if ratio is None else ratio
        element = rows.copies(at.ELEMENT)
        model = model._replace(
            mass=_tiled(model.mass, free) * heavier,
            inertia=_tiled(model.inertia, free) * heavier,
            wrench=_tiled(model.wrench, free),
            spring=_tiled(model.spring, free),
            drag=drag if len(drag) == free * len(scene.bodies) else _tiled(drag, n),
            piece_body=_tiled(model.piece_body, rows.copies(at.PIECE)),
            piece_bound=bound,
            piece_radius=radius,
            friction=np.ascontiguousarray(friction, dtype=np.float64).reshape(-1),
            restitution=_tiled(model.restitution, pair),
            element_body=_tiled(elements.body, element),
            element_kind=_tiled(elements.kind, element),
            element_point=point,
            element_limit=limit,
            element_ratio=arm,
            path_start=path_start,
            path=path / np.array([units.time, units.length, units.length, 1.0]),
            plane=_repeated(varied.plane, n) if varied.plane.ndim == 1 else varied.plane,
            map_frame=_repeated(own.frame, n),
        )
        batch = Batch(
            begin=rows.begin,
            count=rows.count,
            model=model,
            map_shape=_repeated(np.array(own.factors.shape, np.int64), n),
            sides=np.full(n, scene.support_directions or 0, np.int64),
            pose=pose,
            velocity=_tiled(own.velocity, free),
            settings=settings,
        )
        return PackedBatch(batch, units, own.com, varied.outline)

    def _supports(
        self, elements: Elements, rows: _FamilyRows, heavier: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return scaled points, limits and arms of the supports, and the drag of the bodies."""
        n, n_element, n_free = rows.n, len(elements.body), len(self.scene.bodies)
        varied = (elements.load, elements.friction, elements.arm, elements.point[..., 0])
        own = any(values.ndim > 1 for values in varied)
        first_order = self.motion_kind == codes.FIRST_ORDER
        rows.place(at.ELEMENT, n_element, own=own)
        rows.place(at.FREE, n_free, own=own and (first_order or heavier))
        if elements is self._arrays.elements:
            model = self._arrays.model
            return model.element_point, model.element_limit, model.element_ratio, model.drag
        if own:
            elements = elements._replace(
                point=np.broadcast_to(elements.point, (n, n_element, 2)),
                load=np.broadcast_to(elements.load, (n, n_element)),
                arm=np.broadcast_to(elements.arm, (n, n_element)),
            )
        return _scaled_supports(elements, n_free, self.units, self.motion_kind)

    def _radii(self, grown: FloatArray | None, rows: _FamilyRows) -> tuple[FloatArray, FloatArray]:
        """Return scaled rounding radii and bounding circles of pieces, with enlarged pushers."""
        radius, bound = self._arrays.model.piece_radius, self._arrays.model.piece_bound
        rows.place(at.PIECE, len(radius), own=grown is not None)
        if grown is None:
            return radius, bound
        more = np.where(self._arrays.growing, grown[:, None] / self.units.length, 0.0)
        wide = np.repeat(bound[None], len(grown), axis=0)
        wide[:, :, 2] += more
        return np.ascontiguousarray((radius + more).reshape(-1)), wide.reshape(-1, 3)

    def _paths(
        self, variation: Variation, varied: VariedScene, duration: float, rows: _FamilyRows
    ) -> tuple[FloatArray, IntArray]:
        """Return the waypoints of all pushers, and the index of the first of each."""
        path, registration = variation.path, varied.registration
        if path is None:
            waypoints = [pusher_path(p, duration) for p in self.scene.pushers]
            start = np.cumsum([0, *(len(p) for p in waypoints)]).astype(np.int64)
            if registration is None or not waypoints:
                rows.place(at.PATH, int(start[-1]))
                return (np.concatenate(waypoints) if waypoints else np.zeros((0, 4))), start
            if len(waypoints) > 1:
                found, expected = f"{len(waypoints)} pushers", "a scene with one pusher"
                raise InvalidInput("parameters.registration_x", found=found, expected=expected)
            path = waypoints[0][None]
        of = variation.path_of
        if registration is not None:
            own = path if of is None else path[of]
            path, of = np.array(np.broadcast_to(own, (len(registration), *own.shape[1:]))), None
            path[:, :, 1:] = composed(registration[:, None], own[:, :, 1:])
        n_sample = path.shape[1]
        rows.place(at.PATH, n_sample, own=True)
        if of is not None:
            rows.begin[:, at.PATH] = n_sample * of
        return path.reshape(-1, 4), np.array([0, n_sample], np.int64)

    def _poses(
        self, start: FloatArray | None, fixels: FloatArray | None, rows: _FamilyRows
    ) -> FloatArray:
        """Return scaled poses of all bodies at time zero; of centres of mass for free bodies."""
        own = start is not None or fixels is not None
        rows.place(at.BODY, len(self._arrays.pose), own=own)
        if not own:
            return self._arrays.pose
        scene, com = self.scene, self._arrays.com
        pose = np.tile(np.array([item.pose for item in _items(scene)]), (rows.n, 1, 1))
        if start is not None:
            pose[:, : len(com)] = start
        if fixels is not None:
            pose[:, len(pose[0]) - len(scene.fixels) :] += fixels
        return _scaled_poses(pose, com, self.units.length)


def _tiled(rows: Rows, copies: int) -> Rows:
    """Repeat rows; the rows themselves for one copy."""
    if copies == 1:
        return rows
    return _repeated(rows, copies).reshape(copies * len(rows), *rows.shape[1:])  # type: ignore[return-value]


def _repeated(row: Rows, n: int) -> Rows:
    """Copy a row `n` times; much faster than `numpy.tile` for short rows."""
    rows = np.empty((n, *row.shape), row.dtype)
    rows[:] = row
    return rows  # type: ignore[return-value]


class _FamilyRows:
    """Rows of each family that a rollout owns, or shares with the others."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.begin = np.zeros((n, at.N_FAMILY), np.int64)
        self._count = [0] * at.N_FAMILY
        self._own: set[int] = set()

    @property
    def count(self) -> IntArray:
        """Number of rows (n, N_FAMILY) of every rollout."""
        return _repeated(np.array(self._count, np.int64), self.n)

    def copies(self, family: int) -> int:
        """Number of copies of a family's rows in the batch."""
        return self.n if family in self._own else 1

    def place(self, family: int, rows: int, own: bool = False) -> None:
        """Assign `rows` rows of a family to every rollout, shared or its own."""
        self._count[family] = rows
        if own:
            self._own.add(family)
            self.begin[:, family] = rows * np.arange(self.n)


def _settings(stepper: AbstractStepper, units: Units, n_free: int) -> FloatArray:
    """Return the row of `Batch.settings` of a stepper, for no duration yet."""
    step, tolerance, largest = stepper.first_step, None, math.inf
    if isinstance(stepper, Adaptive):
        tolerance, largest = stepper.tolerance, stepper.largest_step
    settings = np.zeros(at.N_SETTING)
    settings[at.STEP] = TYPICAL_STEP if step is None else step / units.time
    usual = max(DEFAULT_TOLERANCE, min(MAX_HEAP_TOLERANCE, HEAP_TOLERANCE * n_free**2))
    settings[at.TOLERANCE] = usual if tolerance is None else tolerance / units.length
    settings[at.SMALLEST] = SMALLEST_STEP
    settings[at.LARGEST] = largest
    return settings


def _spring(body: Body, units: Units) -> list[float]:
    if body.spring is None:
        return [0.0, 0.0, 0.0]
    x, y = body.spring.anchor
    stiffness = body.spring.stiffness * units.length / units.force
    return [stiffness, x / units.length, y / units.length]


def stack(packed: Sequence[PackedBatch]) -> Batch:
    """Concatenate batches of scenes that share nothing."""
    if len(packed) == 1:
        return packed[0].batch
    family_of = {
        "mass": at.FREE, "friction": at.PAIR, "piece_body": at.PIECE,
        "piece_start": at.PIECE_START, "vertex": at.VERTEX,
        "element_body": at.ELEMENT, "force_limit": at.DRIVEN,
        "path_start": at.PATH_START, "path": at.PATH, "map_factor": at.MAP,
    }  # fmt: skip
    begin = []
    offset = np.zeros(at.N_FAMILY, np.int64)
    for part in packed:
        begin.append(part.batch.begin + offset)
        for field, family in family_of.items():
            offset[family] += len(getattr(part.batch.model, field))
        offset[at.BODY] += len(part.batch.pose)
    joined = [
        0 if field == "sides" else np.concatenate([getattr(p.batch.model, field) for p in packed])
        for field in Model._fields
    ]
    return Batch(
        np.concatenate(begin),
        np.concatenate([p.batch.count for p in packed]),
        Model._make(joined),
        *(np.concatenate([getattr(p.batch, field) for p in packed]) for field in Batch._fields[3:]),
    )
