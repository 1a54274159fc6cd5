"""Accuracy of the end of a simulation: a second, independent way solves it again.

Quasi-static motion of one part is followed from contact mode to contact mode, which shares no step
with the stepper. Other motion is repeated in small fixed steps, which share no decision about
steps. docs/theory/modes.md has measured figures.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fixel.kernels import arrays as at, codes
from fixel.kernels.arrays import StepMethod
from fixel.kernels.modes import walk
from fixel.simulation.pack import PackedBatch
from fixel.simulation.result import AGREED, CERTIFIED, UNCERTAIN
from fixel.simulation.threads import in_ranges, poses_at, shape_poses
from fixel.typing import BoolArray, FloatArray, IntArray

APART_LENGTH: Final = 5e-3  # of the characteristic length: two ends that are this close agree
APART_ANGLE: Final = math.radians(0.1)
UNSURE: Final = 4.0  # times these limits; within them, ends of fixed steps err by themselves
# Fixed steps, of the time in which the fastest motion covers that length; longer if they are many.
FIXED_STEP: Final = 5e-4, 1e-2
MOST_STEPS: Final = 100_000  # of fixed length, at least, whatever the limit of the stepper
# Shifts of the start, of that length and in rad: every step size may choose the same motion.
SHIFTS: Final = 2e-6 * np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
# Ways to solve a rollout; from SHIFTED, the stepper from each shift.
STEPPER, MODES, FIXED, FINER, FINEST, MIDPOINT, COARSE, SHIFTED = range(8)
STEPS: Final = ((1.0, 0.0), (0.25, 0.0), (0.125, 0.0), (0.25, 0.5), (1.0, 0.5))  # length, lead
LOOKS: Final = np.arange(1, 33) / 32  # of a span, to find where two ways part

_LOST: Final = {
    walk.UNSUITED: "contact modes describe one part and one pusher on an even plane only",
    walk.NO_MODE: "no contact mode holds where one ended",
    walk.CHATTER: "contact modes alternate",
    walk.FOLD: "contact modes ended without a cause",
}


def confirm(
    packed: PackedBatch,
    method: StepMethod,
    final: FloatArray,
    status: IntArray,
    threads: int | None = None,
    modes: walk.ModeRecord | None = None,
) -> tuple[NDArray[np.str_], FloatArray, FloatArray, FloatArray, list[str]]:
    """Solve rollouts again; return verdicts (n,), distances and angles (n, 2), times of parting
    (n,) [s], ends, reasons (n,).

    `final` (n, n_free, 3) are their ends in SI units, and `status` (n,) how they ended
    (`fixel.kernels.codes`). `modes` are those of quasi-static motion, where they are known.
    """
    n, end = len(final), packed.batch.settings[:, at.DURATION, None]
    ends = np.repeat(final[None], SHIFTED + len(SHIFTS), axis=0)  # by ways, as far as they are used
    ended, folds = np.full(n, walk.UNSUITED), np.zeros(n, np.int64)
    stopped = np.zeros(n, np.bool_)

    def solve(way: int, chosen: IntArray) -> None:
        if chosen.size:
            found, how = _solve(packed, method, way, chosen, end[chosen], threads)
            ends[way, chosen] = found[:, 0]
            stopped[chosen] |= (how != codes.CONVERGED) & (way < SHIFTED)

    converged = doubtful = status == codes.CONVERGED
    if method.motion == codes.QUASI_STATIC:
        modes = modes or _modes(packed, method, threads)
        ended, folds = modes.status, modes.count[:, walk.FOLDS]
        reached = ended == walk.COMPLETE
        if reached.any():
            ends[MODES, reached] = shape_poses(packed, modes.end[:, None, None, :3])[reached, 0]
        # Where a drive stalls at once, it may as well go on: a third way decides.
        doubtful = converged & (~reached | (modes.count[:, walk.SUDDEN] == 1))
    again = np.flatnonzero(doubtful)
    solve(FIXED, again)
    gap = ends[FIXED] - final
    near = _compare(packed, gap / UNSURE)[2] & ~_compare(packed, gap)[2]
    unsure = np.flatnonzero(near & (final.shape[1] <= 3))  # heaps: too long, and rarely false
    ends[FIXED, unsure] = final[unsure]
    for k in (FINER, MIDPOINT, FINEST):
        solve(k, unsure)
        unsure = unsure[_compare(packed, ends[k, unsure] - final[unsure])[2]]
    for k in range(COARSE + (method.motion != codes.QUASI_STATIC), SHIFTED + len(SHIFTS)):
        solve(k, again[packed.batch.count[again, at.DRIVEN] > 1])  # COARSE errs with inertia
    # The end that is farthest away counts; a radian counts as 10 cm.
    way = (np.abs(ends - final).max(axis=2) @ [1.0, 1.0, 0.1]).argmax(axis=0)
    other = ends[way, np.arange(n)]
    distance, angle, close = _compare(packed, other - final)
    close &= ~stopped & converged
    held = np.where((ended == walk.COMPLETE) & (folds == 0), CERTIFIED, AGREED)
    verdict = np.where(close, held, UNCERTAIN)
    parted = np.full(n, np.nan)
    way[close | stopped | ~converged] = STEPPER
    for k in np.unique(way[way != STEPPER]).tolist():
        own = np.flatnonzero(way == k)
        parted[own] = _parting(packed, method, k, own, end[own], threads)
    reason = ["it stopped early"] * n
    for k in np.flatnonzero(converged).tolist():
        reason[k] = _reason(verdict[k], method, int(ended[k]), bool(folds[k]), float(parted[k]))
    return verdict, np.stack((distance, angle), axis=1), parted, other, reason


def _compare(packed: PackedBatch, gap: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the largest distances and angles of poses (..., n_free, 3), and whether they agree."""
    distance = np.hypot(gap[..., 0], gap[..., 1]).max(axis=-1)
    angle = np.abs(gap[..., 2]).max(axis=-1)
    limit = APART_LENGTH * packed.units.length
    return distance, angle, (distance <= limit) & (angle <= APART_ANGLE)


def _parting(
    packed: PackedBatch, method: StepMethod, way: int, chosen: IntArray, end: FloatArray,
    threads: int | None,
) -> FloatArray:  # fmt: skip
    """Return the times (n,) [s] from which the stepper and another way no longer agree, for
    rollouts `chosen` (n,) that are apart at their `end` (n, 1)."""
    begin, span = 0.0 * end, end
    for _ in range(2):
        times = begin + span * LOOKS
        one, two = (_solve(packed, method, k, chosen, times, threads)[0] for k in (STEPPER, way))
        near = _compare(packed, one - two)[2]
        begin = begin + span * np.max(near[:, :-1] * LOOKS[:-1], axis=1, keepdims=True)
        span = span / len(LOOKS)
    return (begin + span)[:, 0] * packed.units.time


def _solve(
    packed: PackedBatch, method: StepMethod, way: int, chosen: IntArray, times: FloatArray,
    threads: int | None,
) -> tuple[FloatArray, IntArray]:  # fmt: skip
    """Solve some rollouts in one way; return poses (n, n_time, n_free, 3) at scaled times (n,
    n_time), and how the rollouts ended."""
    n, n_time = times.shape
    if way == MODES:
        part = _chosen(packed, np.repeat(chosen, n_time))
        part.batch.settings[:, at.DURATION] = times.ravel()
        modes = _modes(part, method, threads)
        ends = shape_poses(part, modes.end[:, None, None, :3])
        return ends.reshape(n, n_time, 1, 3), modes.status
    part = _chosen(packed, chosen, SHIFTS[way - SHIFTED] if way >= SHIFTED else 0.0)
    if FIXED <= way < SHIFTED:
        length, lead = STEPS[way - FIXED]
        step = part.batch.settings[:, at.DURATION] / (0.9 * MOST_STEPS)
        part.batch.settings[:, at.STEP] = length * np.clip(step, *FIXED_STEP)
        most = int(max(method.max_steps, MOST_STEPS) / length)
        method = method._replace(adaptive=0, lead=lead, max_steps=most)
    return poses_at(part, method, times, threads)


def _modes(packed: PackedBatch, method: StepMethod, threads: int | None) -> walk.ModeRecord:
    """Follow the contact modes of packed rollouts."""
    modes, none = empty_modes(len(packed.batch.count)), np.empty((0, 0))
    follow = partial(walk.walk_batch, packed.batch, method, 1, modes, walk.Tape(none, none))
    in_ranges(follow, len(modes.status), threads)
    return modes


def _reason(verdict: str, method: StepMethod, ended: int, folds: bool, parted: float) -> str:
    """Return what is behind a verdict on a simulation that reached its end."""
    if verdict == UNCERTAIN:
        differ = f"from {parted:.3g} s on two ways differ, so that two motions may be possible"
        return "small fixed steps stopped early" if math.isnan(parted) else differ
    if verdict == AGREED and method.motion != codes.QUASI_STATIC:
        return "contact modes describe quasi-static motion only"
    return _LOST.get(ended, "a contact mode ended in a jump" if folds else "")


def empty_modes(n: int) -> walk.ModeRecord:
    """Return an empty record of the contact modes of rollouts."""
    count = np.zeros((n, 6), np.int64)
    return walk.ModeRecord(status=np.zeros(n, np.int64), end=np.zeros((n, 4)), count=count)


def _chosen(packed: PackedBatch, chosen: IntArray, shift: FloatArray | float = 0.0) -> PackedBatch:
    """Return some rollouts of a batch, whose parts start a little aside."""
    batch, model, pose = packed.batch, packed.batch.model, packed.batch.pose.copy()
    pose[np.unique(batch.begin[chosen, at.BODY, None] + np.arange(len(packed.com)))] += shift
    some = batch._replace(
        begin=batch.begin[chosen],
        count=batch.count[chosen],
        map_shape=batch.map_shape[chosen],
        sides=batch.sides[chosen],
        pose=pose,
        settings=batch.settings[chosen],
        model=model._replace(plane=model.plane[chosen], map_frame=model.map_frame[chosen]),
    )
    outline = None if packed.outline is None else packed.outline[chosen]
    return packed._replace(batch=some, outline=outline)
