"""Work that takes long: the queue, who computes, what was lost, the log."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """`/jobs`; the name of the chosen job stands behind `#`."""
    context = {"folder": shlex.quote(str(desk.folder))}
    return [Page(path="/jobs", title="Jobs", template="jobs.html", context=context, place=60)]
