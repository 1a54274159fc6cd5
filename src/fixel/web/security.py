"""Access control of the web server: a link with a token, cookies, headers.

The server listens on this machine only, but every program of the machine can reach it, and so can
the pages of any site that is open in the browser. A page therefore opens only with the token of
the link. The token is exchanged for a cookie and a secret first part of all paths. Cookies ignore
ports: a browser sends those of this server to every other server of this machine, but only with
their own path, which no other server knows. Requests must name the server as the link does, or a
foreign name could be made to point here (DNS rebinding). Requests that change something need a
word that only our own pages know (CSRF): scripts send it in a header, forms in a hidden field.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import parse_qs, parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fixel.web.problems import Refusal, answer

LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
WORD_HEADER: Final = "x-fixel-word"  # header with the word of our own pages
WORD_FIELD: Final = "fixel-word"  # field of our own forms with the same word
FORM: Final = "application/x-www-form-urlencoded"
MAX_FORM: Final = 64 * 1024  # [byte] largest body of a form
MAX_FIELDS: Final = 500
SAFE_METHODS: Final = ("GET", "HEAD", "OPTIONS")
MAX_BODY: Final = 2 * 1024 * 1024  # [byte] largest body of a request

HEADERS: Final = {
    # All content comes from here, and no script or style is written into a page.
    "content-security-policy": "default-src 'none'; img-src 'self' data:; style-src 'self'; "
    "script-src 'self'; connect-src 'self'; media-src 'self'; form-action 'self'; base-uri 'none'; "
    "frame-ancestors 'none'",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=()",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


def _secret() -> str:
    return secrets.token_urlsafe(32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """Secrets of one running server."""

    # In the link that opens the pages, and in the header of programs.
    token: str = field(default_factory=_secret, repr=False)
    session: str = field(default_factory=_secret, repr=False)  # in the cookie, for the link
    # First part of the path of every page; the cookie is sent with no other path.
    prefix: str = field(default_factory=lambda: secrets.token_urlsafe(16), repr=False)
    # In our own pages, sent back with every request that changes something.
    word: str = field(default_factory=_secret, repr=False)
    # Name of the cookie, as all servers of a machine share their cookies.
    cookie: str = field(default_factory=lambda: f"fixel-{secrets.token_hex(4)}")

    @property
    def root(self) -> str:
        """Path below which browsers find the pages."""
        return f"/{self.prefix}"

    def inside(self, path: str) -> str | None:
        """Return a path without the prefix; None if it does not begin with the prefix."""
        first, _, rest = path.removeprefix("/").partition("/")
        return f"/{rest}" if _same(first, self.prefix) else None

    def opens(self, headers: Headers) -> bool:
        """Whether a request carries the cookie."""
        # As lenient as browsers: cookies left by other servers of this machine may be malformed.
        cookies = cookie_parser(headers.get("cookie", ""))
        return _same(cookies.get(self.cookie, ""), self.session)

    def admits(self, headers: Headers) -> bool:
        """Whether a request that changes something comes from one of our own pages."""
        return at_home(headers) and self.says(headers.get(WORD_HEADER, ""))

    def says(self, word: str) -> bool:
        """Whether a word is that of our own pages."""
        return _same(word, self.word)

    def knows(self, headers: Headers) -> bool:
        """Whether a program sent the token: `Authorization: Bearer TOKEN`."""
        kind, _, token = headers.get("authorization", "").partition(" ")
        return kind.lower() == "bearer" and _same(token.strip(), self.token) and at_home(headers)


def at_home(headers: Headers, *, safe: bool = False) -> bool:
    """Whether a request comes from no page at all, or from one of this server.

    A page of another port of this machine is of the same *site*, but not ours. A link on it may be
    followed, by a `safe` method only: what a link opens changes nothing, and no other page can read
    it. A form on it may not be sent.
    """
    origin = headers.get("origin")
    site = headers.get("sec-fetch-site", "none")  # older browsers, and programs, do not send it
    # As our pages send no referrer, browsers do not state the origin of their forms either.
    ours = (None, f"http://{headers.get('host', '')}", *(["null"] * (site == "same-origin")))
    if origin not in ours:
        return False
    if site in ("none", "same-origin"):
        return True
    navigation = (headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest"))
    return safe and navigation == ("navigate", "document")


def headers_added(app: ASGIApp) -> ASGIApp:
    """Return an application that adds `HEADERS` to every answer of another."""

    async def with_all(scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await app(scope, receive, with_headers)

    return with_all


class Guard:
    """Middleware that admits requests with cookie and prefix; exchanges the token for both.

    It removes the prefix from the paths of requests that it admits.
    """

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self.app = app
        self.gate = gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        path = self.gate.inside(scope["path"])
        inner = {**scope, "path": scope["path"] if path is None else path}
        refused = self._refused(inner, path is not None)
        if refused is None and _is_form(inner):
            body = await _body(receive)
            words = form_fields(body).get(WORD_FIELD, [])
            if len(words) != 1 or not self.gate.says(words[0]):
                refused = _refusal(inner, 403, NOT_OURS)
            receive = _again(body)
        await (refused or self.app)(inner, receive, send)

    def _refused(self, scope: Scope, knows_prefix: bool) -> Response | None:
        if scope["type"] != "http":
            return PlainTextResponse("Not found", status_code=404)
        headers, query = Headers(scope=scope), parse_qsl(scope["query_string"].decode("latin-1"))
        safe = scope["method"] in SAFE_METHODS
        tokens = [value for name, value in query if name == "token"]
        if safe and len(tokens) == 1 and _same(tokens[0], self.gate.token):
            return self._let_in(scope["path"], [pair for pair in query if pair[0] != "token"])
        if "authorization" in headers:
            return None if self.gate.knows(headers) else _refusal(scope, 401, WRONG_TOKEN)
        # The cookie alone is not enough: it may have come from anywhere.
        if not (knows_prefix and self.gate.opens(headers)):
            return _refusal(scope, 403, NO_COOKIE)
        ours = at_home(headers, safe=safe)
        if not ours or not (safe or self.gate.admits(headers) or _is_form(scope)):
            return _refusal(scope, 403, NOT_OURS)
        return None

    def _let_in(self, path: str, query: list[tuple[str, str]]) -> Response:
        address = self.gate.root + path + (f"?{urlencode(query)}" if query else "")
        response = RedirectResponse(address, status_code=303)
        response.set_cookie(
            self.gate.cookie, self.gate.session, httponly=True, samesite="lax", path=self.gate.root
        )
        return response


def form_fields(body: bytes) -> dict[str, list[str]]:
    """Return the fields of a form with their texts; none if it cannot be read."""
    try:
        return parse_qs(body.decode(), max_num_fields=MAX_FIELDS, errors="strict")
    except ValueError:
        return {}


def _is_form(scope: Scope) -> bool:
    """Whether a request is a form that a page posts without a script."""
    headers = Headers(scope=scope)
    kind = headers.get("content-type", "").partition(";")[0].strip().lower()
    return scope["method"] == "POST" and kind == FORM and WORD_HEADER not in headers


async def _body(receive: Receive) -> bytes:
    """Return the body of a form; empty if it is too large."""
    body, more = b"", True
    while more and len(body) <= MAX_FORM:
        message = await receive()
        body += message.get("body", b"")
        more = message.get("more_body", False)
    return body if len(body) <= MAX_FORM else b""


def _again(body: bytes) -> Receive:
    """Return a channel that a body is received from once more."""
    messages = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Message:
        return messages.pop() if messages else {"type": "http.disconnect"}

    return receive


def body_limited(app: ASGIApp) -> ASGIApp:
    """Return an application that rejects requests with a body longer than `MAX_BODY`."""

    async def limited(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await app(scope, receive, send)
            return
        said = Headers(scope=scope).get("content-length", "0")
        if not said.isdecimal() or int(said) > MAX_BODY:
            await _refusal(scope, 413, TOO_LONG)(scope, receive, send)
            return
        had = 0

        async def counted() -> Message:
            nonlocal had
            message = await receive()
            had += len(message.get("body", b""))
            # Without a declared length the end is cut off, so that the body cannot be parsed.
            return message if had <= MAX_BODY else {"type": "http.disconnect"}

        await app(scope, counted, send)

    return limited


NO_COOKIE: Final = (
    "Open this page with the link that fixel printed when it started.",
    "If fixel was restarted, use the new link. Programs send the header: Authorization: Bearer "
    "TOKEN",
)
NOT_OURS: Final = (
    "Only pages served by fixel may send this request.",
    "Reload the page and try again.",
)
WRONG_TOKEN: Final = (
    "The token does not belong to this server.",
    "Use the token in the link that fixel printed when it started, after token=",
)
TOO_LONG: Final = ("The request is too large.", f"The limit is {MAX_BODY // 1024**2} MB.")


def _refusal(scope: Scope, status: int, words: tuple[str, str]) -> Response:
    sentence, hint = words
    headers = {"www-authenticate": "Bearer"} if status == 401 else None
    if scope.get("path", "").startswith("/api/"):
        problem = Refusal(status=status, sentence=f"{sentence} {hint}", hint=hint)
        return answer(problem, headers)
    return PlainTextResponse(f"{sentence} {hint}\n", status_code=status, headers=headers)


def _same(given: str, wanted: str) -> bool:
    return secrets.compare_digest(given.encode(), wanted.encode())
