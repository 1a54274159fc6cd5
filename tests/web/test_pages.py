"""Every route, with and without what opens it."""

import asyncio
import json

import numpy as np
import pytest
from tests.web.client import Client

from fixel.testbed.recorder import RecordingStatus
from fixel.web.app import create_app
from fixel.web.live import LiveView
from fixel.web.live_pages import RecordPreview, overlay_page
from fixel.web.security import WORD_HEADER, Gate

HERE = "http://127.0.0.1:8000"


class Bench:
    def __init__(self):
        self.gate = Gate()
        self.view = LiveView()
        self.preview = RecordPreview("pushes/<141>")
        pages = [overlay_page(self.view, "square & three fixels"), self.preview.page()]
        self.app = create_app(pages, self.gate)

    def client(self, *, let_in=True, **options) -> Client:
        """One that has opened the link; else one that knows nothing but the way."""
        cookies = {self.gate.cookie: self.gate.session} if let_in else None
        return Client(self.app, HERE + self.gate.root, cookies=cookies, **options)


@pytest.fixture
def bench():
    return Bench()


# --- who gets in ------------------------------------------------------------------------------


def test_without_the_link_it_is_asked_for(bench):
    for path in ("/", "/overlay/stream", "/static/live.js"):
        answer = bench.client(let_in=False).get(path)
        assert answer.status_code == 403
        assert "link" in answer.text


@pytest.mark.parametrize("prefix", ["", "/", "/guess", "//{prefix}", "/{prefix}x", "/x/{prefix}"])
def test_the_cookie_alone_opens_nothing(bench, prefix):
    """Other servers of this machine may have it; the way is a second secret."""
    home = HERE + prefix.format(prefix=bench.gate.prefix)
    client = Client(bench.app, home, cookies={bench.gate.cookie: bench.gate.session})
    for headers in ({}, {"origin": HERE, "sec-fetch-site": "same-origin", WORD_HEADER: "x"}):
        assert client.get("/overlay", headers=headers).status_code == 403


def test_cookies_of_other_servers_do_no_harm(bench):
    gate = bench.gate
    mixed = f'a:b={{"x": 1}}; ; =;{gate.cookie}={gate.session}; x'
    answer = bench.client(let_in=False).get("/overlay", headers={"cookie": mixed})
    assert answer.status_code == 200


def test_the_token_becomes_a_cookie_and_leaves_the_address(bench):
    client = Client(bench.app, HERE, follow_redirects=False)
    answer = client.get(f"/overlay?token={bench.gate.token}&scale=2")
    assert answer.status_code == 303
    assert answer.headers["location"] == f"{bench.gate.root}/overlay?scale=2"
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=lax" in cookie
    assert f"; path={bench.gate.root.lower()}" in cookie
    assert bench.gate.token.lower() not in cookie
    assert client.get(answer.headers["location"]).status_code == 200


def test_the_token_leads_nowhere_else(bench):
    client = bench.client(let_in=False, follow_redirects=False)
    for way in ("", bench.gate.root):
        answer = client.get(f"{HERE}{way}//elsewhere.example/?token={bench.gate.token}")
        assert answer.headers["location"] == f"{bench.gate.root}//elsewhere.example/"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "192.168.0.4"])
def test_foreign_names_of_this_machine_are_refused(bench, host):
    answer = bench.client().get("/overlay", headers={"host": host})
    assert answer.status_code == 400
    forwarded = {"host": host, "x-forwarded-host": "127.0.0.1", "forwarded": "host=127.0.0.1"}
    assert bench.client().get("/overlay", headers=forwarded).status_code == 400


@pytest.mark.parametrize("host", ["127.0.0.1:1", "localhost:80", "LOCALHOST"])
def test_its_own_names_are_not(bench, host):
    cookie = f"{bench.gate.cookie}={bench.gate.session}"
    answer = bench.client(let_in=False).get("/overlay", headers={"host": host, "cookie": cookie})
    assert answer.status_code == 200


def test_the_secrets_do_not_print(bench):
    gate = bench.gate
    assert not {gate.token, gate.session, gate.prefix, gate.word} & set(
        repr(gate).replace("'", " ").split()
    )


@pytest.mark.parametrize(
    "path", ["/docs", "/openapi.json", "/redoc", "/static/../app.py", "/nowhere"]
)
def test_what_is_not_there(bench, path):
    assert bench.client().get(path).status_code == 404


def test_sockets_are_refused(bench):
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "websocket.connect"}

    scope = {
        "type": "websocket",
        "path": "/overlay/events",
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1")],
        "extensions": {},
    }
    asyncio.run(bench.app(scope, receive, send))
    assert sent
    assert "websocket.accept" not in [message["type"] for message in sent]


# --- pages ------------------------------------------------------------------------------------


def test_pages_fetch_nothing_from_elsewhere(bench):
    client = bench.client()
    for path in ("/overlay", "/record"):
        page = client.get(path).text
        assert "http://" not in page
        assert "https://" not in page
        assert 'style="' not in page
        assert "<script>" not in page


def test_names_of_people_are_escaped(bench):
    assert "pushes/&lt;141&gt;" in bench.client().get("/record").text
    assert "square &amp; three fixels" in bench.client().get("/overlay").text


def test_the_first_page_is_home(bench):
    answer = bench.client(follow_redirects=False).get("/")
    assert answer.status_code == 303
    assert answer.headers["location"] == f"{bench.gate.root}/overlay"


def test_pages_lead_to_each_other(bench):
    page = bench.client().get("/overlay").text
    assert f'href="{bench.gate.root}/record"' in page
    assert page.count("aria-current") == 1


# --- live pictures ----------------------------------------------------------------------------


def test_status_and_picture(bench):
    client = bench.client()
    assert client.get("/overlay/status").json() == {}
    assert client.get("/overlay/picture.jpg").status_code == 404
    bench.view.show(np.full((24, 32, 3), 90, dtype=np.uint8), {"state": "off"})
    assert client.get("/overlay/status").json() == {"state": "off"}
    answer = client.get("/overlay/picture.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    assert answer.content[:2] == b"\xff\xd8"


def test_streams_end_when_the_view_is_closed(bench):
    bench.view.show(np.zeros((24, 32, 3), dtype=np.uint8), {"frames": 1})
    bench.view.close()
    client = bench.client()
    stream = client.get("/overlay/stream")
    assert stream.headers["content-type"].startswith("multipart/x-mixed-replace")
    events = client.get("/overlay/events")
    assert events.headers["content-type"].startswith("text/event-stream")
    assert "event: end" in events.text


# --- the recording ----------------------------------------------------------------------------


def test_a_recording_is_stopped_by_the_page_and_not_by_looking(bench):
    client = bench.client()
    assert client.get("/record/stop").status_code == 405
    assert not bench.preview.stop_wanted
    page = client.get("/record").text
    word = page.split('name="fixel-word" content="')[1].split('"')[0]
    answer = client.post("/record/stop", headers={WORD_HEADER: word, "origin": HERE})
    assert answer.json() == {"stopping": True}
    assert bench.preview.stop_wanted


def test_bits_of_the_tactile_byte_are_lamps(bench):
    preview = bench.preview
    status = RecordingStatus(2.5, 75, 0, 30.0, 0b101, 4 * 10**9, ())
    preview.show(None, status)
    shown = json.loads(preview.view.report)
    assert [lamp["on"] for lamp in shown["tactile"]] == [True, False, True]
    assert (shown["disk_free_gb"], shown["frames"]) == (4.0, 75)
    preview.show(None, status._replace(bits=None))
    nothing = json.loads(preview.view.report)
    assert [lamp["on"] for lamp in nothing["tactile"]] == [None, None, None]


# --- documentation ----------------------------------------------------------------------------


def test_pages_link_to_the_documentation_where_it_was_built(bench, tmp_path):
    (tmp_path / "index.html").write_text("<h1>fixel</h1>")
    pages = [overlay_page(bench.view, "plate"), bench.preview.page()]
    for docs, linked in ((tmp_path, True), (tmp_path / "none", False)):
        bench.app = create_app(pages, bench.gate, docs=docs)
        shown = bench.client().get("/overlay").text
        assert (f"{bench.gate.root}/documentation/index.html" in shown) == linked
        answer = bench.client().get("/documentation/index.html")
        assert (answer.status_code == 200) == linked
    bench.app = create_app(pages, bench.gate, docs=tmp_path)
    assert bench.client(let_in=False).get("/documentation/index.html").status_code == 403
    policy = bench.client().get("/documentation/index.html").headers["content-security-policy"]
    assert policy.startswith("default-src 'self' data:")
