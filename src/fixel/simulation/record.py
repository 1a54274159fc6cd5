"""Records of rollouts: their allocation, and conversion of their poses to SI units."""

from __future__ import annotations

import functools

import numpy as np

from fixel.kernels import batch as kernel
from fixel.kernels.arrays import DURATION, N_TOTAL, SAMPLES, BatchRecord, StepMethod
from fixel.simulation.pack import RECENT_SCENES, PackedBatch, Units
from fixel.simulation.threads import rollout_in_threads
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray, IntArray


def empty_record(
    packed: PackedBatch,
    n_sample: int,
    n_row: int,
    times: FloatArray | None = None,
    bare: bool = False,
) -> BatchRecord:
    """Allocate `n_sample` samples for every rollout, at `times` [s] where given; if `bare`, only
    for poses of the free bodies. The first has the poses at time zero, for rollouts that write none
    since their first step fails."""
    count = packed.batch.count
    n = len(count)
    n_driven = 0 if bare else int(count[:, kernel.DRIVEN].max(initial=0))
    n_moving = int(count[:, kernel.FREE].max(initial=0)) + n_driven
    time = np.zeros((n, n_sample))
    if times is not None:
        time[:] = times / packed.units.time
    pose = np.zeros((n, n_sample, n_moving, 3))
    rows = packed.batch.begin[:, kernel.BODY, None] + np.arange(n_moving)
    pose[:, 0] = packed.batch.pose.take(rows, axis=0, mode="clip")
    model, begin = packed.batch.model, packed.batch.begin
    for d in range(n_driven):  # where its own path begins, not the scene's
        first = model.path_start.take(begin[:, kernel.PATH_START] + d, mode="clip")
        waypoint = model.path.take(begin[:, kernel.PATH] + first, axis=0, mode="clip")
        pose[np.arange(n), 0, count[:, kernel.FREE] + d] = waypoint[:, 1:]
    return BatchRecord(
        time=time,
        pose=pose,
        twist=np.zeros((n, 0 if bare else n_sample, n_moving, 3)),
        drive=np.zeros((n, n_sample, n_driven, 2)),
        contact=np.zeros((n, n_row, 11)),
        count=np.zeros((n, 4), np.int64),
        total=np.zeros((n, N_TOTAL)),
        status=np.zeros(n, np.int64),
    )


MAX_SPARE = 1 << 24  # [bytes] of contacts in a record that stays in memory
_spare: list[BatchRecord] = []  # the record given back last


def borrowed_record(packed: PackedBatch, n_sample: int, n_row: int) -> BatchRecord:
    """Return a record like that of `empty_record`, to `give_back`, with any numbers in its samples.

    The first use of new memory takes half as long as the rollout of a grasp.
    """
    try:
        record = _spare.pop()
    except IndexError:
        return empty_record(packed, n_sample, n_row)
    n_driven = int(packed.batch.count[0, kernel.DRIVEN])
    n_moving = int(packed.batch.count[0, kernel.FREE]) + n_driven
    shapes = (1, n_sample, n_moving, 3), (1, n_sample, n_driven, 2), (1, n_row, 11)
    if shapes != (record.pose.shape, record.drive.shape, record.contact.shape):
        return empty_record(packed, n_sample, n_row)
    for counted in (record.count, record.total, record.status):
        counted[:] = 0
    return record


def give_back(record: BatchRecord) -> None:
    """Provide the memory of a record, which nothing else refers to, to the next simulation."""
    if record.contact.nbytes <= MAX_SPARE:
        _spare[:] = [record]


@functools.lru_cache(maxsize=RECENT_SCENES)
def pose_units(units: Units) -> FloatArray:
    """Return the units of the columns of poses."""
    return np.array([units.length, units.length, 1.0])


def shape_poses(packed: PackedBatch, pose: FloatArray) -> FloatArray:
    """Convert scaled poses of centres of mass to poses (..., n_moving, 3) of shape frames in SI."""
    out = pose * pose_units(packed.units)
    free = out[..., : len(packed.com), :]
    if np.count_nonzero(packed.com):  # faster than `any`
        c, s = np.cos(free[..., 2]), np.sin(free[..., 2])
        x, y = packed.com[:, 0], packed.com[:, 1]
        free[..., 0] -= c * x - s * y
        free[..., 1] -= s * x + c * y
    if packed.outline is not None:
        frame = inverted(packed.outline)[:, None, None]
        free[:] = composed(free, frame if out.ndim == 4 else frame[0, 0])
    return np.asarray(out)


def hold_last(record: BatchRecord, *arrays: FloatArray) -> None:
    """Repeat the last sample of rollouts that stopped early in arrays (n, n_sample, ...)."""
    written = record.count[:, SAMPLES]
    for r in np.flatnonzero(written < record.time.shape[1]):
        last = max(written[r] - 1, 0)
        for array in arrays:
            array[r, last:] = array[r, last]


def ends_of(
    packed: PackedBatch, method: StepMethod, threads: int | None
) -> tuple[FloatArray, IntArray]:
    """Simulate packed rollouts; return their last poses (n, n_free, 3) and statuses (n,)."""
    record = empty_record(packed, 1, 0, bare=True)
    record.time[:] = packed.batch.settings[:, DURATION, None]
    rollout_in_threads(packed.batch, method, record, threads)
    return shape_poses(packed, record.pose)[:, 0], record.status
