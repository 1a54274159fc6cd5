"""Pages and API of one project.

To add a page, put a module into `fixel.web.pages` with `pages(desk) -> list[Page]`. To add a
resource, put one into `fixel.web.api` with `router(desk) -> APIRouter`. Modules are found there
without any registration.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Any, Final, final

from fastapi import FastAPI

import fixel
from fixel.database.project import Project
from fixel.database.query import ExperimentQuery
from fixel.web import api as resources
from fixel.web import pages as shown
from fixel.web.app import Page
from fixel.web.problems import Refusal, tell_problems
from fixel.web.serve import HERE_ONLY, WebServer

ABOUT: Final = """Experiments, simulations, calibrations and domains of one project.

Lengths are in metres, angles in radians, times in seconds, unless a field's name ends with another
unit (`error_mm`). Long arrays are objects `{"dtype": "<f8", "shape": [n, 3], "base64": "..."}`:
little-endian, row after row. A refused request is answered with a status from 400 to 499 and a
`Refusal`.

Programs send `Authorization: Bearer TOKEN` with the token of the link that `fixel serve` printed.
"""


@final
class ProjectContext:
    """Project and store that its pages share.

    Parameters
    ----------
    project : Project

    Attributes
    ----------
    store : Store
        Records of the project, opened once; any thread may use it.
    """

    def __init__(self, project: Project) -> None:
        self.project = project
        self.store = project.store()
        # So that the first page does not wait for its statements.
        self.store.experiments(ExperimentQuery(include_faulty=True, limit=1), details=True)

    @property
    def name(self) -> str:
        """Name of the project."""
        return self.project.settings.name

    @property
    def folder(self) -> Path:
        """Absolute folder of the project, for commands that are typed elsewhere."""
        return self.project.folder.resolve()

    def close(self) -> None:
        """Close the store."""
        self.store.close()


def project_pages(desk: ProjectContext) -> list[Page]:
    """Return all pages, in the order of the navigation."""
    found = [page for module in _modules(shown) for page in module.pages(desk)]
    return sorted(found, key=lambda page: (not page.listed, page.place))


def project_api(desk: ProjectContext) -> FastAPI:
    """Create the API for programs, to be mounted."""
    api = FastAPI(
        title=f"fixel: {desk.name}",
        version=fixel.__version__,
        description=ABOUT,
        docs_url=None,  # these pages load scripts from elsewhere
        redoc_url=None,
        openapi_url="/openapi.json",
        responses={"4XX": {"model": Refusal}, 422: {"model": Refusal}},
    )
    for module in _modules(resources):
        api.include_router(module.router(desk))
    tell_problems(api)
    return api


def project_server(
    desk: ProjectContext, *, port: int | None = None, host: str = HERE_ONLY
) -> WebServer:
    """Create a server of the pages and the API, without starting it."""
    pages = project_pages(desk)
    return WebServer(pages, port=port, host=host, api=project_api(desk), name=desk.name)


def _modules(package: Any) -> list[Any]:
    names = sorted(entry.name for entry in pkgutil.iter_modules(package.__path__))
    return [
        import_module(f"{package.__name__}.{name}") for name in names if not name.startswith("_")
    ]
