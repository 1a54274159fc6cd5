"""Ensemble of simulations of one push from perturbed starts, which are freed from overlaps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.model import Disk, Pusher, Scene, Shape, rotated
from fixel.model.overlap import Overlap, overlaps
from fixel.model.trajectory import wrapped
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.rollouts import RolloutCase, Rollouts, ensemble_of
from fixel.simulation.stepping import AbstractStepper
from fixel.simulation.vary import composed, grown_by, inverted, registration_of, varied_start
from fixel.typing import BoolArray, FloatArray, ProgressCallback
from fixel.uncertainty.error_terms import StartError
from fixel.uncertainty.prediction import Prediction

Values = Mapping[str, FloatArray]

INSTANTS: Final = 12
PORTION: Final = 1000  # starts between two calls of the progress callback
START: Final = ("start_x", "start_y", "start_theta")

# Largest distance by which a start may be moved out of neighbours, over the size of its error.
ROOM: Final = 2.0


def simulate_starts(
    scene: Scene,
    error: StartError | None,
    n: int = 1000,
    *,
    drawn: FloatArray | None = None,
    values: Mapping[str, ArrayLike] | None = None,
    nominal: Mapping[str, float] | None = None,
    times: ArrayLike | None = None,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> Prediction:
    """Simulate n perturbed starts of a scene with one free body and at most one pusher.

    Without a start error, overlaps of the nominal start are ignored. Errors (n, 3) may be `drawn`
    elsewhere [m, m, rad]. Parameters have one value for all starts, or one per start; those of the
    nominal simulation are by default the means of `values`. By default, twelve instants [s] are
    recorded, up to the end of the scene. Progress is called with the number of starts done and in
    all. A scene with several free bodies or pushers, or without a parameter, raises `InvalidInput`.
    """
    if drawn is None:
        drawn = np.zeros((n, 3)) if error is None else error.samples(n, seed)
    n = len(drawn)
    if times is None:
        times = np.linspace(0.0, scene.duration, INSTANTS + 1)[1:]
    instants = np.atleast_1d(np.asarray(times, np.float64))
    # The last rollout has no error: the nominal one.
    errors = np.vstack((drawn, np.zeros(3)))
    given = _given(values or {}, n, nominal or {})
    columns = _starts(given, errors)
    refused = [""] * (n + 1) if error is None else _set_apart(scene, columns, error)
    ensemble = ensemble_of([RolloutCase(scene, instants)], motion, stepper, threads)
    good = np.array([not reason for reason in refused], bool)
    pose, status, reasons = _simulated(ensemble, columns, good, progress)
    for k in np.flatnonzero(~good):
        reasons[k] = refused[k]
    ended = good & np.isin(status, (codes.CONVERGED, codes.JAMMED))
    still = pose[-1]
    # Relative to the nominal motion, angles are small, also for a body that turns by full turns.
    pose[:, :, 2] = still[:, 2] + wrapped(pose[:, :, 2] - still[:, 2])
    if not ended[-1]:
        found = f"no end pose without start error: {reasons[-1]}"
        raise InvalidInput("scene", found=found, expected="a push that can be simulated")
    offset = np.column_stack([columns[name][:-1] for name in START])
    return Prediction(
        scene=scene,
        error=error,
        drawn=drawn,
        start=scene.bodies[0].pose + offset,
        time=instants,
        pose=pose[:-1],
        nominal=still,
        ended=ended[:-1],
        reasons=tuple(reasons[:-1]),
        motion=ensemble.motion.name,
        seed=seed,
        parameters={name: column[:-1] for name, column in given.items()},
    )


def _given(
    values: Mapping[str, ArrayLike], n: int, nominal: Mapping[str, float]
) -> dict[str, FloatArray]:
    """Return (n + 1,) values per parameter; those of the nominal rollout are means by default."""
    found = {}
    for name, value in values.items():
        column = np.asarray(value, np.float64)
        if column.ndim and column.shape != (n,):
            raise InvalidInput(
                f"values.{name}",
                found=f"shape {column.shape}",
                expected=f"one number, or {n} numbers, one per start",
            )
        found[name] = np.append(np.broadcast_to(column, n), nominal.get(name, column.mean()))
    return found


def _starts(given: dict[str, FloatArray], errors: FloatArray) -> dict[str, FloatArray]:
    """Return the parameters, with the start errors added to a calibrated start."""
    own = {
        name: np.array(given.get(name, np.zeros(len(errors))) + error)
        for name, error in zip(START, errors.T, strict=True)
    }
    return given | own


def _placed(scene: Scene, values: Values) -> tuple[Shape, FloatArray, list[Neighbour]]:
    """Return the shape of the body, the start poses of its outline (n, 3), and its neighbours."""
    body = scene.bodies[0]
    starts = varied_start(scene, None, values)
    assert starts is not None
    others = [Neighbour(f.name, f.shape, f.pose) for f in scene.fixels]
    others += [_pusher(scene, pusher, values) for pusher in scene.pushers]
    return body.shape, starts[:, 0], others


def _pusher(scene: Scene, pusher: Pusher, values: Values) -> Neighbour:
    """Return the pusher with its size and its pose at the start of each rollout."""
    shape, grown = pusher.shape, grown_by(scene, values)
    if grown is not None and isinstance(shape, Disk):
        shape = Disk(shape.radius + float(grown.mean()))
    return Neighbour(pusher.name, shape, pusher.pose, registration_of(values))


def _set_apart(scene: Scene, columns: dict[str, FloatArray], error: StartError) -> list[str]:
    """Move starts out of the neighbours that they may reach; return why some have no room."""
    shape, poses, neighbours = _placed(scene, columns)
    reach = error.reach
    most = ROOM * float(np.hypot(*reach[:2]) + reach[2] * shape.radius)
    middle = poses[:, :2].mean(axis=0)
    wander = float(np.hypot(*(poses[:, :2] - middle).T).max()) + most
    near = [
        other
        for other in neighbours
        if other.moved is not None
        or np.hypot(*(other.pose[:2] - middle)) < shape.radius + other.shape.radius + wander
    ]
    moved, refused = remove_overlap(shape, poses, near, most)
    columns["start_x"] += (moved - poses)[:, 0]
    columns["start_y"] += (moved - poses)[:, 1]
    return refused


def _simulated(
    ensemble: Rollouts, columns: Values, good: BoolArray, progress: ProgressCallback | None
) -> tuple[FloatArray, np.ndarray, list[str]]:
    n = len(good)
    pose = np.zeros((n, ensemble.n_sample, 3))
    status = np.full(n, -1)
    reasons = [""] * n
    rows = np.flatnonzero(good)
    for k in range(0, len(rows), PORTION):
        own = rows[k : k + PORTION]
        values = {name: np.ascontiguousarray(column[own]) for name, column in columns.items()}
        outcome = ensemble.simulate(np.zeros(len(own), np.int64), values)
        pose[own], status[own] = outcome.pose, outcome.status
        for row, reason in zip(own, outcome.reasons, strict=True):
            reasons[row] = reason
        if progress is not None:
            progress(min(k + PORTION, len(rows)), len(rows))
    return pose, status, reasons


# A body that rests against a pusher overlaps it for half of all start errors. This is impossible in
# reality, so the body is moved out along the shortest way, without rotation.


ROUNDS: Final = 8  # moves out of one neighbour, perhaps into another
ROUNDING: Final = 1e-9  # overlap that still counts as touching, over the size of a body


class Neighbour(NamedTuple):
    """Fixel or pusher that a body may overlap."""

    name: str
    shape: Shape
    pose: FloatArray  # (3,)
    moved: FloatArray | None = None  # (n, 3) world motions that take it to its poses


def remove_overlap(
    shape: Shape, poses: FloatArray, neighbours: list[Neighbour], most: float
) -> tuple[FloatArray, list[str]]:
    """Move poses (n, 3) of a body out of its neighbours, by at most `most` [m].

    Return the poses, and for each the reason why it is impossible; empty for the others.
    """
    moved = np.array(poses)
    reasons = [""] * len(poses)
    size = float(np.ptp(shape.outline, axis=0).max())
    inside = np.full(len(poses), -1)
    for _ in range(ROUNDS):
        deepest = np.full(len(poses), ROUNDING * size)
        inside[:] = -1
        way = np.zeros((len(poses), 2))
        for k, other in enumerate(neighbours):
            found = _overlaps(shape, moved, other)
            worse = found.depth > deepest
            deepest[worse], way[worse], inside[worse] = found.depth[worse], found.way[worse], k
        hit = inside >= 0
        if not hit.any():
            break
        moved[hit, :2] += deepest[hit, None] * way[hit]
    far = np.hypot(*(moved - poses)[:, :2].T) > most
    for k in np.flatnonzero(far | (inside >= 0)).tolist():
        name = neighbours[inside[k]].name if inside[k] >= 0 else "a neighbour"
        reasons[k] = f"starts inside {name}, and no free space is next to it"
    return moved, reasons


def _overlaps(shape: Shape, poses: FloatArray, other: Neighbour) -> Overlap:
    if other.moved is None:
        return overlaps(shape, poses, other.shape, other.pose)
    seen = composed(inverted(other.moved), poses)
    found = overlaps(shape, seen, other.shape, other.pose)
    return Overlap(found.depth, rotated(found.way, other.moved[:, 2]))
