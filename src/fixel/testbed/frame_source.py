"""Frame sources: cameras, addresses and files by one interface, for one or several readers."""

from __future__ import annotations

import abc
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple, NoReturn

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


GLANCE: Final = 0.1  # [s] between two checks of a reader or a camera that has ended
MIN_SILENCE: Final = 0.5  # [s] without a picture after which a live camera is lost, at least
MISSING: Final = 5.0  # pictures that are missing then, at the measured rate
RECENT: Final = 0.1  # weight of the newest picture in the measured interval


class SharedCamera:
    """Camera that stays open; `view` returns a source of its pictures from now on.

    `source` returns a new source of the camera. `InvalidInput` is raised if it cannot be opened.
    """

    def __init__(self, source: Callable[[], FrameSource]) -> None:
        self._make = source
        self._views: tuple[CameraView, ...] = ()
        self._changed = threading.Condition()
        self._open()

    def _open(self) -> None:
        self.source = self._make()
        self.stream: Stream = self.source.open()  # properties of the open camera
        self.reason = ""  # why it sends no more pictures
        self.newest = time.monotonic()  # arrival of the newest picture [s]
        self._interval = 0.0  # mean time between the last pictures [s]
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    @property
    def patience(self) -> float:
        """Time without a picture after which the camera is lost [s]; one that waits never is."""
        measured = min(max(MIN_SILENCE, MISSING * self._interval), STALLED + 1.0)
        return measured if self.stream.live else math.inf

    @property
    def lost(self) -> str:
        """Why no more pictures come, or none came lately; empty while they do."""
        silent = time.monotonic() - self.newest
        late = f"it has sent nothing for {silent:.1f} s" if silent > self.patience else ""
        return self.reason or late

    def view(self) -> CameraView:
        """Return a source of the pictures from now on, to be closed by its reader."""
        view = CameraView(self)
        with self._changed:
            self._views = (*self._views, view)
            self._changed.notify_all()
        return view

    def leave(self, view: CameraView) -> None:
        """Send no more pictures to a view."""
        with self._changed:
            self._views = tuple(own for own in self._views if own is not view)

    def restart(self) -> None:
        """Open the camera again, after its pictures have ended."""
        self.close()
        self._open()

    def close(self) -> None:
        """Close the camera, which ends all views."""
        self.reason = self.reason or "the camera was closed"
        self.source.close()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(ENDS_WITHIN)

    def _read(self) -> None:
        try:
            for picture in self.source.frames():
                now = time.monotonic()
                self._interval += RECENT * (now - self.newest - self._interval)
                self.newest = now
                self._hand_over(picture)
                if self.reason:
                    break
            self.reason = self.reason or self.source.ended or ENDED
        except (FixelError, OSError) as problem:
            self.reason = f"the camera failed: {problem}"

    def _hand_over(self, picture: CameraPicture) -> None:
        with self._changed:
            # A camera that waits for its reader also waits for the first one.
            while not (self.stream.live or self._views or self.reason):
                self._changed.wait(GLANCE)
            views = self._views
        for view in views:
            view.put(picture)


class CameraView(FrameSource):
    """Pictures of a shared camera for one reader."""

    def __init__(self, camera: SharedCamera) -> None:
        self.name = camera.source.name
        self._camera, self._torn_before = camera, camera.source.torn
        self._waiting: queue.Queue[CameraPicture] = queue.Queue(HELD if camera.stream.live else 1)
        self._closed = threading.Event()

    def open(self) -> Stream:
        """Return the properties of the camera, which is open."""
        return self._camera.stream

    def put(self, picture: CameraPicture) -> None:
        """Add a picture; one of a camera that does not wait for its reader is lost if many wait."""
        live = self._camera.stream.live
        self.torn = self._camera.source.torn - self._torn_before
        while not (self._closed.is_set() or self._camera.reason):
            try:
                self._waiting.put(picture, block=not live, timeout=GLANCE)
                return
            except queue.Full:
                if live:
                    self.dropped += 1
                    return

    def frames(self) -> Iterator[CameraPicture]:
        """Yield the pictures since `view`, until either side is closed."""
        while not self._closed.is_set():
            try:
                yield self._waiting.get(timeout=GLANCE)
            except queue.Empty:
                if self._camera.reason:
                    break
        self.ended = "stopped" if self._closed.is_set() else self._camera.reason
        self._camera.leave(self)

    def close(self) -> None:
        """End `frames`."""
        self._closed.set()
        self._camera.leave(self)
