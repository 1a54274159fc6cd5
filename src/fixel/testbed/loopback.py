"""Simulated network camera: serves a film over HTTP on this machine."""

from __future__ import annotations

import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Final, final
from urllib.parse import quote

from fixel.errors import InvalidInput
from fixel.formats.recording_video import jpeg_of
from fixel.testbed.file_source import FileSource
from fixel.testbed.frame_source import Stream

HERE_ONLY: Final = "127.0.0.1"
BOUNDARY: Final = "fixel-frame"
STAMP: Final = "X-Timestamp"  # capture time of a part [s], as mjpg-streamer sends it
SIMULATED: Final = "X-Fixel-Simulated-By"  # marks rendered films as simulated


@final
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
