"""Page of the domain of applicability, and of the other stored analyses."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from fastapi import Request

from fixel.web.app import Page
from fixel.workflows.analysis import kept_and_not

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/domain?map=NAME`; by default with the newest map."""

    def fill(request: Request) -> dict[str, Any]:
        every, unreadable = kept_and_not(desk.project)
        maps = [one for one in every if one.analysis.kind == "domain"]
        wanted = request.query_params.get("map", "")
        chosen = next((one for one in maps if one.folder.name == wanted), None)
        chosen = chosen or (maps[0] if maps else None)
        return {
            "name": "" if chosen is None else chosen.folder.name,
            "chosen": None if chosen is None else chosen.analysis,
            "maps": [(one.folder.name, one.analysis) for one in maps],
            "others": [(one.folder.name, one.analysis) for one in every if one not in maps],
            "unreadable": [str(problem) for problem in unreadable],
            "folder": shlex.quote(str(desk.folder)),
        }

    return [Page(path="/domain", title="Domain", template="domain.html", fill=fill, place=40)]
