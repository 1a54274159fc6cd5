"""All experiments: look through them, mark them, see what has been run."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


def pages(desk: ProjectContext) -> list[Page]:
    """`/experiments`."""
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
