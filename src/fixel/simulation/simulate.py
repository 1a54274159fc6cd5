"""Simulation of one scene."""

from __future__ import annotations

import functools
import math
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib import import_module
from importlib.metadata import version
from os import PathLike
from typing import Any, Protocol, final, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel.errors import Interrupted, InvalidInput, SolveFailed
from fixel.kernels import arrays, codes
from fixel.kernels.samples import SAMPLE_SLACK
from fixel.model import Parameters, PathDrive, Scene
from fixel.model.fields import floats, frozen, instance, positive, settle, texts, whole
from fixel.registry import offered
from fixel.simulation.first_code import is_missing, roll_in_python
from fixel.simulation.motion import AbstractMotionModel, OtherEngine, motion_model, named_part
from fixel.simulation.pack import RECENT_SCENES, PackedBatch, Units, pack
from fixel.simulation.plain import rollout_in_python
from fixel.simulation.result import CONTACT_FIELDS, Accuracy, PusherTrajectory, Simulation
from fixel.simulation.stepping import (
    SOLVERS,
    STEPPERS,
    AbstractSolver,
    AbstractStepper,
    Adaptive,
    GaussSeidel,
    Lemke,
    Newton,
)
from fixel.simulation.threads import (
    borrowed_record,
    empty_record,
    give_back,
    pose_units,
    poses_at,
    rollout_in_threads,
    shape_poses,
)
from fixel.simulation.vary import AS_IT_IS, Variation, check_one_pusher, variation_of
from fixel.trust import permit
from fixel.typing import FloatArray, IntArray

MAX_STEPS = 1_000_000  # of a stepper without a limit
ADAPTIVE_STEPS = 100_000  # of adaptive ones, by default
ALTERNATING_STEPS = 5_000  # the same for quasi-static motion with friction polygons
MAX_SAMPLES = 200_000
USUAL_SAMPLES = 1_000  # steps of an adaptive stepper, of which most scenes take fewer
INSTANT = 1e-6  # duration of a start-up simulation [s]: one step of any stepper
DEFAULT_SOLVER = Newton()
CONTACTS_PER_BODY = 8  # rows of the contact table per sample and moving body


@runtime_checkable
class SceneWithMethod(Protocol):
    """Scene with the method that its file requests, such as `fixel.formats.SceneFile`."""

    @property
    def scene(self) -> Scene: ...
    @property
    def motion(self) -> str: ...
    @property
    def stepper(self) -> AbstractStepper: ...
    @property
    def output_interval(self) -> float | None: ...


def simulate(
    scene: Scene | SceneWithMethod | str | PathLike[str],
    parameters: Mapping[str, float] | None = None,
    *,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    solver: AbstractSolver | str | None = None,
    duration: float | None = None,
    output_interval: float | None = None,
    max_contacts: int = 4096,
    plain: bool = False,
    check: bool = False,
    accuracy: bool = False,
    derivatives: Sequence[str] = (),
) -> Simulation:
    """Simulate one scene.

    Parameters
    ----------
    scene : Scene, SceneFile, str or path
        Scene; or what `load_scene` returns, or a scene file, whose motion model, step and output
        interval then apply.
    parameters : mapping of str to float, optional
        Values in SI units that replace the scene's own, such as ``{"mu_pusher": 0.2}``.
    motion, stepper, solver : optional
        Method, or the name of a motion model (``"quasistatic"``) or solver; `Dynamic()`,
        `Adaptive()` and `Newton()` by default.
    duration : float, optional
        Simulated time [s]; the scene's by default.
    output_interval : float, optional
        Time between samples [s]; by default a sample at the end of every step.
    max_contacts : int
        Largest number of contacts; more end the rollout with the status ``contact_overflow``.
    plain : bool
        Whether to run the steps in Python, one part at a time; always done for plug-ins.
    check : bool
        Whether to raise `SolveFailed` instead of returning a simulation that stopped early.
    accuracy : bool
        Whether to solve the scene in a second, independent way and compare both ends; see
        `Accuracy`. It takes about five times as long, and ten times for motion with inertia.
    derivatives : sequence of str
        Parameters, or ``"x"``, ``"y"`` and ``"theta"`` of the start pose, by which to differentiate
        the end; for quasi-static motion of one part.

    Returns
    -------
    Simulation
        Results with a status; after a failure, those computed until then.

    Raises
    ------
    InvalidInput
        The scene is a template, or the method does not suit it.
    SolveFailed
        Only with `check`.
    Interrupted
        Ctrl-C; its `result` is the simulation up to then.

    References
    ----------
    :cite:t:`stewart1996`; :cite:t:`anitescu1997`.

    Examples
    --------
    >>> from fixel.testing.scenes import pushed_square
    >>> push = simulate(pushed_square(), {"mu_pusher": 0.3})
    >>> x, y, theta = push.final["part"]
    >>> print(f"moved {1e3 * x:.1f} mm, status {push.status}")
    moved 32.0 mm, status converged
    """
    simulator = Simulator(
        scene, motion=motion, stepper=stepper, solver=solver, max_contacts=max_contacts, plain=plain
    )
    return simulator.run(
        parameters,
        duration=duration,
        output_interval=output_interval,
        check=check,
        accuracy=accuracy,
        derivatives=derivatives,
    )


@final
class Simulator:
    """Scene and method, to simulate many times with small changes.

    A run takes less time than `simulate` with a new scene: the parts of the scene that do not
    change are converted for the compiled loop once. For many runs in one call, on all cores, use
    `simulate_batch`.

    Parameters
    ----------
    scene : Scene, SceneFile, str or path
        Scene; or what `load_scene` returns, or a scene file, whose motion model, step and output
        interval then apply.
    motion, stepper, solver : optional
        Method, or the name of a motion model (``"quasistatic"``) or solver; `Dynamic()`,
        `Adaptive()` and `Newton()` by default.
    max_contacts : int
        Largest number of contacts; more end the rollout with the status ``contact_overflow``.
    plain : bool
        Whether to run the steps in Python, one part at a time; always done for plug-ins.

    Raises
    ------
    InvalidInput
        The method does not suit the scene.

    Examples
    --------
    >>> from fixel.testing.scenes import pushed_square
    >>> simulator = Simulator(pushed_square())
    >>> for start in [(0, 0, 0), (0, 2e-3, 0)]:
    ...     push = simulator.run({"mu_pusher": 0.3}, start=start)
    ...     print(f"turned {push.final['part'].theta:.2f} rad")
    turned -0.30 rad
    turned -0.28 rad
    """

    def __init__(
        self,
        scene: Scene | SceneWithMethod | str | PathLike[str],
        *,
        motion: AbstractMotionModel | str | None = None,
        stepper: AbstractStepper | None = None,
        solver: AbstractSolver | str | None = None,
        max_contacts: int = 4096,
        plain: bool = False,
    ) -> None:
        self._interval: float | None = None
        permit(motion)
        if not isinstance(scene, Scene):
            file = scene_file(scene, "a Scene or a scene file")
            motion = motion or file.motion
            stepper = stepper or file.stepper
            self._interval = file.output_interval
            scene = file.scene
        self.scene = scene
        self.motion = motion_model(motion)
        self.stepper = Adaptive() if stepper is None else stepper
        self.solver = named_part(DEFAULT_SOLVER if solver is None else solver, SOLVERS, "solver")
        check_method(scene, self.solver)
        parts = (self.motion, self.stepper, self.solver)
        own = is_compiled(self.motion) and is_compiled(self.stepper) and is_compiled(self.solver)
        convert = _converted if own else _converted.__wrapped__
        polygons = scene.support_directions is not None
        self._method, self._described = convert(
            *parts, whole(max_contacts, "max_contacts", 0), polygons
        )
        self._plain = plain or not own

    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        start: ArrayLike | None = None,
        waypoints: ArrayLike | None = None,
        duration: float | None = None,
        output_interval: float | None = None,
        check: bool = False,
        accuracy: bool = False,
        derivatives: Sequence[str] = (),
    ) -> Simulation:
        """Simulate the scene, with changes for this run only.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Values in SI units that replace the scene's own, such as ``{"mu_pusher": 0.2}``.
        start : (3,) or (n_free, 3) array_like, optional
            Start pose of every free body [m, m, rad]; the scene's by default.
        waypoints : (n, 4) array_like, optional
            Path of the one pusher: time [s], x, y [m], theta [rad]; the scene's by default.
        duration : float, optional
            Simulated time [s]; the scene's by default.
        output_interval : float, optional
            Time between samples [s]; by default a sample at the end of every step.
        check : bool
            Whether to raise `SolveFailed` instead of returning a simulation that stopped early.
        accuracy, derivatives : optional
            As for `simulate`.

        Returns
        -------
        Simulation
            Bit for bit that of `simulate` for the changed scene, which is its `scene`.

        Raises
        ------
        InvalidInput
            The scene is a template, a change does not suit it, or bodies overlap at the start.
        SolveFailed
            Only with `check`.
        Interrupted
            Ctrl-C; its `result` is the simulation up to then.
        """
        scene, derivatives = self._changed(start, waypoints), texts(derivatives, "derivatives")
        duration = duration_of(scene, duration)
        interval = self._interval if output_interval is None else output_interval
        parameters = None if parameters is None else Parameters(parameters)
        variation = one_variation(parameters)
        if start is not None:  # no other array depends on it
            variation = variation._replace(start=np.array([[body.pose for body in scene.bodies]]))
        times = None if interval is None else sample_times(duration, interval)
        if isinstance(self.motion, OtherEngine):
            if accuracy or derivatives:
                asked = "accuracy" if accuracy else "derivatives"
                name = f"the engine {self.motion.name}"
                raise InvalidInput(asked, found=name, expected="a motion model of fixel")
            engines = import_module("fixel.simulation.engines.ensemble")
            found = engines.fields_of_engine(scene, self.motion, parameters, duration, times)
        else:
            known = self.scene if waypoints is None else scene
            packed = pack(known, self.motion, self.stepper, variation, 1, duration)
            seconds = clock.perf_counter()
            record = self._record(packed, duration, times)
            seconds = clock.perf_counter() - seconds
            found = _unpacked(scene, packed, record, duration, times)
            found |= {"wall_time_s": seconds, "method": dict(self._described)}
            if accuracy or derivatives:
                found |= self._follow_modes(
                    known, variation, packed, record.status, found, accuracy, derivatives
                )
            if not self._plain:
                give_back(record)
        simulation = Simulation(
            scene=scene, parameters=parameters, version=fixel_version(), **found
        )
        if simulation.status == codes.STATUS_NAMES[codes.INTERRUPTED]:
            raise Interrupted(simulation)
        if check and not simulation.converged:
            raise SolveFailed(
                f"{simulation.status} at {simulation.stopped_at:.6g} s. {simulation.advice}",
                status=simulation.status,
                stopped_at=simulation.stopped_at,
            )
        return simulation

    def ends(
        self,
        parameters: Mapping[str, ArrayLike] | Sequence[Mapping[str, float]] | None = None,
        *,
        start: ArrayLike | None = None,
        waypoints: ArrayLike | None = None,
        duration: float | None = None,
        threads: int | None = None,
    ) -> tuple[FloatArray, NDArray[np.str_]]:
        """Simulate the scene in many variations, and return only how they end.

        For searches, which call this often: no samples, contacts or forces are stored.

        Parameters
        ----------
        parameters, start, waypoints, duration, threads : optional
            As for `simulate_batch`.

        Returns
        -------
        poses : (n, n_free, 3) float64
            Last pose of the shape frame of every free body [m, m, rad], bit for bit that of
            `simulate_batch`.
        status : (n,) str
            ``converged``, or the reason of an early end (`fixel.kernels.codes.STATUS_NAMES`).

        Raises
        ------
        InvalidInput
            As for `simulate_batch`.

        Examples
        --------
        >>> from fixel.testing.scenes import pushed_square
        >>> simulator = Simulator(pushed_square(), motion="quasistatic")
        >>> poses, status = simulator.ends({"mu_pusher": [0.1, 0.2, 0.3]})
        >>> poses.shape, status.tolist()
        ((3, 1, 3), ['converged', 'converged', 'converged'])
        """
        check_compiled(self.motion, self.stepper, self.solver)
        variation, n = variation_of(self.scene, parameters, start, waypoints)
        seconds = duration_of(self.scene, duration)
        packed = pack(self.scene, self.motion, self.stepper, variation, n, seconds)
        end = packed.batch.settings[:, arrays.DURATION, None]
        poses, status = poses_at(packed, self._method, end, threads)
        return poses[:, 0], np.array(codes.STATUS_NAMES)[status]

    def _changed(self, start: ArrayLike | None, waypoints: ArrayLike | None) -> Scene:
        """Return the scene with other start poses of its bodies and another path."""
        scene, bodies, pushers = self.scene, self.scene.bodies, self.scene.pushers
        if start is None and waypoints is None:
            return scene
        if start is not None:
            poses = floats(start, "start", "x [m], y [m], theta [rad] of each free body")
            if poses.shape not in {(len(bodies), 3), (3,) if len(bodies) == 1 else ()}:
                expected = f"one pose for each free body, shape ({len(bodies)}, 3)"
                raise InvalidInput("start", found=f"shape {poses.shape}", expected=expected)
            pairs = zip(bodies, poses.reshape(-1, 3), strict=True)
            bodies = tuple(replace(body, pose=pose) for body, pose in pairs)
        if waypoints is not None:
            check_one_pusher(scene, "waypoints")
            limit = None if pushers[0].is_template else pushers[0].drive.force_limit
            path = PathDrive(waypoints, force_limit=limit)
            pushers = (replace(pushers[0], drive=path),)
        return replace(scene, bodies=bodies, pushers=pushers)

    def _follow_modes(
        self,
        scene: Scene,
        variation: Variation,
        packed: PackedBatch,
        status: IntArray,
        found: Mapping[str, Any],
        accuracy: bool,
        names: Sequence[str],
    ) -> dict[str, Any]:
        """Return accuracy and derivatives of a motion that was found; none of an early end."""
        result: dict[str, Any] = {}
        ends = np.array([[found["pose"][body.name][-1] for body in scene.bodies]])
        modes = None
        if names:
            slopes = import_module("fixel.simulation.derivatives")  # late: few runs need it
            slopes.check_differentiable(scene, self.motion)
            duration: float = found["duration"]
            packed_of = functools.partial(pack, scene, self.motion, self.stepper, duration=duration)
            ended = np.array([found["stopped_at"] is None])
            columns, _, modes = slopes.end_slopes(
                scene, variation, names, packed_of, self._method, ends[:, 0], ended, threads=1
            )
            lacking = [name for name, own in columns.items() if np.isnan(own[0, 0])]
            result["derivatives"] = {k: own[0] for k, own in columns.items() if k not in lacking}
            if lacking:
                result["method"] = found["method"] | {"lacking": lacking}
        if accuracy:
            from fixel.simulation.accuracy import confirm  # late: few runs need it

            verdict, apart, at, other, why = confirm(packed, self._method, ends, status, 1, modes)
            when = None if np.isnan(at[0]) else float(at[0])
            result["accuracy"] = Accuracy(
                verdict=str(verdict[0]), distance=float(apart[0, 0]), angle=float(apart[0, 1]),
                other=other[0], reason=why[0], parted_at=when,
            )  # fmt: skip
        return result

    def _record(
        self, packed: PackedBatch, duration: float, times: FloatArray | None
    ) -> arrays.BatchRecord:
        if self._plain:
            return rollout_in_python(
                packed, self.motion, self.stepper, self.solver, self._method, times
            )
        return _roll_compiled(packed, self.stepper, self._method, duration, times)


def scene_file(file: SceneWithMethod | str | PathLike[str], expected: str) -> SceneWithMethod:
    """Return a scene file, loaded if its path is given; raise for other types."""
    if isinstance(file, str | PathLike):
        loaded: SceneWithMethod = offered("methods", "load_scene")(file)
        return loaded
    instance(file, SceneWithMethod, "scene", expected)
    return file


def duration_of(scene: Scene, duration: float | None) -> float:
    """Return the simulated time of a scene [s]; raise for templates."""
    scene.complete(duration)
    return positive(scene.duration if duration is None else duration, "duration", "s")


def one_variation(parameters: Parameters | None) -> Variation:
    """Create the variation of a single rollout."""
    if not parameters:
        return AS_IT_IS
    return Variation({k: np.array([v]) for k, v in parameters.items()})


def check_method(scene: Scene, solver: AbstractSolver) -> None:
    """Raise for a solver that does not support the scene's friction."""
    if isinstance(solver, Lemke) and not scene.support_directions:
        found = "the solver lemke with exact friction discs"
        hint = "set support_directions to 4 or more (16 in the thesis), or choose Newton"
        raise InvalidInput("solver", found=found, expected="linearised friction", hint=hint)


def method_of(
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    solver: AbstractSolver,
    max_contacts: int,
    polygons: bool = False,
) -> arrays.StepMethod:
    """Convert a method for the kernels; `polygons` for supports with `support_directions`."""
    instance(motion, AbstractMotionModel, "motion", "a motion model, or its name")
    instance(stepper, AbstractStepper, "stepper", "a stepper, such as fixel.Adaptive()")
    instance(solver, AbstractSolver, "solver", "a solver, or its name")
    effort = solver.max_sweeps if isinstance(solver, GaussSeidel) else 0
    max_steps = stepper.max_steps if isinstance(stepper, Adaptive) else MAX_STEPS
    if max_steps is None:
        alternates = polygons and motion.kind == codes.QUASI_STATIC
        max_steps = ALTERNATING_STEPS if alternates else ADAPTIVE_STEPS
    if isinstance(solver, Lemke):
        max_steps = min(max_steps, solver.MAX_STEPS)
    return arrays.StepMethod(
        motion=motion.kind,
        solver=solver.kind,
        adaptive=int(stepper.adaptive),
        lead=float(stepper.lead),
        max_steps=int(max_steps),
        max_contacts=max_contacts,
        effort=effort,
    )


def is_compiled(part: AbstractMotionModel | AbstractStepper | AbstractSolver) -> bool:
    """Whether the compiled loop supports this part of a method; plug-ins need the plain loop."""
    return type(part) in STEPPERS or getattr(part, "kind", codes.EXTERNAL) != codes.EXTERNAL


def get_ready(scene: Scene, solver: AbstractSolver | None = None, plain: bool = False) -> None:
    """Compile or load what a simulation needs, so that its wall time excludes compilation.

    Where plain Python computes the same bits, it starts the compilation and does not wait for it.
    """
    solver = solver or DEFAULT_SOLVER
    plain = plain or not is_compiled(solver)
    simulate(scene, duration=min(INSTANT, scene.duration), solver=solver, plain=plain)


def check_compiled(
    motion: AbstractMotionModel, stepper: AbstractStepper, solver: AbstractSolver
) -> None:
    """Raise for parts of a method that the compiled loop does not support."""
    for role, part in (("motion", motion), ("stepper", stepper), ("solver", solver)):
        if not is_compiled(part):
            expected = "a part of the compiled loop, since batches run only in it"
            hint = "call simulate for each rollout"
            raise InvalidInput(role, found=type(part).__name__, expected=expected, hint=hint)


def sample_times(duration: float, interval: float) -> FloatArray:
    """Sample times 0, interval, 2 interval, ... and the end [s]."""
    positive(interval, "output_interval", "s")
    n = math.floor(duration / interval * (1.0 + 1e-12))
    if n + 2 > MAX_SAMPLES:
        expected, hint = f"at most {MAX_SAMPLES}", f"use at least {duration / MAX_SAMPLES:.3g} s"
        raise InvalidInput("output_interval", found=f"{n} samples", expected=expected, hint=hint)
    times = interval * np.arange(n + 1)
    if times[-1] < duration * (1.0 - 1e-9):
        times = np.append(times, duration)
    times[-1] = min(times[-1], duration)
    return np.asarray(times, np.float64)


def _roll_compiled(
    packed: PackedBatch,
    stepper: AbstractStepper,
    method: arrays.StepMethod,
    duration: float,
    times: FloatArray | None,
) -> arrays.BatchRecord:
    n_moving = int(packed.batch.count[0, arrays.FREE] + packed.batch.count[0, arrays.DRIVEN])
    per_sample = CONTACTS_PER_BODY * n_moving
    if times is not None:
        record = empty_record(packed, len(times), per_sample * len(times), times)
        _roll_one(packed, method, record, every_step=False)
        return record
    room = USUAL_SAMPLES
    if stepper.first_step is not None:
        room = math.ceil(duration / stepper.first_step * (1.0 + 1e-9)) + 2
    while True:
        if room > MAX_SAMPLES:
            found = f"none, with {room} steps"
            expected = f"at most {MAX_SAMPLES} samples"
            hint = f"set output_interval, for example to {duration / 1000:.3g} s"
            raise InvalidInput("output_interval", found=found, expected=expected, hint=hint)
        record = borrowed_record(packed, room, per_sample * room)
        _roll_one(packed, method, record, every_step=True)
        n_sample = int(record.count[0, arrays.STEPS_TAKEN]) + 1
        if n_sample <= room or record.status[0] == codes.INTERRUPTED:
            break
        room = n_sample  # rare: all steps of an adaptive stepper, once more
    if stepper.first_step is None:
        record.count[0, arrays.CONTACT_ROWS] = min(
            record.count[0, arrays.CONTACT_ROWS], per_sample * n_sample
        )
    return record


def _roll_one(
    packed: PackedBatch, method: arrays.StepMethod, record: arrays.BatchRecord, *, every_step: bool
) -> None:
    if is_missing() and roll_in_python(packed.batch, method, record, every_step):
        return
    try:
        rollout_in_threads(packed.batch, method, record, 1, every_step)
    except KeyboardInterrupt:
        if record.status[0] != codes.INTERRUPTED or not record.count[0, arrays.SAMPLES]:
            raise


@functools.cache
def fixel_version() -> str:
    """Return the version of fixel that is installed."""
    return version("fixel")


def _unpacked(
    scene: Scene,
    packed: PackedBatch,
    record: arrays.BatchRecord,
    duration: float,
    times: FloatArray | None,
) -> dict[str, Any]:
    """Return the motion of a record as fields of a `Simulation`."""
    units = packed.units
    n_sample, n_contact, steps, fallbacks = record.count[0].tolist()
    time = record.time[0, :n_sample] * units.time
    if times is not None and (np.diff(time[-2:]) <= SAMPLE_SLACK * duration).any():
        n_sample, time = n_sample - 1, time[:-1]  # one of an early end at another
    poses = shape_poses(packed, record.pose[0, :n_sample])
    of_twists, of_contacts = _scales(units)
    twists = record.twist[0, :n_sample] * of_twists
    moving = [body.name for body in scene.bodies] + [pusher.name for pusher in scene.pushers]
    reached = float(record.total[0, arrays.REACHED]) * units.time
    status = int(record.status[0])
    pushers = {}
    own_time = frozen(time) if scene.pushers else time
    for k, pusher in enumerate(scene.pushers):
        path = poses[:, len(scene.bodies) + k]
        way = path[:, :2]
        if isinstance(pusher.drive, PathDrive) and pusher.drive.force_limit is None:
            at, *own = pusher.drive.waypoints[:, :3].T
            every = np.union1d(time, at[(at > time[0]) & (at < time[-1])])
            way = np.column_stack([np.interp(every, at, column) for column in own])
        step = np.diff(way, axis=0)
        drive = record.drive[0, :n_sample, k]
        pushers[pusher.name] = trace = object.__new__(PusherTrajectory)
        settle(  # without its checks, which take as long as all else here
            trace,
            time=own_time,
            pose=frozen(path),
            travel=float(np.add.reduce(np.hypot(step[:, 0], step[:, 1]))),
            force=drive[:, 0] * units.force,
            stalled=drive[:, 1] > 0.0,
        )
    return {
        "status": codes.STATUS_NAMES[status],
        "stopped_at": None if status == codes.CONVERGED else reached,
        "duration": duration if status == codes.CONVERGED else reached,
        "time": time,
        "pose": {name: poses[:, k] for k, name in enumerate(moving)},
        "twist": {name: twists[:, k] for k, name in enumerate(moving)},
        "contacts": _contact_table(record.contact[0, :n_contact] * of_contacts, time),
        "pushers": pushers,
        "steps": steps,
        "fallbacks": fallbacks,
        "max_residual": float(record.total[0, arrays.WORST_RESIDUAL]),
    }


@functools.lru_cache(maxsize=RECENT_SCENES)
def _scales(units: Units) -> tuple[FloatArray, FloatArray]:
    """Return the units of the columns of twists, and of the contact rows of a record."""
    length, time, force = units.length, units.time, units.force
    contact = [1.0, 1.0, 1.0, length, 1.0, 1.0, length, length, force, force, time]
    return pose_units(units) / time, np.array(contact)


def _contact_table(values: FloatArray, time: FloatArray) -> NDArray[np.void]:
    """Convert rows in SI units, new ones, which have the columns of `CONTACT_FIELDS`."""
    counts = values[:, :3].astype(np.int64)
    values[:, 0] = time[counts[:, 0]]
    values.view(np.int64)[:, 1:3] = counts[:, 1:]
    return np.ndarray(len(values), CONTACT_FIELDS, values)  # faster than a view


@functools.lru_cache(maxsize=16)
def _converted(
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    solver: AbstractSolver,
    max_contacts: int,
    polygons: bool,
) -> tuple[arrays.StepMethod, Mapping[str, Any]]:
    """Return a method for the kernels; and its names and options, sufficient to run it again."""
    described: dict[str, Any] = {}
    parts: dict[str, Any] = {"motion": motion, "stepper": stepper, "solver": solver}
    for role, part in parts.items():
        described[role] = getattr(part, "name", type(part).__name__)
        if is_dataclass(part):
            described |= {f"{role}.{f.name}": getattr(part, f.name) for f in fields(part)}
    method = method_of(motion, stepper, solver, max_contacts, polygons)
    if isinstance(stepper, Adaptive):
        described["stepper.max_steps"] = method.max_steps
    return method, described
