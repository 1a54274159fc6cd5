"""Web application: pages for browsers and an API for programs, behind one gate."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import jinja2
from fastapi import APIRouter, FastAPI, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import fixel
from fixel.errors import FixelError, machine_failure
from fixel.web import security
from fixel.web.live import LiveView
from fixel.web.palette import palette_css
from fixel.web.problems import ABSENT, OUR_MISTAKE, Refusal, answer, problem_of
from fixel.web.values import FILTERS

HERE: Final = Path(str(files("fixel.web")))
API: Final = "/api/v1"
DOCS: Final = HERE.parents[2] / "build" / "docs"  # where `make docs` of a clone writes the site
# Its pages have scripts and styles in them, and load nothing from elsewhere either.
DOCS_POLICY: Final = (
    "default-src 'self' data: 'unsafe-inline'; object-src 'none'; base-uri 'none'; "
    "frame-ancestors 'none'"
)
# Former addresses of forms, and present ones.
MOVED: Final = {"/calibrations/new": "/run/calibrate", "/next": "/run/next"}
_log = logging.getLogger("fixel.web")


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Page of the interface, with its template, context and routes."""

    # `"/overlay"`, or `"/experiments/{number}"` for one page per record. Everything that the page
    # fetches is below it.
    path: str
    title: str  # in the list of pages and of the window
    template: str  # name in `templates`
    context: Mapping[str, Any] = field(default_factory=dict)  # in addition to title and pages
    # Returns the rest of the context for a request; a `title` in it names the window, a `status` is
    # that of the response. A `FixelError` that it raises becomes a page with the error.
    fill: Callable[[Request], Mapping[str, Any]] | None = None
    # Gets the fields of a posted form; returns the path to which the browser goes, or the context
    # of the same page, with `status` and errors.
    post: Callable[[Request, dict[str, list[str]]], str | Mapping[str, Any]] | None = None
    router: APIRouter | None = None  # routes below the path of the page
    views: tuple[LiveView, ...] = ()  # streams that must end when the server does
    place: int = 0  # in the navigation, from left to right
    listed: bool = True  # whether the navigation lists the page


def create_app(
    pages: Sequence[Page],
    gate: security.Gate,
    hosts: Sequence[str] = security.LOOPBACK,
    *,
    api: FastAPI | None = None,
    name: str = "",
    docs: Path = DOCS,
) -> FastAPI:
    """Create the application of at least one page; `/` leads to the first.

    A browser may address the server by one of the names in `hosts`. The API for programs is mounted
    at `API`. Every page has the name of the project, and a link to the folder `docs` of the
    documentation site if that was built.
    """
    # The pages need no OpenAPI document, and its viewer loads scripts from elsewhere.
    app = FastAPI(title="fixel", docs_url=None, redoc_url=None, openapi_url=None)
    app.mount("/static", StaticFiles(directory=HERE / "static"), name="static")
    has_docs = (docs / "index.html").exists()
    if has_docs:
        app.mount("/documentation", _Documentation(directory=docs), name="documentation")
    render = _renderer(pages, name, gate, has_docs)
    css = palette_css()

    @app.get("/")
    def home() -> RedirectResponse:
        return RedirectResponse(gate.root + pages[0].path, status_code=303)

    @app.get("/palette.css")
    def palette() -> Response:
        return Response(css, media_type="text/css")

    for old, new in MOVED.items():
        app.add_api_route(old, _moved(gate.root + new), response_class=RedirectResponse)
    for page in pages:
        app.add_api_route(page.path, _shown(page, render), response_class=HTMLResponse)
        if page.post is not None:
            route = _posted(page, render, gate.root)
            app.add_api_route(page.path, route, methods=["POST"], response_class=HTMLResponse)
        if page.router is not None:
            app.include_router(page.router, prefix=page.path)
        for view in page.views:
            view.markup = partial(_markup, page, render)
    if api is not None:
        app.mount(API, api)
    _answer_errors(app, render)

    app.add_middleware(internal_errors_answered)  # innermost
    app.add_middleware(security.body_limited)
    app.add_middleware(security.Guard, gate=gate)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)
    app.add_middleware(security.headers_added)
    return app


def internal_errors_answered(app: ASGIApp) -> ASGIApp:
    """Log unexpected exceptions of an application, and answer with a one-sentence 500."""

    async def answered_app(scope: Scope, receive: Receive, send: Send) -> None:
        answered = False

        async def noted(message: Message) -> None:
            nonlocal answered
            answered = True
            await send(message)

        try:
            await app(scope, receive, noted)
        except Exception:
            _log.exception("%s %s", scope.get("method", ""), scope.get("path", ""))
            if not answered:
                await PlainTextResponse(f"{OUR_MISTAKE}\n", status_code=500)(scope, receive, send)

    return answered_app


class _Documentation(StaticFiles):
    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers["content-security-policy"] = DOCS_POLICY
        return response


def _renderer(pages: Sequence[Page], name: str, gate: security.Gate, has_docs: bool) -> Any:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(FILTERS)
    common = {
        "pages": sorted((page for page in pages if page.listed), key=lambda page: page.place),
        "project": name,
        "has_docs": has_docs,
        "root": gate.root,
        "word": gate.word,
        "version": fixel.__version__,
    }

    def render(page: Page, more: Mapping[str, Any], path: str) -> str:
        context = {"title": page.title, "path": path, **common, **page.context, **more}
        return environment.get_template(page.template).render(page=page, **context)

    return render


def _moved(address: str) -> Any:
    def lead(request: Request) -> RedirectResponse:
        given = request.query_params
        fields = [("experiments", one) for one in given.get("experiments", "").split(",") if one]
        fields += [("where", given["filter"])] if given.get("filter") else []
        query = f"?{urlencode(fields)}" if fields else ""
        return RedirectResponse(address + query, status_code=303)

    return lead


def _shown(page: Page, render: Any) -> Any:
    def show(request: Request) -> HTMLResponse:
        more = {} if page.fill is None else page.fill(request)
        return HTMLResponse(render(page, more, request.url.path), more.get("status", 200))

    return show


def _markup(page: Page, render: Any) -> str:
    """Return a page that depends on no request."""
    more = {} if page.fill is None else page.fill(Request({"type": "http"}))
    return str(render(page, more, page.path))


def _posted(page: Page, render: Any, root: str) -> Any:
    async def take(request: Request) -> Response:
        assert page.post is not None
        fields = security.form_fields(await request.body())
        fields.pop(security.WORD_FIELD, None)
        done = await run_in_threadpool(page.post, request, fields)
        if isinstance(done, str):
            return RedirectResponse(root + done, status_code=303)
        return HTMLResponse(render(page, done, request.url.path), status_code=done["status"])

    return take


def _answer_errors(app: FastAPI, render: Any) -> None:
    """Answer errors with a page that explains them."""
    page = Page(path="", title="Page not found", template="problem.html", listed=False)

    @app.exception_handler(FixelError)
    def refused(request: Request, error: FixelError) -> Response:
        problem = problem_of(error)
        title = page.title if problem.status == ABSENT else "The page cannot be shown"
        more = {"title": title, "sentence": problem.sentence, "hint": ""}  # the sentence has it
        return HTMLResponse(render(page, more, request.url.path), status_code=problem.status)

    @app.exception_handler(OSError)
    def of_the_machine(request: Request, error: OSError) -> Response:
        if (failure := machine_failure(error)) is None:
            raise error
        return refused(request, failure)

    @app.exception_handler(HTTPException)
    def missing(request: Request, error: HTTPException) -> Response:
        if request.url.path.startswith("/api/"):  # with characters that the API's paths never have
            problem = Refusal(status=error.status_code, sentence=f"{error.detail}.")
            return answer(problem, dict(error.headers or {}))
        more = {"sentence": f"{error.detail}.", "hint": "Use the navigation at the top."}
        return HTMLResponse(
            render(page, more, request.url.path),
            status_code=error.status_code,
            headers=error.headers,
        )
