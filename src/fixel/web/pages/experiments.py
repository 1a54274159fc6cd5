"""Page of all experiments: browse them, mark them, see the coverage."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/experiments`."""
    context = {"folder": shlex.quote(str(desk.folder))}
    return [
        Page(
            path="/experiments",
            title="Experiments",
            template="experiments.html",
            context=context,
            place=10,
        )
    ]
