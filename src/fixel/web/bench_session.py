"""The bench of a server: at most one campaign, its live picture, and wishes of pages."""

from __future__ import annotations

import threading
import time
from contextlib import AbstractContextManager
from typing import Final

from fixel.errors import FixelError, JobRefused, machine_failure
from fixel.web.live import LiveView
from fixel.workflows.bench.loop import BenchLoop

GLANCE: Final = 0.01  # [s]
LOST: Final = 3.0  # [s] without a sign of life after which a page counts as lost


class BenchSession:
    """Campaign that the server performs."""

    def __init__(self) -> None:
        self.view = LiveView()
        self.loop: BenchLoop | None = None  # None before the first campaign
        self.running = False  # whether a campaign is performed now
        self._alive = time.monotonic()
        self._ready = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None
        self._closed = False

    @property
    def trouble(self) -> str:
        """Why the campaign could not be opened, or ended early; empty otherwise."""
        return "" if self._failure is None else str(self._failure)

    def start(self, opened: AbstractContextManager[BenchLoop], by: str = "key") -> BenchLoop:
        """Open the devices and begin the campaign in a thread; return when they are open.

        It is begun by a `key` or a `page`. Raise `JobRefused` if a campaign is performed already,
        and what opening raises.
        """
        if self.running:
            raise JobRefused("a campaign is running already", hint="end it first")
        self._forget()
        self.running = True
        shown = self.view.newest.number
        self._thread = threading.Thread(target=self._run, args=(opened, by), name="fixel-bench")
        self._thread.start()
        self._ready.wait()
        if self._failure is not None:
            self._thread.join()
        self.raise_failure()
        assert self.loop is not None
        while self.running and self.view.newest.number == shown:
            time.sleep(GLANCE)  # else a page would find no status, or that of the campaign before
        return self.loop

    def _forget(self) -> None:
        """Forget the campaign before."""
        self.loop = self._failure = None
        self._closed = False
        self._ready.clear()

    def _run(self, opened: AbstractContextManager[BenchLoop], by: str) -> None:
        try:
            with opened as loop:
                self.loop = loop
                loop.show, loop.page_left, loop.begun_by = self.view.show, self._left, by
                self.alive()
                self._ready.set()
                if not self._closed:
                    loop.run()
        except BaseException as failure:
            named = machine_failure(failure) if isinstance(failure, OSError) else None
            self._failure = named or failure
            if not isinstance(self._failure, FixelError):
                raise
        finally:
            self.running = False
            self._ready.set()
            self.view.repeat()  # without buttons, which nothing answers from now on

    def raise_failure(self) -> None:
        """Raise the error that ended the campaign, if there is one."""
        if self._failure is not None:
            raise self._failure

    def ask(self, do: str, row: str = "", by: str = "page") -> None:
        """Ask the loop for something, as `BenchLoop.ask`."""
        self.alive()
        if self.loop is not None:
            self.loop.ask(do, row, by)

    def alive(self) -> None:
        """Take a sign of life of a page."""
        self._alive = time.monotonic()

    def _left(self) -> str:
        silent = time.monotonic() - self._alive
        return f"the page has not answered for {silent:.1f} s" if silent > LOST else ""

    def close(self) -> None:
        """Stop the drive and end the campaign, which can be continued."""
        self._closed = True  # also where the devices are still being opened
        if self._thread is not None:
            if self.loop is not None:
                self.loop.stop("the program was ended")
                self.loop.ask("end")
            self._thread.join()
