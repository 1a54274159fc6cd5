"""The page on which a person places a part."""

from __future__ import annotations

from fixel.web.app import Page
from fixel.web.live import LiveView


def overlay_page(view: LiveView, heading: str, path: str = "/overlay") -> Page:
    """The live picture with outlines, and how far the part is from its place.

    Parameters
    ----------
    view : LiveView
        Its status is a `fixel.workflows.acquisition.overlay_check.Look.summary()`.
    heading : str
        What is to be placed, from which scene.
    path : str
    """
    return Page(
        path=path,
        title="Placing",
        template="overlay.html",
        context={"heading": heading},
        router=view.router(),
        views=(view,),
    )
