"""Compiled rollouts in one or many threads, which Ctrl-C stops at their next step; and records."""

from __future__ import annotations

import atexit
import functools
import os
import signal
import socket
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Final, TypeVar

import numpy as np

from fixel.kernels import codes, rollout as kernel
from fixel.kernels.arrays import (
    BODY,
    DRIVEN,
    FREE,
    N_TOTAL,
    PATH,
    PATH_START,
    SAMPLES,
    STOP,
    Batch,
    BatchRecord,
    StepMethod,
)
from fixel.model.fields import whole
from fixel.simulation.first_code import is_missing, wait_for_code
from fixel.simulation.pack import RECENT_SCENES, PackedBatch, Units
from fixel.simulation.vary import composed, inverted
from fixel.typing import FloatArray, IntArray

T = TypeVar("T")
MAX_RANGE: Final = 64  # rollouts of one call
POOL_NAME: Final = "fixel-rollouts"  # beginning of the names of its threads
WAIT_S: Final = 0.1  # between two looks for Ctrl-C, which interrupts no wait on Windows


def rollout_in_threads(
    batch: Batch,
    method: StepMethod,
    record: BatchRecord,
    threads: int | None,
    every_step: bool = False,
    then: Callable[[int, int], None] | None = None,
) -> None:
    """Distribute the rollouts among threads, by default one per core, in ranges small enough to
    balance the load.

    The thread that has simulated rollouts `first` to ``last - 1`` calls ``then(first, last)``, so
    that several threads share the work on the results, too. Ctrl-C raises `KeyboardInterrupt`;
    rollouts that did not end have the status INTERRUPTED.
    """
    if is_missing():
        wait_for_code()
    n = len(record.status)
    n_threads = cores() if threads is None else whole(threads, "threads")
    roll = partial(kernel.rollout_batch, batch, method, record, every_step)

    def roll_and_then(first: int, last: int) -> None:
        roll(first, last)
        if shared and not record.total[first, STOP]:
            shared(first, last)

    size = max(1, min(MAX_RANGE, n // (4 * n_threads)))
    try:
        alone = n_threads == 1 or n < 2 or _is_nested()
        shared = None if alone or n <= MAX_RANGE else then  # of few, it takes longer to share
        if alone:
            _run(partial(roll, 0, n), record)
        else:
            _share(roll_and_then, n, size, n_threads, lambda: record.total[:, STOP].fill(1.0))
        if then and not shared:
            for k in range(0, n, MAX_RANGE):
                then(k, min(n, k + MAX_RANGE))
    except KeyboardInterrupt:
        record.status[(record.status == codes.CONVERGED) & (record.count[:, SAMPLES] == 0)] = (
            codes.INTERRUPTED
        )
        raise


def in_ranges(call: Callable[[int, int], None], n: int, threads: int | None) -> None:
    """Call `call(first, last)` for ranges of `n` items, in threads; Ctrl-C ends after a range."""
    n_threads = cores() if threads is None else threads
    if n_threads == 1 or n <= MAX_RANGE or _is_nested():
        for k in range(0, n, MAX_RANGE):
            call(k, min(n, k + MAX_RANGE))
    else:
        _share(call, n, MAX_RANGE, n_threads)


def _is_nested() -> bool:
    """Whether this is a thread of the pool, which must not wait for itself."""
    return threading.current_thread().name.startswith(POOL_NAME)


def cores() -> int:
    """Return the number of cores that this process may use."""
    count = os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
    return count or 1


def _share(
    call: Callable[[int, int], None],
    n: int,
    size: int,
    n_threads: int,
    stop: Callable[[], None] = lambda: None,
) -> None:
    """Call `call(first, last)` for ranges of `size` of `n` items in threads; after a failure or
    Ctrl-C `stop`, and wait for calls under way."""
    left = deque(range(0, n, size))
    ended: SimpleQueue[BaseException | None] = SimpleQueue()

    def work() -> None:
        problem = None
        try:
            while left:
                try:
                    first = left.popleft()
                except IndexError:  # another thread was faster
                    return
                call(first, min(n, first + size))
        except BaseException as found:
            problem = found
        finally:
            ended.put(problem)

    pool = _threads(n_threads)
    futures = [pool.submit(work) for _ in range(min(n_threads, len(left)))]
    try:
        for _ in futures:
            if problem := awaited(ended):
                raise problem
    except BaseException:
        left.clear()
        stop()
        wait(futures)
        raise


def awaited(queue: SimpleQueue[T]) -> T:
    """Wait for the next item of a queue, or for Ctrl-C.

    Ctrl-C inside a wait for futures can find their lock released, and ends in a RuntimeError then.
    """
    while True:
        with suppress(Empty):
            return queue.get(timeout=WAIT_S)


def _threads(n: int) -> ThreadPoolExecutor:
    """Return a pool of at least `n` threads; started threads wait for the next call."""
    global _pool, _pool_size
    with _starting:
        if _pool is None or _pool_size < n:
            _pool, _pool_size = ThreadPoolExecutor(n, POOL_NAME), n
        return _pool


# Threads stay for later calls, since starting them takes as long as a few rollouts.
_pool: ThreadPoolExecutor | None = None
_pool_size = 0
_starting = threading.Lock()
# Not `signal.getsignal`, which searches an enumeration for every handler, in 20 us.
_handler: Callable[[int], Any] = getattr(signal, "_signal", signal).getsignal
_sender: socket.socket | None = None  # of the numbers of signals, to the thread that watches
_rolling: BatchRecord | None = None  # what the main thread computes, for that thread to stop
_next_fd = -1  # where signals went before


def _run(call: Callable[[], None], record: BatchRecord) -> None:
    """Run compiled code in this thread; Ctrl-C in the main thread stops it at its next step.

    Python handles a signal only after compiled code returns. Its number is sent to a socket at
    once, though, where another thread waits for it and sets the flag that the code looks at.
    """
    global _rolling, _next_fd
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or _handler(signal.SIGINT) is not signal.default_int_handler:
        call()
        return
    given = record.total.copy()
    while True:
        sender = _watched()
        _rolling = record
        _next_fd = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
        try:
            call()
        finally:
            signal.set_wakeup_fd(_next_fd)
            _rolling = None
        if not record.total[0, STOP]:
            return
        # Stopped by a signal that an earlier call has handled: run once more.
        record.count[:], record.status[:], record.total[:] = 0, codes.CONVERGED, given


def _watched() -> socket.socket:
    """Return the socket for the numbers of signals; its thread starts when first used."""
    global _sender
    if _sender is None:
        receiver, _sender = socket.socketpair()
        _sender.setblocking(False)
        atexit.register(_sender.close)
        threading.Thread(target=_watch, args=(receiver,), daemon=True, name="fixel").start()
    return _sender


def _watch(receiver: socket.socket) -> None:
    with receiver:
        while number := receiver.recv(1):
            record, following = _rolling, _next_fd
            if number[0] == signal.SIGINT and record is not None:
                record.total[:, STOP] = 1.0
            with suppress(OSError):  # also without a following one, -1
                os.write(following, number)


def _forget_threads() -> None:
    """Start again in a forked process, which has no thread but its own."""
    global _sender, _pool, _starting
    _sender = _pool = None
    _starting = threading.Lock()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_threads)


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
    n_driven = 0 if bare else int(count[:, DRIVEN].max(initial=0))
    n_moving = int(count[:, FREE].max(initial=0)) + n_driven
    time = np.zeros((n, n_sample))
    if times is not None:
        time[:] = times / packed.units.time
    pose = np.zeros((n, n_sample, n_moving, 3))
    rows = packed.batch.begin[:, BODY, None] + np.arange(n_moving)
    pose[:, 0] = packed.batch.pose.take(rows, axis=0, mode="clip")
    model, begin = packed.batch.model, packed.batch.begin
    for d in range(n_driven):  # where its own path begins, not the scene's
        first = model.path_start.take(begin[:, PATH_START] + d, mode="clip")
        waypoint = model.path.take(begin[:, PATH] + first, axis=0, mode="clip")
        pose[np.arange(n), 0, count[:, FREE] + d] = waypoint[:, 1:]
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
    n_driven = int(packed.batch.count[0, DRIVEN])
    n_moving = int(packed.batch.count[0, FREE]) + n_driven
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


def poses_at(
    packed: PackedBatch, method: StepMethod, times: FloatArray, threads: int | None
) -> tuple[FloatArray, IntArray]:
    """Simulate packed rollouts to scaled `times` (n, n_time); return poses (n, n_time, n_free, 3),
    the last repeated after an early stop, and statuses (n,)."""
    record = empty_record(packed, times.shape[1], 0, bare=True)
    record.time[:] = times
    rollout_in_threads(packed.batch, method, record, threads)
    hold_last(record, record.pose)
    return shape_poses(packed, record.pose), record.status
