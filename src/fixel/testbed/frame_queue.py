"""Reads a source in a thread of its own: no picture waits for what is done with the last."""

from __future__ import annotations

import queue
import threading
import time
from typing import Final, final

from fixel.errors import FixelError
from fixel.testbed.frame_source import CameraPicture, FrameSource

HELD: Final = 30  # pictures: a second of them
OLD: Final = 0.15  # [s] a picture that waited longer is late
CATCHING_UP: Final = 0.15  # [s] for which pictures may be late, after something held them up
ENDS_WITHIN: Final = 5.0  # [s]


@final
class FrameQueue:
    """Pictures of a source, in order; those too many are counted, never silently gone.

    What is held up for a moment is caught up with. Where pictures stay late, because writing them
    takes longer than they last, the oldest are given up: what is written is never long ago.

    Parameters
    ----------
    source : FrameSource
        Opened already.
    live : bool
        Whether pictures come when they come. Of another source none is lost: it has to wait.
    held : int
        How many may wait.
    """

    def __init__(self, source: FrameSource, *, live: bool, held: int = HELD) -> None:
        self._refused = self._given_up = 0  # by the thread that reads, and by the one that writes
        self._source = source
        self._live = live
        self._waiting: queue.Queue[CameraPicture] = queue.Queue(held)
        self._ended = threading.Event()
        self._stop = threading.Event()
        self._late_since: float | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._read, name="frames", daemon=True)

    def start(self) -> None:
        """Read from now on."""
        self._thread.start()

    def get(self, patience: float) -> CameraPicture | None:
        """The next picture; None where none came within `patience` [s], or none will come."""
        while True:
            try:
                arrived = self._waiting.get(timeout=0.0 if self._ended.is_set() else patience)
            except queue.Empty:
                return None
            if not (self._live and self._too_old(arrived)):
                return arrived
            self._given_up += 1

    def _too_old(self, arrived: CameraPicture) -> bool:
        """Whether to give a picture up: it is late, and so were those before it for a while."""
        now = time.monotonic()
        if now - arrived.time <= OLD:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = now
        return now - self._late_since > CATCHING_UP and not self._ended.is_set()

    @property
    def lost(self) -> int:
        """Pictures that were lost so far."""
        return self._refused + self._given_up

    @property
    def over(self) -> bool:
        """Whether no more pictures will come."""
        return self._ended.is_set() and self._waiting.empty()

    @property
    def reason(self) -> str:
        """Why no more will come."""
        if self._error is not None:
            return f"the camera failed: {self._error}"
        return self._source.ended or "the camera sends no more pictures"

    @property
    def waiting(self) -> int:
        """How many pictures wait."""
        return self._waiting.qsize()

    def close(self) -> None:
        """Let go of the source."""
        self._stop.set()
        self._source.close()
        if self._thread.ident is not None:
            self._thread.join(ENDS_WITHIN)

    def _read(self) -> None:
        try:
            for arrived in self._source.frames():
                if self._stop.is_set():
                    break
                self._put(arrived)
        except (FixelError, OSError) as error:
            self._error = error
        except BaseException as error:
            self._error = error
            raise
        finally:
            self._ended.set()

    def _put(self, arrived: CameraPicture) -> None:
        if self._live:
            try:
                self._waiting.put_nowait(arrived)
            except queue.Full:
                self._refused += 1
            return
        while not self._stop.is_set():
            try:
                self._waiting.put(arrived, timeout=0.1)
                return
            except queue.Full:
                continue
