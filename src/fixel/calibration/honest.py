"""Intervals of parameters that allow for a model that is wrong, and their joint distribution.

Two fits weigh the data differently: least squares over all frames, and a mixed-effects fit in which
every experiment has shifts of its own (`mixed`). Of a right model they agree within their errors;
of a wrong one they do not, and how far they are apart is the only sign in the data of an error that
all experiments share. The interval is that of the mixed fit, with the variance

    max(model-based, jackknife over experiments) + mean of (mixed - least squares)^2

over the two descents of least squares, from the search's best and from the mixed fit, and Student's
t with the effective number of experiments. If the noise of the measurements is unknown, the sum of
both differences replaces their mean, since nothing shows how wrong the model is.

The joint distribution shows which combinations of parameters the experiments exclude. Its
correlations are those of least squares at the best fit: of the inverse of the information that the
experiments give about all parameters together.

Source: Hausman (1978) for the difference of two estimators; `clusters` and `mixed` have
theirs. Measured on simulated laboratories: `python -m benchmarks misfit`.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import NormalDist
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from fixel.calibration.mixed import Linear, fit_mixed, jackknife, numbered
from fixel.calibration.noise import Noise
from fixel.calibration.objective import ANGLE_SCALE, Comparer
from fixel.calibration.target import Target, same_configuration
from fixel.errors import InvalidInput
from fixel.model.records import Estimate
from fixel.model.space import ParameterSpace, Unknown
from fixel.typing import BoolArray, FloatArray, IntArray

ROUNDS: Final = 4  # linearisations
INSTANTS: Final = 27  # of an experiment
# Shifts that each experiment has of its own: step of the derivative, and standard deviation about
# which thirty times less and thirty times more are searched.
SHIFTS: Final = {
    "mu_pusher": (0.02, 0.02),
    "mu_fixel": (0.02, 0.02),
    "friction_centre_x": (7e-4, 1e-3),
    "friction_centre_y": (7e-4, 1e-3),
    "start_x": (7e-4, 3e-4),
    "start_y": (7e-4, 3e-4),
    "start_theta": (6e-3, 4e-3),
}
SEARCHED_EVERYWHERE: Final = ("mu_pusher", "mu_fixel")  # shifts only of what is itself searched
SPAN: Final = math.log(30.0)
STEP: Final = 0.2  # of the derivative of other parameters [scales]
MAX_SCALES: Final = 3.0  # that one round may move a parameter
MAX_SD: Final = 4.0  # of an own shift
# Standard deviations of priors about the best [ranges]: of the fit itself, which would wander off
# where its own information is weak, and of its variance, which must not take that for information.
NEAR: Final = 0.1
WEAK: Final = 0.5
MIN_FREEDOM: Final = 1.5
MM: Final = np.array([1e3, 1e3, 1e3 * ANGLE_SCALE])


class Honest(NamedTuple):
    """Estimate that allows for a model that is wrong."""

    value: FloatArray  # (n_free,) of the mixed fit
    # (n_free,) Standard error: model-based or over experiments, whichever is larger; see `widened`.
    sd: FloatArray
    freedom: FloatArray  # (n_free,) degrees of freedom behind it
    clusters: int  # conditions under which experiments were done

    def widened(self, fits: Sequence[FloatArray], *, known_noise: bool = True) -> Honest:
        """Include the disagreement with the ends (n_free,) of least squares in the standard errors.

        The squared differences are averaged if the noise is known, else summed.
        """
        squares = (self.value - np.array(fits)) ** 2
        gap = squares.mean(axis=0) if known_noise else squares.sum(axis=0)
        return self._replace(sd=np.sqrt(self.sd**2 + gap))

    def ends(self, level: float) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends (n_free,) of intervals, before any bounds."""
        from scipy.special import stdtrit

        reach = stdtrit(self.freedom, 0.5 * (1.0 + level)) * self.sd
        return self.value - reach, self.value + reach


class ShiftModel:
    """Experiments of a calibration with shifts of their own, for the rollouts of a mixed fit."""

    def __init__(self, comparer: Comparer) -> None:
        self.searched = comparer.space
        self.space = _with_shifts(comparer.space)
        self.targets = comparer.targets
        self.free = [self.space.labels.index(label) for label in comparer.space.labels]
        self.columns = [_columns(self.space, target) for target in self.targets]
        self.instants = [_instants(len(target.pose)) for target in self.targets]
        self._comparer = comparer.over(self.space)

    def differences(self, rows: FloatArray) -> FloatArray:
        """Simulated less measured poses (k, 3 INSTANTS) [mm].

        Rows (k, 1 + n) are the number of an experiment and a point of `space`. Differences are zero
        beyond an experiment's last instant, and inf without a simulation.
        """
        which = rows[:, 0].astype(np.int64)
        found, good, _ = self._comparer.differences(which, rows[:, 1:])
        out = np.zeros((len(which), 3, INSTANTS))
        for row, member in enumerate(which.tolist()):
            own = self.instants[member]
            out[row, :, : len(own)] = (found[row, own] * MM).T
        out[~good] = math.inf
        return out.reshape(len(rows), -1)


def mixed_study(
    shifted: ShiftModel, members: Sequence[int], point: FloatArray, noise: Noise
) -> Generator[FloatArray, FloatArray, Honest]:
    """Rollouts of a mixed fit: yields rows, and is sent `ShiftModel.differences` of them.

    It begins at the best point (n_free,) of least squares. The noise is that of the camera.
    """
    space = shifted.searched
    names = [name for name in SHIFTS if any(name in shifted.columns[m] for m in members)]
    unit = np.array([SHIFTS[name][1] for name in names])
    n, q = len(members), len(names)
    cluster = numbered([condition_of(shifted.targets[m]) for m in members])
    weight = 1.0 / np.bincount(cluster)[cluster]
    precision, anchor = _prior(space, point, NEAR)
    theta, own, log_sd = np.array(point, np.float64), np.zeros((n, q)), np.zeros(q + 3)
    for _ in range(ROUNDS):
        probes = [
            Probes(shifted, m, names, theta, one * unit)
            for m, one in zip(members, own, strict=True)
        ]
        parts = yield from probe_rollouts(probes)
        data = linear_data(shifted, probes, parts, own, unit, noise)._replace(
            weight=weight,
            precision=precision * np.outer(space.scale, space.scale),
            mean=(anchor - theta) / space.scale,
        )
        fit = fit_mixed(data, log_sd, SPAN)
        log_sd = fit.log_sd
        reach = MAX_SD * np.exp(log_sd[:q])
        own = np.clip(fit.shifts, -reach, reach)
        step = space.scale * np.clip(fit.step, -MAX_SCALES, MAX_SCALES)
        theta = np.clip(theta + step, space.low, space.high)
    weak = _prior(space, point, WEAK)[0] * np.outer(space.scale, space.scale)
    covariance = np.linalg.inv(fit.information.sum(axis=0) + weak)
    spread, effective = jackknife(fit.information, fit.gradient, covariance, cluster)
    variance = np.maximum(np.diag(covariance), np.diag(spread))
    freedom = np.maximum(effective - 1.0, MIN_FREEDOM)  # effective: number of conditions behind it
    return Honest(theta, np.sqrt(variance) * space.scale, freedom, int(cluster.max()) + 1)


class Probes:
    """Points about one experiment's own, for central differences.

    The shifts of `names` are varied about `shift` (q,), besides the free parameters `theta`
    (n_free,). Steps replace those of `SHIFTS`, by name.
    """

    def __init__(
        self,
        shifted: ShiftModel,
        member: int,
        names: Sequence[str],
        theta: FloatArray,
        shift: FloatArray,
        steps: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        space, own = shifted.space, shifted.columns[member]
        self.member = member
        low, high = space.low, space.high
        base = np.array(space.nominal)
        base[shifted.free] = theta
        self._shifts = [own.get(name) for name in names]
        for column, value in zip(self._shifts, shift.tolist(), strict=True):
            if column is not None:
                base[column] += value
        base = np.clip(base, low, high)
        self._free = shifted.free
        moved = {*own.values()} & {*shifted.free, *(c for c in self._shifts if c is not None)}
        points, self._moves = [base], {}
        for column in sorted(moved):
            step = steps.get(space.free[column].name) or _step(space.free[column])
            ends = [min(base[column] + step, high[column]), max(base[column] - step, low[column])]
            self._moves[column] = len(points)
            for end in ends:
                point = base.copy()
                point[column] = end
                points.append(point)
        self.points = np.array(points)

    def slopes(
        self, rows: FloatArray, scale: FloatArray, unit: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(3, m, p) change a scale of each parameter, (3, m, q) a unit of each shift.

        Where the simulation on one side failed, such as of bodies that overlap, the difference is
        one-sided; it is zero where both failed.
        """
        nothing, table = np.zeros(rows.shape[1:]), {}
        for column, at in self._moves.items():
            known = [k for k in (at, 0, at + 1) if np.isfinite(rows[k]).all()]
            span = self.points[known[0], column] - self.points[known[-1], column] if known else 0.0
            table[column] = (rows[known[0]] - rows[known[-1]]) / span if span else nothing
        common = [table.get(c, nothing) * s for c, s in zip(self._free, scale, strict=True)]
        single = [
            nothing if c is None else table[c] * u for c, u in zip(self._shifts, unit, strict=True)
        ]
        return np.stack(common, -1), np.stack(single, -1)


def probe_rollouts(probes: Sequence[Probes]) -> Generator[FloatArray, FloatArray, list[FloatArray]]:
    """Yield the rows of all probes for `ShiftModel.differences`; return the answers of each."""
    count = [len(one.points) for one in probes]
    which = np.repeat([float(one.member) for one in probes], count)
    answers = yield np.column_stack((which, np.concatenate([one.points for one in probes])))
    return np.split(answers.reshape(-1, 3, INSTANTS), np.cumsum(count)[:-1])


def linear_data(
    shifted: ShiftModel,
    probes: Sequence[Probes],
    parts: Sequence[FloatArray],
    own: FloatArray,
    unit: FloatArray,
    noise: Noise,
) -> Linear:
    """Return experiments that are linearised about points; each counts once, without a prior.

    `parts` are the answers of `probe_rollouts`; an experiment that failed at its point has no
    information. The points lie about the shifts `own` (n, q), in units (q,). The noise is that of
    the camera.
    """
    space = shifted.searched
    n, p, q = len(probes), len(space.free), own.shape[1]
    y = np.zeros((n, 3, INSTANTS))
    common, single = np.zeros((n, 3, INSTANTS, p)), np.zeros((n, 3, INSTANTS, q))
    share = np.zeros((n, INSTANTS))
    for k, (one, part) in enumerate(zip(probes, parts, strict=True)):
        if not np.isfinite(part[0]).all():
            continue
        common[k], single[k] = one.slopes(part, space.scale, unit)
        y[k] = single[k] @ own[k] - part[0]
        at, times = shifted.instants[one.member], shifted.targets[one.member].case.times
        share[k, : len(at)] = times[at] / times[-1]  # of the time; zero beyond the last
    white = MM * noise.standard_deviations
    return Linear(y, common, single, share, white, np.ones(n), np.zeros((p, p)), np.zeros(p))


def _with_shifts(space: ParameterSpace) -> ParameterSpace:
    """The space with all unknowns free, and one for each shift that it has not got."""
    unknowns = [replace(u, frozen=False) for u in space.unknowns]
    known = {u.name for u in unknowns}
    for name, (step, _) in SHIFTS.items():
        if name not in known and name not in SEARCHED_EVERYWHERE:
            reach = 100.0 * step
            unknowns.append(Unknown(name=name, low=-reach, high=reach, nominal=0.0, scale=step))
    return ParameterSpace(unknowns=tuple(unknowns))


def _columns(space: ParameterSpace, target: Target) -> dict[str, int]:
    """Index of the free unknown that gives an experiment its value, by parameter."""
    found: dict[str, int] = {}
    for k, unknown in enumerate(space.free):
        if unknown.covers(target.conditions):
            found.setdefault(unknown.name, k)
    return found


def _step(unknown: Unknown) -> float:
    return SHIFTS[unknown.name][0] if unknown.name in SHIFTS else STEP * float(unknown.scale or 0.0)


def _instants(length: int) -> IntArray:
    """Evenly spread frames of an experiment, the last among them."""
    count = min(length, INSTANTS)
    return np.asarray(np.round(np.linspace(length / count, length, count)) - 1, np.int64)


def condition_of(target: Target) -> object:
    """Return a label that experiments under the same conditions share."""
    same = same_configuration(target)
    return target.case.scene if same == target.key else same


def _prior(space: ParameterSpace, point: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
    """Precision (n, n) and mean (n,): a share of the range about the best, and priors given."""
    weak = 1.0 / (share * (space.high - space.low)) ** 2
    given = np.array([0.0 if u.prior is None else u.prior**-2 for u in space.free])
    mean = (weak * point + given * space.nominal) / (weak + given)
    return np.diag(weak + given), mean


DIFFERENCE: Final = 0.1  # of the differences [scales]
# Independent observations that an experiment counts for: errors of a motion are much alike.
OBSERVATIONS: Final = 3.0


class LinearFit(NamedTuple):
    """Poses of experiments near the best fit, linear in the parameters, in parts of their ranges.

    Only experiments whose simulations near the fit all converged, n of them.
    """

    slope: FloatArray  # (n, p, i) of poses at some instants [mm]
    off: FloatArray  # (n, i) simulated less measured poses [mm]
    good: BoolArray  # (n_target,) which experiments these are
    span: FloatArray  # (p,) ranges of the parameters

    @property
    def information(self) -> FloatArray:
        """Information of all experiments and of the bounds about the parameters (p, p)."""
        slope = self.slope
        own = np.einsum("npi,nqi->pq", slope, slope) / slope.shape[2] * OBSERVATIONS / self._error
        return np.asarray(own + 12.0 * np.eye(len(self.span)))

    @property
    def correlation(self) -> FloatArray:
        """Correlations (p, p) of the parameters.

        Directions without information have the variance of their bounds.
        """
        if not self.good.any():
            return np.eye(len(self.span))
        covariance = np.linalg.inv(self.information)
        sd = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(sd, sd))

    @property
    def _error(self) -> float:
        return max(float(np.mean(self.off**2)), 1e-12)

    def left_out(self) -> FloatArray:
        """Return by how much the fit moves where one experiment is left out (n_target, p)."""
        found = np.zeros((len(self.good), len(self.span)))
        if not self.good.any():
            return found
        weight = OBSERVATIONS / self._error / self.slope.shape[2]
        each = np.einsum("npi,nqi->npq", self.slope, self.slope) * weight
        gradient = np.einsum("npi,ni->np", self.slope, self.off) * weight
        moved = np.linalg.solve(self.information - each, gradient[..., None])[..., 0]
        found[self.good] = moved * self.span
        return found


def quoted(
    estimates: Iterable[Estimate], labels: Sequence[str], level: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return values (p,) and standard deviations (p,) of estimates; infinite without an interval.

    An interval with one open end has the width of its other half.
    """
    known = {estimate.label: estimate for estimate in estimates}
    own = [known[label] for label in labels]
    value = np.array([e.value for e in own])
    ends = np.array([[np.nan if x is None else x for x in (e.low, e.high)] for e in own])
    half = np.abs(ends - value[:, None])
    closed = np.isfinite(half).any(axis=1)
    sd = np.full(len(own), math.inf)
    if closed.any():
        if level is None:
            found = "intervals stored without it"
            raise InvalidInput("level", found=found, expected="a level", hint="calibrate again")
        reach = NormalDist().inv_cdf(0.5 + 0.5 * level)
        sd[closed] = np.nanmean(half[closed], axis=1) / reach
    return value, sd


def linear_fit(comparer: Comparer, point: FloatArray) -> LinearFit:
    """Simulate the experiments near the best fit (p,), by central differences."""
    space = comparer.space
    low, high = space.low, space.high
    step = DIFFERENCE * space.scale
    up, down = np.minimum(point + step, high), np.maximum(point - step, low)
    probes = np.tile(point, (1 + 2 * len(point), 1))
    np.fill_diagonal(probes[1::2], up)
    np.fill_diagonal(probes[2::2], down)
    n = len(comparer.targets)
    which = np.repeat(np.arange(n), len(probes))
    found, converged, _ = comparer.differences(which, np.tile(probes, (n, 1)))
    rows = np.unique(np.linspace(0, found.shape[1] - 1, INSTANTS).astype(np.int64))
    off = (found[:, rows] * MM).reshape(n, len(probes), -1)
    good: BoolArray = np.all(converged.reshape(n, len(probes)), axis=1)
    span = high - low
    slope = (off[good, 1::2] - off[good, 2::2]) / ((up - down) / span)[None, :, None]
    return LinearFit(slope, off[good, 0], good, span)


def draw_joint(
    centre: FloatArray,
    low: FloatArray,
    high: FloatArray,
    sd: FloatArray,
    correlation: FloatArray,
    n: int,
    seed: int,
) -> FloatArray:
    """Draw n points (n, p) of normal distributions with correlations (p, p), within bounds (p,).

    A parameter with an infinite standard deviation is even within its bounds.
    """
    size, axes = np.linalg.eigh(correlation)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    normal = np.random.default_rng(seed).standard_normal((n, len(centre))) @ root.T
    share = ndtr(normal)
    even = ~np.isfinite(sd)
    scale = np.where(even, 1.0, np.maximum(sd, 1e-300))
    left, right = ndtr((low - centre) / scale), ndtr((high - centre) / scale)
    inside = centre + scale * ndtri(left + (right - left) * share)
    found = np.where(even, low + (high - low) * share, inside)
    return np.asarray(np.clip(found, low, high))


# --- noise of measured start poses ----------------------------------------------------------------

# A simulation begins at the first measured pose. The noise of that pose moves the whole simulated
# trajectory, by the derivative of the trajectory with respect to the start: one error common to all
# frames of an experiment. The residuals of a right model therefore have the covariance
#
#     V = white + S S',
#
# where the columns of S are the changes that one standard deviation of x, y and theta of the start
# causes. See `docs/theory/misfit.md`.
STARTS: Final = ("start_x", "start_y", "start_theta")
# Smallest eigenvalue of the information, as a share of the largest, that counts as information.
MIN_INFORMATION: Final = 1e-9


class StartSensitivity(NamedTuple):
    """Changes of one experiment's simulated poses."""

    instants: IntArray  # (m,) frames of the experiment at which the changes are known
    # (m, 3, n_free) Change of x, y, theta per scale of each parameter [m, m, rad].
    common: FloatArray
    # (m, 3, 3) Change that one standard deviation of x, y, theta of the start pose causes.
    start: FloatArray

    @property
    def at_end(self) -> StartSensitivity:
        """Changes of the last pose only."""
        return StartSensitivity(self.instants[-1:], self.common[-1:], self.start[-1:])

    def deviations(self, frames: IntArray) -> FloatArray:
        """Return standard deviations (n, 3) of the poses at frames (n,), by the start's noise."""
        own = np.sqrt((self.start**2).sum(axis=2))
        return np.column_stack([np.interp(frames, self.instants, column) for column in own.T])


def start_study(
    shifted: ShiftModel, members: Sequence[int], point: FloatArray, camera: Noise
) -> Generator[FloatArray, FloatArray, list[StartSensitivity]]:
    """Compute the sensitivities of experiments; yields rows, is sent `ShiftModel.differences`.

    An experiment whose scene begins elsewhere than at the first measured pose, such as at a planned
    one, has no noise of the start. Steps of the start are standard deviations of its noise, that of
    one measured pose, so that the changes are those which this noise makes on a rough surface.
    """
    sd = camera.standard_deviations
    steps = dict(zip(STARTS, sd.tolist(), strict=True))
    probes = [Probes(shifted, m, STARTS, point, np.zeros(3), steps) for m in members]
    parts = yield from probe_rollouts(probes)
    found = []
    for one, part in zip(probes, parts, strict=True):
        instants = shifted.instants[one.member]
        own = sd * shifted.targets[one.member].starts_measured
        slopes = one.slopes(part[:, :, : len(instants)], shifted.searched.scale, own)
        common, start = (np.swapaxes(table, 0, 1) / MM[:, None] for table in slopes)
        found.append(StartSensitivity(instants, common, start))
    return found


def start_dispersion(
    sensitivities: Sequence[StartSensitivity], frames: Sequence[int], noise: Noise, camera: Noise
) -> float:
    """Compute the dispersion of a right model whose start poses have noise.

    Least squares weights residuals by 1/W of `noise`. Its estimate has the covariance H^-1 J' W^-1
    V W^-1 J H^-1 with H = J' W^-1 J, where independent residuals of variance W would have H^-1. The
    dispersion is the largest ratio of the two variances of a parameter. `frames` are the numbers of
    frames that count; `camera` is the noise of one measured pose.
    """
    n = sensitivities[0].common.shape[2]
    information, middle = np.zeros((n, n)), np.zeros((n, n))
    white = (camera.standard_deviations / noise.standard_deviations) ** 2
    for one, count in zip(sensitivities, frames, strict=True):
        share = count / len(one.instants)  # of the frames that one instant represents
        slopes = one.common / noise.standard_deviations[:, None]
        start = one.start / noise.standard_deviations[:, None]
        carried = share * np.einsum("mcp,mcs->ps", slopes, start)
        information += share * np.einsum("mcp,mcr->pr", slopes, slopes)
        middle += carried @ carried.T
        middle += share * np.einsum("mcp,c,mcr->pr", slopes, white, slopes)
    inverse = np.linalg.pinv(information, rcond=MIN_INFORMATION, hermitian=True)
    alone = np.diag(inverse)
    ratio = np.diag(inverse @ middle @ inverse)[alone > 0.0] / alone[alone > 0.0]
    return float(ratio.max(initial=0.0))
