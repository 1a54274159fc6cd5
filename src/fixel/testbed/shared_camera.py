"""Camera whose pictures several readers get at once: a live picture, and a recording."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Final, final

from fixel.errors import FixelError
from fixel.testbed.frame_source import ENDED, HELD, STALLED, CameraPicture, FrameSource, Stream

GLANCE: Final = 0.1  # [s] between two checks of a reader or a camera that has ended
ENDS_WITHIN: Final = 5.0  # [s]
MIN_SILENCE: Final = 0.5  # [s] without a picture after which a live camera is lost, at least
MISSING: Final = 5.0  # pictures that are missing then, at the measured rate
RECENT: Final = 0.1  # weight of the newest picture in the measured interval


@final
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


@final
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
