"""A copy of a project of simulated runs; its server; a real browser."""

import os
import shutil
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from tests import laboratories

from fixel.database.project import Project

NAMES = (os.environ.get("CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
QUIET = [
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-first-run",
    "--disable-features=OptimizationHints,MediaRouter",
    "--disable-dev-shm-usage",
    "--disable-gpu",
]
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
VIOLATIONS = """async (rules) => (await window.axe.run(document, {
  runOnly: { type: "tag", values: rules }, resultTypes: ["violations"],
})).violations.filter((one) => one.impact !== "minor").map((one) => [one.id,
  one.nodes.map((node) => `${node.target.join(" ")}: ${node.failureSummary}`)])"""
SCRIPTS = ["<img src=x onerror=window.hacked=1>", "</script><script>window.hacked=1</script>"]


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    """A copy of the laboratory for the tests of one module, which may change it."""
    return laboratories.laboratory(tmp_path_factory.mktemp("copy") / "my_lab")


@pytest.fixture(scope="module")
def bench(project):
    """The application of the copy in this process."""
    from tests.web.bench import Bench

    made = Bench(project)
    yield made
    made.close()


@pytest.fixture(scope="module")
def server(project):
    """The pages of the copy, on a port of this machine: `server.link`, `server.home`."""
    from fixel.web.context import ProjectContext
    from fixel.web.project import project_server

    context = ProjectContext(Project(project))
    running = project_server(context).start()
    running.context = context
    yield running
    running.stop()
    context.close()


@pytest.fixture(scope="module")
def chromium():
    """One browser for a module; longer, and its event loop would be in the way of others."""
    found = next((path for name in NAMES if name and (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium on this machine")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=found, chromium_sandbox=os.geteuid() != 0, args=QUIET
        )
        yield browser
        browser.close()


@contextmanager
def opened_page(chromium, **options):
    """A page in a context of its own; every error that it does not expect fails the test."""
    context = chromium.new_context(**{"viewport": {"width": 1280, "height": 800}} | options)
    page = context.new_page()
    page.set_default_timeout(60_000)  # the machine may be busy
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda line: problems.append(line.text) if line.type == "error" else None)
    page.expected_problems = []
    yield page
    context.close()
    surprises = [p for p in problems if not any(e in p for e in page.expected_problems)]
    assert surprises == []


@pytest.fixture
def browser_page(chromium, server):
    """A page that has opened the link."""
    with opened_page(chromium) as page:
        page.goto(server.link)
        yield page


def page_fixture(path, selector):
    """Return a fixture: the page of an address, once it shows what the selector finds."""

    @pytest.fixture
    def opened(browser_page, server):
        browser_page.goto(server.home + path)
        browser_page.wait_for_selector(selector)
        return browser_page

    return opened


@pytest.fixture(scope="module")
def faults():
    """Function that returns the faults of a page by the rules of axe, and of its width."""
    package = pytest.importorskip("axe_playwright_python", reason="pip install 'fixel[dev]'")
    rules = files(package).joinpath("axe.min.js").read_text(encoding="utf-8")

    def found(page):
        page.evaluate(rules)
        return [*page.evaluate(VIOLATIONS, RULES), *width_fault(page)]

    return found


def width_fault(page):
    wide = page.evaluate("document.documentElement.scrollWidth > innerWidth + 1")
    cut = """[...document.querySelectorAll("input[type=number]")].filter((one) =>
        one.scrollWidth > one.clientWidth + 1).map((one) => `the number ${one.value} is cut off`)"""
    return [*(["wider than the window"] if wide else []), *page.evaluate(cut)]


def unpacked(array):
    """The numbers of a packed array."""
    import base64

    data = base64.b64decode(array["base64"])
    return np.frombuffer(data, array["dtype"]).reshape(array["shape"])
