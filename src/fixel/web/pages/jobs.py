"""Page of the jobs: queue, workers, losses, log."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/jobs`; the name of the chosen job follows `#`."""
    context = {"folder": shlex.quote(str(desk.folder))}
    return [Page(path="/jobs", title="Jobs", template="jobs.html", context=context, place=60)]
