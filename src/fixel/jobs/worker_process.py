"""Calls of a function in a process of its own, with a time limit and cancellation.

Compiled kernels cannot be interrupted. A scene from a stranger must not block a server, so it is
simulated in another process.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, Final

from fixel.errors import JobRefused

GLANCE: Final = 0.02  # [s] between two checks whether the caller still waits
STARTS_WITHIN: Final = 120.0  # [s], with an engine to compile
SAFE_PATH: Final = "PYTHONSAFEPATH"  # environment variable of Python, as its option -P


class CallCancellation(Exception):
    """Exception raised when the caller does not wait for the answer any more."""


class WorkerProcess:
    """Process that calls a function, one call at a time, each within a time limit [s].

    The process starts with the first call and stays for the next ones. It is replaced after it was
    ended. The function has one argument; both it and the answer can be pickled. `ready` is called
    in the process when it starts, outside the time limit, to compile or load. `hint` is the advice
    in the error if the time limit is too short.

    Examples
    --------
    >>> from math import sqrt
    >>> with WorkerProcess(sqrt, limit=30.0) as root:
    ...     root.call(9.0)
    3.0
    """

    def __init__(
        self,
        function: Callable[[Any], Any],
        *,
        limit: float,
        ready: Callable[[], object] | None = None,
        hint: str = "try again",
    ) -> None:
        self._function, self._ready, self.limit, self._hint = function, ready, limit, hint
        self._turn = threading.Lock()
        self._starting = False
        self._process: Any = None
        self._pipe: Connection | None = None

    def call(self, argument: Any, cancelled: Callable[[], bool] = lambda: False) -> Any:
        """Return the answer of the function, or raise its exception.

        Raise `JobRefused` if the time limit was exceeded or the process died, and
        `CallCancellation` if `cancelled()` returned True.
        """
        with self._my_turn(cancelled):
            pipe = self._running(cancelled)
            self._hand_over(pipe, argument)
            late = JobRefused(
                f"the computation took more than {self.limit:g} s and was stopped", hint=self._hint
            )
            worked, answer = self._received(pipe, self.limit, cancelled, late)
        if not worked:
            raise answer
        return answer

    def start(self) -> None:
        """Start the process now, so that the first call need not wait for it."""
        with self._turn:
            self._running(lambda: False)

    def close(self) -> None:
        """End the process."""
        with self._turn:
            self._end()

    def __enter__(self) -> WorkerProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _my_turn(self, cancelled: Callable[[], bool]) -> Iterator[None]:
        until = time.monotonic() + self.limit
        while not self._turn.acquire(timeout=GLANCE):
            if cancelled():
                raise CallCancellation
            if self._starting:  # has a limit of its own, as it may have to compile
                until = time.monotonic() + self.limit
            if time.monotonic() > until:
                raise JobRefused(
                    f"the server is busy: another computation has run for {self.limit:g} s",
                    hint="try again",
                )
        try:
            yield
        finally:
            self._turn.release()

    def _running(self, cancelled: Callable[[], bool]) -> Connection:
        """Return the pipe to the process; start it and wait until it is ready, if necessary."""
        if self._pipe is not None and self._process.is_alive():
            return self._pipe
        self._end()
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._function, self._ready), daemon=True
        )
        with _safe_path():
            self._process.start()
        theirs.close()
        self._pipe = ours
        late = JobRefused(
            f"a process to compute in was not ready within {STARTS_WITHIN:g} s",
            hint="try again later",
        )
        self._starting = True
        try:
            self._received(ours, STARTS_WITHIN, cancelled, late)
        finally:
            self._starting = False
        return ours

    def _hand_over(self, pipe: Connection, argument: Any) -> None:
        """Send the argument; end a process that hangs and does not read it."""
        hung = threading.Timer(self.limit, self._process.kill)
        hung.start()
        try:
            pipe.send(argument)
        except OSError:
            raise self._died() from None
        finally:
            hung.cancel()

    def _received(
        self, pipe: Connection, limit: float, cancelled: Callable[[], bool], late: JobRefused
    ) -> tuple[bool, Any]:
        until = time.monotonic() + limit
        try:
            while not pipe.poll(GLANCE):
                if cancelled():
                    raise CallCancellation
                if time.monotonic() > until:
                    raise late
            answer: tuple[bool, Any] = pipe.recv()
        except (EOFError, OSError):
            raise self._died() from None
        except (CallCancellation, JobRefused):
            self._end()
            raise
        return answer

    def _died(self) -> JobRefused:
        self._end()
        return JobRefused("the computation died", hint="try again")

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let processes started in the block import no module from the folder that they start in."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[SAFE_PATH]
        if before is not None:
            os.environ[SAFE_PATH] = before


def _serve(
    pipe: Connection, function: Callable[[Any], Any], ready: Callable[[], object] | None
) -> None:
    """Call the function for each argument until the pipe is closed; runs in the process."""
    os.environ.pop(SAFE_PATH, None)  # not for programs that the function starts
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if ready is not None:
        ready()
    with suppress(EOFError, OSError):
        pipe.send((True, None))
        while True:
            argument = pipe.recv()
            try:
                answer = (True, function(argument))
            except Exception as problem:
                answer = (False, problem)
            pipe.send(answer)


def _end_with_parent() -> None:
    """End this process when its parent ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
