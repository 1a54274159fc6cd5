"""Live picture with a status, from any thread to any number of browsers."""

from __future__ import annotations

import asyncio
import functools
import json
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple

from fastapi import APIRouter
from fastapi.responses import JSONResponse, Response, StreamingResponse

from fixel.errors import InvalidInput
from fixel.vision.frame import Picture, opencv

BOUNDARY: Final = "next-picture-of-fixel-7d1f0c5e"
PART_HEAD: Final = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\n\r\n".encode()
HEARTBEAT: Final = 1.0  # [s] between two signs of life if nothing changes
STATUS_PAUSE: Final = 0.05  # [s] shortest time between two reports; faster ones are not read


def jpeg_on_demand(picture: Picture | Callable[[], Picture], quality: int) -> Callable[[], bytes]:
    """Return a function that draws and compresses a picture at its first call, for all viewers."""
    lock = threading.Lock()

    @functools.cache
    def compressed() -> bytes:
        cv2 = opencv()
        pixels = picture() if callable(picture) else picture
        done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not done:
            raise InvalidInput("picture", found="one that cannot be encoded as JPEG")
        return bytes(data)

    def jpeg() -> bytes:
        with lock:
            return compressed()

    return jpeg


class LiveFrame(NamedTuple):
    """State of a view: the number of the change, the picture if any, the status."""

    number: int
    jpeg: Callable[[], bytes] | None  # returns the picture as a JPEG file
    report: str


class LiveView:
    """Live view of a camera.

    A program shows pictures from its own thread and never waits; browsers get the newest when they
    are ready for one. Pictures are drawn and compressed only while there is a viewer, as JPEG of a
    quality from 1 to 100. `markup` returns the page that shows the status, which browsers get with
    every status.

    Examples
    --------
    >>> view = LiveView()
    >>> view.show(None, {"frames": 0})
    >>> view.report
    '{"frames": 0}'
    """

    def __init__(self, quality: int = 80) -> None:
        self.markup: Callable[[], str] | None = None
        self._quality = quality
        self._lock = threading.Lock()
        self._shot = LiveFrame(0, None, "{}")
        self._waiting: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}
        self._watchers = 0
        self._closed = False

    def show(
        self, picture: Picture | Callable[[], Picture] | None, status: Mapping[str, Any]
    ) -> None:
        """Show a picture and a status, with plain values for JSON, until the next call.

        The picture (h, w, 3) uint8 must not be modified afterwards. A callable that returns one is
        called in another thread, and only if there is a viewer. None: the picture stays and only
        the report is new. A number that is not finite raises `ValueError`.
        """
        report = json.dumps(status, allow_nan=False)
        jpeg = None if picture is None else jpeg_on_demand(picture, self._quality)
        self._change(lambda old: LiveFrame(old.number + 1, jpeg or old.jpeg, report))

    def repeat(self) -> None:
        """Send the newest status again: its page shows something new."""
        self._change(lambda old: old._replace(number=old.number + 1))

    def _change(self, change: Callable[[LiveFrame], LiveFrame]) -> None:
        with self._lock:
            self._shot = change(self._shot)
            waiting = list(self._waiting.items())
        _wake(waiting)

    def close(self) -> None:
        """End all streams."""
        with self._lock:
            self._closed = True
            waiting = list(self._waiting.items())
        _wake(waiting)

    @property
    def watched(self) -> bool:
        """Whether a browser shows the moving picture."""
        return self._watchers > 0

    @property
    def newest(self) -> LiveFrame:
        """Newest picture and report."""
        with self._lock:
            return self._shot

    @property
    def report(self) -> str:
        """Newest status, as JSON."""
        return self.newest.report

    async def after(self, number: int, patience: float) -> LiveFrame | None:
        """Return a frame after `number`, or the old one after `patience` [s]; None if closed."""
        event, loop = asyncio.Event(), asyncio.get_running_loop()
        with self._lock:
            if self._closed or self._shot.number > number:
                return self._open_shot()
            self._waiting[event] = loop
        try:
            with suppress(TimeoutError):
                await asyncio.wait_for(event.wait(), patience)
        finally:
            with self._lock:
                self._waiting.pop(event, None)
        return self._open_shot()

    def _open_shot(self) -> LiveFrame | None:
        return None if self._closed else self._shot

    async def pictures(self) -> AsyncIterator[bytes]:
        """Yield the parts of a `multipart/x-mixed-replace` answer.

        The head of the next picture is sent directly after each picture: Chromium shows a picture
        when it has read that head, so each would be one picture late otherwise.
        """
        self._watchers += 1  # always in the same event loop, so without a race
        seen, shown = 0, None
        try:
            yield PART_HEAD
            while (shot := await self.after(seen, HEARTBEAT)) is not None:
                silent = shot.number == seen
                seen = shot.number
                if shot.jpeg is not None and (silent or shot.jpeg is not shown):
                    shown = shot.jpeg
                    yield await asyncio.to_thread(shown) + b"\r\n" + PART_HEAD
        finally:
            self._watchers -= 1

    async def reports(self) -> AsyncIterator[str]:
        """Yield server-sent events: the status when it changes, and signs of life."""
        seen = 0
        yield "retry: 1000\n\n"
        while (shot := await self.after(seen, HEARTBEAT)) is not None:
            yield self._event() if shot.number > seen else ": still here\n\n"
            seen = shot.number
            await asyncio.sleep(STATUS_PAUSE)
        if self.newest.number > seen:  # the last status
            yield self._event()
        yield "event: end\ndata: {}\n\n"

    def _event(self) -> str:
        page = f"event: page\ndata: {json.dumps(self.markup())}\n\n" if self.markup else ""
        return f"data: {self.report}\n\n{page}"

    def router(self) -> APIRouter:
        """Routes `stream` (MJPEG), `picture.jpg`, `events` (server-sent) and `status` (JSON)."""
        router = APIRouter()

        @router.get("/stream")
        def stream() -> StreamingResponse:
            return StreamingResponse(
                self.pictures(), media_type=f"multipart/x-mixed-replace; boundary={BOUNDARY}"
            )

        @router.get("/picture.jpg")
        def picture() -> Response:
            jpeg = self.newest.jpeg
            if jpeg is None:
                return Response(status_code=404, headers={"retry-after": "1"})
            return Response(jpeg(), media_type="image/jpeg")

        @router.get("/events")
        def events() -> StreamingResponse:
            return StreamingResponse(self.reports(), media_type="text/event-stream")

        @router.get("/status")
        def status() -> JSONResponse:
            return JSONResponse(json.loads(self.report))

        return router


def _wake(waiting: list[tuple[asyncio.Event, asyncio.AbstractEventLoop]]) -> None:
    for event, loop in waiting:
        with suppress(RuntimeError):  # the server has ended meanwhile
            loop.call_soon_threadsafe(event.set)
