"""The fan of outcomes: where a body ends whose start is not quite known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.model import Disk, Pusher, Scene, Shape
from fixel.model.trajectory import wrapped
from fixel.simulation.ensemble import Ensemble, RolloutCase
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepper import AbstractStepper
from fixel.simulation.vary import grown_by, moves, varied_start
from fixel.typing import BoolArray, FloatArray, Progress
from fixel.uncertainty.apart import Neighbour, overlaps, set_apart
from fixel.uncertainty.starts import StartError

Values = Mapping[str, FloatArray]

INSTANTS: Final = 12
PORTION: Final = 1000  # starts between two words of progress
START: Final = ("start_x", "start_y", "start_theta")

# Gap up to which a body counts as touching a fixel, as a share of the body's size. A simulated
# contact is closed to about 1e-6 of it.
TOUCHING: Final = 1e-3

# How much farther than its own error a start may have to be moved to have room.
ROOM: Final = 2.0


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fan:
    """Outcomes of n perturbed starts of one scene.

    Attributes
    ----------
    scene : Scene
    error : StartError
    drawn : (n, 3) float64
        Errors of the start [m, m, rad].
    start : (n, 3) float64
        Where the body started: set apart from what it would have overlapped.
    times : (n_time,) float64
        [s].
    pose : (n, n_time, 3) float64
        Of the body at these, the angle continuous; only rows with `ended` mean anything.
    nominal : (n_time, 3) float64
        Without an error.
    ended : (n,) bool
        Which came to an end: the planned one, or a grasp that jams a rigid drive.
    reasons : tuple of str
        Why there is no end, or that it jammed; empty for the planned one.
    mode : (n,) str
        Which fixels touch at the end, a digit each; empty without fixels.
    motion : str
        Name of the motion model.
    seed : int
    """

    scene: Scene
    error: StartError
    drawn: FloatArray
    start: FloatArray
    times: FloatArray
    pose: FloatArray
    nominal: FloatArray
    ended: BoolArray
    reasons: tuple[str, ...]
    mode: np.ndarray
    motion: str
    seed: int

    @property
    def end(self) -> FloatArray:
        """(k, 3) end poses of those that ended [m, m, rad]."""
        return np.asarray(self.pose[self.ended, -1])

    @property
    def moved_apart(self) -> float:
        """Share of starts that would have overlapped something."""
        asked = self.scene.bodies[0].pose + self.drawn
        return float(np.mean(np.hypot(*(self.start - asked)[:, :2].T) > 1e-12))

    @property
    def arm(self) -> float:
        """Radius of gyration of the body: what a turn is counted as [m/rad]."""
        return float(np.sqrt(self.scene.bodies[0].shape.unit_inertia))


def fan_of(
    scene: Scene,
    error: StartError,
    n: int = 1000,
    *,
    drawn: FloatArray | None = None,
    values: Mapping[str, ArrayLike] | None = None,
    times: ArrayLike | None = None,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Fan:
    """Simulate perturbed starts of a scene.

    Parameters
    ----------
    scene : Scene
        With one free body and at most one pusher.
    error : StartError
    n : int
        How many starts.
    drawn : (n, 3) float64, optional
        Their errors [m, m, rad], where they were drawn elsewhere; `n` does not count then.
    values : mapping of name to float or (n,) array_like, optional
        Parameters; one value for all starts, or one a start for what is uncertain itself.
    times : (n_time,) array_like, optional
        Instants to look at [s]; twelve up to the scene's end where left out.
    motion, stepper, threads : optional
        As for `Ensemble`.
    seed : int
    progress : callable, optional
        Told how many starts of how many are done.

    Raises
    ------
    InvalidInput
        A scene with several free bodies or pushers, or parameters it does not have.
    """
    drawn = error.samples(n, seed) if drawn is None else drawn
    n = len(drawn)
    instants = _instants(scene, times)
    # The last rollout has no error: the nominal one.
    errors = np.vstack((drawn, np.zeros(3)))
    given = _given(values or {}, n)
    columns = _starts(given, errors)
    shape, placed, neighbours = _placed(scene, columns)
    reach = error.reach
    room = ROOM * float(np.hypot(*reach[:2]) + reach[2] * _radius(shape))
    apart, refused = _set_apart(shape, placed, neighbours, room)
    columns["start_x"] += (apart - placed)[:, 0]
    columns["start_y"] += (apart - placed)[:, 1]
    ensemble = Ensemble([RolloutCase(scene, instants)], motion, stepper, threads=threads)
    good = np.array([not reason for reason in refused], bool)
    pose, status, reasons = _simulated(ensemble, columns, good, progress)
    for k in np.flatnonzero(~good):
        reasons[k] = refused[k]
    ended = good & np.isin(status, (codes.CONVERGED, codes.JAMMED))
    nominal = pose[-1]
    # Against the nominal way, angles are small; a body that turns round stays comparable.
    pose[:, :, 2] = nominal[:, 2] + wrapped(pose[:, :, 2] - nominal[:, 2])
    if not ended[-1]:
        raise InvalidInput(
            "scene", found=f"no end without an error: {reasons[-1]}", expected="a push that ends"
        )
    offset = np.column_stack([columns[name][:-1] for name in START])
    return Fan(
        scene=scene,
        error=error,
        drawn=drawn,
        start=scene.bodies[0].pose + offset,
        times=instants,
        pose=pose[:-1],
        nominal=nominal,
        ended=ended[:-1],
        reasons=tuple(reasons[:-1]),
        mode=_modes(scene, pose[:-1, -1]),
        motion=ensemble.motion.name,
        seed=seed,
    )


def _instants(scene: Scene, times: ArrayLike | None) -> FloatArray:
    if times is None:
        return np.asarray(np.linspace(0.0, scene.duration, INSTANTS + 1)[1:])
    return np.atleast_1d(np.asarray(times, np.float64))


def _given(values: Mapping[str, ArrayLike], n: int) -> dict[str, FloatArray]:
    """(n + 1,) a name; the nominal rollout has the mean."""
    found = {}
    for name, value in values.items():
        column = np.asarray(value, np.float64)
        if column.ndim and column.shape != (n,):
            raise InvalidInput(
                f"values.{name}",
                found=f"shape {column.shape}",
                expected=f"one number, or {n}: one a start",
            )
        found[name] = np.append(np.broadcast_to(column, n), column.mean())
    return found


def _starts(given: dict[str, FloatArray], errors: FloatArray) -> dict[str, FloatArray]:
    """Parameters with the errors of the start on top of a start that was calibrated."""
    own = {
        name: np.array(given.get(name, np.zeros(len(errors))) + error)
        for name, error in zip(START, errors.T, strict=True)
    }
    return given | own


def _placed(scene: Scene, values: Values) -> tuple[Shape, FloatArray, list[Neighbour]]:
    """The body's shape, where its outline starts (n, 3), and what stands about it."""
    body = scene.bodies[0]
    starts = varied_start(scene, None, values)
    assert starts is not None
    others = [Neighbour(f.name, f.shape, f.pose) for f in scene.fixels]
    others += [_pusher(scene, pusher, values) for pusher in scene.pushers]
    return body.shape, starts[:, 0], others


def _pusher(scene: Scene, pusher: Pusher, values: Values) -> Neighbour:
    """The pusher as large and where it stands at the start of each rollout."""
    shape, grown = pusher.shape, grown_by(scene, values)
    if grown is not None and isinstance(shape, Disk):
        shape = Disk(shape.radius + float(grown.mean()))
    moved = None
    if moves(values):
        zero = np.zeros(len(values["start_x"]))
        axes = ("registration_x", "registration_y", "registration_theta")
        moved = np.column_stack([values.get(name, zero) for name in axes])
    return Neighbour(pusher.name, shape, pusher.pose, moved)


def _set_apart(
    shape: Shape, poses: FloatArray, neighbours: list[Neighbour], most: float
) -> tuple[FloatArray, list[str]]:
    """As `set_apart`, without neighbours that no start comes near."""
    radius = _radius(shape)
    middle = poses[:, :2].mean(axis=0)
    wander = float(np.hypot(*(poses[:, :2] - middle).T).max()) + most
    near = [
        other
        for other in neighbours
        if other.moved is not None
        or np.hypot(*(other.pose[:2] - middle)) < radius + _radius(other.shape) + wander
    ]
    return set_apart(shape, poses, near, most)


def _radius(shape: Shape) -> float:
    return float(shape.radius)


def _simulated(
    ensemble: Ensemble, columns: Values, good: BoolArray, progress: Progress | None
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


def _modes(scene: Scene, poses: FloatArray) -> np.ndarray:
    """(n,) which fixels the body touches at poses, a digit each."""
    shape = scene.bodies[0].shape
    gap = TOUCHING * float(np.ptp(shape.outline, axis=0).max())
    digits = [
        np.where(overlaps(shape, poses, f.shape, f.pose).depth > -gap, "1", "0")
        for f in scene.fixels
    ]
    modes = np.full(len(poses), "", dtype=f"<U{max(1, len(digits))}")
    for digit in digits:
        modes = np.char.add(modes, digit)
    return modes
