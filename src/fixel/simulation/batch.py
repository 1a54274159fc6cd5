"""Simulation of many scenes in one call, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from os import PathLike
from typing import Any, Final, overload

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import Interrupted, InvalidInput
from fixel.kernels import arrays, codes
from fixel.model import Scene
from fixel.model.fields import floats, instance, texts, whole
from fixel.simulation.motion import AbstractMotionModel, motion_model, named_part
from fixel.simulation.pack import PackedBatch, pack, stack
from fixel.simulation.result import BatchResult
from fixel.simulation.simulate import (
    CONTACTS_PER_BODY,
    SceneWithMethod,
    check_compiled,
    check_method,
    duration_of,
    fixel_version,
    method_of,
    one_variation,
    scene_file,
)
from fixel.simulation.stepping import SOLVERS, AbstractSolver, AbstractStepper, Adaptive, Newton
from fixel.simulation.threads import empty_record, hold_last, rollout_in_threads, shape_poses
from fixel.simulation.vary import Variation, variation_of
from fixel.typing import BoolArray, FloatArray, IntArray

STATUS_NAMES: Final = np.array(codes.STATUS_NAMES)
SLOPES: Final = "fixel.simulation.derivatives"  # imported late: few batches need it


@overload
def simulate_batch(
    scene: Scene | SceneWithMethod | str | PathLike[str],
    parameters: Mapping[str, ArrayLike] | Sequence[Mapping[str, float]] | None = None,
    *,
    start: ArrayLike | None = None,
    waypoints: ArrayLike | None = None,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    solver: AbstractSolver | str | None = None,
    duration: float | None = None,
    times: ArrayLike | None = None,
    threads: int | None = None,
    max_contacts: int = 4096,
    accuracy: bool = False,
    derivatives: Sequence[str] = (),
) -> BatchResult: ...


@overload
def simulate_batch(scene: Sequence[Scene], **options: Any) -> list[BatchResult]: ...


def simulate_batch(  # type: ignore[misc]
    scene: Scene | SceneWithMethod | str | PathLike[str] | Sequence[Scene],
    parameters: Mapping[str, ArrayLike] | Sequence[Mapping[str, float]] | None = None,
    *,
    start: ArrayLike | None = None,
    waypoints: ArrayLike | None = None,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    solver: AbstractSolver | str | None = None,
    duration: float | None = None,
    times: ArrayLike | None = None,
    threads: int | None = None,
    max_contacts: int = 4096,
    accuracy: bool = False,
    derivatives: Sequence[str] = (),
) -> BatchResult | list[BatchResult]:
    """Simulate one scene in many variations, or many scenes.

    Parameters
    ----------
    scene : Scene, SceneFile, path or sequence of Scene
        One scene to vary, or scenes to simulate as they are. A scene file's motion model and step
        apply.
    parameters : mapping from name to (n,) array_like, or sequence of mappings, optional
        Parameters of the one scene, in SI units: arrays of equal length by name, or one mapping
        from names to numbers for each run.
    start : (n, n_free, 3) or (n, 3) array_like, optional
        Start poses of the free bodies [m, m, rad], each rollout its own. Not checked for overlap.
    waypoints : (n, n_sample, 4) array_like, optional
        Path of the one pusher in each rollout: time [s], x, y [m], theta [rad].
    motion, stepper, solver : optional
        Built-in methods, or the name of a motion model or solver; `Dynamic()`, `Adaptive()` and
        `Newton()` by default.
    duration : float, optional
        Simulated time [s]; the scene's by default.
    times : (n_sample,) array_like, optional
        Times at which poses are sampled [s]; only the end by default.
    threads : int, optional
        Number of threads; all cores by default. Results are bit for bit the same for any number.
    max_contacts : int
        Largest number of contacts in one rollout.
    accuracy : bool
        Whether to solve every run in a second, independent way, until the last of `times`; see
        `BatchResult.accuracy`.
    derivatives : sequence of str
        Parameters, or ``"x"``, ``"y"`` and ``"theta"`` of the start pose, by which to differentiate
        the last poses; for quasi-static motion of one part.

    Returns
    -------
    BatchResult, or a list of one BatchResult per scene

    Raises
    ------
    InvalidInput
        Arrays differ in length, the scene is a template, or the method does not suit it.
    Interrupted
        Ctrl-C; its `result` has the runs that ended.

    Examples
    --------
    >>> import numpy as np
    >>> from fixel.testing.scenes import pushed_square
    >>> friction = np.linspace(0.1, 0.4, 100)
    >>> runs = simulate_batch(pushed_square(), {"mu_pusher": friction})
    >>> runs["part"].final.theta.shape
    (100,)
    >>> print(f"still touching: {runs.touching('part', 'finger').mean():.0%}")
    still touching: 100%
    """
    if isinstance(scene, str | PathLike | SceneWithMethod):
        file = scene_file(scene, "a Scene, a scene file or Scenes")
        scene, motion, stepper = file.scene, motion or file.motion, stepper or file.stepper
    motion, derivatives = motion_model(motion), texts(derivatives, "derivatives")
    stepper = stepper or Adaptive()
    solver = named_part(solver or Newton.name, SOLVERS, "solver")
    check_compiled(motion, stepper, solver)
    scenes: Sequence[Any] = scene if isinstance(scene, Sequence) else [scene]
    for own in scenes:
        instance(own, Scene, "scene", "a Scene, a scene file or Scenes")
    polygons = any(own.support_directions for own in scenes)
    method = method_of(motion, stepper, solver, whole(max_contacts, "max_contacts"), polygons)
    if not isinstance(scene, Scene):
        varied = any(given is not None for given in (parameters, start, waypoints))
        if varied or accuracy or derivatives:
            found = "several scenes with variations, accuracy or derivatives"
            raise InvalidInput("scene", found=found, expected="one scene to vary")
        return _simulate_scenes(scene, motion, stepper, solver, method, duration, times, threads)
    check_method(scene, solver)
    if derivatives:
        import_module(SLOPES).check_differentiable(scene, motion)
    variation, n = variation_of(scene, parameters, start, waypoints)
    seconds = duration_of(scene, duration)
    packed = pack(scene, motion, stepper, variation, n, seconds)
    instants = _instants(times, seconds)
    record = empty_record(packed, len(instants), CONTACTS_PER_BODY * len(scene.names), instants)
    record.total[:, arrays.LAST_CONTACTS] = 1.0
    try:
        rollout_in_threads(packed.batch, method, record, threads)
    except KeyboardInterrupt:
        finished = _unpack(scene, packed, record, instants, variation.parameters)
        raise Interrupted(finished) from None
    runs = _unpack(scene, packed, record, instants, variation.parameters)
    if not (accuracy or derivatives):
        return runs
    last = float(instants[-1])  # poses after it are not in the result
    packed_of = partial(pack, scene, motion, stepper, duration=last)
    if accuracy and last < seconds:
        packed = packed_of(variation, n)
    to_confirm = (packed, record.status) if accuracy else None
    return _follow_modes(runs, variation, derivatives, packed_of, to_confirm, method, threads)


def _follow_modes(
    runs: BatchResult,
    variation: Variation,
    names: Sequence[str],
    packed_of: Callable[..., PackedBatch],
    to_confirm: tuple[PackedBatch, IntArray] | None,
    method: arrays.StepMethod,
    threads: int | None,
) -> BatchResult:
    """Return the runs with their derivatives, if any are named, and accuracy.

    The latter is that of packed runs with a status, if they are given.
    """
    ends, modes = runs.final[:, : len(runs.scene.bodies)], None
    if names:
        slopes, found, modes = import_module(SLOPES).end_slopes(
            runs.scene, variation, names, packed_of, method, ends[:, 0], runs.converged, threads
        )
        runs = replace(runs, derivatives=slopes, differentiable=found)
    if to_confirm is not None:
        from fixel.simulation.accuracy import confirm  # late: few batches need it

        packed, status = to_confirm
        verdicts, apart, parted, _, _ = confirm(packed, method, ends, status, threads, modes)
        runs = replace(runs, accuracy=verdicts, apart=apart, parted_at=parted)
    return runs


def simulate_packed(
    scene: Scene,
    packed: PackedBatch,
    method: arrays.StepMethod,
    instants: FloatArray,
    threads: int | None,
) -> BatchResult:
    """Simulate packed rollouts of a scene, for callers that reuse a template.

    Poses are sampled at increasing times `instants` (n_sample,) [s].
    """
    record = empty_record(packed, len(instants), 0, instants)
    rollout_in_threads(packed.batch, method, record, threads)
    return _unpack(scene, packed, record, instants)


def _instants(times: ArrayLike | None, duration: float) -> FloatArray:
    if times is None:
        return np.array([duration])
    expected = f"increasing times from 0 to {duration:g} s"
    instants = floats(times, "times", expected)
    grows = instants.ndim == 1 and instants.size > 0 and bool(np.all(np.diff(instants) > 0.0))
    if not grows or not 0.0 <= instants[0] <= instants[-1] <= duration * (1.0 + 1e-12):
        raise InvalidInput("times", found=instants, expected=expected)
    return instants


def _unpack(
    scene: Scene,
    packed: PackedBatch,
    record: arrays.BatchRecord,
    times: FloatArray,
    parameters: Mapping[str, FloatArray] | None = None,
) -> BatchResult:
    units = packed.units
    hold_last(record, record.pose, record.drive)
    return BatchResult(
        scene=scene,
        parameters={} if parameters is None else parameters,
        status=STATUS_NAMES[record.status],
        time=times,
        pose=shape_poses(packed, record.pose),
        stopped_at=record.total[:, arrays.REACHED] * units.time,
        steps=record.count[:, arrays.STEPS_TAKEN].copy(),
        fallbacks=record.count[:, arrays.FALLBACKS].copy(),
        max_residual=record.total[:, arrays.WORST_RESIDUAL].copy(),
        force=record.drive[:, -1, :, 0] * units.force,
        peak_force=record.drive[:, :, :, 0].max(axis=1) * units.force,
        stalled=record.drive[:, -1, :, 1] > 0.0,
        contacts=_last_contacts(scene, record) if record.contact.shape[1] else None,
        version=fixel_version(),
    )


def _last_contacts(scene: Scene, record: arrays.BatchRecord) -> BoolArray:
    """Whether bodies touch (n, n_moving, n_body) at the end of each rollout."""
    n, n_row = record.contact.shape[:2]
    n_moving = len(scene.bodies) + len(scene.pushers)
    last = record.count[:, arrays.SAMPLES] - 1
    seen = np.arange(n_row) < record.count[:, arrays.CONTACT_ROWS, None]
    seen &= record.contact[:, :, 0] == last[:, None]
    run, row = np.nonzero(seen)
    pair = np.sort(record.contact[run, row, 1:3].astype(np.int64), axis=1)
    touching = np.zeros((n, n_moving, len(scene.names)), dtype=np.bool_)
    touching[run, pair[:, 0], pair[:, 1]] = True
    return touching


def _simulate_scenes(
    scenes: Sequence[Scene],
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    solver: AbstractSolver,
    method: arrays.StepMethod,
    duration: float | None,
    times: ArrayLike | None,
    threads: int | None,
) -> list[BatchResult]:
    """Simulate many scenes in one parallel call; each result is a batch of one."""
    packed, instants = [], []
    for scene in scenes:
        check_method(scene, solver)
        seconds = duration_of(scene, duration)
        packed.append(pack(scene, motion, stepper, one_variation(None), 1, seconds))
        instants.append(_instants(times, seconds))
    if not packed:
        return []
    batch = stack(packed)
    whole = PackedBatch(batch, packed[0].units, packed[0].com, None)
    record = empty_record(whole, len(instants[0]), 0)
    for r, part in enumerate(packed):
        record.time[r] = instants[r] / part.units.time
    rollout_in_threads(batch, method, record, threads)
    results = []
    for r, (scene, part) in enumerate(zip(scenes, packed, strict=True)):
        n_driven, n_moving = len(scene.pushers), len(scene.bodies) + len(scene.pushers)
        own = arrays.BatchRecord._make(array[r : r + 1] for array in record)
        own = own._replace(
            pose=own.pose[:, :, :n_moving],
            drive=own.drive[:, :, :n_driven],
            twist=own.twist[:, :, :n_moving],
        )
        results.append(_unpack(scene, part, own, instants[r]))
    return results
