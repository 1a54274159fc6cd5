"""The web application: pages, behind one gate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, final

import jinja2
from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, RedirectResponse
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

import fixel
from fixel.web.live import LiveView
from fixel.web.security import LOOPBACK, Gate, Guard, SecurityHeaders

HERE: Final = Path(str(files("fixel.web")))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """One page of the interface, and what it needs of the server.

    Parameters
    ----------
    path : str
        Where it is: `"/overlay"`. Everything it fetches is below.
    title : str
        In the list of pages and in the window's title.
    template : str
        Its name in `templates`.
    context : dict
        What the template is told besides title and pages.
    router : APIRouter, optional
        What is below its path.
    views : tuple of LiveView
        Streams that must end when the server does.
    """

    path: str
    title: str
    template: str
    context: dict[str, Any]
    router: APIRouter | None = None
    views: tuple[LiveView, ...] = ()


def create_app(pages: Sequence[Page], gate: Gate, hosts: Sequence[str] = LOOPBACK) -> FastAPI:
    """The application.

    Parameters
    ----------
    pages : sequence of Page
        At least one; `/` leads to the first.
    gate : Gate
    hosts : sequence of str
        Names by which a browser may call the server.
    """
    # The address book of an API is for nobody here, and its page loads scripts from elsewhere.
    app = FastAPI(title="fixel", docs_url=None, redoc_url=None, openapi_url=None)
    app.mount("/static", StaticFiles(directory=HERE / "static"), name="static")
    render = _renderer(pages, gate)

    @app.get("/")
    def home() -> RedirectResponse:
        return RedirectResponse(pages[0].path, status_code=303)

    for page in pages:
        app.add_api_route(page.path, _shown(page, render), response_class=HTMLResponse)
        if page.router is not None:
            app.include_router(page.router, prefix=page.path)

    app.add_middleware(Guard, gate=gate)  # innermost
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)
    app.add_middleware(SecurityHeaders)
    return app


def _renderer(pages: Sequence[Page], gate: Gate) -> Any:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    common = {"pages": pages, "word": gate.word, "version": fixel.__version__}

    def render(page: Page) -> str:
        return environment.get_template(page.template).render(page=page, **common, **page.context)

    return render


def _shown(page: Page, render: Any) -> Any:
    def show() -> HTMLResponse:
        return HTMLResponse(render(page))

    return show
