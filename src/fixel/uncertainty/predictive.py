"""Parameters and errors with which a calibration predicts pushes that were not recorded.

Intervals bound parameters of a model that may be wrong: too wide for predictions from few pushes,
too narrow from many, since the error of the model itself does not shrink. So samples are moved
towards the calibrated values, as near as left-out pushes allow, weighted weakly by how well they
reproduce the recorded ends, and an error of the end is added. It grows with the motion, and with
how much the end depends on the parameters. See `docs/theory/planning.md` for the worlds and
recorded pushes by which constants were chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np

from fixel.calibration.objective import Comparer
from fixel.calibration.target import Target
from fixel.model.records import Estimate
from fixel.model.space import ParameterSpace
from fixel.model.trajectory import pose_error
from fixel.simulation.motion import AbstractMotionModel
from fixel.typing import FloatArray, IntArray

SHRINK: Final = 0.7  # distance of samples from the calibrated values, relative to the intervals
NEAREST: Final = 0.3  # the same where samples miss recorded ends by more than left-out ones miss
POWER: Final = 0.1  # of the likelihood of a recorded push, by the sum of squares of all ends
SHARE: Final = 0.6  # scale of the error of fresh ends, over the residual error of recorded ones
RANGE: Final = (0.2, 3.0)  # of motions and spreads over the mean ones, within which errors grow
POOL: Final = 512  # parameter sets that are weighted
MOST: Final = 40  # recorded pushes by which they are weighted
FAILED: Final = 0.1  # error of a push that could not be simulated [m]
# Pushes left out in turn, to compare their ends with predictions.
LEAST: Final = 4  # pushes of a calibration
DRAWS: Final = 64  # parameter sets
REPEATS: Final = 32  # errors of the end drawn for each of them
REGION: Final = 0.9  # probability that a region is stated to have
TINY: Final = 1e-6  # deviation that no region is below [m]


@dataclass(frozen=True, slots=True)
class EndError:
    """Error of predicted ends, by the motion of the part and the spread of its ends.

    It grows with the geometric mean of both: an end that depends much on the parameters depends
    much on what the model leaves out as well. Models fail in few pushes, and then by far: the error
    has Student's distribution with two degrees of freedom.
    """

    size: float  # scale of each coordinate after a mean push, rotations as arcs [m]
    motion: float  # mean motion of the recorded pushes [m]
    spread: float = 0.0  # mean spread of their free ends over the parameters [m]; 0 without any

    def deviation(self, motion: FloatArray, spread: FloatArray | float = math.nan) -> FloatArray:
        """Return the scales after motions as by `motion_of`, and spreads as by `spread_of` [m].

        By the motion alone where the spread is NaN.
        """
        growth = np.clip(motion / self.motion, *RANGE)
        if self.spread > 0.0:
            other = np.clip(spread / self.spread, *RANGE)
            growth = np.where(np.isnan(other), growth, np.sqrt(growth * other))
        return np.asarray(self.size * growth)

    @staticmethod
    def draws(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        """Draw errors (*shape, 3) of scale 1, large in all coordinates at the same time."""
        normal = rng.standard_normal((*shape, 3))
        return np.asarray(normal / np.sqrt(rng.exponential(size=(*shape, 1))))


@dataclass(frozen=True, slots=True, eq=False)
class Predictive:
    """Equally likely parameter sets of a calibration, and the error of ends that they leave."""

    space: ParameterSpace
    points: FloatArray  # (n, n_free)
    error: EndError

    def samples(
        self, n: int, seed: int, conditions: Mapping[str, str | float]
    ) -> dict[str, FloatArray]:
        """Return n parameter sets, (n,) each by name; each point comes as often as another."""
        rows = np.random.default_rng(seed).permutation(len(self.points))
        return self.space.columns(self.points[np.resize(rows, n)], conditions)


@runtime_checkable
class CalibratedModel(Protocol):
    """Calibrated parameters with the motion model that they belong to; `Calibration` is one."""

    @property
    def motion(self) -> AbstractMotionModel: ...
    @property
    def estimates(self) -> Mapping[str, Estimate]: ...
    def values_for(self, /, **conditions: str | float) -> dict[str, float]: ...
    def samples(self, n: int, seed: int, **conditions: str | float) -> dict[str, FloatArray]: ...


@runtime_checkable
class PredictiveModel(CalibratedModel, Protocol):
    """Calibrated model that knows how well it predicts other pushes; `Calibration` is one."""

    @property
    def predictive(self) -> Predictive: ...


def predictive_of(
    targets: Sequence[Target],
    space: ParameterSpace,
    motion: AbstractMotionModel,
    best: FloatArray,
    value: FloatArray,
    points: FloatArray,
    moved: FloatArray,
) -> Predictive:
    """Return the parameters and the error with which to predict pushes that were not recorded.

    Parameters (n_free,) that fit best, calibrated values (n_free,) and samples (n, n_free) are
    those of a calibration with the recorded pushes. `moved` is as in `check_predictions`.
    """
    ends = [_end_of(own) for own in targets]
    residual = end_residuals(ends, space, motion, best[None])[:, 0]
    some = _spread(len(ends))

    def misses_at(points: FloatArray) -> FloatArray:
        return end_residuals([ends[k] for k in some], space, motion, points)

    shrunk = value + SHRINK * (points - value)
    off = misses_at(shrunk)
    usual = float(np.median((off**2).sum(axis=(0, 2))))
    # Samples miss no more than fits without these pushes do. Among fixels ends do not show it.
    left_out = np.clip(best + moved[some], space.low, space.high)[:, None]
    missed = (misses_at(own) ** 2 for own in (left_out, value[None]))
    enough, at_value = (float(own.sum(axis=(0, 2))[0]) for own in missed)
    if usual > max(enough, at_value) and not any(own.case.scene.fixels for own in targets):
        nearer = math.sqrt(max(enough - at_value, 0.0) / (usual - at_value))
        shrunk = value + max(nearer, NEAREST / SHRINK) * (shrunk - value)
        off = misses_at(shrunk)
    squares = (off**2).sum(axis=(0, 2))
    least = min(float((residual[some] ** 2).sum()), float(squares.min()))
    likelihood = -0.5 * POWER * len(some) * np.log(squares / max(least, 1e-18))
    weight = np.exp(likelihood - likelihood.max())
    # Systematic resampling: each point as often as its weight says, up to one.
    places = (np.arange(len(shrunk)) + 0.5) / len(shrunk)
    rows = np.searchsorted(np.cumsum(weight) / weight.sum(), places)
    free = max(1, 3 * len(ends) - len(space.labels))
    size = SHARE * math.sqrt(float((residual**2).sum()) / free)
    motions = np.concatenate([_motions(own, np.zeros(3)) for own in ends])
    free_ends = [not targets[k].case.scene.fixels for k in some]  # fixels hold the others
    spread = float(spread_of(off[free_ends][:, rows]).mean()) if any(free_ends) else 0.0
    return Predictive(space, shrunk[rows], EndError(size, max(float(motions.mean()), 1e-9), spread))


def check_predictions(
    predictive: Predictive,
    targets: Sequence[Target],
    motion: AbstractMotionModel,
    best: FloatArray,
    moved: FloatArray,
) -> tuple[int, int]:
    """Return how many recorded ends are in the regions predicted without them, and of how many.

    Those among fixels are not counted: their ends are not free. Nor are those in which nothing
    moves. `moved` (n_target, n_free) is by how much the best fit, and the draws with it, move where
    one push is left out.
    """
    space, ends = predictive.space, [_end_of(own) for own in targets]
    left = end_residuals(ends, space, motion, best[None])
    free = np.flatnonzero([
        not own.case.scene.fixels and _motions(own, off)[0] > TINY
        for own, off in zip(ends, left, strict=True)
    ])  # fmt: skip
    if len(targets) < LEAST or not len(free):
        return 0, 0
    some, squares = free[_spread(len(free))], (left**2).sum(axis=(1, 2))
    motions = np.concatenate([_motions(own, np.zeros(3)) for own in ends])
    points = np.clip(predictive.points + moved[some, None], space.low, space.high)
    found = end_residuals([ends[k] for k in some], space, motion, points)
    errors = EndError.draws(np.random.default_rng(0), (REPEATS, found.shape[1]))
    n, held = len(ends) - 1, 0
    for k, off in zip(some.tolist(), found, strict=True):
        others = float(squares.sum() - squares[k]) / max(1, 3 * n - len(space.labels))
        usual = max(float(motions.sum() - motions[k]) / n, 1e-9)
        error = EndError(SHARE * math.sqrt(others), usual, predictive.error.spread)
        own = error.deviation(_motions(ends[k], off), spread_of(off))
        # The ellipsoid about the mean of the drawn ends that contains the share of them.
        middle = off.mean(axis=0)
        inverse = np.linalg.inv(np.cov(off.T) + (np.mean(own**2) + TINY**2) * np.eye(3))
        drawn = off - middle + own[:, None] * errors
        distance = np.einsum("rni,ij,rnj->rn", drawn, inverse, drawn)
        held += bool(middle @ inverse @ middle <= np.quantile(distance, REGION))
    return held, len(some)


def end_residuals(
    ends: Sequence[Target], space: ParameterSpace, motion: AbstractMotionModel, points: FloatArray
) -> FloatArray:
    """Return simulated less measured ends (k, n, 3), turns as arcs [m].

    At points (n, n_free), or (k, n, n_free) of their own.
    """
    which = np.repeat(np.arange(len(ends)), points.shape[-2])
    each = np.broadcast_to(points, (len(ends), *points.shape[-2:]))
    found, good, _ = Comparer(ends, space, None, motion).differences(
        which, each.reshape(len(which), -1)
    )
    off = np.where(good[:, None], found[:, 0], FAILED).reshape(len(ends), -1, 3)
    arms = [math.sqrt(own.case.scene.bodies[0].shape.unit_inertia) for own in ends]
    off[:, :, 2] *= np.array(arms)[:, None]
    return np.asarray(off)


def motion_of(start: FloatArray, end: FloatArray, arm: float) -> FloatArray:
    """Return motions (n,) between poses (n, 3): the way, and the rotation as an arc [m]."""
    way, turned = pose_error(end, start)
    return np.asarray(way + arm * np.abs(turned))


def spread_of(ends: FloatArray) -> FloatArray:
    """Return the spread (...) of a coordinate of ends (..., n, 3), NaN left out, as arcs [m]."""
    return np.asarray(np.sqrt(np.nanvar(ends, axis=-2).mean(axis=-1)))


def _end_of(own: Target) -> Target:
    """Return a recorded push with its last pose only."""
    return own._replace(case=own.case._replace(times=own.case.times[-1:]), pose=own.pose[-1:])


def _spread(n: int) -> IntArray:
    """Return the numbers of at most `MOST` of n pushes, spread evenly."""
    return np.unique(np.linspace(0, n - 1, min(MOST, n)).astype(np.int64))


def _motions(own: Target, off: FloatArray) -> FloatArray:
    """Return the motions (n,) to ends at a distance (n, 3) from the measured one, turns as arcs."""
    body = own.case.scene.bodies[0]
    arm = math.sqrt(body.shape.unit_inertia)
    start = np.asarray(body.pose, np.float64)[None]
    return motion_of(start, own.pose[-1:] + off / (1.0, 1.0, arm), arm)
