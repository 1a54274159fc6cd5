"""Web interface of one project: its pages, and its API for programs.

To add a page, put it into `project_pages` (`fixel.web.pages.site`). To add a resource, put a
module with a `router` into `fixel.web.api`, and add it to `ROUTERS`.
"""

from __future__ import annotations

import threading
from typing import Final

from fastapi import APIRouter, Depends, FastAPI

import fixel
from fixel.web.api import analyses, calibration, changes, compare, experiments, jobs, scenes, system
from fixel.web.context import ProjectContext
from fixel.web.pages.site import project_pages
from fixel.web.problems import Refusal, answer_errors, refuse_unknown_query
from fixel.web.serve import HERE_ONLY, WebServer
from fixel.web.views.live_comparison import warm_up

ROUTERS: Final = (
    *(jobs.runs, analyses.plans, analyses.maps, analyses.router, calibration.router),
    *(changes.router, compare.router, experiments.router, jobs.router, scenes.router),
    system.router,
)
# Shared by all projects of a process: FastAPI reads them for 50 ms when they are first used.
ROUTES: Final = APIRouter(responses={"4XX": {"model": Refusal}, 422: {"model": Refusal}})
for _router in ROUTERS:
    ROUTES.include_router(_router, dependencies=[Depends(refuse_unknown_query)])

ABOUT: Final = """Experiments, simulations, calibrations and domains of one project.

Lengths are in metres, angles in radians, times in seconds, unless a field's name ends with another
unit (`error_mm`). Long arrays are objects `{"dtype": "<f8", "shape": [n, 3], "base64": "..."}`:
little-endian, row after row. A refused request is answered with a status from 400 to 499 and a
`Refusal`.

Programs send `Authorization: Bearer TOKEN` with the token of the link that `fixel serve` printed.
"""


def project_api(context: ProjectContext) -> FastAPI:
    """Create the API for programs, to be mounted."""
    # The viewers of the document load scripts from elsewhere.
    api = FastAPI(
        title=f"fixel: {context.name}", version=fixel.__version__, description=ABOUT,
        docs_url=None, redoc_url=None,
    )  # fmt: skip
    api.state.context = context
    api.router.routes += ROUTES.routes
    answer_errors(api)
    threading.Thread(target=warm_up, name="fixel-warm-up", daemon=True).start()
    return api


def project_server(
    context: ProjectContext, *, port: int | None = None, host: str = HERE_ONLY
) -> WebServer:
    """Create a server of the pages and the API, without starting it."""
    pages = project_pages(context)
    return WebServer(pages, port=port, host=host, api=project_api(context), name=context.name)
