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

from fixel.kernels import arrays as at
from fixel.kernels import codes
from fixel.kernels.arrays import StepMethod
from fixel.kernels.modes import walk
from fixel.simulation.pack import PackedBatch
from fixel.simulation.result import AGREED, CERTIFIED, UNCERTAIN
from fixel.simulation.threads import ends_of, in_ranges, shape_poses
from fixel.typing import FloatArray, IntArray

APART_LENGTH: Final = 5e-3  # of the characteristic length: two ends that are this close agree
APART_ANGLE: Final = math.radians(0.1)
FIXED_STEP: Final = 5e-4  # of the time in which the fastest motion covers that length
# Shifts of the start, of that length and in rad: every step size may choose the same motion.
SHIFTS: Final = 2e-6 * np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])

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
) -> tuple[NDArray[np.str_], FloatArray, FloatArray, list[str]]:
    """Solve rollouts again; return verdicts (n,), distances and angles (n, 2), ends, reasons (n,).

    `final` (n, n_free, 3) are their ends in SI units, and `status` (n,) how they ended
    (`fixel.kernels.codes`). `modes` are those of quasi-static motion, where they are known.
    """
    n = len(final)
    other = np.array(final)
    ended = np.full(n, walk.UNSUITED)
    folds = np.zeros(n, np.int64)
    converged = status == codes.CONVERGED
    doubtful = converged.copy()
    if method.motion == codes.QUASI_STATIC:
        if modes is None:
            modes, none = empty_modes(n), walk.Tape(np.empty((0, 0)), np.empty((0, 0)))
            in_ranges(partial(walk.walk_batch, packed.batch, method, 1, modes, none), n, threads)
        ended, folds = modes.status, modes.count[:, walk.FOLDS]
        reached = ended == walk.COMPLETE
        if reached.any():
            other[reached] = shape_poses(packed, modes.end[:, None, None, :3])[reached, 0]
        # Where a drive stalls at once, it may as well go on: a third way decides.
        doubtful &= ~reached | (modes.count[:, walk.SUDDEN] == 1)
    stopped = np.zeros(n, np.bool_)
    if doubtful.any():
        again = np.flatnonzero(doubtful)
        part = _chosen(packed, again)
        part.batch.settings[:, at.STEP] = FIXED_STEP
        ends, how = ends_of(part, method._replace(adaptive=0, lead=0.0), threads)
        stopped[again] = how != codes.CONVERGED
        _keep_far(other, final, again, ends)
        again = again[packed.batch.count[again, at.DRIVEN] > 1]
        for shift in SHIFTS if again.size else ():
            ends, _ = ends_of(_chosen(packed, again, shift), method, threads)
            _keep_far(other, final, again, ends)
    gap = other - final
    distance = np.hypot(gap[..., 0], gap[..., 1]).max(axis=1)
    angle = np.abs(gap[..., 2]).max(axis=1)
    close = (distance <= APART_LENGTH * packed.units.length) & (angle <= APART_ANGLE)
    close &= ~stopped & converged
    held = (ended == walk.COMPLETE) & (folds == 0)
    verdict = np.where(close, np.where(held, CERTIFIED, AGREED), UNCERTAIN)
    reason = [
        _reason(str(verdict[k]), method, int(ended[k]), bool(folds[k]), bool(stopped[k]))
        if status[k] == codes.CONVERGED
        else "it stopped early"
        for k in range(n)
    ]
    return verdict, np.stack((distance, angle), axis=1), other, reason


def _keep_far(other: FloatArray, final: FloatArray, chosen: IntArray, ends: FloatArray) -> None:
    """Write ends of some rollouts where they are farther away; a radian counts as 10 cm."""
    apart = np.abs([ends - final[chosen], (other - final)[chosen]]).max(axis=2) @ [1.0, 1.0, 0.1]
    farther = apart[0] > apart[1]
    other[chosen[farther]] = ends[farther]


def _reason(verdict: str, method: StepMethod, ended: int, folds: bool, stopped: bool) -> str:
    """Return what is behind a verdict on a simulation that reached its end."""
    if verdict == UNCERTAIN:
        differ = "two ways differ, so that two motions may be possible"
        return "small fixed steps stopped early" if stopped else differ
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
