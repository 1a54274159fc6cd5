"""Queue that reads a frame source in its own thread, so that slow processing blocks no frame."""

from __future__ import annotations

import queue
import threading
import time
from typing import Final, final

from fixel.errors import FixelError
from fixel.testbed.frame_source import CameraPicture, FrameSource

HELD: Final = 30  # pictures, one second at 30 frames/s
OLD: Final = 0.15  # [s] of waiting after which a picture is late
CATCHING_UP: Final = 0.15  # [s] for which pictures may be late after a delay
ENDS_WITHIN: Final = 5.0  # [s]


@final
class FrameQueue:
    """Pictures of a source, in order; those that are dropped are counted.

    A short delay is caught up with. Where pictures stay late, because they arrive faster than they
    are written, the oldest are dropped, so that what is written is always recent.

    Parameters
    ----------
    source : FrameSource
        Open source.
    live : bool
        Whether the source does not wait for its reader; another source waits and loses no picture.
    held : int
        Largest number of waiting pictures.
    """

    def __init__(self, source: FrameSource, *, live: bool, held: int = HELD) -> None:
        self._refused = self._given_up = 0  # by the reading thread, and by the writing one
        self._source = source
        self._live = live
        self._waiting: queue.Queue[CameraPicture] = queue.Queue(held)
        self._ended = threading.Event()
        self._stop = threading.Event()
        self._late_since: float | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._read, name="frames", daemon=True)

    def start(self) -> None:
        """Start reading."""
        self._thread.start()

    def get(self, patience: float) -> CameraPicture | None:
        """Return the next picture; None if none came within `patience` [s], or none will come."""
        while True:
            try:
                arrived = self._waiting.get(timeout=0.0 if self._ended.is_set() else patience)
            except queue.Empty:
                return None
            if not (self._live and self._too_old(arrived)):
                return arrived
            self._given_up += 1

    def _too_old(self, arrived: CameraPicture) -> bool:
        """Whether to drop a picture: it is late, and so were all for `CATCHING_UP` seconds."""
        now = time.monotonic()
        if now - arrived.time <= OLD:
            self._late_since = None
            return False
        if self._late_since is None:
            self._late_since = now
        return now - self._late_since > CATCHING_UP and not self._ended.is_set()

    @property
    def lost(self) -> int:
        """Number of pictures lost so far."""
        return self._refused + self._given_up

    @property
    def over(self) -> bool:
        """Whether no more pictures will come."""
        return self._ended.is_set() and self._waiting.empty()

    @property
    def reason(self) -> str:
        """Reason why no more pictures will come."""
        if self._error is not None:
            return f"the camera failed: {self._error}"
        return self._source.ended or "the camera sends no more pictures"

    @property
    def waiting(self) -> int:
        """Number of waiting pictures."""
        return self._waiting.qsize()

    def close(self) -> None:
        """Stop the thread and close the source."""
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
