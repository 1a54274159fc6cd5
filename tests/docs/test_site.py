"""The built documentation, read from files in a browser; `make docs` builds it first."""

from pathlib import Path

import pytest
from tests.web.conftest import chromium  # noqa: F401

import fixel

SITE = Path(__file__).parents[2] / "build" / "docs"
NAMES = sorted({*fixel.__all__} - {"__version__"})
PAGES = ("index", "theory/contact", "gallery/01_first_push", "reference/commands/calibrate")

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        not (SITE / "index.html").exists(), reason="make docs has not built the documentation"
    ),
]


@pytest.fixture
def page(chromium):  # noqa: F811
    """A page that notes what it asks from elsewhere, and what goes wrong in it."""
    context = chromium.new_context(offline=True, viewport={"width": 390, "height": 844})
    page = context.new_page()
    page.set_default_timeout(60_000)
    page.asked, page.errors = [], []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    yield page
    context.close()
    assert page.errors == []
    assert [url for url in page.asked if not url.startswith(("file:", "data:"))] == []


@pytest.mark.parametrize("name", PAGES)
def test_page_needs_no_network_and_fits_a_phone(page, name):
    page.goto(f"file://{SITE}/{name}.html")
    page.wait_for_load_state("networkidle")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    broken = "[...document.images].filter(one => one.complete && !one.naturalWidth).map(i => i.src)"
    assert page.evaluate(broken) == []


def test_formulas_are_typeset(page):
    page.goto(f"file://{SITE}/theory/contact.html")
    page.wait_for_selector("mjx-container svg", state="attached")
    assert page.locator("mjx-merror, [data-mjx-error]").count() == 0


def test_search_finds_pages(page):
    page.goto(f"file://{SITE}/search.html?q=friction")
    page.wait_for_selector("#search-results li a")
    assert page.locator("#search-results li a").count() > 5


@pytest.mark.parametrize("name", NAMES)
def test_public_name_is_in_the_reference(name):
    assert (SITE / "reference" / "api" / f"fixel.{name}.html").exists()
