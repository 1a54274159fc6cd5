"""Page for placing a part by hand."""

from __future__ import annotations

import json
from typing import Final

from fixel.web.app import Page
from fixel.web.live import LiveView

# Before the first picture.
NOTHING: Final[dict[str, list[str]]] = {"parts": [], "problems": [], "remarks": []}


def overlay_page(view: LiveView, heading: str) -> Page:
    """Create the page with the live picture, its outlines and the errors of the part.

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
