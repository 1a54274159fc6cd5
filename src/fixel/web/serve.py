"""The server: a thread beside the program whose pictures it shows."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from typing import Final, final

import uvicorn

from fixel.errors import InvalidInput
from fixel.web.app import Page, create_app
from fixel.web.security import LOOPBACK, Gate

HERE_ONLY: Final = "127.0.0.1"
STARTS_WITHIN: Final = 10.0  # [s]
ENDS_WITHIN: Final = 1  # [s] for answers to browsers that do not read
# What lies in the socket is late: about three pictures, or a slow browser lags by seconds.
SEND_BUFFER: Final = 256 * 1024  # [byte]


@final
class WebServer:
    """Pages on a port of this machine.

    Parameters
    ----------
    pages : sequence of Page
    port : int, optional
        Left out, any that is free.
    host : str
        Address to listen on. Any but this machine's own lets others in who know the link, which
        then travels in the clear.

    Raises
    ------
    InvalidInput
        A port that another program uses, or that only the administrator may.

    Examples
    --------
    >>> from fixel.web.live import LiveView
    >>> from fixel.web.overlay_page import overlay_page
    >>> with WebServer([overlay_page(LiveView(), "a title")]) as server:
    ...     print(server.link.partition("token")[0].rpartition(":")[0])
    http://127.0.0.1
    """

    def __init__(
        self, pages: Sequence[Page], *, port: int | None = None, host: str = HERE_ONLY
    ) -> None:
        self.gate = Gate()
        self._pages = tuple(pages)
        self._socket = _listening(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        hosts = LOOPBACK if host == HERE_ONLY else (*LOOPBACK, host)
        config = uvicorn.Config(
            create_app(self._pages, self.gate, hosts),
            http="h11",
            ws="none",
            loop="asyncio",
            lifespan="off",
            access_log=False,  # it would hold the token
            log_config=None,
            log_level="critical",
            proxy_headers=False,
            server_header=False,
            limit_concurrency=64,
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
        """Where the pages are, without the token."""
        return f"http://{self.host}:{self.port}/"

    @property
    def link(self) -> str:
        """The link that opens the pages."""
        return f"{self.address}?token={self.gate.token}"

    def start(self) -> WebServer:
        """Serve from now on, in a thread."""
        self._thread.start()
        if not self._server.ready.wait(STARTS_WITHIN):
            raise RuntimeError(f"the web server did not start within {STARTS_WITHIN:g} s")
        return self

    def stop(self) -> None:
        """End, open streams too, within a second or two."""
        for page in self._pages:
            for view in page.views:
                view.close()
        self._server.should_exit = True
        if self._thread.ident is not None:
            self._thread.join()
        self._socket.close()

    def __enter__(self) -> WebServer:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()


@final
class _Server(uvicorn.Server):
    """Tells when it is ready."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.ready = threading.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.ready.set()


def _listening(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        listening.bind((host, port or 0))
    except OSError as problem:
        listening.close()
        raise InvalidInput(
            "--port",
            found=f"{port} of {host}: {(problem.strerror or str(problem)).lower()}",
            expected="a free port from 1024 to 65535",
            hint="leave --port out and any free one is taken",
        ) from None
    return listening
