"""Markup in everything a project holds: shown as text on every page, and nothing of it runs."""

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote

import pytest
from tests.laboratories import trusted_laboratory

from fixel.database.project import Project
from fixel.model import Flag
from fixel.testbed.recorder import RecordingStatus
from fixel.testing.toy_work import MAKER
from fixel.web.live import LiveView
from fixel.web.live_pages import RecordPreview, overlay_page
from fixel.web.serve import WebServer
from fixel.workflows import jobs
from fixel.workflows.project.filters import view_of

pytestmark = pytest.mark.system

# What would run if it were taken for markup, in text, in attributes, in addresses and in JSON.
EVIL = (
    "<script>window.hacked=1</script>",
    '"><img src=x onerror=window.hacked=1>',
    "'><svg onload=window.hacked=1>",
    "</script><script>window.hacked=1</script>",
    "javascript:window.hacked=1",
    "{{ 7*7 }}${7*7}<b>bold</b>",
    "</title></textarea></select><iframe srcdoc='<script>parent.hacked=1</script>'>",
    "</style><style>*{display:none}</style><base href=//evil.example>",
)
ALL = " ".join(EVIL)


def poisoned(folder):
    """The experiments of a project again, with markup wherever somebody may write something."""
    project = Project(folder)
    with project.store() as store:
        for number, evil in enumerate(EVIL, 1):
            one = store.experiment(number)
            scene = one.scene
            body = replace(scene.bodies[0], name=f"body {evil}")
            fixels = tuple(replace(f, name=f"{f.name} {evil}") for f in scene.fixels)
            bad = replace(
                one,
                dataset=f"data {evil}",
                name=f"run {evil}".replace("/", "\u2215"),
                simulated_by=f"testbed {evil}",
                scene=replace(scene, bodies=(body,), fixels=fixels),
                object_name=body.name,
                conditions={
                    **one.conditions, "shape": evil, "layout": evil, f"who_{number}": evil,
                    f"<b>{number}</b>": evil,
                },
                provenance=replace(
                    one.provenance, command=f"fixel {evil}", source=f"/data/{evil}", sha256=""
                ),
                flags=(),
            )  # fmt: skip
            stored = store.add_experiment(bad).id
            store.flag([stored], Flag(f"evil-{number}", evil))
            store.annotate([stored], ALL)
            _keep_simulation(store, stored, evil)
            made = store.calibration(1)
            origin = replace(made.provenance, command=f"fixel {evil}")
            store.add_calibration(replace(made, name=f"fit {evil}", provenance=origin))
    # What is a file name cannot hold a slash.
    for number, evil in enumerate(EVIL):
        name = f"job {number} {evil}".replace("/", "\u2215")
        job = jobs.prepare_job(folder / "jobs" / name, maker=MAKER)
        (folder / "jobs" / job.name / "log.txt").write_text(f"{ALL}\n\x1b[31m{evil}\n")
        workers = folder / "jobs" / job.name / "workers"
        workers.mkdir()
        (workers / f"{evil[:40]}.refused".replace("/", "\u2215")).write_text(ALL)
        (workers / "w.json").write_text(json.dumps({"host": evil, "pid": 1}))
    settings = folder / "fixel.yaml"
    settings.write_text(f"name: {json.dumps('lab ' + ALL[:190])}\n")
    return folder


def _keep_simulation(store, number, evil):
    from fixel.workflows.project.compare import compare_run

    store.add_simulation(compare_run(store.experiment(number)).record(number, f"fixel {evil}"))


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """The laboratory in a folder with an evil name, and evil inside."""
    evil = EVIL[1].replace("/", "")
    folder = tmp_path_factory.mktemp("evil") / f"lab {evil}"
    trusted_laboratory(folder)
    return poisoned(folder)


class _Marked(HTMLParser):
    """Elements, and attributes that run or lead somewhere."""

    def __init__(self):
        super().__init__()
        self.found = []
        self.inside = None

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        self.inside = tag
        for name, value in known.items():
            if name.startswith("on") or name in ("style", "srcdoc", "formaction"):
                self.found.append((tag, name, value))
            leads = name in ("href", "src", "action")
            if leads and not re.match(r"[/#]", value) and not value.startswith("data:"):
                self.found.append((tag, name, value))
        if tag in ("iframe", "object", "embed", "base", "style"):
            self.found.append((tag, "", ""))

    def handle_data(self, text):
        if self.inside == "script" and text.strip():
            self.found.append(("script", "", text))

    def handle_endtag(self, tag):
        self.inside = None


def addresses_of_pages(bench):
    store = bench.context.store
    last = max(store.experiment_ids(view_of("")))
    keys = [store.experiment(number).key for number in range(last - 2, last + 1)]
    listed = (page.path for page in bench.pages if "{" not in page.path)
    yield from (*listed, f"/nowhere/{quote(ALL)}", f"/calibrations/running/{quote(ALL)}")
    yield from (f"/calibrations/{number}" for number in list(store.calibration_summaries())[-3:])
    for number in range(last - len(EVIL) + 1, last + 1):
        yield f"/experiments/{number}"
    for key in (*keys, ALL):
        yield f"/compare?experiment={quote(key)}"
        yield f"/simulate?experiment={quote(key)}"
    yield f"/simulate?example={quote(ALL)}"
    yield f"/experiments/{quote(ALL)}"


def test_no_page_holds_it_as_markup(bench):
    for address in addresses_of_pages(bench):
        answer = bench.client.get(address)
        assert answer.headers["content-type"].startswith("text/html"), address
        parser = _Marked()
        parser.feed(answer.text)
        assert parser.found == [], address
        for evil in EVIL[:4]:
            assert evil not in answer.text, address


def test_no_other_answer_is_taken_for_a_page(bench):
    """JSON as JSON, pictures without scripts; nothing is guessed from what it looks like."""
    for path, methods in bench.addresses().items():
        if "GET" not in methods:
            continue
        answer = bench.client.get(path)
        assert answer.headers["x-content-type-options"] == "nosniff", path
        if path.startswith("/api/v1"):
            assert not answer.headers["content-type"].startswith("text/html"), path
    last = len(bench.get("/experiments/ids")["ids"])
    for number in range(1, last + 1):
        picture = bench.client.get(f"/api/v1/experiments/{number}/thumbnail.svg")
        if picture.status_code == 200:
            assert not re.search(r"<(script|foreignObject|image|a)\b|on\w+=", picture.text)


def test_scripts_know_no_way_to_write_markup():
    import fixel.web

    ways = r"(inner|outer)HTML|insertAdjacentHTML|document\.write|\beval\(|new Function|DOMParser"
    for path in (Path(fixel.web.__file__).parent / "static").glob("*.js"):
        text = path.read_text(encoding="utf-8")
        if path.name == "page.js":  # reads this server's own pages, whose templates escape texts
            text = text.replace('new DOMParser().parseFromString(text, "text/html")', "", 1)
        assert not re.search(ways, text), path
    for path in (Path(fixel.web.__file__).parent / "templates").glob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"\|\s*safe|autoescape|\son\w+=", text), path


def test_nothing_unpickles(bench):
    """No request makes the server unpickle anything."""
    found = []

    def hook(event, arguments):
        if event == "pickle.find_class" and watching:
            found.append(arguments)

    watching = True
    sys.addaudithook(hook)
    try:
        for path, methods in bench.addresses().items():
            if "GET" in methods:
                bench.client.get(path)
        for path in ("/experiments/note", "/scenes/read"):
            bench.send(path, json.dumps({"text": "\x80\x04cos\nsystem\n(S'x'\ntR.", "ids": [1]}))
    finally:
        watching = False
    assert found == []


# --- in a real browser ------------------------------------------------------------------------


@pytest.fixture
def watched(browser_page):
    """A page that records which of its scripts ran, and requests nothing from other servers."""
    elsewhere = []
    home = re.match(r"https?://[^/]+", browser_page.url)[0]

    def seen(request):
        if not request.url.startswith((home, "data:", "blob:")):
            elsewhere.append(request.url)

    browser_page.on("request", seen)
    browser_page.on("dialog", lambda dialog: elsewhere.append(dialog.message))
    browser_page.expected_problems += ["404", "422"]
    yield browser_page
    assert elsewhere == []


def nothing_ran(page):
    assert page.evaluate("window.hacked") is None
    assert page.locator("iframe, base, object, embed, main script").count() == 0
    assert page.locator("b:text('bold')").count() == 0


def test_nothing_runs_on_any_page(watched, bench, server):
    for address in addresses_of_pages(bench):
        watched.goto(f"{server.home.rstrip('/')}{address}")
        watched.wait_for_timeout(250)  # scripts of the page put in what they have fetched
        nothing_ran(watched)


def test_markup_is_seen_as_it_was_written(watched, bench, server):
    last = max(bench.context.store.experiment_ids(view_of("")))
    watched.goto(f"{server.home}experiments/{last}")
    watched.wait_for_function(
        "() => document.querySelector('#notes').textContent.includes('<script>')"
    )
    assert EVIL[1] in watched.inner_text("#notes")
    watched.goto(f"{server.home}jobs")
    assert EVIL[1] in watched.inner_text("#table")
    nothing_ran(watched)
    watched.click("#table tbody tr:nth-child(3) .open")
    assert EVIL[1] in watched.inner_text("#log")
    nothing_ran(watched)
    watched.goto(f"{server.home}experiments#{EVIL[1]}")
    watched.fill("#filter", EVIL[0])
    watched.wait_for_timeout(500)
    nothing_ran(watched)


def test_the_token_leaves_the_address_and_is_no_referrer(watched, server):
    seen = []
    watched.on("request", lambda request: seen.append(request.headers.get("referer", "")))
    watched.goto(server.link)
    watched.wait_for_timeout(300)
    assert server.gate.token not in watched.url
    assert seen
    assert set(seen) <= {""}  # none at all
    assert server.gate.token not in watched.content()
    assert server.gate.session not in watched.evaluate("document.cookie")


def test_live_pages(chromium):
    """Names of scenes, rigs and recordings in reports that change on an open page."""
    view, preview = LiveView(), RecordPreview(ALL)
    view.show(None, {"problems": [ALL], "remarks": [ALL], "state": ALL, "parts": []})
    with WebServer([overlay_page(view, ALL), preview.page()]) as server:
        page = chromium.new_page()
        page.goto(server.link)
        page.wait_for_timeout(300)
        assert page.evaluate("window.hacked") is None
        page.goto(f"{server.home}record")
        preview.show(None, RecordingStatus(1.0, 1, 0, 30.0, None, 10**9, (ALL,)))
        page.wait_for_timeout(300)
        assert page.evaluate("window.hacked") is None
        page.close()
