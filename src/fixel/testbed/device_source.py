"""Frame source for a camera of this computer, through OpenCV."""

from __future__ import annotations

import glob
import os
import sys
import time
from collections.abc import Callable, Iterator
from threading import Event
from typing import Any, Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.jpeg import END
from fixel.testbed.clocks import CaptureClock
from fixel.testbed.frame_source import STALLED, CameraPicture, FrameSource, Stream
from fixel.vision.frame import Picture
from fixel.vision.opencv import opencv

TRIES: Final = 10  # failed pictures in a row after which a camera counts as sending none

Capture = Callable[[int | str], Any]


@final
class DeviceSource(FrameSource):
    """Camera selected by number or by device file.

    Parameters
    ----------
    device : str
        `"0"` or `"/dev/video0"`.
    size : (int, int), optional
        Size requested from the camera [px]; the camera may choose another.
    rate : float
        Frame rate requested from the camera [frames/s].
    capture : callable, optional
        Function that opens a device as `cv2.VideoCapture` does.
    """

    def __init__(
        self,
        device: str,
        *,
        size: tuple[int, int] | None = None,
        rate: float = 30.0,
        capture: Capture | None = None,
    ) -> None:
        self.name = device if device.startswith("/") else f"camera {device}"
        self._device: int | str = int(device) if device.isdecimal() else device
        self._asked, self._rate = size, rate
        self._capture = capture
        self._camera: Any = None
        self._first: CameraPicture | None = None
        self._stop = Event()
        self._reading = False
        self._clock = CaptureClock()

    def open(self) -> Stream:
        """Request JPEG at the wanted size and rate, and accept what the camera delivers."""
        if self._capture is None:
            _check_present(self._device)
        cv2 = opencv()
        camera = (self._capture or cv2.VideoCapture)(self._device)
        self._camera = camera
        if not camera.isOpened():
            self.close()
            raise InvalidInput(
                self.name,
                found="a camera that does not open",
                expected="a camera that no other program uses",
                hint=_hint(),
            )
        camera.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        if self._asked:
            camera.set(cv2.CAP_PROP_FRAME_WIDTH, self._asked[0])
            camera.set(cv2.CAP_PROP_FRAME_HEIGHT, self._asked[1])
        camera.set(cv2.CAP_PROP_FPS, self._rate)
        camera.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # JPEG unchanged, where the system delivers it
        first = self._read()
        if first is None or first.jpeg is None:
            camera.set(cv2.CAP_PROP_CONVERT_RGB, 1)
            first = self._read()
        size = None if first is None else first.size
        if first is None or size is None:
            self.close()
            raise InvalidInput(
                self.name, found="no pictures", expected="a camera that sends them", hint=_hint()
            )
        self._first = first
        self.torn = 0  # a camera may start with half a picture
        promised = float(camera.get(cv2.CAP_PROP_FPS))
        rate = promised if 1.0 <= promised <= 1000.0 else 0.0
        return Stream(size=size, rate=rate, jpeg=first.jpeg is not None, live=True)

    def frames(self) -> Iterator[CameraPicture]:
        """Yield pictures until the camera is unplugged or closed."""
        self._reading = True
        arrived, self._first = self._first, None
        try:
            while arrived is not None and not self._stop.is_set():
                yield arrived
                arrived = self._read()
            self.ended = "stopped" if self._stop.is_set() else "the camera sends no more pictures"
        finally:
            self._let_go()

    def close(self) -> None:
        """Release the camera, after the picture that is being read."""
        self._stop.set()
        if not self._reading:
            self._let_go()

    def _read(self) -> CameraPicture | None:
        """Return the next whole picture, stamped on arrival, before it is decoded; None after
        `TRIES` failures in a row."""
        now = time.monotonic()
        for _ in range(TRIES):
            before = now
            grabbed = self._camera.grab()
            now = time.monotonic()
            if self._stop.is_set() or (not grabbed and now - before > STALLED):
                return None
            if not grabbed:
                continue
            given, raw = self._camera.retrieve()
            arrived = _arrived(now, raw) if given and raw is not None else None
            if arrived is not None:
                # Time stamp of the buffer under Video4Linux, time within the stream elsewhere.
                stamp = 1e-3 * float(self._camera.get(opencv().CAP_PROP_POS_MSEC))
                arrived.captured = self._clock.place(stamp, now)
                return arrived
            self.torn += 1
        return None

    def _let_go(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.release()


def _arrived(now: float, raw: Picture) -> CameraPicture | None:
    """Return a camera's data as a picture: pixels, or one row of JPEG bytes without the remains of
    the buffer behind them; None where the JPEG is truncated."""
    if raw.ndim == 3:
        return CameraPicture(now, pixels=raw)
    data = np.ascontiguousarray(raw).tobytes()
    arrived = CameraPicture(now, jpeg=data[: data.rfind(END) + 2])
    return None if arrived.size is None else arrived


def _check_present(device: int | str) -> None:
    """Raise for a missing or unreadable device on Linux; OpenCV reports no reason."""
    if not sys.platform.startswith("linux"):
        return
    path = f"/dev/video{device}" if isinstance(device, int) else device
    if not os.path.exists(path):
        raise InvalidInput(path, found="no such device", expected="a camera", hint=_hint())
    if not os.access(path, os.R_OK | os.W_OK):
        raise InvalidInput(
            path,
            found="no permission",
            expected="a camera with read permission",
            hint="sudo usermod --append --groups video $USER, then log in again",
        )


def _hint() -> str:
    there = sorted(glob.glob("/dev/video*"))
    if not sys.platform.startswith("linux"):
        return "try another number, starting at 0"
    return f"available cameras: {', '.join(there)}" if there else "no camera is connected"
