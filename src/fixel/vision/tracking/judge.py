"""Which poses of a track to believe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.kernels.arrays import FloatArray
from fixel.model.fields import BoolArray
from fixel.vision.tracking.base import Sighting
from fixel.vision.tracking.tracked import PartTrack

NEIGHBOURS: Final = 5  # frames to either side that a pose must agree with, on one side at least
SCATTERS: Final = 8.0  # of the usual disagreement, beyond which a pose is an outlier
LEAST: Final = (0.3e-3, 0.008)  # [m] at 0.55 mm a pixel, [rad]: smaller disagreements are none
JUMP: Final = (1e-3, 0.05)  # [m] at 0.55 mm a pixel, [rad]: nothing on the plate moves so at once
USUAL_PIXEL: Final = 0.55e-3  # [m]


def judged(name: str, time: FloatArray, sightings: Sequence[Sighting]) -> PartTrack:
    """The track of a part, with poses that cannot be marked as such.

    Parameters
    ----------
    name : str
    time : (n,) float64
        [s].
    sightings : sequence of Sighting
        One a frame.
    """
    seen = np.array([s.pose is not None for s in sightings], dtype=bool)
    nothing = np.full(3, np.nan)
    pose = np.array([nothing if s.pose is None else s.pose for s in sightings]).reshape(-1, 3)
    pose[seen, 2] = np.unwrap(pose[seen, 2])
    residual = np.where(seen, [s.residual for s in sightings], np.nan)
    scale = np.array([s.scale for s in sightings])
    reason = [s.reason for s in sightings]
    good = seen.copy()
    pixel = float(np.median(scale[seen])) if seen.any() else USUAL_PIXEL
    for find, why in (
        (_alone, "an outlier: it fits neither what came before nor what came after"),
        (_between_jumps, "an outlier: nothing moves to there and back at once"),
    ):
        rows = np.flatnonzero(good)
        for row in rows[find(time[rows], pose[rows], pixel / USUAL_PIXEL)]:
            good[row] = False
            reason[row] = why
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


def _alone(time: FloatArray, pose: FloatArray, scale: float) -> BoolArray:
    """(n,) which poses agree with their neighbours neither before nor after nor around."""
    n = len(time)
    if n < 2 * NEIGHBOURS + 1:
        return np.zeros(n, dtype=bool)
    offsets = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    sides = [offsets[offsets < 0], offsets[offsets > 0], offsets[offsets != 0]]
    apart = np.stack([_disagreement(time, pose, side) for side in sides])  # (3, n, 2)
    least = apart.min(axis=0)
    usual = 1.4826 * np.median(least, axis=0)
    limit = np.maximum(SCATTERS * usual, np.array(LEAST) * (scale, 1.0))
    return np.asarray((least > limit).any(axis=1))


def _disagreement(
    time: FloatArray, pose: FloatArray, offsets: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> FloatArray:
    """(n, 2) distance [m] and angle [rad] of poses from a robust line through some neighbours."""
    n = len(time)
    index = np.arange(n)[:, None] + offsets
    inside = (index >= 0) & (index < n)
    index = np.clip(index, 0, n - 1)
    enough = inside.sum(1) >= min(3, len(offsets))
    t, p = time[index], np.where(inside[..., None], pose[index], np.nan)
    slopes = np.diff(p, axis=1) / np.maximum(np.diff(t, axis=1), 1e-9)[..., None]
    p[~enough] = 0.0
    slopes[~enough] = 0.0
    rate = np.nanmedian(slopes, axis=1)
    expected = np.nanmedian(p + rate[:, None] * (time[:, None] - t)[..., None], axis=1)
    off = pose - expected
    apart = np.column_stack((np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])))
    apart[~enough] = np.inf
    return apart


def _between_jumps(time: FloatArray, pose: FloatArray, scale: float) -> BoolArray:
    """(n,) which poses lie on pieces of a track that jump away from the longest one."""
    n = len(time)
    bad = np.zeros(n, dtype=bool)
    if n < 3:
        return bad
    rate = np.diff(pose, axis=0) / np.diff(time)[:, None]
    # What the part did over a step by the usual speed around it, not by this step itself.
    around = np.stack([np.roll(rate, k, axis=0) for k in (-3, -2, -1, 1, 2, 3)])
    off = (rate - np.median(around, axis=0)) * np.diff(time)[:, None]
    jump = (np.hypot(off[:, 0], off[:, 1]) > JUMP[0] * scale) | (np.abs(off[:, 2]) > JUMP[1])
    # Over a gap it may have gone anywhere it had time for.
    step = float(np.median(np.diff(time)))
    jump &= np.diff(time) < 4.0 * step
    if not jump.any():
        return bad
    piece = np.concatenate(([0], np.cumsum(jump)))
    longest = int(np.bincount(piece).argmax())
    return np.asarray(piece != longest)
