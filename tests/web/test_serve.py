"""The server as a program runs it: a thread, a free port, and an end at once."""

import http.client
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.web.live import LiveView
from fixel.web.live_pages import overlay_page
from fixel.web.serve import WebServer


@pytest.fixture
def view():
    return LiveView()


@pytest.fixture
def server(view):
    with WebServer([overlay_page(view, "a scene")]) as server:
        yield server


def connected(server, path):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    cookie = f"{server.gate.cookie}={server.gate.session}"
    connection.request("GET", server.gate.root + path, headers={"Cookie": cookie})
    return connection, connection.getresponse()


@pytest.mark.system
def test_a_server_starts_without_the_distributions_of_scipy():
    """The distributions of SciPy took a quarter of the time until the link is there."""
    code = "import sys, fixel.web.project; assert 'scipy.stats' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_link_opens_the_page(server):
    jar = urllib.request.HTTPCookieProcessor()
    with urllib.request.build_opener(jar).open(server.link, timeout=60) as answer:
        assert answer.url == f"{server.home}overlay"
        assert b"a scene" in answer.read()
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(server.home, timeout=60)


def test_an_idle_connection_stays_open_for_the_next_request(server):
    connection, answer = connected(server, "/palette.css")
    answer.read()
    time.sleep(5.5)  # longer than uvicorn waits by default
    connection.auto_open = False  # else the client would connect again
    connection.request("GET", "/")
    assert connection.getresponse().status == 403
    connection.close()


def test_it_listens_here_only(server):
    assert server._socket.getsockname()[0] == "127.0.0.1"


def test_a_port_in_use_is_refused(server):
    with pytest.raises(InvalidInput, match=f"{server.port} of 127.0.0.1.*without --port"):
        WebServer([], port=server.port)


def test_it_ends_at_once_with_open_streams(view):
    view.show(np.zeros((24, 32, 3), dtype=np.uint8), {"n": 1})
    server = WebServer([overlay_page(view, "a scene")]).start()
    streams = [connected(server, f"/overlay/{name}") for name in ("stream", "events", "stream")]
    for _, answer in streams:
        assert answer.read(20)
    begun = time.monotonic()
    server.stop()
    assert time.monotonic() - begun < 2.5
    for connection, _ in streams:
        connection.close()
    assert not server._thread.is_alive()


def test_ctrl_c_while_waiting_leaves_the_server_to_be_stopped(view):
    def interrupt(*_):
        raise KeyboardInterrupt

    server = WebServer([overlay_page(view, "a scene")]).start()
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1.0)
        with pytest.raises(KeyboardInterrupt):
            server.wait()
    finally:
        signal.signal(signal.SIGALRM, before)
    assert server._thread.is_alive()  # an interrupted `join` would deny it
    server.stop()
    assert not server._thread.is_alive()


def test_it_ends_though_a_browser_does_not_read(view):
    """A browser that stands still holds up its own stream, and neither the program nor others."""
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    server = WebServer([overlay_page(view, "a scene")]).start()
    still = socket.create_connection(("127.0.0.1", server.port))
    still.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    cookie = f"Cookie: {server.gate.cookie}={server.gate.session}"
    asked = f"GET {server.gate.root}/overlay/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n{cookie}\r\n\r\n"
    still.sendall(asked.encode())
    view.show(picture, {"n": 0})
    connection, quick = connected(server, "/overlay/stream")
    took = []
    for number in range(1, 30):
        begun = time.monotonic()
        view.show(picture, {"n": number})
        took.append(time.monotonic() - begun)
        assert len(quick.read(60_000)) == 60_000
    assert sorted(took)[len(took) // 2] < 0.1  # one of them may meet a busy machine
    assert max(took) < 10.0
    begun = time.monotonic()
    server.stop()
    assert time.monotonic() - begun < 4.0
    connection.close()
    still.close()
