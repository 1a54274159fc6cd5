"""One simulation as plain numbers, for engines that know nothing of fixel's scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.model import Disk, Pusher, Scene
from fixel.model.shape import Shape
from fixel.simulation.geometry import contact_pieces
from fixel.simulation.pack import pair_tables, pusher_path, supports_of
from fixel.simulation.vary import Variation, composed, inverted, vary
from fixel.typing import FloatArray

# Parts on a bench, for which engines and their usual choices are made. Others are scaled to them.
BENCH_SIZE = (0.05, 0.15)  # [m] from the centre of mass to the farthest point of the outline
BENCH_MASS = (0.1, 1.0)  # [kg]


class PlainOutline(NamedTuple):
    """Outline of a body as convex pieces, or as a disc."""

    pieces: tuple[FloatArray, ...]  # (k, 2) corners each, counter-clockwise; the centre of a disc
    radius: float  # of a disc [m]; 0 for polygons


class PlainBody(NamedTuple):
    """Free body. The origin of its frame is its centre of mass."""

    outline: PlainOutline
    mass: float  # [kg]
    inertia: float  # [kg m^2]
    start: FloatArray  # (3,) pose [m, m, rad]
    velocity: FloatArray  # (3,) at the start [m/s, m/s, rad/s]
    points: FloatArray  # (n, 2) support points [m]
    loads: FloatArray  # (n,) normal force on each [N]; largest friction force of an ellipsoid
    friction: FloatArray  # (n,) coefficient of each; 1 for an ellipsoid
    arms: FloatArray  # (n,) largest torque over largest force of an ellipsoid [m]; 0 for points


class PlainPusher(NamedTuple):
    """Pusher. Between two waypoints it moves at constant velocity, after the last it stands."""

    outline: PlainOutline
    path: FloatArray  # (n, 4) time [s], x, y [m], theta [rad]
    force_limit: float | None  # [N] along the path; None: a drive that nothing slows down
    friction: float


class PlainFixel(NamedTuple):
    """Fixed body."""

    outline: PlainOutline
    pose: FloatArray  # (3,) [m, m, rad]
    friction: float


class PlainTask(NamedTuple):
    """Simulation of one body, at most one pusher, and fixels, on a level plane."""

    body: PlainBody
    pusher: PlainPusher | None
    fixels: tuple[PlainFixel, ...]
    times: FloatArray  # (n,) at which poses of the body are wanted [s]; the last is the end
    gravity: float  # [m/s^2]
    values: Mapping[str, float]  # parameters of the engine itself


class TaskUnits(NamedTuple):
    """Units and origin of a task, in SI. Gravity is the same number in all units.

    Simulations in two units are the same motion: lengths differ by `length`, times by its root, and
    masses and forces by `mass`.
    """

    length: float = 1.0  # [m]
    mass: float = 1.0  # [kg]
    origin: tuple[float, float] = (0.0, 0.0)  # [m] without it, a small part may be far away

    @property
    def time(self) -> float:
        """Unit of time [s]."""
        return math.sqrt(self.length)

    def task(self, task: PlainTask) -> PlainTask:
        """Return a task of SI units in these."""
        if self == TaskUnits():
            return task
        body, pusher = task.body, task.pusher
        if pusher is not None:
            path = np.column_stack((pusher.path[:, 0] / self.time, self._poses(pusher.path[:, 1:])))
            pusher = pusher._replace(
                outline=self._outline(pusher.outline),
                path=path,
                force_limit=pusher.force_limit and pusher.force_limit / self.mass,
            )
        return task._replace(
            body=body._replace(
                outline=self._outline(body.outline),
                mass=body.mass / self.mass,
                inertia=body.inertia / (self.mass * self.length**2),
                start=self._poses(body.start),
                velocity=body.velocity * np.array([1.0 / self.time, 1.0 / self.time, self.time]),
                points=body.points / self.length,
                loads=body.loads / self.mass,
                arms=body.arms / self.length,
            ),
            pusher=pusher,
            fixels=tuple(
                own._replace(outline=self._outline(own.outline), pose=self._poses(own.pose))
                for own in task.fixels
            ),
            times=task.times / self.time,
        )

    def si_poses(self, poses: FloatArray) -> FloatArray:
        """Return poses (n, 3) in these units as [m, m, rad]."""
        return np.asarray(poses * (self.length, self.length, 1.0) + (*self.origin, 0.0))

    def _poses(self, poses: FloatArray) -> FloatArray:
        return np.asarray((poses - (*self.origin, 0.0)) / (self.length, self.length, 1.0))

    def _outline(self, outline: PlainOutline) -> PlainOutline:
        pieces = tuple(piece / self.length for piece in outline.pieces)
        return PlainOutline(pieces, outline.radius / self.length)


def bench_units(body: PlainBody) -> TaskUnits:
    """Return the units in which a body has the size and mass of one on a bench; SI for most."""
    outline, (x, y, _) = body.outline, body.start.tolist()
    size = max(float(np.hypot(*piece.T).max()) for piece in outline.pieces) + outline.radius
    length = size / min(max(size, BENCH_SIZE[0]), BENCH_SIZE[1])
    mass = body.mass / min(max(body.mass, BENCH_MASS[0]), BENCH_MASS[1])
    return TaskUnits(length, mass, (0.0, 0.0) if length == 1.0 else (x, y))


def unsupported(scene: Scene) -> str:
    """Return what of a scene a task cannot hold; empty for a scene that it can."""
    if len(scene.bodies) != 1 or len(scene.pushers) > 1:
        return f"{len(scene.bodies)} free bodies and {len(scene.pushers)} pushers"
    free, plane = scene.bodies[0], scene.plane
    if free.spring is not None:
        return "a spring"
    if np.any(free.force != 0.0):
        return "a force on the body other than contact and support friction"
    if plane.friction_map is not None or tuple(plane.anisotropy) != (1.0, 1.0):
        return "a plane whose friction depends on direction or place"
    if pair_tables(scene)[1].any():
        return "restitution"
    return ""


def task_of(
    scene: Scene,
    times: FloatArray,
    values: Mapping[str, float],
    own: Mapping[str, float],
    fixels: FloatArray | None = None,
) -> tuple[PlainTask, Callable[[FloatArray], FloatArray]]:
    """Return a scene as a task, and the function that turns its answer into poses of the scene.

    The frame of a task's poses (n, 3) is at the centre of mass of the body; the scene's is not.

    For scenes that a task can hold, see `unsupported`. Parameters of fixel, `values`, replace
    values of the scene; `own` are those of the engine. Errors of the poses of the fixels
    (n_fixel, 3) are added to them [m, m, rad]. Raise `InvalidInput` for a parameter that no task
    has.
    """
    directed = [name for name in values if name.startswith("anisotropy_")]
    if directed:
        raise InvalidInput(
            f"parameters.{directed[0]}",
            found="a plane whose friction depends on direction",
            expected="parameters that other engines have",
        )
    free = scene.bodies[0]
    columns = {name: np.array([value]) for name, value in values.items()}
    varied = vary(scene, supports_of(scene), pair_tables(scene)[0], Variation(columns))
    supports, friction = varied.elements, _row(varied.friction, 2)[0]
    ratio = 1.0 if varied.mass_ratio is None else float(varied.mass_ratio[0])
    start = np.array(free.pose if varied.start is None else varied.start[0, 0])
    body = PlainBody(
        outline=_outline(free.shape, free.com),
        mass=free.mass * ratio,
        inertia=free.moment_of_inertia * ratio,
        start=_moved(start, free.com),
        velocity=np.array(free.velocity, np.float64),
        points=_row(supports.point, 2),
        loads=_row(supports.load, 1),
        friction=_row(supports.friction, 1),
        arms=np.where(supports.kind == codes.ELLIPSOID, _row(supports.arm, 1), 0.0),
    )
    pusher = None
    for driven in scene.pushers:
        grown = 0.0 if varied.growth is None else float(varied.growth[0])
        pusher = _pusher(driven, float(times[-1]), grown, varied.registration, float(friction[1]))
    first = 1 + len(scene.pushers)
    fixed = tuple(
        PlainFixel(
            _outline(fixel.shape, np.zeros(2)),
            np.array(fixel.pose) + (0.0 if fixels is None else fixels[k]),
            float(friction[first + k]),
        )
        for k, fixel in enumerate(scene.fixels)
    )
    outline = None if varied.outline is None else varied.outline[0]

    def scene_poses(pose: FloatArray) -> FloatArray:
        found = _moved(pose, -free.com)
        return found if outline is None else composed(found, inverted(outline))

    times = np.asarray(times, np.float64)
    return PlainTask(body, pusher, fixed, times, scene.gravity, own), scene_poses


def planar_refusal(task: PlainTask) -> str:
    """Return what of a task an engine with point joints cannot represent."""
    if (task.body.arms > 0.0).any():
        return "an ellipsoidal limit surface; it takes support points"
    return drive_refusal(task)


def drive_refusal(task: PlainTask) -> str:
    """Return a drive that an adapter cannot represent; empty for others."""
    if task.pusher is not None and task.pusher.force_limit is not None:
        return "a drive with a force limit; it takes drives that nothing slows down"
    return ""


def pusher_poses(pusher: PlainPusher, times: FloatArray) -> FloatArray:
    """Return the poses (n, 3) of a pusher that follows its path at times (n,) [s]."""
    path = pusher.path
    return np.column_stack([np.interp(times, path[:, 0], path[:, k]) for k in (1, 2, 3)])


# --- plain values -----------------------------------------------------------------------------


def plain(value: Any) -> Any:
    """Return a task, or a part of it, as objects of JSON."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if hasattr(value, "_asdict"):
        return {name: plain(item) for name, item in value._asdict().items()}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return dict(value) if isinstance(value, Mapping) else value


def task_from(document: Mapping[str, Any]) -> PlainTask:
    """Return the task of a JSON object that `plain` made."""
    body, pusher = document["body"], document["pusher"]
    return PlainTask(
        body=PlainBody(**_arrays(body)),
        pusher=None if pusher is None else PlainPusher(**_arrays(pusher)),
        fixels=tuple(PlainFixel(**_arrays(fixel)) for fixel in document["fixels"]),
        times=np.array(document["times"], np.float64),
        gravity=document["gravity"],
        values=document["values"],
    )


_COLUMNS = {"points": 2, "path": 4}  # of tables, which may have no rows


def _arrays(record: Mapping[str, Any]) -> dict[str, Any]:
    found = {k: np.array(v, np.float64) if isinstance(v, list) else v for k, v in record.items()}
    for name in _COLUMNS.keys() & found.keys():
        found[name] = found[name].reshape(-1, _COLUMNS[name])
    pieces, radius = (record["outline"][name] for name in ("pieces", "radius"))
    return {**found, "outline": PlainOutline(tuple(np.array(piece) for piece in pieces), radius)}


# --- parts ------------------------------------------------------------------------------------


def _pusher(
    pusher: Pusher, duration: float, grown: float, registration: FloatArray | None, friction: float
) -> PlainPusher:
    path = pusher_path(pusher, duration)
    if path[0, 0] != 0.0:  # engines move the pusher from the first waypoint on
        path = np.vstack(([0.0, *pusher.pose], path[path[:, 0] > 0.0]))
    if registration is not None:
        path[:, 1:] = composed(registration, path[:, 1:])
    outline = _outline(pusher.shape, np.zeros(2))
    limit = pusher.drive.force_limit
    return PlainPusher(outline._replace(radius=outline.radius + grown), path, limit, friction)


def _outline(shape: Shape, origin: FloatArray) -> PlainOutline:
    radius = shape.radius if isinstance(shape, Disk) else 0.0
    return PlainOutline(tuple(piece - origin for piece, _ in contact_pieces(shape)), radius)


def _moved(pose: FloatArray, offset: FloatArray) -> FloatArray:
    """Return poses (..., 3) of frames with this offset (2,) in the given ones."""
    return composed(pose, np.array([*offset, 0.0]))


def _row(array: FloatArray, n_axis: int) -> FloatArray:
    """Return the one row of an array that may have an axis of rollouts."""
    return np.array(array if array.ndim == n_axis else array[0], np.float64)
