"""Page on which scenes are made and simulated."""

from __future__ import annotations

from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from fastapi import Request

from fixel.database.query import ExperimentQuery
from fixel.web.app import Page
from fixel.web.views import scene_editor

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

OFFERED: Final = 300  # names in the list of experiments
FIRST: Final = "grasp"  # example that is shown first


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/simulate`, `/simulate?experiment=KEY`, `/simulate?example=NAME`."""

    def fill(request: Request) -> dict[str, Any]:
        # A simulation is likely to follow: its process should be ready by then.
        Thread(target=scene_editor.get_ready, name="fixel-beside", daemon=True).start()
        key = request.query_params.get("experiment", "")
        listed = desk.store.experiments(ExperimentQuery(limit=OFFERED)).rows
        return {
            "examples": scene_editor.examples(),
            "example": request.query_params.get("example", FIRST),
            "number": desk.store.find(key) if key else "",
            "key": key,
            "keys": [summary.key for summary in listed],
            "most_bytes": scene_editor.MAX_TEXT,
        }

    return [Page(path="/simulate", title="Simulate", template="simulate.html", fill=fill, place=50)]
