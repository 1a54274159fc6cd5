"""Pages with a live picture: of a running recording, and for placing a part by hand."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from typing import Final

from fastapi import APIRouter
from fastapi.responses import JSONResponse

from fixel.testbed.recorder import RecordingStatus
from fixel.vision.frame import Picture
from fixel.web.app import Page
from fixel.web.live import LiveView

# Names of the fixels that are bits of the tactile byte: blue, red, green.
FIXELS = ("blue", "red", "green")
# Before the first picture.
NOTHING: Final[dict[str, list[str]]] = {"problems": [], "remarks": [], "parts": [], "tactile": []}


class RecordPreview:
    """Live page of a recording, with a button that ends it.

    The heading states what is recorded, and where. `fixels` names the bits of the tactile byte,
    lowest first; none for a recording without fixels.

    Examples
    --------
    >>> preview = RecordPreview("pushes/141", fixels=())
    >>> preview.show(None, RecordingStatus(1.0, 30, 0, 30.0, None, 5 * 10**10, ()))
    >>> preview.stop_wanted
    False
    """

    def __init__(self, heading: str, fixels: Sequence[str] = FIXELS) -> None:
        self.heading = heading
        self.fixels = tuple(fixels)
        self.view = LiveView()
        self._stop = threading.Event()

    @property
    def stop_wanted(self) -> bool:
        """Whether Stop was pressed on the page."""
        return self._stop.is_set()

    def show(
        self,
        picture: Picture | Callable[[], Picture] | None,
        status: RecordingStatus,
        limit_s: float | None = None,
    ) -> None:
        """Show a picture and a status without waiting; the recording ends after `limit_s`."""
        bits = status.bits
        lamps = [
            {"name": name, "on": None if bits is None else bool(bits >> bit & 1)}
            for bit, name in enumerate(self.fixels)
        ]
        content = {
            "state": "recording",
            "elapsed_s": status.seconds,
            "limit_s": limit_s,
            "frames": status.frames,
            "lost": status.lost,
            "tactile": lamps,
            "disk_free_gb": status.free / 1e9,
            "problems": list(status.problems),
            "stopping": self.stop_wanted,
        }
        self.view.show(picture, content)

    def page(self, path: str = "/record") -> Page:
        """Create the page, for `fixel.web.serve.WebServer`."""
        return Page(
            path=path,
            title="Recording",
            template="record.html",
            context={
                "heading": self.heading,
                "fixels": [{"name": name, "on": None} for name in self.fixels],
            },
            fill=lambda _: {
                "report": NOTHING | json.loads(self.view.report),
                "stopping": self.stop_wanted,
            },
            router=self._router(),
            views=(self.view,),
        )

    def _router(self) -> APIRouter:
        router: APIRouter = self.view.router()

        @router.post("/stop")
        def stop() -> JSONResponse:
            self._stop.set()
            self.view.repeat()  # a page fetched for it could arrive after a later status
            return JSONResponse({"stopping": True})

        return router


def overlay_page(view: LiveView, heading: str) -> Page:
    """Create the page for placing a part, with the outlines and errors in the live picture.

    The status of the view is a `fixel.workflows.acquisition.overlay.Look.summary()`.
    """
    return Page(
        path="/overlay",
        title="Placing",
        template="overlay.html",
        context={"heading": heading},
        fill=lambda _: {"report": NOTHING | json.loads(view.report)},
        router=view.router(),
        views=(view,),
    )
