"""Objective: error of simulations against experiments, as a function of parameters."""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np

from fixel.calibration.noise import counting_frames
from fixel.calibration.target import Target
from fixel.errors import InvalidInput
from fixel.model.fields import positive
from fixel.model.space import ParameterSpace
from fixel.model.trajectory import pose_difference
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.rollouts import Rollouts, ensemble_of
from fixel.simulation.stepping import AbstractStepper
from fixel.typing import BoolArray, FloatArray, IntArray

ANGLE_SCALE: Final = 35e-3  # [m/rad] length by which the thesis weights angles
OPTION_UNITS: Final = {"angle_scale": "m/rad", "distance": "m"}  # of all errors


@dataclass(frozen=True, slots=True, kw_only=True)
class AbstractError(abc.ABC):
    """Error of one simulation against one experiment."""

    name: ClassVar[str]
    unit: ClassVar[str]
    # Length by which angles are multiplied, the characteristic length of the part [m/rad].
    angle_scale: float = ANGLE_SCALE

    def __post_init__(self) -> None:
        for name, unit in OPTION_UNITS.items():
            if hasattr(self, name):
                positive(getattr(self, name), f"error.{name}", unit)

    @abc.abstractmethod
    def of(self, difference: FloatArray) -> FloatArray:
        """Return errors (n,) from the differences (n, n_sample, 3) of simulated and measured
        poses: x, y [m], angle within half a turn [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanSquare(AbstractError):
    """Error E of the thesis: mean squared distance of poses, angles times a length [mm^2].

    Source: RPI thesis, eq. 5.1, in millimetres, without the first pose, where the simulation
    starts.
    """

    name: ClassVar[str] = "mean-square"
    unit: ClassVar[str] = "mm^2"

    def of(self, difference: FloatArray) -> FloatArray:
        return np.asarray(_squares(difference, self.angle_scale).mean(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class RootMeanSquare(AbstractError):
    """Error f of the ASME paper: norm of the root mean squares of x, y and L theta [mm].

    Source: ASME 2006 paper, eqs. 3-4.
    """

    name: ClassVar[str] = "root-mean-square"
    unit: ClassVar[str] = "mm"

    def of(self, difference: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(_squares(difference, self.angle_scale).mean(axis=1)))


@dataclass(frozen=True, slots=True, kw_only=True)
class EndPose(AbstractError):
    """Squared distance of the last poses, for data with few other poses [mm^2]."""

    name: ClassVar[str] = "end-pose"
    unit: ClassVar[str] = "mm^2"

    def of(self, difference: FloatArray) -> FloatArray:
        return _squares(difference[:, -1:], self.angle_scale)[:, 0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Robust(AbstractError):
    """Mean square error that grows linearly above a distance, robust to outliers [mm^2].

    The loss is ``2 c^2 (sqrt(1 + d^2 / c^2) - 1)`` of each distance d, soft L1.
    """

    name: ClassVar[str] = "robust"
    unit: ClassVar[str] = "mm^2"
    distance: float = 2e-3  # c, above which the loss is linear [m]

    def of(self, difference: FloatArray) -> FloatArray:
        square = (1e3 * self.distance) ** 2
        squares = _squares(difference, self.angle_scale)
        loss = 2.0 * square * (np.sqrt(1.0 + squares / square) - 1.0)
        return np.asarray(loss.mean(axis=1))


ERRORS: Final = (MeanSquare, RootMeanSquare, EndPose, Robust)


def _squares(difference: FloatArray, angle_scale: float) -> FloatArray:
    """Return squared distances (n, n_sample) [mm^2]."""
    scaled = difference * np.array([1e3, 1e3, 1e3 * angle_scale])
    return np.asarray(np.einsum("nsk,nsk->ns", scaled, scaled))


class Evaluation(NamedTuple):
    """Errors of rollouts, each of one experiment with one parameter set."""

    error: FloatArray  # (n,) inf for a failure
    reasons: list[str]  # reason of a failure, else empty


class Comparer:
    """Comparison of experiments with simulations at points of a parameter space.

    Every free unknown of the space must apply to an experiment. Error, motion model and stepper are
    by default `MeanSquare()`, `QuasiStatic()` and `Adaptive()`. The number of threads, by default
    that of the cores, does not affect the result.
    """

    def __init__(
        self,
        targets: Sequence[Target],
        space: ParameterSpace,
        error: AbstractError | None = None,
        motion: AbstractMotionModel | None = None,
        stepper: AbstractStepper | None = None,
        threads: int | None = None,
    ) -> None:
        self.targets = tuple(targets)
        self.space = space
        self.error = error or MeanSquare()
        _refuse_idle(self.targets, space)
        cases = [target.case for target in self.targets]
        self.ensemble: Rollouts = ensemble_of(cases, motion, stepper, threads)
        self._columns = _Columns(self.targets, space)
        self._length = np.array([len(target.pose) for target in self.targets])
        self._measured = np.zeros((len(self.targets), self.ensemble.n_sample, 3))
        for k, target in enumerate(self.targets):
            self._measured[k, : len(target.pose)] = target.pose

    def over(self, space: ParameterSpace) -> Comparer:
        """Return a comparer of the same experiments in another space."""
        other = copy.copy(self)
        other.space, other._columns = space, _Columns(self.targets, space)
        return other

    def errors(self, which: IntArray, points: FloatArray) -> Evaluation:
        """Compute errors of rollouts: of targets by their indices (n,), at points (n, n_free)."""
        error = np.full(len(which), math.inf)

        def compare(rollouts: IntArray, difference: FloatArray) -> None:
            length = self._length[which[rollouts]]
            # Grouped by length, not padded: rounding of sums depends on the number of terms.
            for n in np.unique(length):
                own = length == n
                error[rollouts[own]] = self.error.of(difference[own, :n])

        good, reasons = self._compared(compare, which, points)
        error[~good] = math.inf
        return Evaluation(error, reasons)

    def errors_at(self, point: FloatArray) -> FloatArray:
        """Return the errors (n_target,) of all experiments at a point (n_free,)."""
        n = len(self.targets)
        return self.errors(np.arange(n), np.repeat(point[None], n, axis=0)).error

    def residuals_at(
        self, members: Sequence[int] | IntArray, point: FloatArray
    ) -> list[FloatArray]:
        """Return the differences (n_frame, 3) of experiments at one point (n_free,), as from
        `differences`, in the frames that count; without failed simulations."""
        own = np.asarray(members, np.int64)
        points = np.repeat(np.asarray(point, np.float64)[None], len(own), axis=0)
        difference, good, _ = self.differences(own, points)
        frames = [np.arange(n) for n in self.length(own[good])]
        series = [one[rows] for one, rows in zip(difference[good], frames, strict=True)]
        masks = counting_frames([self.targets[m] for m in own[good].tolist()], frames, series)
        return [one[mask] for one, mask in zip(series, masks, strict=True) if mask.any()]

    def length(self, which: IntArray) -> IntArray:
        """Return the number of samples (n,) of experiments."""
        return np.asarray(self._length[which])

    def feasible(self, points: FloatArray) -> BoolArray:
        """Return a mask (k,) of the points at which every experiment is feasible."""
        n = len(self.targets)
        which = np.tile(np.arange(n), len(points))
        reasons = [""] * len(which)
        rows = np.repeat(np.asarray(points, np.float64), n, axis=0)
        for own, values in self._columns.groups(which, rows):
            for k, reason in zip(own, self.ensemble.refused(which[own], values), strict=True):
                reasons[k] = reason
        good = np.array([not r for r in reasons], bool).reshape(len(points), n)
        return np.asarray(good.all(axis=1))

    def differences(
        self, which: IntArray, points: FloatArray
    ) -> tuple[FloatArray, BoolArray, list[str]]:
        """Simulate rollouts: return differences (n, n_sample, 3) from the measured poses, zero
        after the last one, which simulations converged, and reasons of failures."""
        found = np.zeros((len(which), self.ensemble.n_sample, 3))

        def store(rollouts: IntArray, difference: FloatArray) -> None:
            found[rollouts] = difference

        good, reasons = self._compared(store, which, points)
        return found, good, reasons

    def _compared(
        self, use: Callable[[IntArray, FloatArray], None], which: IntArray, points: FloatArray
    ) -> tuple[BoolArray, list[str]]:
        """Simulate rollouts and pass their differences (k, n_sample, 3) from the measured poses to
        a function, as `Ensemble.simulate_into` does; they are zero after the last measured pose."""
        good, reasons = np.zeros(len(which), bool), [""] * len(which)
        sample = np.arange(self.ensemble.n_sample)
        for own, values in self._columns.groups(which, points):

            def compare(rollouts: IntArray, pose: FloatArray, own: IntArray = own) -> None:
                mine = own[rollouts]
                difference = pose_difference(pose, self._measured[which[mine]])
                difference[sample >= self._length[which[mine]][:, None]] = 0.0
                use(mine, difference)

            good[own], why = self.ensemble.simulate_into(compare, which[own], values)
            for k, reason in zip(own.tolist(), why, strict=True):
                reasons[k] = reason
        return good, reasons


class _Columns:
    """Assignment of the unknowns of a space to the parameters of experiments."""

    def __init__(self, targets: Sequence[Target], space: ParameterSpace) -> None:
        free = {label: k for k, label in enumerate(space.labels)}
        n_free = len(free)
        # Frozen unknowns are constant columns behind those of the free ones.
        place = {u.label: free.get(u.label, n_free + k) for k, u in enumerate(space.unknowns)}
        self._constant = np.array([u.nominal for u in space.unknowns])
        rows = []
        for target in targets:
            found: dict[str, int] = {}
            for unknown in space.unknowns:
                if unknown.name not in found and unknown.covers(target.conditions):
                    found[unknown.name] = place[unknown.label]
            rows.append(found)
        names = [tuple(sorted(found)) for found in rows]
        self._kinds = sorted(set(names))
        self._kind = np.array([self._kinds.index(own) for own in names])
        self._place = [
            np.array([[found.get(name, 0) for name in kind] for found in rows], np.int64)
            for kind in self._kinds
        ]

    def groups(
        self, which: IntArray, points: FloatArray
    ) -> list[tuple[IntArray, Mapping[str, FloatArray]]]:
        """Return groups of rollouts that vary the same parameters, with values (n,) by name."""
        constant = np.broadcast_to(self._constant, (len(points), len(self._constant)))
        table = np.concatenate((points, constant), axis=1)
        kind = self._kind[which]
        groups: list[tuple[IntArray, Mapping[str, FloatArray]]] = []
        for k in np.unique(kind):
            own = np.flatnonzero(kind == k)
            place = self._place[k][which[own]]
            values = np.take_along_axis(table[own], place, axis=1)
            groups.append((own, dict(zip(self._kinds[k], values.T.copy(), strict=True))))
        return groups


def _refuse_idle(targets: Sequence[Target], space: ParameterSpace) -> None:
    """Raise `InvalidInput` for an unknown that applies to no experiment."""
    for unknown in space.free:
        if not any(unknown.covers(target.conditions) for target in targets):
            raise InvalidInput(
                unknown.label,
                found="no experiment under these conditions",
                expected="at least one experiment that depends on it",
                hint="fix the parameter, or leave it out",
            )


def combined_errors(errors: FloatArray, combine: str) -> FloatArray:
    """Return the sum, mean or largest (k,) of errors (k, n_member)."""
    if combine == "largest":
        return np.asarray(errors.max(axis=1))
    return np.asarray(errors.sum(axis=1) if combine == "sum" else errors.mean(axis=1))


# Outliers: their error, as a length, exceeds the median by this many standard deviations of its
# logarithm, and by this factor; both robust, computed from this many experiments at least.
STANDS_OUT: Final = 3.5
TIMES: Final = 2.0
MIN_COUNT: Final = 8
# Or a single one contributes this share of the summed square, and this many times an equal share.
RULES: Final = 0.05
TIMES_ITS_SHARE: Final = 20.0


def lengths_of(errors: FloatArray, unit: str) -> FloatArray:
    """Convert errors to lengths [mm]: the roots of those in mm^2."""
    return np.sqrt(errors) if unit == "mm^2" else np.asarray(errors)


def root_mean(errors: FloatArray, unit: str) -> float:
    """Return the root mean square of errors as lengths [mm]."""
    squares = errors if unit == "mm^2" else errors**2
    return math.sqrt(float(np.mean(squares)))


def outliers(errors: FloatArray, unit: str) -> list[int]:
    """Return the indices of the errors (n,) that are outliers, the largest first.

    Source
    ------
    Iglewicz & Hoaglin (1993): the modified z-score, here of logarithms, as errors are positive and
    skewed; 3.5 is their limit.
    """
    known = np.flatnonzero(np.isfinite(errors) & (errors > 0.0))
    if len(known) < MIN_COUNT:
        return []
    logs = np.log(errors[known]) * (0.5 if unit == "mm^2" else 1.0)
    middle = float(np.median(logs))
    scatter = 1.4826 * float(np.median(np.abs(logs - middle)))
    squares = np.exp(2.0 * (logs - logs.max()))
    ruling = squares > max(RULES, TIMES_ITS_SHARE / len(known)) * squares.sum()
    far = known[(logs > middle + max(STANDS_OUT * scatter, math.log(TIMES))) | ruling]
    return sorted(far.tolist(), key=lambda k: -float(errors[k]))
