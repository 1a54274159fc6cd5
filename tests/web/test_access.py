"""Access to the server: every route, credential, server name, origin and method at once.

What should happen is computed here from the rules as they are written in docs/how-to/web-safety.md,
and not by asking the gate.
"""

import asyncio
import contextlib
import http.client
import itertools
import logging
import re
import sqlite3

import pytest
from tests.cli.shell import refusal
from tests.web.bench import filled

from fixel.web import security
from fixel.web.live import LiveView
from fixel.web.live_pages import overlay_page
from fixel.web.serve import WebServer

METHODS = ("GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE", "TRACE")
SAFE = ("GET", "HEAD", "OPTIONS")
HOSTS = ("127.0.0.1:8000", "localhost:8000", "[::1]:8000", "evil.example", None)
ORIGINS = ("absent", "same", "http://evil.example", "null", "picture on a page of another port")
ORIGINS += ("link on another page", "form of ours", "form of another port", "form in a sandbox")
CREDENTIALS = (
    "nothing", "prefix", "token in query", "wrong token in query", "token twice in query",
    "bearer", "wrong bearer", "bearer and prefix", "cookie", "cookie and word", "word and prefix",
    "cookie and wrong prefix", "cookie and word and wrong prefix", "cookie and prefix",
    "wrong cookie and prefix", "cookie and prefix and word", "cookie and prefix and wrong word",
    "cookie and prefix and wrong bearer",
)  # fmt: skip
ADMITTED = 299  # no handler answers so


def expected(credential, host, origin, method):
    """The rules."""
    ours = host in HOSTS[:3]
    at_home = origin in ("absent", "same", "form of ours")
    if not ours:
        return 400
    if credential == "token in query" and method in SAFE:
        return 303
    if "bearer" in credential:
        return ADMITTED if "wrong" not in credential and at_home else 401
    if (
        "cookie and prefix" not in credential
        or "wrong cookie" in credential
        or not (at_home or (origin == "link on another page" and method in SAFE))
    ):
        return 403
    if method in SAFE or credential == "cookie and prefix and word":
        return ADMITTED
    return 403


def request(gate, path, credential, host, origin, method):
    """The same, as a server hands it on."""
    headers, query = {}, ""
    if host is None:
        headers |= {"x-forwarded-host": "127.0.0.1", "forwarded": "host=127.0.0.1"}
    else:
        headers["host"] = host
    match origin:
        case "absent":
            pass
        case "same":
            headers |= {"origin": f"http://{host}", "sec-fetch-site": "same-origin"}
        case "picture on a page of another port":
            headers |= {"sec-fetch-site": "same-site", "sec-fetch-dest": "image"}
            headers["sec-fetch-mode"] = "no-cors"
        case "link on another page":
            headers |= {"sec-fetch-site": "cross-site", "sec-fetch-dest": "document"}
            headers["sec-fetch-mode"] = "navigate"
        case "form of ours" | "form of another port" | "form in a sandbox":
            # Pages that send no referrer do not name their origin; a sandboxed frame has none.
            came, site = {
                "form of ours": ("null", "same-origin"),
                "form of another port": ("http://127.0.0.1:9000", "same-site"),
                "form in a sandbox": ("null", "cross-site"),
            }[origin]
            headers |= {"origin": came, "sec-fetch-site": site, "sec-fetch-mode": "navigate"}
            headers["sec-fetch-dest"] = "document"
        case _:
            headers["origin"] = origin
    wrong = "x" * len(gate.token)
    if "query" in credential:
        query = f"token={wrong if 'wrong' in credential else gate.token}"
        query += f"&{query}" if "twice" in credential else ""
    if "bearer" in credential:
        headers["authorization"] = f"Bearer {wrong if 'wrong' in credential else gate.token}"
    if "cookie" in credential:
        value = gate.token if "wrong cookie" in credential else gate.session
        headers["cookie"] = f"{gate.cookie}={value}"
    if "word" in credential:
        headers["x-fixel-word"] = wrong if "wrong word" in credential else gate.word
    if "prefix" in credential:
        path = f"/{wrong[:22] if 'wrong prefix' in credential else gate.prefix}{path}"
    return {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in headers.items()],
        "client": ("127.0.0.1", 50000),
        "server": ("127.0.0.1", 8000),
        "state": {},
    }


async def status_of(app, scope):
    """Status and headers of an answer."""
    sent = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request", "body": b"", "more_body": False}

    await app(scope, receive, send)
    start = sent[0]
    return start["status"], {n.decode().lower(): v.decode() for n, v in start["headers"]}


async def _bell(scope, receive, send):
    """Application instead of all behind the gate; its answer shows that a request got in."""
    await send({"type": "http.response.start", "status": ADMITTED, "headers": []})
    await send({"type": "http.response.body", "body": b""})


@pytest.mark.parametrize("every", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_the_full_matrix(bench, monkeypatch, every):
    """Zero surprises, and the policy on every answer; each path has other cases, and all together
    have each of them several times."""
    monkeypatch.setattr(bench.app.router, "middleware_stack", _bell)
    paths = [*bench.addresses(), "/nowhere", "/api/v1/nowhere", "//evil.example/", "/../x"]
    places = [
        (host, origin)
        for host, origin in itertools.product(HOSTS, ORIGINS)
        if host in (HOSTS[0], "evil.example") or origin in ("absent", "same")
    ]
    ways = list(itertools.product(CREDENTIALS, places, METHODS))
    cases = [
        (path, credential, *place, method)
        for k, path in enumerate(paths)
        for credential, place, method in ways[k % every :: every]
    ]
    surprises, counts = [], {}

    async def all_of_them():
        for path, *case in cases:
            found, headers = await status_of(bench.app, request(bench.gate, path, *case))
            wanted = expected(*case)
            counts[found] = counts.get(found, 0) + 1
            strict = all(headers.get(name) == value for name, value in security.HEADERS.items())
            opened = "set-cookie" in headers
            if found != wanted or not strict or opened != (wanted == 303):
                surprises.append((path, *case, wanted, found))

    asyncio.run(all_of_them())
    print(f"{len(cases)} requests: {counts}")
    assert surprises == []
    assert "'unsafe" not in security.HEADERS["content-security-policy"]
    assert set(counts) == {ADMITTED, 303, 400, 401, 403}


def test_what_only_looks_answers_those_who_may_and_changes_nothing(bench):
    """A link on another site, which a browser follows with the cookie, changes nothing either."""
    client, sent = bench.opened(), {"authorization": f"Bearer {bench.gate.token}"}
    known = {200, 303, 404, 409, 422}  # this project has no plans, for example
    with contextlib.closing(sqlite3.connect(bench.folder / "experiments.db")) as watch:

        def version():
            return watch.execute("PRAGMA data_version").fetchone()

        before = version()
        for path, methods in bench.addresses().items():
            if "GET" not in methods:
                continue
            assert client.get(path).status_code in known, path
            answer = bench.stranger().get(path, headers=sent)
            assert answer.status_code in known, path
            assert "set-cookie" not in answer.headers
        assert version() == before
        bench.post("/experiments/delete", {"ids": [30]})
        assert version() != before  # it would have been noticed


def test_secrets_are_compared_in_constant_time(bench, monkeypatch):
    compared = []
    honest = security.secrets.compare_digest

    def watched(one, other):
        compared.append(other)
        return honest(one, other)

    monkeypatch.setattr(security.secrets, "compare_digest", watched)
    gate = bench.gate
    for credential in CREDENTIALS:
        for method in ("GET", "POST"):
            scope = request(gate, "/nowhere", credential, HOSTS[0], "absent", method)
            asyncio.run(status_of(bench.app, scope))
    assert set(compared) == {
        secret.encode() for secret in (gate.token, gate.session, gate.prefix, gate.word)
    }
    # And nowhere else: no other line of the server compares one of them.
    source = (security.__file__, __import__("fixel.web.app").web.app.__file__)
    for path in source:
        with open(path) as stream:
            assert not re.search(
                r"(==|!=)\s*(self\.)?(gate\.)?(token|session|prefix|word)\b", stream.read()
            )


def test_secrets_are_long_and_never_twice():
    gates = [security.Gate() for _ in range(50)]
    secrets = {s for gate in gates for s in (gate.token, gate.session, gate.word)}
    assert len(secrets) == 150
    assert min(map(len, secrets)) >= 43  # 256 bit
    prefixes = {gate.prefix for gate in gates}
    assert len(prefixes) == 50
    assert min(map(len, prefixes)) >= 22  # 128 bit


def test_the_token_is_in_no_log(caplog):
    """Ask a real server for everything, with all loggers enabled."""
    with caplog.at_level(logging.DEBUG), WebServer([overlay_page(LiveView(), "x")]) as server:
        token = server.gate.token
        for method, path, headers in (
            ("GET", f"/?token={token}", {}),
            ("GET", f"/overlay?token={token}&x=%00", {}),
            ("POST", f"/overlay?token={token}", {}),
            ("GET", "/nowhere", {"Authorization": f"Bearer {token}"}),
            ("BREW", f"/{token}", {"Cookie": f"{server.gate.cookie}={server.gate.session}"}),
        ):
            connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
            connection.request(method, path, headers=headers)
            connection.getresponse().read()
            connection.close()
    assert not [line for line in caplog.messages if token in line]


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.0.4", "127.0.0.2", "example.org", ""])
def test_other_machines_only_where_that_is_said(project, host, capsys):
    assert "--allow-others" in refusal(capsys, "serve", project, "--host", host)


# --- what is sent -----------------------------------------------------------------------------

ESCAPES = (
    "..%2f..%2f..%2f..%2fetc%2fpasswd",
    "%2e%2e%2f%2e%2e%2ffixel.yaml",
    "%2e%2e",
    "%2fetc%2fpasswd",
    "..%5c..%5cfixel.yaml",
    "....//....//fixel.yaml",
    "%252e%252e%252ffixel.yaml",
    "fixel.yaml%00.db",
    "%c0%ae%c0%ae%2ffixel.yaml",
    "file:%2f%2f%2fetc%2fpasswd",
    "%00",
    "-1",
    "1e3",
    "0x1",
    "9" * 5000,
)


def test_no_parameter_is_a_path(bench):
    """Every parameter of every address and page refuses paths, and reveals no file."""
    templates = [page.path for page in bench.pages]
    templates += [f"/api/v1{path}" for path in bench.api.openapi()["paths"]]
    templates += ["/static/{file}", "/static/{folder}/style.css"]
    asked = 0
    for template in templates:
        for parameter in re.findall(r"\{\w+\}", template):
            for escape in ESCAPES:
                address = filled(template.replace(parameter, escape))
                for method in ("GET", "POST"):
                    headers = {"x-fixel-word": bench.gate.word}
                    answer = bench.client.request(method, address, headers=headers)
                    known = {303, 404, 405, 422}
                    assert answer.status_code in known, (method, address, answer.status_code)
                    assert "root:" not in answer.text
                    assert "database:" not in answer.text
                    asked += 1
    assert asked > 500


@pytest.mark.parametrize("announced", [None, "10", "nonsense", "-1"])
def test_long_bodies_are_cut_off_whatever_they_announce(bench, announced):
    """Bodies of unknown or wrong length are not read to their end."""
    scope = request(bench.gate, "/api/v1/scenes/read", "bearer", HOSTS[0], "absent", "POST")
    scope["headers"].append((b"content-type", b"application/json"))
    if announced is not None:
        scope["headers"].append((b"content-length", announced.encode()))
    read, sent = 0, []

    async def receive():
        nonlocal read
        read += 65536
        return {"type": "http.request", "body": b" " * 65536, "more_body": read < 2**28}

    async def send(message):
        sent.append(message)

    asyncio.run(bench.app(scope, receive, send))
    assert read <= security.MAX_BODY + 2 * 65536
    assert 400 <= sent[0]["status"] < 500


def test_nothing_is_uploaded(bench):
    """No address takes a file: scene files are read by the browser, and sent as text."""
    for path, entries in bench.api.openapi()["paths"].items():
        for method, entry in entries.items():
            kinds = set(entry.get("requestBody", {}).get("content", {}))
            assert kinds <= {"application/json"}, (method, path)
