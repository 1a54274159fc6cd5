"""Sensitivity of a push to its start: growth of start errors, and bifurcation of outcomes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.indices import Indices
from fixel.uncertainty.prediction import Prediction

MIN_OUTCOMES: Final = 50  # outcomes that an ensemble needs for an analysis

# Smallest share of an outcome that counts for a bifurcation.
RARE: Final = 0.01
# Probability of detecting a gap in an ensemble without one.
FALSE_ALARM: Final = 1e-3
MAX_OUTCOMES: Final = 8

# Share of the starts, nearest to the nominal one, that the local gain is fitted to.
LOCAL: Final = 0.25
NEIGHBOURS: Final = 4

# Growth of an error from which a push counts as sensitive.
SENSITIVE: Final = 2.0
# Near bifurcation: neighbours move apart by more than the size of the start error, and by this
# many times more than the median of neighbours.
TORN_MORE: Final = 5.0

FLAGS: Final = ("bifurcates", "nearly bifurcates", "sensitive", "insensitive")
MEANING: Final[Mapping[str, str]] = {
    FLAGS[0]: "its outcomes form separate groups",
    FLAGS[1]: "some neighbouring starts end far from each other",
    FLAGS[2]: "start errors at least double",
    FLAGS[3]: "start errors do not grow much, or shrink",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSpread:
    """Size of a cloud of poses."""

    # Root mean square distance from the mean [m], [rad].
    position: float
    angle: float
    # (3,) Ends of the middle 95 % of x, y [m] and angle [rad].
    low: FloatArray
    high: FloatArray


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Sensitivity(Result):
    """Sensitivity of one push to errors of its start.

    Made by `fixel.sensitivity`.

    Attributes
    ----------
    prediction : Prediction
        Simulations from the perturbed starts.
    before, after : PoseSpread
        Spread of the start errors, and of the end poses.
    arm : float
        Radius of gyration of the body, by which rotations are counted as lengths [m/rad].
    amplification : float
        Root mean square spread after over before, rotations counted at `arm`.
    gain : float
        Largest growth of a small error: the first singular value of the map from start to end,
        fitted to the quarter of the starts nearest to the nominal one.
    worst : (3,) float64
        Error that grows most, of length 1, rotations counted at `arm`.
    curved : float
        Share of the spread after the push that no linear map of the start explains, 0 to 1.
    usual_tear, largest_tear : float
        Growth of the distance of neighbouring starts: median and 99 % quantile.
    outcome : (k,) int64
        Number of the outcome that each end belongs to; 0 is the most frequent.
    share : tuple of float
        Share of each outcome.
    modes : dict of str to float
        Share of each final contact mode.
    torn : bool
        Whether the outcomes of neighbouring starts are farther apart than the size of the start
        error, for 1 % of the starts: more than the roughness of the simulation.
    bifurcates : bool
        Whether outcomes or contact modes are farther apart than the size of the start error.
    apart : float
        Largest distance between the means of two outcomes or contact modes, with rotations [m].
    failed : dict of str to int
        Number of starts without an outcome, by reason.
    indices : Indices, optional
        Sobol indices, if requested.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import mm
    >>> start = fixel.StartError(x=1 * mm, y=1 * mm, kind="uniform")
    >>> found = fixel.sensitivity(pushed_square(0.5), start, samples=60, progress=False)
    >>> found.flag
    'insensitive'
    """

    prediction: Prediction
    before: PoseSpread
    after: PoseSpread
    arm: float
    amplification: float
    gain: float
    worst: FloatArray
    curved: float
    usual_tear: float
    largest_tear: float
    outcome: IntArray
    share: tuple[float, ...]
    modes: dict[str, float]
    apart: float
    torn: bool
    bifurcates: bool
    failed: dict[str, int]
    indices: Indices | None = None

    @property
    def flag(self) -> str:
        """Worst of `FLAGS` that applies."""
        if self.bifurcates:
            return FLAGS[0]
        if self.torn and self.largest_tear >= TORN_MORE * self.usual_tear:
            return FLAGS[1]
        return FLAGS[2] if max(self.gain, self.amplification) >= SENSITIVE else FLAGS[3]

    def summary(self) -> dict[str, Any]:
        """Return plain values in SI units."""
        return {
            "flag": self.flag,
            "amplification": self.amplification,
            "gain": self.gain,
            "worst_direction": self.worst.tolist(),
            "curved": self.curved,
            "usual_tear": self.usual_tear,
            "largest_tear": self.largest_tear,
            "arm_m": self.arm,
            "before": _plain(self.before),
            "after": _plain(self.after),
            "outcome_shares": list(self.share),
            "contact_modes": dict(self.modes),
            "apart_m": self.apart,
            "failed": dict(self.failed),
        }

    def _summary(self) -> Summary:
        own = self.prediction
        rows = [
            ("position", "mm", 1e3 * self.before.position, 1e3 * self.after.position),
            ("angle", "deg", *map(math.degrees, (self.before.angle, self.after.angle))),
        ]
        spread = Table(
            ("spread (rms)", "", Column("start", format=".3g"), Column("end", format=".3g")), rows
        )
        notes = [
            f"a start error grows {self.amplification:.2g} times on average, a small one up to"
            f" {self.gain:.2g} times"
        ]
        if len(self.share) > 1:
            shares = ", ".join(f"{share:.0%}" for share in self.share)
            notes.append(f"{len(self.share)} separate outcomes: {shares}")
        if self.failed:
            notes.append(f"{sum(self.failed.values())} starts without an outcome are not included")
        starts = "" if own.error is None else f" S{str(own.error)[1:]}."
        return Summary(
            f"Sensitivity: {self.flag}: {MEANING[self.flag]}.{starts}",
            [spread] if self.indices is None else [spread, self.indices.table()],
            notes,
            {"runs": str(len(own.ended)), "motion": own.motion, "seed": str(own.seed)},
        )

    def _data(self) -> Table:
        """Start error, end and contact mode of each run, and the outcome that it belongs to."""
        runs = self.prediction._data()
        rows = [(*row, int(k)) for row, k in zip(runs.rows, self.outcome, strict=True)]
        return Table((*runs.columns, "outcome"), rows)


def sensitivity_of(ensemble: Prediction) -> Sensitivity:
    """Compute the sensitivity of a push from its ensemble.

    Raise `InvalidInput` for fewer than 50 starts with an outcome.
    """
    end, arm = ensemble.ends, ensemble.arm
    if len(end) < MIN_OUTCOMES:
        why = next((reason for reason in ensemble.reasons if reason), "")
        raise InvalidInput(
            "samples",
            found=f"{len(end)} starts with an outcome" + (f" ({why})" if why else ""),
            expected=f"at least {MIN_OUTCOMES}",
        )
    weight = np.array([1.0, 1.0, arm])
    start, after = ensemble.drawn[ensemble.ended] * weight, (end - end.mean(axis=0)) * weight
    size_in, size_out = _rms(start), _rms(after)
    gain, worst = _gain(start, (end - ensemble.nominal[-1]) * weight)
    usual, largest, distance = _tears(start, after)
    outcome = group_outcomes(after, floor=size_in)
    shares = np.bincount(outcome) / len(outcome)
    mode = ensemble.mode[ensemble.ended]
    names, numbered, counts = np.unique(mode, return_inverse=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    apart = max(_apart(after, outcome), _apart(after, numbered))
    several = len(shares) > 1 or int(np.sum(counts / len(mode) >= RARE)) > 1
    return Sensitivity(
        prediction=ensemble,
        before=_spread(ensemble.drawn[ensemble.ended]),
        after=_spread(end),
        arm=arm,
        amplification=size_out / size_in,
        gain=gain,
        worst=worst,
        curved=_curved(start, after),
        usual_tear=usual,
        largest_tear=largest,
        outcome=outcome,
        share=tuple(shares.tolist()),
        modes={str(names[k]): float(counts[k] / len(mode)) for k in order if names[k]},
        apart=apart,
        torn=distance > size_in,
        bifurcates=several and apart > size_in,
        failed=_failed(ensemble),
    )


def group_outcomes(cloud: FloatArray, floor: float) -> IntArray:
    """Divide points (n, d) into groups with gaps between them; return the group of each (n,).

    Points are projected on their principal axes. In a cloud without a gap, distances between
    neighbours there are exponentially distributed about the local mean. So the widest of n exceeds
    r times the mean of its k = sqrt(n) neighbours with a probability below ``n (1 + r / k)^-k``. A
    gap divides the cloud if it exceeds the r of probability 1e-3 on both sides, is wider than
    `floor`, and has 1 % of the points on each side. The parts are then divided in the same way.
    Group 0 is the largest.
    """
    label = np.zeros(len(cloud), np.int64)
    waiting: list[IntArray] = [np.arange(len(cloud))]
    done: list[IntArray] = []
    least = max(5, math.ceil(RARE * len(cloud)))
    while waiting:
        own = waiting.pop()
        full = len(done) + len(waiting) + 1 >= MAX_OUTCOMES
        low = None if full else _gap(cloud[own], floor, least)
        if low is None:
            done.append(own)
        else:
            waiting += [own[low], own[~low]]
    done.sort(key=lambda own: (-len(own), own[0]))
    for k, own in enumerate(done):
        label[own] = k
    return label


def _gap(cloud: FloatArray, floor: float, least: int) -> NDArray[np.bool_] | None:
    """Return a mask (n,) of the points below the widest significant gap; None without one."""
    n = len(cloud)
    if n < 2 * least:
        return None
    _, _, axes = np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)
    best, split = 1.0, None
    for axis in axes:
        along = cloud @ axis
        order = np.sort(along)
        width = np.diff(order)
        k = max(5, round(math.sqrt(n)))
        limit = k * ((n / FALSE_ALARM) ** (1.0 / k) - 1.0)
        where = np.arange(least - 1, n - least)  # last point below the gap
        below = (order[where] - order[np.maximum(where - k, 0)]) / np.minimum(k, where)
        above = (order[np.minimum(where + 1 + k, n - 1)] - order[where + 1]) / np.minimum(
            k, n - 2 - where
        )
        usual = np.maximum(np.maximum(below, above), 1e-3 * floor)
        ratio = np.where(width[where] > floor, width[where] / (limit * usual), 0.0)
        if len(ratio) and ratio.max() > best:
            best, at = float(ratio.max()), int(where[ratio.argmax()])
            split = along <= 0.5 * (order[at] + order[at + 1])
    return split


def _gain(start: FloatArray, end: FloatArray) -> tuple[float, FloatArray]:
    """Return the largest singular value of the map near the nominal start, and its direction."""
    scale = np.maximum(start.std(axis=0), 1e-30)
    distance = np.linalg.norm(start / scale, axis=1)
    n = max(MIN_OUTCOMES, math.ceil(LOCAL * len(start)))
    near = np.argsort(distance, kind="stable")[:n]
    free = start.std(axis=0) > 0.0
    table = np.column_stack((start[near][:, free], np.ones(len(near))))
    found, *_ = np.linalg.lstsq(table / np.append(scale[free], 1.0), end[near], rcond=None)
    slope = (found[:-1].T / scale[free]).T
    _, sizes, directions = np.linalg.svd(slope.T, full_matrices=False)
    worst = np.zeros(3)
    worst[free] = directions[0]
    turn = worst[np.abs(worst).argmax()]
    return float(sizes[0]), worst if turn >= 0.0 else -worst


def _curved(start: FloatArray, end: FloatArray) -> float:
    scale = np.maximum(start.std(axis=0), 1e-30)
    table = np.column_stack((start / scale, np.ones(len(start))))
    found, *_ = np.linalg.lstsq(table, end, rcond=None)
    whole = float(np.sum(end**2))
    return float(np.sum((end - table @ found) ** 2)) / whole if whole > 0.0 else 0.0


def _tears(start: FloatArray, end: FloatArray) -> tuple[float, float, float]:
    """Return the median and 99 % quantile of the neighbours' growth, and that of end distances."""
    from scipy.spatial import cKDTree

    tree = cKDTree(start)
    distance, which = tree.query(start, k=min(NEIGHBOURS, len(start) - 1) + 1)
    apart = np.linalg.norm(end[which[:, 1:]] - end[:, None], axis=2)
    growth = np.sum(apart, axis=1) / np.maximum(np.sum(distance[:, 1:], axis=1), 1e-30)
    middle, most = np.quantile(growth, (0.5, 0.99))
    return float(middle), float(most), float(np.quantile(apart.mean(axis=1), 0.99))


def _apart(cloud: FloatArray, label: IntArray) -> float:
    """Return the largest distance between the means of groups that are not rare."""
    shares = np.bincount(label) / len(label)
    means = [cloud[label == k].mean(axis=0) for k in np.flatnonzero(shares >= RARE)]
    return max((float(np.linalg.norm(a - b)) for a in means for b in means), default=0.0)


def _failed(ensemble: Prediction) -> dict[str, int]:
    """Count the reasons of failures, without the instants, which differ from start to start."""
    why = [ensemble.reasons[k].partition(" at ")[0] for k in np.flatnonzero(~ensemble.ended)]
    return {reason: why.count(reason) for reason in sorted(set(why))}


def _spread(pose: FloatArray) -> PoseSpread:
    off = pose - pose.mean(axis=0)
    low, high = np.quantile(pose, (0.025, 0.975), axis=0)
    return PoseSpread(
        position=float(np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2))),
        angle=float(np.sqrt(np.mean(off[:, 2] ** 2))),
        low=low,
        high=high,
    )


def _rms(cloud: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(cloud**2, axis=1))))


def _plain(spread: PoseSpread) -> dict[str, Any]:
    return {
        "position_rms_m": spread.position,
        "angle_rms_rad": spread.angle,
        "low_m_m_rad": spread.low.tolist(),
        "high_m_m_rad": spread.high.tolist(),
    }
