"""Videos and recordings played as if they came from a camera, here or over HTTP."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final
from urllib.parse import quote

import numpy as np

from fixel.errors import InvalidInput
from fixel.formats.recording import Recording, is_recording, open_recording
from fixel.formats.recording_video import jpeg_of
from fixel.formats.video_file import VideoFile, open_video
from fixel.testbed.frame_source import CameraPicture, FrameSource, Stream
from fixel.testbed.recorder import USUAL_RATE
from fixel.testbed.tactile import TactileReading

FILM: Final = "film"  # instead of a port: the readings of the recording that is played
HERE_ONLY: Final = "127.0.0.1"
BOUNDARY: Final = "fixel-frame"
STAMP: Final = "X-Timestamp"  # capture time of a part [s], as mjpg-streamer sends it
SIMULATED: Final = "X-Fixel-Simulated-By"  # marks rendered films as simulated


class FileSource(FrameSource):
    """File played at the rate of its recording, or as fast as it is read.

    It is a video, or the folder of a recording, whose JPEG pictures are passed unchanged. A file
    that is played `as_fast_as_possible` waits for its reader only; its frames have the times of the
    file. With `loop` it restarts at the end.
    """

    def __init__(
        self, path: str | Path, *, as_fast_as_possible: bool = False, loop: bool = False
    ) -> None:
        self.path = Path(path)
        self.name = str(path)
        self.began = math.nan
        self._fast = as_fast_as_possible
        self._loop = loop
        self._stop = threading.Event()
        self._recording: Recording | None = None
        self._video: VideoFile | None = None

    def open(self) -> Stream:
        """Open the recording or video and return its properties."""
        if is_recording(self.path):
            self._recording = recording = open_recording(self.path)
            jpeg = recording.header.codec != "exact"
            header, rate = recording.header, _rate(recording)
            return Stream(header.size, rate, jpeg, not self._fast, header.simulated_by)
        self._video = video = open_video(self.path, threads=1)
        return Stream(video.size, 0.0, jpeg=False, live=not self._fast)

    def frames(self) -> Iterator[CameraPicture]:
        """Yield every picture when it is due."""
        zero, last, step = math.nan, 0.0, 0.0
        while not self._stop.is_set():
            for at, arrived in self._played():
                if math.isnan(zero):  # opening takes time
                    zero, self.began = at, time.monotonic()
                due = self.began + at - zero
                if not self._fast:
                    self._stop.wait(max(0.0, due - time.monotonic()))
                if self._stop.is_set():
                    break
                arrived.time = due if self._fast else time.monotonic()
                arrived.captured = due
                yield arrived
                step, last = at - last, at
            if not self._loop or math.isnan(zero):  # or there is no picture to play again
                break
            self.began += last - zero + (step or 1.0 / USUAL_RATE)  # of a single picture
        self.ended = "stopped" if self._stop.is_set() else self._at_its_end()

    def close(self) -> None:
        """Stop playing."""
        self._stop.set()

    def _at_its_end(self) -> str:
        """Return why the pictures ended, with what the file turned out to lack."""
        wrong = tuple(self._video.remarks) if self._video else ()
        if self._recording is not None and not self._recording.complete:
            wrong = self._recording.problems
        self.complete = not wrong
        return "; ".join(("the file has ended", *wrong))

    def _played(self) -> Iterator[tuple[float, CameraPicture]]:
        recording = self._recording
        if recording is not None and recording.header.codec != "exact":
            for at, jpeg in recording.jpegs():
                arrived = CameraPicture(0.0, jpeg=jpeg)
                if arrived.size is not None:
                    yield at, arrived
                else:
                    self.torn += 1
            return
        film = recording or self._video
        assert film is not None
        for frame in film.frames():
            yield frame.time, CameraPicture(0.0, pixels=frame.picture)


class PlayedTactile:
    """Readings of a recording, as if its fixels were read while it is played.

    With `in_turn` each `read` returns the next reading, for a source that is played as fast as
    possible; else it returns the one that is due, counted from the first call.
    """

    trouble = ""

    def __init__(self, recording: str | Path | Recording, *, in_turn: bool = False) -> None:
        if not isinstance(recording, Recording):
            recording = open_recording(recording)
        self._recording = recording
        self._in_turn = in_turn
        self._next = 0
        self._began = math.nan

    def read(self) -> TactileReading:
        """Return the current reading."""
        now = time.monotonic()
        times = self._recording.time
        if self._in_turn:
            k, self._next = self._next, self._next + 1
        else:
            self._began = now if math.isnan(self._began) else self._began
            k = int(np.searchsorted(times - times[0], now - self._began + 1e-3, side="right")) - 1
            k = min(k, len(times) - 1)
        bits = int(self._recording.readings[k]) if k < len(times) else -1
        if bits < 0:
            return TactileReading(bits=None, time=now, problem="no reading")
        return TactileReading(bits=bits, time=now)


class LoopbackCamera:
    """Server that plays a film to every client from its beginning, at its own rate.

    The film is a video, or the folder of a recording; with `loop` it restarts at its end. Port 0 is
    any free one. `InvalidInput` is raised where there is no such film, or the port is taken.
    """

    def __init__(self, path: str | Path, *, port: int = 0, loop: bool = False) -> None:
        self.path, self.loop = Path(path), loop
        self.stream: Stream = FileSource(path).open()
        self._playing: set[FileSource] = set()
        try:
            self._server = ThreadingHTTPServer((HERE_ONLY, port), self._handler())
        except (OSError, OverflowError) as problem:
            raise InvalidInput("--port", found=problem, expected="a free port") from None
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="loopback camera", daemon=True
        )

    @property
    def url(self) -> str:
        """Address of the film."""
        return f"http://{HERE_ONLY}:{self._server.server_port}/video.mjpg"

    def start(self) -> LoopbackCamera:
        """Start to serve, in a thread."""
        self._thread.start()
        return self

    def wait(self) -> None:
        """Serve until interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def stop(self) -> None:
        """Stop the server and drop its connections, as when a plug is pulled."""
        # Shutting down a server that was not started would wait without end.
        if self._thread.ident is not None:
            self._server.shutdown()
            for source in tuple(self._playing):
                source.close()
            self._thread.join()
        self._server.server_close()

    def __enter__(self) -> LoopbackCamera:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        camera = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.0"

            def do_GET(self) -> None:
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
                self.send_header("Cache-Control", "no-store")
                if camera.stream.simulated_by:
                    self.send_header(SIMULATED, quote(camera.stream.simulated_by))
                self.end_headers()
                with suppress(ConnectionError):
                    camera._play(self)

            def log_message(self, format: str, *args: object) -> None:
                pass

        return Handler

    def _play(self, handler: BaseHTTPRequestHandler) -> None:
        source = FileSource(self.path, loop=self.loop)
        self._playing.add(source)
        try:
            source.open()
            for arrived in source.frames():
                jpeg = arrived.jpeg or jpeg_of(arrived.picture())
                head = (
                    f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\n"
                    f"Content-Length: {len(jpeg)}\r\n{STAMP}: {arrived.taken:.6f}\r\n\r\n"
                )
                handler.wfile.write(head.encode() + jpeg + b"\r\n")
        finally:
            source.close()
            self._playing.discard(source)


def _rate(recording: Recording) -> float:
    if recording.n_frames < 2:
        return recording.header.rate
    return float(1.0 / np.median(np.diff(recording.time)))
