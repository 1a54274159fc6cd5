"""Cross-validation: errors of experiments under parameters that were calibrated without them.

Every fold of every group is one fit by least squares on the other folds, started at the values of
a calibration. The caller may store finished fits, so that an interrupted command continues.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.assess import Frames
from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.noise import Noise, noise_from_repetitions
from fixel.calibration.objective import AbstractError, Comparer, EndPose, MeanSquare
from fixel.calibration.study import box_of
from fixel.calibration.target import Target, repetitions, same_configuration
from fixel.domain.cells import label_of
from fixel.domain.evidence import folds_of
from fixel.errors import InvalidInput
from fixel.model.space import ParameterSpace
from fixel.simulation import AbstractMotionModel
from fixel.simulation.stepping import AbstractStepper, Adaptive, Midpoint
from fixel.typing import FloatArray, IntArray, ProgressCallback

# Steps along a push, for experiments with two poses only. On a twelfth of the pushes of a public
# dataset they took half the time of adaptive steps; 19 in 20 errors agreed within 0.06 mm.
STEPS: Final = 50
THOUSANDS: Final = 1000  # number of experiments from which a fixed step is used
# Experiments used by one fit: a handful of values needs no more, and time grows with them.
MAX_TRAINING: Final = 120
# A fit starts near its end: each fold omits a part of a calibration's data. Distances count
# linearly beyond 2 mm: a push that goes the other way is tens of millimetres off, and the fold
# that contains it would decide the parameters.
SQUARES: Final = LeastSquares(
    loss="soft_l1", width=2.0, tolerance=1e-4, most_iterations=12, trials=3
)


# Returns the stored answer of a name and its question, or computes and stores it.
Finished = Callable[[str, Any, Callable[[], dict[str, Any]]], dict[str, Any]]


class Apart(NamedTuple):
    """Conditions with separate fits, and experiments that are held out together."""

    by: tuple[str, ...] = ()  # conditions: separate parameters for each of their values
    out: str = ""  # condition whose values are held out as a whole
    folds: int = 5
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationModel:
    """Parameters to calibrate, and the method of simulation."""

    space: ParameterSpace  # parameters to search; fits start at the nominal point
    motion: AbstractMotionModel
    error: AbstractError  # mean square or end pose

    def __post_init__(self) -> None:
        if not isinstance(self.error, MeanSquare | EndPose):
            found = f"one with the error {self.error.name} [{self.error.unit}]"
            expected = "mean-square or end-pose [mm^2], the errors of a map"
            hint = "calibrate again with error='mean-square'"
            raise InvalidInput("calibration", found=found, expected=expected, hint=hint)


class HeldOut(NamedTuple):
    """Held-out errors by cross-validation."""

    # (n,) E of every experiment, held out [mm^2]; inf if its simulation failed, nan without a fit.
    error: FloatArray
    fold: IntArray  # (n,)
    points: dict[str, list[float]]  # parameters of every fit
    stepper: str  # name of the stepper and its step


def stepper_for(targets: Sequence[Target]) -> AbstractStepper:
    """Return adaptive steps; fixed ones for thousands of pushes with only two poses."""
    two_poses = all(len(target.pose) <= 2 for target in targets)
    if len(targets) < THOUSANDS or not two_poses or any(t.case.scene.fixels for t in targets):
        return Adaptive()
    longest = max(float(target.case.times[-1]) for target in targets)
    return Midpoint(step=longest / STEPS)


def held_out(
    targets: Sequence[Target],
    model: CalibrationModel,
    apart: Apart,
    finished: Finished,
    progress: ProgressCallback | None = None,
    threads: int | None = None,
) -> HeldOut:
    """Compute held-out errors by cross-validation; `finished` may return answers that are stored.

    Raise `InvalidInput` for too few configurations for the folds, or a start at which nothing can
    be simulated.
    """
    stepper = stepper_for(targets)
    groups = [label_of(target.conditions, apart.by) for target in targets]
    fold = _folds(targets, groups, apart)
    comparer = Comparer(targets, model.space, model.error, model.motion, stepper, threads)
    _refuse_start(comparer, groups)
    error = np.full(len(targets), math.inf)
    points: dict[str, list[float]] = {}
    jobs = [(g, k) for g in dict.fromkeys(groups) for k in range(apart.folds)]
    for done, (group, k) in enumerate(jobs):
        own = np.array([name == group for name in groups])
        train, test = np.flatnonzero(own & (fold != k)), np.flatnonzero(own & (fold == k))
        if len(test) and len(train):
            of = _asked(targets, model, apart, stepper, train, test)
            name = f"fold-{done}"
            answer = finished(
                name, of, partial(_fold_answer, comparer, train, test, apart.seed + k)
            )
            error[test] = [math.inf if e is None else e for e in answer["error"]]
            points[f"{group or 'all'}, fold {k + 1}"] = answer["point"]
        elif len(test):
            error[test] = math.nan
        if progress is not None:
            progress(done + 1, len(jobs))
    return HeldOut(error=error, fold=fold, points=points, stepper=_said(stepper))


def _refuse_start(comparer: Comparer, groups: Sequence[str]) -> None:
    """Raise if some group has no simulation at the start, before any group is fitted.

    One experiment of a group that can be simulated is enough; usually the first can.
    """
    start = comparer.space.nominal[None]
    for group in dict.fromkeys(groups):
        members = [k for k, name in enumerate(groups) if name == group]
        reasons = []
        for k in members:
            answer = comparer.errors(np.array([k]), start)
            reasons += answer.reasons
            if math.isfinite(answer.error[0]):
                break
        else:
            raise _no_start(reasons, f"{group}: " if group else "")


def reasons_text(reasons: Iterable[str]) -> str:
    """Return each reason with its count, the most frequent first: `2 x no scene; 1 x too late`."""
    return "; ".join(f"{n} x {reason}" for reason, n in Counter(reasons).most_common())


def _no_start(reasons: Sequence[str], of: str = "") -> InvalidInput:
    found = f"no simulation at it: {of}{reasons_text(reasons)}"
    expected = "parameters with which experiments can be simulated"
    hint = "start at another calibration"
    return InvalidInput("start of the fits", found=found, expected=expected, hint=hint)


def _fold_answer(comparer: Comparer, train: IntArray, test: IntArray, seed: int) -> dict[str, Any]:
    """Fit one fold of one group: return parameters from some experiments, and errors of others."""
    point = _fold_point(comparer, train, seed)
    errors = comparer.errors(test, np.repeat(point[None], len(test), axis=0))
    values = [float(e) if math.isfinite(e) else None for e in errors.error]
    return {"point": point.tolist(), "error": values}


def _fold_point(comparer: Comparer, train: IntArray, seed: int) -> FloatArray:
    space = comparer.space
    frames = Frames(comparer, _usable(comparer, train, seed))
    scale = float(comparer.error.angle_scale)
    noise = Noise(position_m=1e-3, angle_rad=1e-3 / scale)
    # Every experiment counts alike, however long; residuals stay in millimetres.
    weight = np.sqrt(frames.weights / frames.weights.mean())
    residuals = frames.residuals(noise)
    search = SQUARES.start(box_of(space), seed, None, NormalPrior.of(space))
    return np.asarray(fit(search, lambda points: residuals(points) / weight).point)


def _usable(comparer: Comparer, train: IntArray, seed: int) -> IntArray:
    """Select training experiments at random, without those that cannot be simulated at the start: a
    single failure would stop the whole fit."""
    if len(train) > MAX_TRAINING:
        rng = np.random.default_rng(seed)
        train = np.sort(rng.choice(train, MAX_TRAINING, replace=False))
    answer = comparer.errors(train, np.repeat(comparer.space.nominal[None], len(train), axis=0))
    good = train[np.isfinite(answer.error)]
    if not len(good):
        raise _no_start(answer.reasons)
    return good


def calibrated_on(targets: Sequence[Target], model: CalibrationModel, seed: int = 0) -> FloatArray:
    """(n_free,) parameters of a fold that is trained on all of these experiments."""
    stepper = stepper_for(targets)
    comparer = Comparer(targets, model.space, model.error, model.motion, stepper)
    return _fold_point(comparer, np.arange(len(targets)), seed)


def _folds(targets: Sequence[Target], groups: Sequence[str], apart: Apart) -> IntArray:
    if not apart.out:
        blocks = [same_configuration(target) for target in targets]
        return folds_of(blocks, groups, apart.folds, apart.seed)
    values = [label_of(target.conditions, (apart.out,)) for target in targets]
    return folds_of(values, [""] * len(targets), apart.folds, apart.seed)


def _asked(
    targets: Sequence[Target],
    model: CalibrationModel,
    apart: Apart,
    stepper: AbstractStepper,
    train: IntArray,
    test: IntArray,
) -> list[Any]:
    """Everything that an answer depends on; an answer stored under a name never changes."""
    return [
        [targets[k].key for k in train.tolist()],
        [targets[k].key for k in test.tolist()],
        float(sum(targets[k].pose.sum() for k in np.concatenate((train, test)).tolist())),
        [repr(unknown) for unknown in model.space.unknowns],
        [repr(model.motion), repr(model.error), repr(stepper), repr(SQUARES), MAX_TRAINING],
        apart.seed,
    ]


def _said(stepper: AbstractStepper) -> str:
    first = stepper.first_step
    return stepper.name if first is None else f"{stepper.name}, {first:.3g} s"


# --- noise of the measurement -------------------------------------------------------------------


def noise_floor(
    targets: Sequence[Target], scale: float, *, ends: bool = False
) -> tuple[float | None, str]:
    """Return the root mean square error of a perfect simulator [mm], and its source.

    It is computed from repetitions, else from the scatter of measured poses about smooth motion;
    None if there are too few frames. An angle counts as `scale` [m/rad]; with `ends` only last
    poses count, as in a map of them.
    """
    groups = repetitions(targets, ends=ends)
    if groups:
        noise = noise_from_repetitions(groups)
        floor = 1e3 * math.hypot(noise.position_m, noise.position_m, scale * noise.angle_rad)
        return floor, "repetitions"
    weights = np.array([1e3, 1e3, 1e3 * scale])
    bends = [_bends(target.pose * weights) for target in targets if len(target.pose) > 8]
    if not bends:
        return None, ""
    # The median over runs: in a few, contacts bend the path itself.
    return float(np.median(bends)), "scatter from frame to frame"


def _bends(pose: FloatArray) -> float:
    """Noise [mm] from second differences, whose variance is six times as large (white noise)."""
    second = np.diff(pose, n=2, axis=0)
    middle = np.median(second**2, axis=0) / 0.4549  # variance of normal numbers from the median
    return float(np.sqrt(middle.sum() / 6.0))


def own_errors(
    targets: Sequence[Target],
    model: CalibrationModel,
    seed: int,
    threads: int | None,
    progress: ProgressCallback,
) -> FloatArray:
    """Return the error (n,) of each experiment with parameters of its own [mm^2]; nan if failed."""
    found = np.empty(len(targets))
    for k, target in enumerate(targets):
        point = calibrated_on([target], model, seed)
        comparer = Comparer(
            [target], model.space, model.error, model.motion, stepper_for(targets), threads
        )
        found[k] = comparer.errors(np.zeros(1, np.int64), point[None]).error[0]
        progress(k + 1, len(targets))
    return np.where(np.isfinite(found), found, np.nan)


def end_errors(comparer: Comparer, found: HeldOut) -> tuple[FloatArray, FloatArray]:
    """Return errors of end positions and angles (n,), each with the parameters of its fold."""
    every = np.arange(len(found.fold))
    points = np.array([found.points[f"all, fold {k + 1}"] for k in found.fold.tolist()])
    difference, good, _ = comparer.differences(every, points)
    last = comparer.length(every) - 1
    off = difference[every, last]
    return (
        np.where(good, np.hypot(off[:, 0], off[:, 1]), np.inf),
        np.where(good, np.abs(off[:, 2]), np.inf),
    )
