"""Compiled rollouts, in one or many threads, that Ctrl-C stops at their next step."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from typing import Final

from fixel.errors import InvalidInput
from fixel.kernels import batch as kernel
from fixel.kernels import codes
from fixel.kernels.arrays import SAMPLES, STOP, Batch, BatchRecord, StepMethod

MAX_RANGE: Final = 64  # rollouts of one call
WAIT_S: Final = 0.1  # between two looks for Ctrl-C, which interrupts no wait on Windows


def rollout_in_threads(
    batch: Batch,
    method: StepMethod,
    record: BatchRecord,
    threads: int | None,
    every_step: bool = False,
    then: Callable[[int, int], None] | None = None,
) -> None:
    """Distribute the rollouts among threads, in ranges small enough to balance the load.

    Parameters
    ----------
    batch, method, record
    threads : int, optional
        Number of threads; all cores by default.
    every_step : bool
        See `fixel.kernels.rollout.rollout`.
    then : callable, optional
        Called as `then(first, last)` in the thread that has simulated rollouts `first` to
        ``last - 1``, so that several threads also share the work on the results.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C; rollouts that did not end have the status INTERRUPTED.
    """
    n = len(record.status)
    n_threads = _cores() if threads is None else threads
    if n_threads < 1:
        raise InvalidInput("threads", found=threads, expected="at least 1")
    roll = partial(kernel.rollout_batch, batch, method, record, every_step)
    size = max(1, min(MAX_RANGE, n // (4 * n_threads)))
    try:
        if n_threads == 1 or n < 2:
            _run(partial(roll, 0, n), record)
            for k in range(0, n if then else 0, MAX_RANGE):
                then(k, min(n, k + MAX_RANGE))  # type: ignore[misc]
        else:
            _share(roll, then, record, size, n_threads)
    except KeyboardInterrupt:
        record.status[(record.status == codes.CONVERGED) & (record.count[:, SAMPLES] == 0)] = (
            codes.INTERRUPTED
        )
        raise


def _cores() -> int:
    count = os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
    return count or 1


def _share(
    roll: Callable[[int, int], None],
    then: Callable[[int, int], None] | None,
    record: BatchRecord,
    size: int,
    n_threads: int,
) -> None:
    def range_from(first: int) -> None:
        last = min(len(record.status), first + size)
        roll(first, last)
        if then and not record.total[first, STOP]:
            then(first, last)

    with ThreadPoolExecutor(n_threads) as pool:
        futures = {pool.submit(range_from, k) for k in range(0, len(record.status), size)}
        try:
            while futures:
                done, futures = wait(futures, WAIT_S)
                for future in done:
                    future.result()
        except BaseException:
            record.total[:, STOP] = 1.0
            pool.shutdown(cancel_futures=True)
            raise


_sender: socket.socket | None = None  # of the numbers of signals, to the thread that watches
_rolling: BatchRecord | None = None  # what the main thread computes, for that thread to stop
_next_fd = -1  # where signals went before


def _run(call: Callable[[], None], record: BatchRecord) -> None:
    """Run compiled code in this thread; Ctrl-C in the main thread stops it at its next step.

    Python handles a signal only after compiled code returns. Its number is sent to a socket at
    once, though, where another thread waits for it and sets the flag that the code looks at.
    """
    global _rolling, _next_fd
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
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
        threading.Thread(target=_watch, args=(receiver,), daemon=True, name="fixel").start()
    return _sender


def _watch(receiver: socket.socket) -> None:
    while number := receiver.recv(1):
        record, following = _rolling, _next_fd
        if number[0] == signal.SIGINT and record is not None:
            record.total[:, STOP] = 1.0
        if following >= 0:
            with suppress(OSError):
                os.write(following, number)


def _forget_watch() -> None:
    global _sender
    _sender = None


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_watch)
