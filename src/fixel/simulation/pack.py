"""Conversion of scenes and parameters to scaled arrays for the kernels.

Every scene has its own units: its characteristic length, speed and mass. Numbers in the kernels are
then of the same size for a part of 1.6 mm and a block of 107 mm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import InvalidInput
from fixel.kernels import arrays as at
from fixel.kernels import batch as families
from fixel.kernels import codes
from fixel.kernels.arrays import Batch, Model
from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    LineDrive,
    NoSupport,
    Pusher,
    Scene,
    Tripod,
    support_points,
)
from fixel.simulation.geometry import contact_pieces
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepper import AbstractStepper, Adaptive
from fixel.simulation.vary import Elements, Variation, VariedScene, composed, vary
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
DEFAULT_TOLERANCE = 1e-5
SMALLEST_STEP = 1e-7  # of an adaptive stepper, scaled


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


def characteristic_units(scene: Scene, speed: float | None = None) -> Units:
    """Compute the units of a scene: radius of gyration, fastest prescribed or initial motion (or a
    given `speed` [m/s]), mass or friction.

    Raises
    ------
    InvalidInput
        Products of speeds, sizes, masses and forces overflow.
    """
    try:
        units = _units(scene, speed)
        scales = [*units, units.speed, units.force, units.torque]
    except (OverflowError, ZeroDivisionError):
        scales = [math.inf]
    if not all(MIN_SCALE < scale < MAX_SCALE for scale in scales):
        length = median(math.sqrt(b.moment_of_inertia / b.mass) for b in scene.bodies)
        raise InvalidInput(
            "scene",
            found=f"a fastest motion of {fastest_motion(scene, length):.3g} m/s "
            f"of bodies of {length:.3g} m and {median(b.mass for b in scene.bodies):.3g} kg",
            expected="speeds, lengths and masses whose products can be computed",
        )
    return units


def _units(scene: Scene, speed: float | None) -> Units:
    bodies = scene.bodies
    length = median(math.sqrt(b.moment_of_inertia / b.mass) for b in bodies)
    if speed is None:
        speed = fastest_motion(scene, length)
    mass = median(b.mass for b in bodies)
    forces = [_friction_force(b, scene.gravity) + math.hypot(*b.force[:2]) for b in bodies]
    force = median(forces)
    if speed < SLOWEST:
        # Without prescribed motion: the speed that the forces would cause over one length.
        speed = math.sqrt((force / mass if force > 0.0 else 1.0) * length)
    time = length / speed
    # Slow pushing: inertia is negligible against friction, which then sets the scale of impulses.
    mass = max(mass, TYPICAL_STEP * force * time**2 / length)
    return Units(length, time, mass)


def fastest_motion(scene: Scene, length: float) -> float:
    """Fastest motion of pushers, and of bodies at the start [m/s]; rotation at arm `length` [m]."""
    pushed = [_fastest(p, length) for p in scene.pushers]
    own = [math.hypot(*b.velocity[:2]) + abs(float(b.velocity[2])) * length for b in scene.bodies]
    return max(pushed + own)


def _fastest(pusher: Pusher, length: float) -> float:
    if isinstance(pusher.drive, LineDrive):
        return pusher.drive.speed
    steps = np.diff(pusher.drive.waypoints, axis=0)
    rate = np.hypot(steps[:, 1], steps[:, 2]) + np.abs(steps[:, 3]) * length
    # Measured paths are noisy; their mean speed is a better scale.
    return float(rate.sum() / steps[:, 0].sum()) if len(steps) else 0.0


def _friction_force(body: Body, gravity: float) -> float:
    if isinstance(body.support, NoSupport):
        return 0.0
    if isinstance(body.support, Ellipsoid):
        return float(body.support.force)
    _, loads, friction = support_points(body.support, body.shape, body.com, body.mass, gravity)
    return float(loads @ friction)


def _elements(scene: Scene) -> Elements:
    rows: list[tuple[int, int, FloatArray, float, float, float, FloatArray]] = []
    nowhere = np.zeros(2)
    for b, body in enumerate(scene.bodies):
        support = body.support
        if isinstance(support, Ellipsoid):
            point = np.asarray(support.centre) - body.com
            arm = support.torque / support.force
            rows.append((b, codes.ELLIPSOID, point, support.force, 1.0, arm, nowhere))
            continue
        points, loads, friction = support_points(
            support, body.shape, body.com, body.mass, scene.gravity
        )
        for point, load, mu in zip(points, loads, friction, strict=True):
            unit = point / support.radius if isinstance(support, Tripod) else nowhere
            rows.append((b, codes.POINT, point, float(load), float(mu), 0.0, unit))
    return Elements(
        np.array([r[0] for r in rows], np.int64),
        np.array([r[1] for r in rows], np.int64),
        np.array([r[2] for r in rows], np.float64).reshape(-1, 2),
        np.array([r[3] for r in rows], np.float64),
        np.array([r[4] for r in rows], np.float64),
        np.array([r[5] for r in rows], np.float64),
        np.array([r[6] for r in rows], np.float64).reshape(-1, 2),
    )


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


def _pieces(scene: Scene) -> Pieces:
    body_of, start, bound, radius = [], [0], [], []
    vertex: list[FloatArray] = []
    real: list[NDArray[np.bool_]] = []
    for k, item in enumerate(_items(scene)):
        shift = item.com if isinstance(item, Body) else np.zeros(2)
        rounding = item.shape.radius if isinstance(item.shape, Disk) else 0.0
        for corners, outline in contact_pieces(item.shape):
            local = corners - shift
            centre = 0.5 * (local.min(axis=0) + local.max(axis=0))
            reach = float(np.hypot(*(local - centre).T).max()) + rounding
            body_of.append(k)
            start.append(start[-1] + len(local))
            bound.append([centre[0], centre[1], reach])
            radius.append(rounding)
            vertex.append(local)
            real.append(outline)
    return Pieces(
        np.array(body_of, np.int64),
        np.array(start, np.int64),
        np.array(bound, np.float64),
        np.array(radius, np.float64),
        np.concatenate(vertex),
        np.concatenate(real).astype(np.int64),
    )


def _pair_tables(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Compute `Scene.friction` and `Scene.restitution` of all pairs as tables (n, n)."""
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
    start = np.array([0.0, *pusher.pose])
    if drive.speed == 0.0 or drive.travel == 0.0:
        return start[None, :]
    # A force-limited pusher may lag and need its line for longer than the duration
    # requires.
    seconds = min(drive.travel / drive.speed, max(duration, 1e-9))
    end = start.copy()
    end[0] = seconds
    end[1:3] += drive.speed * seconds * np.asarray(drive.direction)
    return np.stack((start, end))


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


def check_motion(scene: Scene, motion_kind: int) -> None:
    """Raise for a motion model that needs support friction if a body has none."""
    if motion_kind not in (codes.QUASI_STATIC, codes.FIRST_ORDER):
        return
    for k, body in enumerate(scene.bodies):
        if _friction_force(body, scene.gravity) <= 0.0:
            raise InvalidInput(
                f"bodies[{k}].support",
                found=f"no support friction under body {body.name!r}",
                expected="support friction, for motion without inertia",
                hint="give it a support with friction, or choose dynamic motion",
            )


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
    return Template(scene, motion, stepper).packed(variation, n, duration)


@final
class Template:
    """Scene as arrays, to be completed by the quantities that vary between rollouts.

    Parameters
    ----------
    scene : Scene
    motion, stepper
        Method.
    speed : float, optional
        Characteristic speed [m/s]; the scene's own by default.
    """

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotionModel,
        stepper: AbstractStepper,
        speed: float | None = None,
    ) -> None:
        check_motion(scene, motion.kind)
        self.scene = scene
        self.motion_kind = motion.kind
        self.units = characteristic_units(scene, speed)
        self.com = np.array([b.com for b in scene.bodies], np.float64).reshape(-1, 2)
        self._elements = _elements(scene)
        self._friction, restitution = _pair_tables(scene)
        self._pieces = _pieces(scene)
        self._settings = _settings(stepper, self.units)
        self._model = self._constant(restitution)

    def _constant(self, restitution: FloatArray) -> Model:
        """Create the model with fields that no parameter changes; others are empty or nominal."""
        bodies, units = self.scene.bodies, self.units
        length, force = units.length, units.force
        pieces, elements = self._pieces, self._elements
        drives = [p.drive for p in self.scene.pushers]
        limits = np.array(
            [math.inf if d.force_limit is None else d.force_limit for d in drives]
        ).reshape(-1)
        limited = np.isfinite(limits)
        drive_dof = np.where(limited, 3 * len(bodies) + np.cumsum(limited) - 1, -1)
        factors, _ = self._map()
        return Model(
            mass=np.array([b.mass / units.mass for b in bodies]),
            inertia=np.array([b.moment_of_inertia / (units.mass * length**2) for b in bodies]),
            wrench=np.array([b.force for b in bodies]) / (force * np.array([1.0, 1.0, length])),
            spring=np.array([_spring(b, units) for b in bodies]),
            drag=np.zeros((len(bodies), 3, 3)),
            piece_body=pieces.body,
            piece_start=pieces.start,
            piece_bound=pieces.bound / length,
            piece_radius=pieces.radius / length,
            vertex=np.ascontiguousarray(pieces.vertex / length),
            edge_real=pieces.edge_real,
            friction=np.zeros(0),
            restitution=restitution.reshape(-1),
            element_body=elements.body,
            element_kind=elements.kind,
            element_point=np.zeros((0, 2)),
            element_limit=np.zeros(0),
            element_ratio=np.zeros(0),
            path_start=np.zeros(0, np.int64),
            path=np.zeros((0, 4)),
            force_limit=limits / force,
            drive_dof=drive_dof.astype(np.int64),
            plane=np.zeros((0, 3)),
            map_frame=np.zeros((0, 4)),
            map_factor=np.array(factors, np.float64).reshape(-1),
            sides=0,
        )

    def _map(self) -> tuple[FloatArray, FloatArray]:
        """Return factors of the friction map, (0, 0) without one, and scaled origin and cell."""
        own = self.scene.plane.friction_map
        if own is None:
            return np.zeros((0, 0)), np.zeros(4)
        return own.factor, np.concatenate((own.origin, own.cell)) / self.units.length

    def packed(self, variation: Variation, n: int, duration: ArrayLike) -> PackedBatch:
        """Pack the arrays of `n` rollouts, with one duration [s] each or one for all."""
        scene, units = self.scene, self.units
        length = units.length
        rows = _FamilyRows(n)
        n_body, n_driven = len(scene.names), len(scene.pushers)
        varied = vary(scene, self._elements, self._friction, variation)
        elements, friction, ratio = varied.elements, varied.friction, varied.mass_ratio
        point, limit, arm, drag = self._scaled(elements, n, rows, ratio is not None)
        rows.place(families.PAIR, n_body * n_body, own=friction.ndim == 3)
        radius, bound = self._radii(varied.growth, rows)
        rows.place(families.PIECE_START, len(self._pieces.start))
        rows.place(families.VERTEX, len(self._pieces.vertex))
        rows.place(families.DRIVEN, n_driven)
        rows.place(families.PATH_START, n_driven + 1)
        path, path_start = self._paths(variation, varied, float(np.max(duration)), rows)
        pose = self._poses(varied.start, variation.fixels, rows)
        factors, frame = self._map()
        rows.place(families.MAP, factors.size)
        model = self._model
        copies = {name: n if own else 1 for name, own in rows.own.items()}
        per_free, per_pair = copies[families.FREE], copies[families.PAIR]
        per_piece, per_element = copies[families.PIECE], copies[families.ELEMENT]
        plane = np.broadcast_to(varied.plane, (n, 3))
        velocity = np.array([b.velocity for b in scene.bodies], np.float64).reshape(-1, 3)
        velocity = velocity / (np.array([length, length, 1.0]) / units.time)
        settings = np.tile(self._settings, (n, 1))
        settings[:, at.DURATION] = np.asarray(duration) / units.time
        batch = Batch(
            begin=rows.begin,
            count=rows.count,
            model=model._replace(
                mass=_times(np.tile(model.mass, per_free), ratio),
                inertia=_times(np.tile(model.inertia, per_free), ratio),
                wrench=np.tile(model.wrench, (per_free, 1)),
                spring=np.tile(model.spring, (per_free, 1)),
                drag=drag
                if len(drag) == per_free * len(scene.bodies)
                else np.tile(drag, (n, 1, 1)),
                piece_body=np.tile(model.piece_body, per_piece),
                piece_bound=bound,
                piece_radius=radius,
                friction=np.ascontiguousarray(friction, dtype=np.float64).reshape(-1),
                restitution=np.tile(model.restitution, per_pair),
                element_body=np.tile(elements.body, per_element),
                element_kind=np.tile(elements.kind, per_element),
                element_point=point,
                element_limit=limit,
                element_ratio=arm,
                path_start=path_start,
                path=np.ascontiguousarray(path / np.array([units.time, length, length, 1.0])),
                plane=np.array(plane, order="C"),
                map_frame=np.tile(frame, (n, 1)),
            ),
            map_shape=np.tile(np.array(factors.shape, np.int64), (n, 1)),
            sides=np.full(n, scene.support_directions or 0, np.int64),
            pose=pose,
            velocity=np.tile(velocity, (per_free, 1)),
            settings=settings,
        )
        return PackedBatch(batch, units, self.com, varied.outline)

    def _scaled(
        self, elements: Elements, n: int, rows: _FamilyRows, heavier: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Scale points, limits and arms of the supports, and compute the drag of the bodies."""
        units, n_free = self.units, len(self.scene.bodies)
        n_element = len(elements.body)
        limit = elements.load * elements.friction
        point, arm = elements.point, elements.arm
        own = limit.ndim == 2 or point.ndim == 3 or arm.ndim == 2
        rows.place(families.ELEMENT, n_element, own=own)
        if own:
            limit = np.broadcast_to(limit, (n, n_element))
            point = np.broadcast_to(point, (n, n_element, 2))
            arm = np.broadcast_to(arm, (n, n_element))
        first_order = self.motion_kind == codes.FIRST_ORDER
        rows.place(families.FREE, n_free, own=own and (first_order or heavier))
        drag = np.zeros((n_free, 3, 3))
        if first_order:
            drag = _drag(elements._replace(arm=arm), n_free, limit, point, units.speed)
        scale = np.array([1.0, 1.0, units.length])
        drag = drag * (units.speed / units.force) / np.outer(scale, scale)
        return (
            np.ascontiguousarray(point.reshape(-1, 2) / units.length),
            np.ascontiguousarray(limit.reshape(-1) / units.force),
            np.ascontiguousarray(arm.reshape(-1) / units.length),
            np.ascontiguousarray(drag.reshape(-1, 3, 3)),
        )

    def _radii(self, grown: FloatArray | None, rows: _FamilyRows) -> tuple[FloatArray, FloatArray]:
        """Return scaled rounding radii and bounding circles of pieces, with enlarged pushers."""
        radius, bound = self._model.piece_radius, self._model.piece_bound
        rows.place(families.PIECE, len(radius), own=grown is not None)
        if grown is None:
            return radius, bound
        first = len(self.scene.bodies)
        body = self._pieces.body
        pusher = (body >= first) & (body < first + len(self.scene.pushers))
        more = np.where(pusher, grown[:, None] / self.units.length, 0.0)
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
                rows.place(families.PATH, int(start[-1]))
                return (np.concatenate(waypoints) if waypoints else np.zeros((0, 4))), start
            if len(waypoints) > 1:
                raise InvalidInput(
                    "parameters.registration_x",
                    found=f"{len(waypoints)} pushers",
                    expected="a scene with one pusher",
                )
            path = waypoints[0][None]
        of = variation.path_of
        if registration is not None:
            own = path if of is None else path[of]
            path, of = np.array(np.broadcast_to(own, (len(registration), *own.shape[1:]))), None
            path[:, :, 1:] = composed(registration[:, None], own[:, :, 1:])
        n_sample = path.shape[1]
        rows.place(families.PATH, n_sample, own=True)
        if of is not None:
            rows.begin[:, families.PATH] = n_sample * of
        return path.reshape(-1, 4), np.array([0, n_sample], np.int64)

    def _poses(
        self, start: FloatArray | None, fixels: FloatArray | None, rows: _FamilyRows
    ) -> FloatArray:
        """Return scaled poses of all bodies at time zero; of centres of mass for free bodies."""
        scene, length = self.scene, self.units.length
        n_free = len(scene.bodies)
        own = start is not None or fixels is not None
        rows.place(families.BODY, len(scene.names), own=own)
        pose = np.array([item.pose for item in _items(scene)])
        if own:
            pose = np.tile(pose, (len(rows.begin), 1, 1))
        if start is not None:
            pose[:, :n_free] = start
        if fixels is not None:
            pose[:, len(pose[0]) - len(scene.fixels) :] += fixels
        pose = pose.reshape(-1, len(scene.names), 3)
        c, s = np.cos(pose[:, :n_free, 2]), np.sin(pose[:, :n_free, 2])
        pose[:, :n_free, 0] += c * self.com[:, 0] - s * self.com[:, 1]
        pose[:, :n_free, 1] += s * self.com[:, 0] + c * self.com[:, 1]
        return np.ascontiguousarray(pose.reshape(-1, 3) / np.array([length, length, 1.0]))


def _times(rows: FloatArray, ratio: FloatArray | None) -> FloatArray:
    """Multiply rows (n,) of the one free body by their ratios."""
    return rows if ratio is None else rows * ratio


class _FamilyRows:
    """Rows of each family that a rollout owns, or shares with the others."""

    def __init__(self, n: int) -> None:
        self.count = np.zeros((n, families.N_FAMILY), np.int64)
        self.begin = np.zeros((n, families.N_FAMILY), np.int64)
        self.own = dict.fromkeys(range(families.N_FAMILY), False)

    def place(self, family: int, rows: int, own: bool = False) -> None:
        """Assign `rows` rows of a family to every rollout, shared or its own."""
        self.count[:, family] = rows
        self.own[family] = own
        if own:
            self.begin[:, family] = rows * np.arange(len(self.begin))


def _settings(stepper: AbstractStepper, units: Units) -> FloatArray:
    """Return the row of `Batch.settings` of a stepper, for no duration yet."""
    step, tolerance, largest = stepper.first_step, None, math.inf
    if isinstance(stepper, Adaptive):
        tolerance, largest = stepper.tolerance, stepper.largest_step
    settings = np.zeros(at.N_SETTING)
    settings[at.STEP] = TYPICAL_STEP if step is None else step / units.time
    settings[at.TOLERANCE] = DEFAULT_TOLERANCE if tolerance is None else tolerance / units.length
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
        "mass": families.FREE, "friction": families.PAIR, "piece_body": families.PIECE,
        "piece_start": families.PIECE_START, "vertex": families.VERTEX,
        "element_body": families.ELEMENT, "force_limit": families.DRIVEN,
        "path_start": families.PATH_START, "path": families.PATH, "map_factor": families.MAP,
    }  # fmt: skip
    begin = []
    offset = np.zeros(families.N_FAMILY, np.int64)
    for part in packed:
        begin.append(part.batch.begin + offset)
        for field, family in family_of.items():
            offset[family] += len(getattr(part.batch.model, field))
        offset[families.BODY] += len(part.batch.pose)
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
