"""Scenes and parameters as arrays for the kernels. The only place that casts and scales.

Every scene gets units of its own: its characteristic length, speed and mass. A part of 1.6 mm and
a block of 107 mm then give the kernels the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.kernels import batch as families
from fixel.kernels import codes
from fixel.kernels.arrays import Batch, FloatArray, IntArray, Model
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

# A part of the time in which the fastest body moves by one characteristic length; friction
# impulses over such a step are of the order of one in scaled units.
TYPICAL_STEP = 0.01

# Of position in one adaptive step, in characteristic lengths: with it 95 % of random grasps end
# within 0.1 mm and 0.1 degree of converged (docs/theory/stepping.md).
TOLERANCE = 1e-5


class Units(NamedTuple):
    """Characteristic values of one scene [m, s, kg]; everything in the kernels is a multiple of
    them."""

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


def characteristic_units(scene: Scene) -> Units:
    """Units of a scene: radius of gyration, fastest prescribed or initial motion, mass or
    friction."""
    bodies = scene.bodies
    length = median(math.sqrt(b.moment_of_inertia / b.mass) for b in bodies)
    speed = max(
        [_fastest(p, length) for p in scene.pushers]
        + [math.hypot(*b.velocity[:2]) + abs(b.velocity[2]) * length for b in bodies]
    )
    mass = median(b.mass for b in bodies)
    forces = [_friction_force(b, scene.gravity) + math.hypot(*b.force[:2]) for b in bodies]
    force = median(forces)
    if speed == 0.0:
        # Nothing is asked to move: the speed that the forces would give over one length.
        speed = math.sqrt((force / mass if force > 0.0 else 1.0) * length)
    time = length / speed
    # Slow pushing: inertia is nothing against friction, which then sets the scale of impulses.
    mass = max(mass, TYPICAL_STEP * force * time**2 / length)
    return Units(length, time, mass)


def _fastest(pusher: Pusher, length: float) -> float:
    if isinstance(pusher.drive, LineDrive):
        return pusher.drive.speed
    steps = np.diff(pusher.drive.waypoints, axis=0)
    rate = np.hypot(steps[:, 1], steps[:, 2]) + np.abs(steps[:, 3]) * length
    # Measured paths jitter; their mean speed is the better scale.
    return float(rate.sum() / steps[:, 0].sum()) if len(steps) else 0.0


def _friction_force(body: Body, gravity: float) -> float:
    if isinstance(body.support, NoSupport):
        return 0.0
    if isinstance(body.support, Ellipsoid):
        return float(body.support.force)
    _, loads, friction = support_points(body.support, body.shape, body.com, body.mass, gravity)
    return float(loads @ friction)


class Elements(NamedTuple):
    """Support friction elements of all free bodies, SI."""

    body: IntArray  # (n,)
    kind: IntArray  # (n,)
    point: FloatArray  # (n, 2) from the centre of mass [m]
    load: FloatArray  # (n,) normal force [N]; of an ellipsoid its largest force, with friction 1
    friction: FloatArray  # (n,)
    arm: FloatArray  # (n,) ellipsoid: largest torque over largest force [m]
    unit: FloatArray  # (n, 2) tripods: direction of the point, else zero


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
    """All bodies in the order of the kernels."""
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
    names = scene.names
    n = len(names)
    friction = np.zeros((n, n))
    restitution = np.zeros((n, n))
    for a in range(len(scene.bodies)):
        for b in range(a + 1, n):
            friction[a, b] = friction[b, a] = scene.friction(names[a], names[b])
            restitution[a, b] = restitution[b, a] = scene.restitution(names[a], names[b])
    return friction, restitution


def pusher_path(pusher: Pusher, duration: float) -> FloatArray:
    """Waypoints (n, 4) of a pusher: time [s], x, y [m], theta [rad]."""
    drive = pusher.drive
    if not isinstance(drive, LineDrive):
        return np.array(drive.waypoints, np.float64)
    start = np.array([0.0, *pusher.pose])
    if drive.speed == 0.0 or drive.travel == 0.0:
        return start[None, :]
    # A force-limited pusher may lag and need more of its line than the duration alone would ask
    # for.
    seconds = min(drive.travel / drive.speed, max(duration, 1e-9))
    end = start.copy()
    end[0] = seconds
    end[1:3] += drive.speed * seconds * np.asarray(drive.direction)
    return np.stack((start, end))


def _drag(
    elements: Elements, n_free: int, limit: FloatArray, point: FloatArray, speed: float
) -> FloatArray:
    """First-order model: wrench per twist of every body, from the ellipsoid that its supports span.

    At the characteristic speed the ellipsoid is reached: D = diag(f, f, tau^2 / f) / speed at the
    centre of friction, moved to the centre of mass. Shapes: limit (..., n), point (..., n, 2) ->
    (..., n_free, 3, 3).
    """
    lead = limit.shape[:-1]
    drag = np.zeros((*lead, n_free, 3, 3))
    for b in range(n_free):
        own = elements.body == b
        f = limit[..., own].sum(axis=-1)
        safe = np.where(f > 0.0, f, 1.0)
        centre = (limit[..., own, None] * point[..., own, :]).sum(axis=-2) / safe[..., None]
        arm = np.hypot(*np.moveaxis(point[..., own, :] - centre[..., None, :], -1, 0))
        arm = np.where(elements.kind[own] == codes.ELLIPSOID, elements.arm[own], arm)
        torque = (limit[..., own] * arm).sum(axis=-1)
        x, y = centre[..., 0], centre[..., 1]
        drag[..., b, 0, 0] = f
        drag[..., b, 1, 1] = f
        drag[..., b, 0, 2] = drag[..., b, 2, 0] = -f * y
        drag[..., b, 1, 2] = drag[..., b, 2, 1] = f * x
        drag[..., b, 2, 2] = torque**2 / safe + f * (x * x + y * y)
    return drag / speed


def refuse_motion(scene: Scene, motion_kind: int) -> None:
    """Refuse a motion model under which a body of the scene has no law."""
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


class Variation(NamedTuple):
    """What differs from rollout to rollout of one scene; None where nothing does."""

    parameters: Mapping[str, FloatArray]  # name -> (n,)
    start: FloatArray | None  # (n, n_free, 3) poses of the free bodies' shape frames
    path: FloatArray | None  # (n, n_sample, 4) waypoints of the one pusher


class Packed(NamedTuple):
    """A batch of rollouts of one scene, and what turns it back into SI."""

    batch: Batch
    units: Units
    com: FloatArray  # (n_free, 2) centres of mass in their shape frames [m]


def pack(
    scene: Scene,
    motion_kind: int,
    variation: Variation,
    n: int,
    *,
    step: float | None,
    tolerance: float | None,
    largest: float,
    duration: float,
) -> Packed:
    """Arrays of `n` rollouts of a scene.

    Parameters
    ----------
    scene : Scene
    motion_kind : int
        codes.DYNAMIC, QUASI_STATIC or FIRST_ORDER.
    variation : Variation
    n : int
        Number of rollouts.
    step : float or None
        Fixed or first step [s].
    tolerance : float or None
        Of position per step of an adaptive stepper [m].
    largest : float
        Longest step of an adaptive stepper, scaled.
    duration : float
        [s].
    """
    refuse_motion(scene, motion_kind)
    units = characteristic_units(scene)
    length, force = units.length, units.force
    bodies, pushers = scene.bodies, scene.pushers
    n_free, n_driven = len(bodies), len(pushers)
    n_body = len(scene.names)
    elements = _elements(scene)
    pieces = _pieces(scene)
    friction, restitution = _pair_tables(scene)
    com = np.array([b.com for b in bodies], np.float64).reshape(-1, 2)
    values = variation.parameters

    limit = elements.load * elements.friction
    point = elements.point
    if "mu_support" in values:
        _refuse_ellipsoid(elements, "mu_support")
        limit = values["mu_support"][:, None] * elements.load
    if "tripod_radius" in values:
        tripod = np.any(elements.unit != 0.0, axis=1)
        if not tripod.any():
            raise InvalidInput(
                "parameters.tripod_radius",
                found="no body on a tripod",
                expected="a tripod support to change the radius of",
            )
        moved = values["tripod_radius"][:, None, None] * elements.unit
        point = np.where(tripod[:, None], moved, elements.point)
    own_friction = friction
    for name, first, last in (
        ("mu_pusher", n_free, n_free + n_driven),
        ("mu_fixel", n_free + n_driven, n_body),
    ):
        if name in values:
            own_friction = np.array(np.broadcast_to(own_friction, (n, n_body, n_body)))
            own_friction[:, :n_free, first:last] = values[name][:, None, None]
            own_friction[:, first:last, :n_free] = values[name][:, None, None]

    count = np.zeros((n, families.N_FAMILY), np.int64)
    begin = np.zeros((n, families.N_FAMILY), np.int64)

    def place(family: int, rows: int, own: bool) -> None:
        count[:, family] = rows
        if own:
            begin[:, family] = rows * np.arange(n)

    # Elements whose limits or points differ, and what depends on them, get rows of their own.
    own_elements = limit.ndim == 2 or point.ndim == 3
    if own_elements:
        limit = np.ascontiguousarray(np.broadcast_to(limit, (n, len(elements.body))))
        point = np.ascontiguousarray(np.broadcast_to(point, (n, len(elements.body), 2)))
    copies = n if own_elements else 1
    own_drag = own_elements and motion_kind == codes.FIRST_ORDER
    drag = np.zeros((n_free, 3, 3))
    if motion_kind == codes.FIRST_ORDER:
        drag = _drag(elements, n_free, limit, point, units.speed)
    scale = np.array([1.0, 1.0, length])
    drag = drag * (units.speed / force) / np.outer(scale, scale)
    free_copies = n if own_drag else 1

    place(families.FREE, n_free, own_drag)
    place(families.PAIR, n_body * n_body, own_friction.ndim == 3)
    place(families.PIECE, len(pieces.body), False)
    place(families.PIECE_START, len(pieces.start), False)
    place(families.VERTEX, len(pieces.vertex), False)
    place(families.ELEMENT, len(elements.body), own_elements)
    place(families.DRIVEN, n_driven, False)
    place(families.PATH_START, n_driven + 1, False)
    place(families.BODY, n_body, variation.start is not None)

    path, path_start = _paths(scene, duration)
    if variation.path is not None:
        path_start = np.array([0, variation.path.shape[1]], np.int64)
        path = variation.path.reshape(-1, 4)
    place(families.PATH, int(path_start[-1]), variation.path is not None)

    pose = np.zeros((n_body, 3))
    for k, item in enumerate(_items(scene)):
        pose[k] = item.pose
    if variation.start is not None:
        pose = np.array(np.broadcast_to(pose, (n, n_body, 3)))
        pose[:, :n_free] = variation.start
    c, s = np.cos(pose[..., :n_free, 2]), np.sin(pose[..., :n_free, 2])
    pose[..., :n_free, 0] += c * com[:, 0] - s * com[:, 1]
    pose[..., :n_free, 1] += s * com[:, 0] + c * com[:, 1]

    plane = scene.plane
    factors = np.zeros((0, 0))
    frame = np.zeros(4)
    if plane.friction_map is not None:
        factors = np.ascontiguousarray(plane.friction_map.factor, dtype=np.float64)
        frame = np.concatenate((plane.friction_map.origin, plane.friction_map.cell)) / length
    place(families.MAP, factors.size, False)

    limits = np.array(
        [math.inf if p.drive.force_limit is None else p.drive.force_limit for p in pushers]
    ).reshape(-1)
    limited = np.isfinite(limits)
    drive_dof = np.where(limited, 3 * n_free + np.cumsum(limited) - 1, -1).astype(np.int64)
    tolerance_scaled = TOLERANCE if tolerance is None else tolerance / length
    first_step = TYPICAL_STEP if step is None else step / units.time
    pace = np.array([duration / units.time, first_step, tolerance_scaled, 1e-7, largest])

    per_length = np.array([length, length, 1.0])
    model = Model(
        mass=np.tile([b.mass / units.mass for b in bodies], free_copies),
        inertia=np.tile(
            [b.moment_of_inertia / (units.mass * length**2) for b in bodies], free_copies
        ),
        wrench=np.tile(
            np.array([b.force for b in bodies]) / (force * np.array([1.0, 1.0, length])),
            (free_copies, 1),
        ),
        spring=np.tile(np.array([_spring(b, units) for b in bodies]), (free_copies, 1)),
        drag=np.ascontiguousarray(drag.reshape(-1, 3, 3)),
        piece_body=pieces.body,
        piece_start=pieces.start,
        piece_bound=pieces.bound / length,
        piece_radius=pieces.radius / length,
        vertex=np.ascontiguousarray(pieces.vertex / length),
        edge_real=pieces.edge_real,
        friction=np.ascontiguousarray(own_friction, dtype=np.float64).reshape(-1),
        restitution=np.tile(restitution.reshape(-1), n if own_friction.ndim == 3 else 1),
        element_body=np.tile(elements.body, copies),
        element_kind=np.tile(elements.kind, copies),
        element_point=np.ascontiguousarray(point.reshape(-1, 2) / length),
        element_limit=np.ascontiguousarray(limit.reshape(-1) / force),
        element_ratio=np.tile(elements.arm / length, copies),
        path_start=path_start,
        path=np.ascontiguousarray(path / np.array([units.time, length, length, 1.0])),
        force_limit=limits / force,
        drive_dof=drive_dof,
        plane=np.tile(np.array([*plane.anisotropy, plane.axis], np.float64), (n, 1)),
        map_frame=np.tile(frame, (n, 1)),
        map_factor=np.array(factors, np.float64).reshape(-1),
        sides=0,
    )
    velocity = np.array([b.velocity for b in bodies], np.float64).reshape(-1, 3)
    velocity = velocity / (np.array([length, length, 1.0]) / units.time)
    batch = Batch(
        begin=begin,
        count=count,
        model=model,
        map_shape=np.tile(np.array(factors.shape, np.int64), (n, 1)),
        sides=np.full(n, scene.support_directions or 0, np.int64),
        pose=np.ascontiguousarray(pose.reshape(-1, 3) / per_length),
        velocity=np.tile(velocity, (free_copies, 1)),
        pace=np.tile(pace, (n, 1)),
    )
    return Packed(batch, units, com)


def _refuse_ellipsoid(elements: Elements, name: str) -> None:
    if np.any(elements.kind == codes.ELLIPSOID):
        raise InvalidInput(
            f"parameters.{name}",
            found="a body on an ellipsoidal limit surface, which has no coefficient",
            expected="bodies on support points",
        )


def _paths(scene: Scene, duration: float) -> tuple[FloatArray, IntArray]:
    paths = [pusher_path(p, duration) for p in scene.pushers]
    start = np.concatenate(([0], np.cumsum([len(p) for p in paths]))).astype(np.int64)
    return (np.concatenate(paths) if paths else np.zeros((0, 4))), start


def _spring(body: Body, units: Units) -> list[float]:
    if body.spring is None:
        return [0.0, 0.0, 0.0]
    x, y = body.spring.anchor
    stiffness = body.spring.stiffness * units.length / units.force
    return [stiffness, x / units.length, y / units.length]


def stack(packed: Sequence[Packed]) -> Batch:
    """Several batches end to end, for scenes that share nothing."""
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
