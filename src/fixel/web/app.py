"""The web application: pages, and what programs ask for, behind one gate."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, final

import jinja2
from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import fixel
from fixel.errors import FixelError
from fixel.web.live import LiveView
from fixel.web.palette import palette_css
from fixel.web.problems import OUR_MISTAKE, Refusal, answer, problem_of
from fixel.web.security import LOOPBACK, BodyLimit, Gate, Guard, SecurityHeaders

HERE: Final = Path(str(files("fixel.web")))
API: Final = "/api/v1"
_log = logging.getLogger("fixel.web")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """One page of the interface, and what it needs of the server.

    Parameters
    ----------
    path : str
        Where it is: `"/overlay"`, or `"/experiments/{number}"` for one page a thing. Everything it
        fetches is below.
    title : str
        In the list of pages and in the window's title.
    template : str
        Its name in `templates`.
    context : mapping
        What the template is told besides title and pages.
    fill : callable, optional
        Told the request, gives the rest of the context; a `title` in it names the window. What it
        raises of `FixelError` becomes a page that says so.
    router : APIRouter, optional
        What is below its path.
    views : tuple of LiveView
        Streams that must end when the server does.
    place : int
        Among the pages in the navigation, from left to right.
    listed : bool
        Whether the navigation names it.
    """

    path: str
    title: str
    template: str
    context: Mapping[str, Any] = field(default_factory=dict)
    fill: Callable[[Request], Mapping[str, Any]] | None = None
    router: APIRouter | None = None
    views: tuple[LiveView, ...] = ()
    place: int = 0
    listed: bool = True


def create_app(
    pages: Sequence[Page],
    gate: Gate,
    hosts: Sequence[str] = LOOPBACK,
    *,
    api: FastAPI | None = None,
    name: str = "",
) -> FastAPI:
    """The application.

    Parameters
    ----------
    pages : sequence of Page
        At least one; `/` leads to the first.
    gate : Gate
    hosts : sequence of str
        Names by which a browser may call the server.
    api : FastAPI, optional
        What programs ask for, below `API`.
    name : str
        Of the project, for all pages.
    """
    # The address book of the pages is for nobody, and its page loads scripts from elsewhere.
    app = FastAPI(title="fixel", docs_url=None, redoc_url=None, openapi_url=None)
    app.mount("/static", StaticFiles(directory=HERE / "static"), name="static")
    render = _renderer(pages, name, gate)
    css = palette_css()

    @app.get("/")
    def home() -> RedirectResponse:
        return RedirectResponse(gate.root + pages[0].path, status_code=303)

    @app.get("/palette.css")
    def palette() -> Response:
        return Response(css, media_type="text/css")

    for page in pages:
        app.add_api_route(page.path, _shown(page, render), response_class=HTMLResponse)
        if page.router is not None:
            app.include_router(page.router, prefix=page.path)
    if api is not None:
        app.mount(API, api)
    _tell_problems(app, render)

    app.add_middleware(Unforeseen)  # innermost
    app.add_middleware(BodyLimit)
    app.add_middleware(Guard, gate=gate)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)
    app.add_middleware(SecurityHeaders)
    return app


class Unforeseen:
    """Mistakes of ours: told to whoever started fixel, and in one sentence to who asked."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answered = False

        async def noted(message: Message) -> None:
            nonlocal answered
            answered = True
            await send(message)

        try:
            await self.app(scope, receive, noted)
        except Exception:
            _log.exception("%s %s", scope.get("method", ""), scope.get("path", ""))
            if not answered:
                await PlainTextResponse(f"{OUR_MISTAKE}\n", status_code=500)(scope, receive, send)


def _renderer(pages: Sequence[Page], name: str, gate: Gate) -> Any:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    common = {
        "pages": sorted((page for page in pages if page.listed), key=lambda page: page.place),
        "project": name,
        "root": gate.root,
        "word": gate.word,
        "version": fixel.__version__,
    }

    def render(page: Page, more: Mapping[str, Any], path: str) -> str:
        context = {"title": page.title, "path": path, **common, **page.context, **more}
        return environment.get_template(page.template).render(page=page, **context)

    return render


def _shown(page: Page, render: Any) -> Any:
    def show(request: Request) -> HTMLResponse:
        more = {} if page.fill is None else page.fill(request)
        return HTMLResponse(render(page, more, request.url.path))

    return show


def _tell_problems(app: FastAPI, render: Any) -> None:
    """A page for a person where something is not there or cannot be."""
    page = Page(path="", title="Not here", template="problem.html", listed=False)

    @app.exception_handler(FixelError)
    def refused(request: Request, error: FixelError) -> Response:
        problem = problem_of(error)
        more = {"sentence": problem.sentence, "hint": problem.hint}
        return HTMLResponse(render(page, more, request.url.path), status_code=problem.status)

    @app.exception_handler(HTTPException)
    def missing(request: Request, error: HTTPException) -> Response:
        if request.url.path.startswith("/api/"):  # with characters that no address of it has
            problem = Refusal(status=error.status_code, sentence=f"{error.detail}.")
            return answer(problem, dict(error.headers or {}))
        more = {"sentence": f"{error.detail}.", "hint": "The navigation leads to what there is."}
        return HTMLResponse(
            render(page, more, request.url.path),
            status_code=error.status_code,
            headers=error.headers,
        )
