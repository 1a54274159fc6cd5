"""Compiled rollouts in threads, so that Ctrl-C stops them at their next step."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from queue import SimpleQueue
from typing import Final, NamedTuple

from fixel.errors import InvalidInput
from fixel.kernels import batch as kernel
from fixel.kernels import codes
from fixel.kernels.arrays import SAMPLES, STOP, Batch, BatchRecord, StepMethod

WAIT_S: Final = 0.1  # between two looks for Ctrl-C, which interrupts no wait on Windows
LAST_WAIT_S: Final = 0.5  # for rollouts to notice that they were stopped


def rollout_in_threads(
    batch: Batch,
    method: StepMethod,
    record: BatchRecord,
    threads: int | None,
    every_step: bool = False,
) -> None:
    """Distribute the rollouts among threads, in ranges small enough to balance the load.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C; rollouts that did not end have the status INTERRUPTED.
    """
    n = len(record.status)
    n_threads = os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
    n_threads = (n_threads or 1) if threads is None else threads
    if n_threads < 1:
        raise InvalidInput("threads", found=threads, expected="at least 1")
    roll = partial(kernel.rollout_batch, batch, method, record, every_step)
    try:
        if n_threads == 1 or n < 2:
            _run_beside(partial(roll, 0, n), record)
        else:
            _share(roll, record, n, n_threads)
    except KeyboardInterrupt:
        record.status[(record.status == codes.CONVERGED) & (record.count[:, SAMPLES] == 0)] = (
            codes.INTERRUPTED
        )
        raise


def _share(roll: Callable[[int, int], None], record: BatchRecord, n: int, n_threads: int) -> None:
    size = max(1, min(64, n // (4 * n_threads)))
    with ThreadPoolExecutor(n_threads) as pool:
        futures = {pool.submit(roll, k, min(n, k + size)) for k in range(0, n, size)}
        try:
            while futures:
                done, futures = wait(futures, WAIT_S)
                for future in done:
                    future.result()
        except BaseException:
            record.total[:, STOP] = 1.0
            pool.shutdown(cancel_futures=True)
            raise


class _Task(NamedTuple):
    """Call in the worker thread: a lock that is released at its end, and its exceptions."""

    call: Callable[[], None]
    end: threading.Lock
    problems: list[BaseException]


_tasks: SimpleQueue[_Task] | None = None


def _run_beside(call: Callable[[], None], record: BatchRecord) -> None:
    """Run compiled code in a worker thread, while this one waits for its end or Ctrl-C.

    Python handles signals in the main thread only, and not while that runs compiled code. Other
    threads run the call themselves.
    """
    if threading.current_thread() is not threading.main_thread():
        call()
        return
    task = _Task(call, threading.Lock(), [])
    task.end.acquire()
    started = False
    try:
        _worker().put(task)
        started = True
        while not task.end.acquire(timeout=WAIT_S):
            pass
    except BaseException:
        record.total[:, STOP] = 1.0
        if started:
            task.end.acquire(timeout=LAST_WAIT_S)
        raise
    if task.problems:
        raise task.problems[0]


def _worker() -> SimpleQueue[_Task]:
    """Return the queue of the worker thread, which starts when first used."""
    global _tasks
    if _tasks is None:
        _tasks = SimpleQueue()
        threading.Thread(target=_work, args=(_tasks,), daemon=True, name="fixel").start()
    return _tasks


def _work(tasks: SimpleQueue[_Task]) -> None:
    while True:
        task = tasks.get()
        try:
            task.call()
        except BaseException as problem:
            task.problems.append(problem)
        task.end.release()
        del task  # which refers to the record


def _forget_worker() -> None:
    global _tasks
    _tasks = None


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_worker)
