"""Frame sources: the common interface of cameras, addresses and files, and a queue of frames."""

from __future__ import annotations

import abc
import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, NoReturn, final

from fixel.errors import FixelError, InvalidInput
from fixel.formats.recording_video import REDUCED, brightness, decoded, jpeg_size, shrunk
from fixel.vision.frame import Frame, Gray, Picture

STALLED: Final = 3.0  # [s] without data after which a camera counts as unplugged
ENDED: Final = "the camera sends no more pictures"


class Stream(NamedTuple):
    """Properties of an open source."""

    size: tuple[int, int]  # width and height [px]
    rate: float  # nominal frame rate [frames/s], 0 where unknown
    jpeg: bool  # whether pictures are JPEG data
    live: bool  # whether the source does not wait for its reader; one that waits loses no picture
    simulated_by: str = ""  # program that rendered the pictures; empty for a camera


@final
@dataclass(slots=True)
class CameraPicture:
    """Picture as it arrived."""

    time: float  # time of arrival, on `time.monotonic` [s]
    jpeg: bytes | None = None  # JPEG data as they arrived
    pixels: Picture | None = None  # pixels, in the order blue, green, red, where it arrived as such
    # Time of capture on the same clock [s], where the camera reports it.
    captured: float | None = None
    rendered: Frame | None = None  # picture of an emulated camera, rendered when it is looked at

    @property
    def taken(self) -> float:
        """Time of capture, or of arrival where the camera does not report it [s]."""
        return self.time if self.captured is None else self.captured

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height [px]; None for an incomplete picture."""
        if self.jpeg is not None:
            return jpeg_size(self.jpeg)
        if self.rendered is not None:
            return self.rendered.size
        if self.pixels is None or self.pixels.ndim != 3:
            return None
        return self.pixels.shape[1], self.pixels.shape[0]

    def picture(self) -> Picture:
        """Return the pixels (height, width, 3) uint8, decoded at the first call, or raise."""
        if self.pixels is None:
            own = self.rendered
            self.pixels = decoded(self.jpeg or b"") if own is None else own.picture
        return self.pixels

    def small(self) -> Gray:
        """Return the brightness (height / 8, width / 8) uint8, without full decoding of a JPEG."""
        if self.jpeg is None:
            return shrunk(self.picture())
        return brightness(self.jpeg, REDUCED)


class FrameSource(abc.ABC):
    """Abstract camera, or a substitute for one."""

    name: str  # name for messages and records, without passwords
    ended: str = ""  # reason why the pictures ended; empty before
    complete: bool = False  # whether a file was read to its end, without damage
    torn: int = 0  # number of incomplete pictures, which are skipped
    dropped: int = 0  # number of pictures that arrived while too many waited

    @abc.abstractmethod
    def open(self) -> Stream:
        """Open the source and read the first picture; raise `InvalidInput` if that fails."""

    @abc.abstractmethod
    def frames(self) -> Iterator[CameraPicture]:
        """Yield every whole picture once, the first included; then set `ended`."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close the source, which ends `frames`; may be called from another thread."""

    def fail(self, found: str, expected: str, hint: str | None = None) -> NoReturn:
        """Close the source and raise `InvalidInput` with its name."""
        self.close()
        raise InvalidInput(self.name, found=found, expected=expected, hint=hint)

    def __enter__(self) -> FrameSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


HELD: Final = 30  # pictures, one second at 30 frames/s
OLD: Final = 0.15  # [s] of waiting after which a picture is late
CATCHING_UP: Final = 0.15  # [s] for which pictures may be late after a delay
ENDS_WITHIN: Final = 5.0  # [s]


@final
class FrameQueue:
    """Pictures of a source, in order; those that are dropped are counted.

    A short delay is caught up with. Where pictures stay late, because they arrive faster than they
    are written, the oldest are dropped, so that what is written is always recent.

    The source is open. One that is not `live` waits for its reader, is one picture ahead, and loses
    none. Of a live one, at most `held` pictures wait.
    """

    def __init__(self, source: FrameSource, *, live: bool, held: int = HELD) -> None:
        self._refused = self._given_up = 0  # by the reading thread, and by the writing one
        self._source = source
        self._live = live
        self._waiting: queue.Queue[CameraPicture] = queue.Queue(held if live else 1)
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
        return self._refused + self._given_up + self._source.dropped

    @property
    def over(self) -> bool:
        """Whether no more pictures will come."""
        return self._ended.is_set() and self._waiting.empty()

    @property
    def reason(self) -> str:
        """Reason why no more pictures will come."""
        if self._error is not None:
            return f"the camera failed: {self._error}"
        return self._source.ended or ENDED

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
        while not self._stop.is_set():
            try:
                self._waiting.put(arrived, block=not self._live, timeout=0.1)
                return
            except queue.Full:
                if self._live:
                    self._refused += 1
                    return
