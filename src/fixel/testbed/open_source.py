"""Frame sources: devices, addresses and files, opened by the argument of a command."""

from __future__ import annotations

import base64
import glob
import http.client
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from threading import Event, Timer
from typing import Any, Final
from urllib.parse import SplitResult, unquote, urlsplit

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.recording_video import END
from fixel.testbed.clocks import CaptureClock
from fixel.testbed.file_source import SIMULATED, STAMP, FileSource
from fixel.testbed.frame_source import ENDED, STALLED, CameraPicture, FrameSource, Stream
from fixel.vision.frame import Picture, opencv


def source_of(
    text: str,
    *,
    size: tuple[int, int] | None = None,
    rate: float = 30.0,
    as_fast_as_possible: bool = False,
) -> FrameSource:
    """Choose the frame source for a camera, an address, a file or a recording.

    The text is `0` or `/dev/video0` for a camera, `http://...` for a network camera, else a video
    file or the folder of a recording. `size` [px] and `rate` [frames/s] are requested from a
    camera. A file may be played faster than it was recorded; frames then have the file's times.
    """
    if text.isdecimal() or text.startswith("/dev/"):
        return DeviceSource(text, size=size, rate=rate)
    if "://" in text:
        return UrlSource(text)
    return FileSource(text, as_fast_as_possible=as_fast_as_possible)


def check_size(stream: Stream, size: tuple[int, int], name: str) -> None:
    """Raise for pictures of another size than the rig's, before recording starts."""
    if stream.size != size:
        raise InvalidInput(
            name,
            found="pictures of {} x {} pixels".format(*stream.size),
            expected="{} x {}, as the rig was calibrated".format(*size),
            hint="set the camera to that size, or calibrate it at this one",
        )


TRIES: Final = 10  # failed pictures in a row after which a camera counts as sending none

Capture = Callable[[int | str], Any]


class DeviceSource(FrameSource):
    """Camera selected by number or by device file, such as `"0"` or `"/dev/video0"`.

    A size [px] and a frame rate [frames/s] are requested from the camera, which may choose others.
    `capture` opens a device as `cv2.VideoCapture` does.
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
            expected = "a camera that no other program uses"
            self.fail("a camera that does not open", expected, _hint())
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
            self.fail("no pictures", "a camera that sends them", _hint())
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
            self.ended = "stopped" if self._stop.is_set() else ENDED
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
        found = "no permission"
        hint = "sudo usermod --append --groups video $USER, then log in again"
        raise InvalidInput(path, found=found, expected="a camera with read permission", hint=hint)


def _hint() -> str:
    there = sorted(glob.glob("/dev/video*"))
    if not sys.platform.startswith("linux"):
        return "try another number, starting at 0"
    return f"available cameras: {', '.join(there)}" if there else "no camera is connected"


MULTIPART: Final = "multipart/x-mixed-replace"
MAX_LINE: Final = 4096  # [bytes] of a header
MAX_PICTURE_BYTES: Final = 32 * 1024 * 1024  # [bytes] of a picture
GARBAGE: Final = 10  # unreadable pictures in a row after which the stream ends
OPENS_WITHIN: Final = 10.0  # [s] in which the first picture must be complete


class UrlSource(FrameSource):
    """Camera that sends JPEG pictures over HTTP as `multipart/x-mixed-replace`.

    Its address is `http://NAME:PASSWORD@HOST:PORT/PATH`; name and password are not recorded. It may
    be silent for `patience` [s].
    """

    def __init__(self, url: str, *, patience: float = STALLED) -> None:
        parts = _split(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise _refusal(
                f"{parts.scheme}://{parts.hostname or ''}",
                "use the HTTP address of the camera: most cameras with RTSP also send MJPEG",
            )
        self.name = _shown(parts)
        self._parts = parts
        self._patience = patience
        self._stop = Event()
        self._connection: http.client.HTTPConnection | None = None
        self._socket: socket.socket | None = None
        self._answer: http.client.HTTPResponse | None = None
        self._boundary = b""
        self._inside = False  # a part, after its boundary
        self._first: CameraPicture | None = None
        self._stamp: float | None = None  # capture time of the part, camera's clock [s]
        self._clock = CaptureClock()

    def open(self) -> Stream:
        """Connect to the camera and read the first picture."""
        limit = max(OPENS_WITHIN, 2.0 * self._patience)
        late = Timer(limit, self._hang_up, (f"no whole picture within {limit:g} s",))
        late.start()
        try:
            self._connect()
            self._first = self._next()
        except TimeoutError:
            self.fail(f"no data within {self._patience:g} s", "a camera that sends pictures")
        except (OSError, http.client.HTTPException) as problem:
            found = self.ended or _words(problem)
            self.fail(found, "a camera that answers", "check the address")
        finally:
            late.cancel()
        size = None if self._first is None else self._first.size
        if size is None:
            self.fail(self.ended or "no JPEG picture", "a stream of JPEG pictures")
        made_by = "" if self._answer is None else self._answer.headers.get(SIMULATED, "")
        return Stream(size=size, rate=0.0, jpeg=True, live=True, simulated_by=unquote(made_by))

    def frames(self) -> Iterator[CameraPicture]:
        """Yield pictures until the camera is unplugged or closed."""
        arrived, self._first = self._first, None
        while arrived is not None:
            yield arrived
            try:
                arrived = self._next()
            except TimeoutError:
                self.ended = f"the camera has sent nothing for {self._patience:g} s"
                break
            except (OSError, ValueError, AttributeError, http.client.HTTPException) as problem:
                # Closing from another thread closes the file during a read.
                self.ended = f"the connection to the camera was lost: {_words(problem)}"
                break
        if self._stop.is_set():
            self.ended = "stopped"

    def close(self) -> None:
        """Close the connection."""
        self._stop.set()
        self._hang_up()
        if self._answer is not None:
            with suppress(OSError, ValueError):
                self._answer.close()
        if self._connection is not None:
            self._connection.close()

    def _hang_up(self, why: str = "") -> None:
        """Shut down the socket to end a blocked read, for which closing would wait."""
        self.ended = self.ended or why
        if self._socket is not None:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def _connect(self) -> None:
        parts = self._parts
        secure = parts.scheme == "https"
        kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        self._connection = kind(parts.hostname or "", parts.port, timeout=self._patience)
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        headers = {"Accept": MULTIPART, "Connection": "close"}
        if parts.username is not None:
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            headers["Authorization"] = "Basic " + base64.b64encode(user.encode()).decode()
        self._connection.request("GET", target, headers=headers)
        # The connection drops its socket once the answer has begun.
        self._socket = self._connection.sock
        self._answer = answer = self._connection.getresponse()
        if answer.status != http.HTTPStatus.OK:
            hint = "http://NAME:PASSWORD@HOST/..." if answer.status == 401 else None
            self.fail(f"the answer {answer.status} {answer.reason}", "pictures", hint)
        kind_of_answer = answer.headers.get_content_type()
        if kind_of_answer != MULTIPART:
            hint = "this may be the page that shows the stream, not the stream"
            self.fail(kind_of_answer, MULTIPART, hint)
        boundary = answer.headers.get_param("boundary")
        self._boundary = b"--" + str(boundary or "").strip('"').removeprefix("--").encode()

    def _next(self) -> CameraPicture | None:
        """Return the next valid picture, None at the end of the stream."""
        for _ in range(GARBAGE):
            data = self._part()
            now = time.monotonic()
            if data is None:
                self.ended = self.ended or "the camera ended the stream"
                return None
            arrived = CameraPicture(now, jpeg=data)
            if arrived.size is not None:
                arrived.captured = self._clock.place(self._stamp, now)
                return arrived
            self.torn += 1
        self.ended = f"{GARBAGE} parts in a row that are not JPEG pictures"
        return None

    def _part(self) -> bytes | None:
        """Read the data between two boundaries; None at the end."""
        answer = self._answer
        assert answer is not None
        length = self._head(answer)
        if length is None:
            return None
        if length >= 0:
            data = answer.read(length)
            return data if len(data) == length else None
        return self._until_boundary(answer)

    def _head(self, answer: http.client.HTTPResponse) -> int | None:
        """Read the length of the next part; -1 if it is missing, None at the end of the stream."""
        begun, length, read = self._inside, -1, 0
        self._inside, self._stamp = False, None
        while line := answer.readline(MAX_LINE):
            read += len(line)
            text = line.strip()
            if text == self._boundary or text == b"--" + self._boundary:
                begun, length, self._stamp = True, -1, None
            elif begun and text.lower().startswith(STAMP.lower().encode() + b":"):
                self._stamp = _stamp(text)
            elif begun and text.lower().startswith(b"content-length:"):
                length = _length(text)
            elif begun and not text:
                return length
            if read > MAX_PICTURE_BYTES:
                self.ended = "no picture in the stream"
                return None
        return None

    def _until_boundary(self, answer: http.client.HTTPResponse) -> bytes | None:
        """Read a part of unknown length up to the boundary, which may be in the last line."""
        data = bytearray()
        while line := answer.readline(MAX_LINE):
            if line.strip() in (self._boundary, b"--" + self._boundary) and line.endswith(b"\n"):
                self._inside = True
                return bytes(data[: data.rfind(END) + 2])
            data += line
            if len(data) > MAX_PICTURE_BYTES:
                return None
        return None


def _split(url: str) -> SplitResult:
    try:
        parts = urlsplit(url)
        _ = parts.port  # parsed only on access
    except ValueError as problem:
        raise _refusal(f"an error ({problem})") from None
    return parts


def _refusal(found: str, hint: str | None = None) -> InvalidInput:
    expected = "the address http://... of a camera that sends MJPEG"
    return InvalidInput("camera", found=found, expected=expected, hint=hint)


def _length(header: bytes) -> int:
    value = header.partition(b":")[2].strip()
    return int(value) if value.isdigit() and int(value) <= MAX_PICTURE_BYTES else -1


def _stamp(header: bytes) -> float | None:
    try:
        return float(header.partition(b":")[2])
    except ValueError:
        return None


def _shown(parts: SplitResult) -> str:
    """Format the address without name, password and query, which may contain secrets."""
    host = parts.hostname or ""
    port = f":{parts.port}" if parts.port else ""
    return f"{parts.scheme}://{host}{port}{parts.path}"


def _words(problem: Exception) -> str:
    text = getattr(problem, "strerror", None) or str(problem) or type(problem).__name__
    return str(text).lower()
