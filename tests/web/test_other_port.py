"""Another server of this machine: browsers send it the cookies of 127.0.0.1, whatever the port.

It may send what it received from outside any browser, with any headers. Nothing of fixel may open.
"""

import http.client
import http.cookiejar
import http.server
import json
import re
import threading
import urllib.request
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import fixel.web
from fixel.model.selection import ExperimentQuery
from fixel.web.security import WORD_HEADER

TOTAL = "api/v1/experiments?limit=1"
# What a page of another port tries on the address of fixel, from inside the browser.
ATTACKS = """async home => {
  const found = [];
  const paths = ["", "experiments", "api/v1/experiments", "palette.css", "static/dom.js"];
  for (const path of paths) {
    for (const mode of ["cors", "no-cors"]) {
      try {
        const answer = await fetch(home + path, { mode, credentials: "include" });
        found.push(await answer.text());
      } catch { found.push(""); }
    }
  }
  await fetch(home + "api/v1/experiments/delete", {
    method: "POST", mode: "no-cors", credentials: "include", body: '{"ids": [7]}',
    headers: { "Content-Type": "text/plain" },
  }).catch(() => null);
  for (const kind of ["img", "iframe", "script"]) {
    const node = document.createElement(kind);
    node.src = home + "experiments";
    document.body.append(node);
  }
  window.open(home + "experiments");
  await new Promise(done => setTimeout(done, 500));
  return found;
}"""

# A form that a page of another port posts. What the page could never learn is given to it: the
# address with the prefix, and the word.
FORM = """<form method="post" action="{home}run/filter">
<input name="fixel-word" value="{word}"><input name="experiment" value="{experiment}"></form>"""
POST = "html => { document.body.innerHTML = html; document.forms[0].submit(); }"


class Neighbour(http.server.BaseHTTPRequestHandler):
    """Notes what browsers send."""

    def do_GET(self):
        self.server.received.append((self.path, self.headers.get("cookie")))
        self.send_response(200)
        self.send_header("content-type", "text/html")
        if self.path == "/sandboxed":  # its pages have no origin
            self.send_header("content-security-policy", "sandbox allow-forms allow-scripts")
        self.end_headers()
        self.wfile.write(b"<h1>hello</h1>")

    def log_message(self, *_):
        pass


@contextmanager
def neighbour():
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Neighbour) as server:
        server.received = []
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def sent(server, method, path, headers=None, body=None):
    """Status and body of a request that no browser sends."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    connection.request(method, path, body, headers or {})
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, text


def total(server):
    bearer = {"Authorization": f"Bearer {server.gate.token}"}
    return json.loads(sent(server, "GET", f"/{TOTAL}", bearer)[1])["total"]


def rob(server, cookies):
    """Return what opens for a thief who has the cookies and forges everything else."""
    home = f"http://127.0.0.1:{server.port}"
    forged = {
        "Cookie": cookies,
        "Origin": home,
        "Referer": f"{home}/experiments",
        "Sec-Fetch-Site": "same-origin",
        "Sec-Fetch-Mode": "navigate",
        "Sec-Fetch-Dest": "document",
    }
    paths = {page.path.replace("{number}", "1") for page in server._pages}
    paths |= {"/", "/palette.css", "/static/dom.js", "/api/v1/openapi.json", "/api/v1/project"}
    paths |= {f"/{TOTAL}", "/api/v1/experiments/1", "/api/v1/experiments/1/thumbnail.svg"}
    taken = {path: sent(server, "GET", path, forged) for path in sorted(paths)}
    opened = [path for path, (status, _) in taken.items() if status != 403]
    words = {w for _, text in taken.values() for w in re.findall(rb'word" content="(.+?)"', text)}
    for word in {b"guess", *words}:
        write = {**forged, WORD_HEADER: word.decode(), "Content-Type": "application/json"}
        status, _ = sent(server, "POST", "/api/v1/experiments/delete", write, b'{"ids": [5]}')
        if status != 403:
            opened.append("delete")
    return opened


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_server_on_another_port_receives_nothing_that_opens(server, name):
    """Python's cookie jar follows the same rules as browsers: hosts and paths, no ports."""
    jar = http.cookiejar.CookieJar()
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))
    link = server.link.replace("127.0.0.1", name)
    with browser.open(link, timeout=60) as answer:
        home, name_of_page = answer.url.rsplit("/", 1)
    assert name_of_page == "experiments"
    assert len(jar) == 1
    before = total(server)
    with neighbour() as other:
        for path in ("/", "/experiments", "/overlay/stream", f"/static{urlsplit(home).path}"):
            browser.open(f"http://{name}:{other.server_port}{path}", timeout=60).close()
        received = {cookies or "" for _, cookies in other.received}
    for cookies in received:
        assert rob(server, cookies) == []
    assert received == {""}
    # And if it had the cookie, from wherever: that alone is worth nothing.
    assert rob(server, f"{server.gate.cookie}={server.gate.session}") == []
    assert total(server) == before
    # The jar itself still opens everything that is ours.
    with browser.open(f"{home}/{TOTAL}", timeout=60) as answer:
        assert json.load(answer)["total"] == before


def test_no_page_leaves_the_prefix():
    """Addresses of our own pages begin with it; one that does not would open nothing."""
    folder = Path(fixel.web.__file__).parent
    leaving = re.compile(r"""(?:href|src|action)="/|(?:href|src): ?["'`]/|fetch\(["'`]/""")
    leaving_at_once = re.compile(r"""(?:assign|replace|open|Source|"href",)\(? ?["'`]/""")
    found = [
        (path.name, line.strip())
        for path in (*folder.glob("templates/*.html"), *folder.glob("static/*.js"))
        for line in path.read_text().splitlines()
        if leaving.search(line) or leaving_at_once.search(line)
    ]
    assert found == []


@pytest.mark.system
def test_a_real_browser_and_a_hostile_page(browser_page, server):
    before = total(server)
    assert browser_page.url.endswith("/experiments")
    with neighbour() as other:
        hostile = browser_page.context.new_page()
        hostile.goto(f"http://127.0.0.1:{other.server_port}/innocent")
        assert set(hostile.evaluate(ATTACKS, f"http://127.0.0.1:{server.port}/")) == {""}
        # Also where it writes paths into its own address, as a page may.
        for path in ("/experiments", "/static/", "/x/y/z"):
            hostile.evaluate("path => history.pushState(null, '', path)", path)
            hostile.reload()
        received = {cookies or "" for _, cookies in other.received}
        hostile.close()
    for cookies in received:
        assert rob(server, cookies) == []
    assert received == {""}
    assert total(server) == before


@pytest.mark.system
@pytest.mark.parametrize(("path", "site"), [("innocent", "same-site"), ("sandboxed", "cross-site")])
def test_a_form_of_another_port_starts_nothing(path, site, browser_page, server, project):
    experiment = server.context.store.experiments(ExperimentQuery(limit=1)).rows[0].key
    form = FORM.format(home=server.home, word=server.gate.word, experiment=experiment)
    before = {*project.glob("jobs/*")}
    with neighbour() as other:
        hostile = browser_page.context.new_page()
        hostile.goto(f"http://127.0.0.1:{other.server_port}/{path}")
        with hostile.expect_response("**/run/filter") as answer:
            hostile.evaluate(POST, form)
        assert answer.value.status == 403
        sent = answer.value.request.all_headers()
        hostile.close()
    assert (sent["sec-fetch-site"], sent["origin"] == "null") == (site, path == "sandboxed")
    assert {*project.glob("jobs/*")} == before


@pytest.mark.system
def test_whoever_opened_the_link_goes_where_he_likes(browser_page, server):
    """Reloads, new tabs, the way back, the same link once more, pictures and links of pages."""
    browser_page.wait_for_selector("tr[data-id]")
    browser_page.reload()
    browser_page.wait_for_selector("tr[data-id] img")
    browser_page.locator("tr[data-id] .named a").first.click()
    browser_page.wait_for_selector("main h1")
    assert browser_page.url.startswith(f"{server.home}experiments/")
    address = browser_page.url
    browser_page.go_back()
    browser_page.wait_for_selector("tr[data-id]")
    context = browser_page.context
    for where in (
        address,
        server.home,
        server.link,
        f"{server.address}jobs?token=" + server.gate.token,
    ):
        tab = context.new_page()
        assert tab.goto(where).status == 200
        assert tab.url.startswith(server.home)
        assert server.gate.token not in tab.url
        tab.close()
    with neighbour() as other:  # a link on another page, as in a notebook
        elsewhere = context.new_page()
        elsewhere.goto(f"http://127.0.0.1:{other.server_port}/")
        elsewhere.evaluate("address => location.assign(address)", address)
        elsewhere.wait_for_url(address)
        elsewhere.wait_for_selector("main h1")
        elsewhere.close()
    for link in browser_page.locator("nav a").all():
        assert link.get_attribute("href").startswith(server.gate.root)
