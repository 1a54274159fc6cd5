"""Web interface of one project: its pages, and its API for programs.

To add a page, put it into `project_pages` (`fixel.web.pages.site`). To add a resource, put a
module with a `router` into `fixel.web.api`, and add it to `ROUTERS`.
"""

from __future__ import annotations

import threading
from typing import Final

from fastapi import Depends, FastAPI

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

ABOUT: Final = """Experiments, simulations, calibrations and domains of one project.

Lengths are in metres, angles in radians, times in seconds, unless a field's name ends with another
unit (`error_mm`). Long arrays are objects `{"dtype": "<f8", "shape": [n, 3], "base64": "..."}`:
little-endian, row after row. A refused request is answered with a status from 400 to 499 and a
`Refusal`.

Programs send `Authorization: Bearer TOKEN` with the token of the link that `fixel serve` printed.
"""


def project_api(context: ProjectContext) -> FastAPI:
    """Create the API for programs, to be mounted."""
    api = FastAPI(
        title=f"fixel: {context.name}",
        version=fixel.__version__,
        description=ABOUT,
        docs_url=None,  # these pages load scripts from elsewhere
        redoc_url=None,
        openapi_url="/openapi.json",
        responses={"4XX": {"model": Refusal}, 422: {"model": Refusal}},
    )
    api.state.context = context
    for router in ROUTERS:
        api.include_router(router, dependencies=[Depends(refuse_unknown_query)])
    answer_errors(api)
    threading.Thread(target=warm_up, name="fixel-warm-up", daemon=True).start()
    return api


def project_server(
    context: ProjectContext, *, port: int | None = None, host: str = HERE_ONLY
) -> WebServer:
    """Create a server of the pages and the API, without starting it."""
    pages = project_pages(context)
    return WebServer(pages, port=port, host=host, api=project_api(context), name=context.name)
