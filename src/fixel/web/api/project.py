"""Facts about the project itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastapi import APIRouter
from pydantic import BaseModel, Field

import fixel

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext


class ProjectOut(BaseModel):
    """Project that is served."""

    name: str
    version: str = Field(description="of fixel")
    datasets: dict[str, int] = Field(description="how many experiments each has")
    flags: dict[str, int] = Field(description="how many experiments carry each")


def router(desk: ProjectContext) -> APIRouter:
    """Routes of `/project`."""
    found = APIRouter(tags=["project"])

    @found.get("/project", summary="What is served here")
    def project() -> ProjectOut:
        return ProjectOut(
            name=desk.name,
            version=fixel.__version__,
            datasets=desk.store.datasets(),
            flags=desk.store.flags(),
        )

    return found
