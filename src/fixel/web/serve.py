"""Web server in a thread of the program whose pictures it shows."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Sequence
from typing import Final

import uvicorn
from fastapi import FastAPI

from fixel.errors import InvalidInput, os_reason
from fixel.web.app import Page, create_app
from fixel.web.security import LOOPBACK, Gate

HERE_ONLY: Final = "127.0.0.1"
EVERYWHERE: Final = ("0.0.0.0", "::")
CONNECTIONS: Final = 512  # a browser uses six, and an open page one more
# [s] Longer than browsers use an idle connection: a request that meets its end gets no answer.
IDLE: Final = 600
STARTS_WITHIN: Final = 10.0  # [s]
ENDS_WITHIN: Final = 1  # [s] for answers to browsers that do not read
# Data that waits in the socket is late: about three pictures, or a slow browser lags by seconds.
SEND_BUFFER: Final = 256 * 1024  # [byte]


class WebServer:
    """Server of pages, and of an API for programs, on a port of this machine.

    The port is any free one by default. An address other than this machine's own admits others who
    know the link, which is then sent unencrypted. `name` is that of the project. A port that
    another program uses, or that is reserved for the administrator, raises `InvalidInput`.

    Examples
    --------
    >>> from fixel.web.live import LiveView
    >>> from fixel.web.live_pages import overlay_page
    >>> with WebServer([overlay_page(LiveView(), "a title")]) as server:
    ...     print(server.link.partition("token")[0].rpartition(":")[0])
    http://127.0.0.1
    """

    def __init__(
        self,
        pages: Sequence[Page],
        *,
        port: int | None = None,
        host: str = HERE_ONLY,
        api: FastAPI | None = None,
        name: str = "",
    ) -> None:
        self.gate = Gate()
        self._pages = tuple(pages)
        self._socket = _listening(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        config = uvicorn.Config(
            create_app(self._pages, self.gate, _names(host), api=api, name=name),
            http="h11",
            ws="none",
            loop="asyncio",
            lifespan="off",
            access_log=False,  # it would contain the token
            log_config=None,
            log_level="critical",
            proxy_headers=False,
            server_header=False,
            limit_concurrency=CONNECTIONS,
            timeout_keep_alive=IDLE,
            timeout_graceful_shutdown=ENDS_WITHIN,
        )
        self._server = _Server(config)
        self._thread = threading.Thread(
            target=self._server.run,
            kwargs={"sockets": [self._socket]},
            name="fixel-web",
            daemon=True,
        )

    @property
    def address(self) -> str:
        """Base address for programs, which send the token in a header."""
        name = socket.gethostname() if self.host in EVERYWHERE else self.host
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    @property
    def home(self) -> str:
        """Address of the pages for a browser that has opened the link."""
        return f"{self.address}{self.gate.prefix}/"

    @property
    def link(self) -> str:
        """Link that opens the pages."""
        return f"{self.address}?token={self.gate.token}"

    def start(self) -> WebServer:
        """Start serving, in a thread."""
        self._thread.start()
        if not self._server.ready.wait(STARTS_WITHIN):
            raise RuntimeError(f"the web server did not start within {STARTS_WITHIN:g} s")
        return self

    def stop(self) -> None:
        """Stop the server and its open streams, within a second or two."""
        for page in self._pages:
            for view in page.views:
                view.close()
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._socket.close()

    def wait(self) -> None:
        """Wait until the server ends by itself, or the program is interrupted."""
        while self._thread.is_alive():
            time.sleep(0.2)  # an interrupted `join` counts the thread as ended (bpo-45274)

    @property
    def busy(self) -> bool:
        """Whether threads of the server still compute after its end."""
        return any("AnyIO" in thread.name for thread in threading.enumerate())

    def __enter__(self) -> WebServer:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()


class _Server(uvicorn.Server):
    """Server that signals when it is ready, and ends with no connection open."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = threading.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.ready.set()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await super().shutdown(sockets)
        for connection in list(self.server_state.connections):
            # The browser has stopped reading: data sent to it would wait without end.
            transport = getattr(connection, "transport", None)
            if transport is not None:
                transport.abort()
        await asyncio.sleep(0.01)  # lets the loop close them


def _names(host: str) -> tuple[str, ...]:
    """Names by which a browser may address the server."""
    if host in EVERYWHERE:
        name = socket.gethostname()
        try:
            found = socket.getaddrinfo(name, None, family=socket.AF_INET)
        except OSError:  # a machine that does not know its own name
            found = []
        return (*LOOPBACK, name, *sorted({str(entry[4][0]) for entry in found}))
    return LOOPBACK if host == HERE_ONLY else (*LOOPBACK, f"[{host}]" if ":" in host else host)


def _listening(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        listening.bind((host, port or 0))
    except OSError as problem:
        listening.close()
        found = f"{port} of {host} in use ({os_reason(problem)})"
        expected = "a free port from 1024 to 65535"
        hint = "without --port, any free port is used"
        raise InvalidInput("--port", found=found, expected=expected, hint=hint) from None
    return listening
