"""Outlier detection in tracks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fixel.model.trajectory import wrapped
from fixel.typing import BoolArray, FloatArray
from fixel.vision.tracking.base import USUAL_PIXEL, PartObservation, PartTrack

NEIGHBOURS: Final = 5  # frames to either side; a pose must agree with one side at least
SCATTERS: Final = 8.0  # times the usual deviation, beyond which a pose is an outlier
MIN_DISAGREEMENT: Final = (0.3e-3, 0.008)  # [m] at 0.55 mm per pixel, [rad]: less is ignored
JUMP: Final = (1e-3, 0.05)  # [m] at 0.55 mm per pixel, [rad]: impossible change between frames
ELSEWHERE: Final = "the camera or the plate was moved"
WINDOW: Final = 3  # steps to either side from which a speed is computed
AT_END: Final = 4  # poses likewise, at the end of a piece
NEARBY: Final = 7  # frames to either side for the even frame rate
EVEN: Final = (
    0.06  # of the frame period: milliseconds of a container at 30 frames a second are even
)
SPREAD: Final = 2.0  # standard deviations of a time stamp by which a pose may be early or late
Clock = FloatArray  # (2, n) times of frames, and the uncertainty of each [s]


def judged(
    name: str,
    time: FloatArray,
    sightings: Sequence[PartObservation],
    doubted: BoolArray | None = None,
) -> PartTrack:
    """Return the track of a part, with impossible poses marked, from one sighting per frame.

    `doubted` (n,) are the frames during which the camera may have been moved.
    """
    seen = np.array([s.pose is not None for s in sightings], dtype=bool)
    nothing = np.full(3, np.nan)
    pose = np.array([nothing if s.pose is None else s.pose for s in sightings]).reshape(-1, 3)
    residual = np.where(seen, [s.residual for s in sightings], np.nan)
    scale = np.array([s.scale for s in sightings])
    reason = [s.reason for s in sightings]
    good = seen.copy()
    if doubted is not None:
        good &= ~doubted
        reason = [
            ELSEWHERE if s and d else why for s, d, why in zip(seen, doubted, reason, strict=True)
        ]
    pixel = float(np.median(scale[seen])) if seen.any() else USUAL_PIXEL
    clocks = _clocks(time)
    for find, why in (
        (_alone, "an outlier: it fits neither the previous nor the following frames"),
        (_between_jumps, "an outlier: no part moves so far and back within one frame"),
    ):
        rows = np.flatnonzero(good)
        pose[:, 2] = _continuous(pose[:, 2], good)
        own = tuple(clock[:, rows] for clock in clocks)
        for row in rows[find(own, pose[rows], pixel / USUAL_PIXEL)]:
            good[row] = False
            reason[row] = why
    pose[:, 2] = _continuous(pose[:, 2], good)
    return PartTrack(
        name=name,
        time=time,
        pose=pose,
        seen=seen,
        good=good,
        residual=residual,
        residual_m=residual * np.where(seen, scale, np.nan),
        sd=np.array([s.sd if s.pose is not None else nothing for s in sightings]).reshape(-1, 3),
        marks=np.array([s.marks for s in sightings], dtype=np.int64),
        share=np.array([s.share for s in sightings], dtype=np.float64),
        reason=tuple("" if ok else why for ok, why in zip(good, reason, strict=True)),
    )


def _continuous(angle: FloatArray, good: BoolArray) -> FloatArray:
    """Unwrap good angles of (n,) [rad]; put others within half a turn of the last good one."""
    rows = np.flatnonzero(good)
    if not len(rows):
        return angle
    smooth = np.unwrap(angle[rows])
    last = smooth[np.maximum(np.searchsorted(rows, np.arange(len(angle)), side="right") - 1, 0)]
    result = last + wrapped(angle - last)
    result[rows] = smooth
    return np.asarray(result)


def _clocks(time: FloatArray) -> tuple[Clock, ...]:
    """Return the time stamps with their uncertainty, and where they are uneven, even times too.

    Either the computer delayed the stamps of evenly taken frames, or the camera left frames out
    and the stamps are right. A pose is accepted if it fits the motion by either of these times.
    """
    scatter = stamp_scatter(time)
    stamps = np.array([time, SPREAD * scatter])
    if not scatter.any():
        return (stamps,)
    period = (time[-1] - time[0]) / (len(time) - 1)
    return stamps, np.array([period * np.arange(len(time)), scatter])


def clock_scatter(time: FloatArray) -> FloatArray:
    """`stamp_scatter` (n,) [s], or that of an even clock with lost frames where it is less."""
    step = np.diff(time)
    period = float(step[step <= 1.5 * np.median(step)].mean()) if len(step) else 1.0
    passed = np.maximum(np.rint(step / period), 1.0)
    number = np.concatenate(([0.0], np.cumsum(passed)))
    return np.minimum(stamp_scatter(time), stamp_scatter(time, number))


def stamp_scatter(time: FloatArray, number: FloatArray | None = None) -> FloatArray:
    """Root mean square distance (n,) of time stamps (n,) from a locally even frame rate [s].

    The even rate is a line through the stamps of `NEARBY` frames to either side, against their
    number (n,), by default that among the frames. A scatter of less than `EVEN` of the frame
    period, such as that of rounded stamps, counts as 0.
    """
    n = len(time)
    if n < 4:
        return np.zeros(n)
    number = np.arange(n, dtype=np.float64) if number is None else number
    index = np.arange(n)[:, None] + np.arange(-NEARBY, NEARBY + 1)
    inside = (index >= 0) & (index < n)
    index = np.clip(index, 0, n - 1)
    count = inside.sum(1)
    t = np.where(inside, time[index], 0.0)
    k = np.where(inside, number[index], 0.0)
    t = np.where(inside, t - (t.sum(1) / count)[:, None], 0.0)
    k = np.where(inside, k - (k.sum(1) / count)[:, None], 0.0)
    period = (k * t).sum(1) / (k * k).sum(1)
    scatter = np.sqrt(((t - period[:, None] * k) ** 2).sum(1) / count)
    return np.where(scatter < EVEN * period, 0.0, scatter)


def _alone(clocks: Sequence[Clock], pose: FloatArray, scale: float) -> BoolArray:
    """Return (n,) bool: poses that disagree with the neighbours before, after and around them."""
    n = len(pose)
    if n < 2 * NEIGHBOURS + 1:
        return np.zeros(n, dtype=bool)
    offsets = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    sides = [offsets[offsets < 0], offsets[offsets > 0], offsets[offsets != 0]]
    apart = np.stack(
        [_disagreement(clock, pose, side) for clock in clocks for side in sides]
    )  # (3 or 6, n, 2)
    least = apart.min(axis=0)
    usual = 1.4826 * np.median(least, axis=0)
    limit = np.maximum(SCATTERS * usual, np.array(MIN_DISAGREEMENT) * (scale, 1.0))
    return np.asarray((least > limit).any(axis=1))


def _disagreement(
    clock: Clock, pose: FloatArray, offsets: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> FloatArray:
    """Distance [m] and angle [rad] (n, 2) of poses from a robust line through neighbours."""
    time, slack = clock
    n = len(time)
    index = np.arange(n)[:, None] + offsets
    inside = (index >= 0) & (index < n)
    index = np.clip(index, 0, n - 1)
    enough = inside.sum(1) >= 2
    t, p = time[index], np.where(inside[..., None], pose[index], np.nan)
    slopes = np.diff(p, axis=1) / np.maximum(np.diff(t, axis=1), 1e-9)[..., None]
    p[~enough] = 0.0
    slopes[~enough] = 0.0
    rate = np.nanmedian(slopes, axis=1)
    expected = np.nanmedian(p + rate[:, None] * (time[:, None] - t)[..., None], axis=1)
    off = _within(pose - expected, rate, slack)
    apart = np.column_stack((np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])))
    apart[~enough] = np.inf
    return apart


def _within(off: FloatArray, rate: FloatArray, slack: FloatArray) -> FloatArray:
    """Part (n, 3) of offsets (n, 3) that no error of the time up to `slack` [s] explains.

    A part that moves at `rate` is seen early or late: the offset is along that rate, in position
    and angle together.
    """
    if not slack.any():
        return off
    weight = np.array([1.0, 1.0, JUMP[0] / JUMP[1]]) ** 2
    square = np.maximum((weight * rate**2).sum(1), 1e-30)
    late = np.clip((weight * off * rate).sum(1) / square, -slack, slack)
    return np.asarray(off - late[:, None] * rate)


def _between_jumps(clocks: Sequence[Clock], pose: FloatArray, scale: float) -> BoolArray:
    """Return (n,) bool: poses on pieces of a track that do not continue the longest one."""
    n = len(pose)
    bad = np.zeros(n, dtype=bool)
    if n < 3:
        return bad
    limit = np.array([JUMP[0] * scale, JUMP[1]])
    rates = [np.diff(pose, axis=0) / _lasted(clock)[:, None] for clock in clocks]  # [m/s, rad/s]
    # Nearly coinciding stamps make speeds too high: use the lower speeds of the two clocks.
    fastest = np.min(
        [np.max([_sizes(r) for r in _neighbours(rate)], axis=0) for rate in rates], axis=0
    )
    jump = np.ones(n - 1, dtype=bool)
    for clock, rate in zip(clocks, rates, strict=True):
        jump &= _jumps(clock, rate, limit, fastest)
    if not jump.any():
        return bad
    piece = np.concatenate(([0], np.cumsum(jump)))
    longest = int(np.bincount(piece).argmax())
    good = piece == longest
    for k in (*range(longest + 1, piece[-1] + 1), *range(longest - 1, -1, -1)):
        own, kept = np.flatnonzero(piece == k), np.flatnonzero(good)
        if own[0] < kept[0]:
            own, kept = own[::-1], kept[::-1]
        speeds = [_speed(clock[0], pose, kept[-AT_END:]) for clock in clocks]
        size = np.min([_sizes(speed) for speed in speeds], axis=0)
        if any(
            _goes_on(clock, pose, (kept[-1], own), speed, limit, size)
            for clock, speed in zip(clocks, speeds, strict=True)
        ):
            good |= piece == k
    return np.asarray(~good)


def _lasted(clock: Clock) -> FloatArray:
    """Durations (n - 1,) of steps, at least a quarter of the median [s]."""
    step = np.diff(clock[0])
    return np.asarray(np.maximum(step, 0.25 * np.median(step)))


def _jumps(clock: Clock, rate: FloatArray, limit: FloatArray, fastest: FloatArray) -> BoolArray:
    """Return (n - 1,) bool: steps longer than the speeds before and after explain."""
    time, slack = clock
    step = np.diff(time)
    off = _beyond(rate, *_neighbours(rate)) * _lasted(clock)[:, None]
    slack = np.maximum(slack[1:], slack[:-1])
    far = (off > limit + slack[:, None] * fastest).any(axis=1)
    # During a long gap any motion is possible.
    return np.asarray(far & (step < 4.0 * np.median(step) + slack))


def _goes_on(
    clock: Clock,
    pose: FloatArray,
    pieces: tuple[np.int64, NDArray[np.int64]],
    speed: FloatArray,
    limit: FloatArray,
    size: FloatArray,
) -> bool:
    """Whether a piece continues the last pose of another, forwards or backwards.

    `speed` (3,) is the speed of the other piece there, `size` (2,) the reliable size of it.
    """
    time, slack = clock
    there, own = pieces
    here = own[0]
    its_own = _speed(time, pose, own[:AT_END]) if len(own) >= AT_END else speed
    passed = time[here] - time[there]
    off = _beyond((pose[here] - pose[there]) / passed, speed, its_own) * abs(passed)
    # The longer the gap, the less certain the motion in it.
    unsure = max(0.5 * abs(float(passed)), float(slack[[here, there]].max()))
    return bool((off < limit + unsure * size).all())


def _sizes(rate: FloatArray) -> FloatArray:
    """Sizes (..., 2) of speeds (..., 3) [m/s, rad/s]."""
    return np.stack((np.hypot(rate[..., 0], rate[..., 1]), np.abs(rate[..., 2])), axis=-1)


def _neighbours(rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Median speeds (n, 3) over the steps before each and after it; at ends, both from one side."""
    before, after = _usual(rate)[:-1], _usual(rate[::-1])[::-1][1:]
    return np.concatenate((after[:1], before)), np.concatenate((after, before[-1:]))


def _usual(rate: FloatArray) -> FloatArray:
    """Running medians (n, 3) of speeds (n, 3): each with up to two before it."""
    first = [np.median(rate[: k + 1], axis=0) for k in range(min(WINDOW - 1, len(rate)))]
    if len(rate) < WINDOW:
        return np.array(first)
    windows = np.lib.stride_tricks.sliding_window_view(rate, WINDOW, axis=0)
    return np.concatenate((first, np.median(windows, axis=-1)))


def _beyond(rate: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Distance (..., 2) of speeds (..., 3) from the range between two others [m/s, rad/s].

    A part that is hit, released or reversed has one speed before and another after, and any
    mixture of the two in between.
    """
    way = other - one
    length = np.maximum((way[..., :2] ** 2).sum(-1), 1e-30)
    share = np.clip(((rate - one) * way)[..., :2].sum(-1) / length, 0.0, 1.0)
    off = (rate - one)[..., :2] - share[..., None] * way[..., :2]
    turn = np.clip(rate[..., 2], *np.sort((one[..., 2], other[..., 2]), axis=0)) - rate[..., 2]
    return np.stack((np.hypot(off[..., 0], off[..., 1]), np.abs(turn)), axis=-1)


def _speed(time: FloatArray, pose: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Median speed (3,) over some poses; 0 for a single one."""
    if len(rows) < 2:
        return np.zeros(3)
    rates = np.diff(pose[rows], axis=0) / np.diff(time[rows])[:, None]
    return np.asarray(np.median(rates, axis=0))
