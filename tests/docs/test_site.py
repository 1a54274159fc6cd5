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


def test_search_lists_how_tos_before_decisions(page):
    page.goto(f"file://{SITE}/search.html?q=calibrate")
    page.wait_for_selector("#search-results li a[href*='decisions/']")
    found = page.locator("#search-results li a")
    places = [link.get_attribute("href").split("/")[0] for link in found.all()]
    assert places.index("decisions") > len(places) - 1 - places[::-1].index("how-to")


def test_wide_formulas_fit_a_phone(page):
    page.goto(f"file://{SITE}/theory/domain.html")
    page.wait_for_selector("mjx-container svg", state="attached")
    widths = (
        "[...document.querySelectorAll('div.math svg')].map(e => e.getBoundingClientRect().right)"
    )
    assert max(page.evaluate(widths)) <= 390


def test_code_fits_a_laptop(page):
    page.set_viewport_size({"width": 1280, "height": 800})
    wide = "[...document.querySelectorAll('pre')].filter(e => e.scrollWidth > e.clientWidth)"
    pages = [SITE / "index.html", SITE / "get-started.html", *(SITE / "tutorials").glob("*.html")]
    pages += (SITE / "how-to").glob("*.html")
    for file in pages:
        page.goto(f"file://{file}")
        assert page.evaluate(f"{wide}.map(e => e.innerText)") == [], file.name


def test_code_is_copied_without_prompts_and_outputs_are_not(page):
    page.goto(f"file://{SITE}/tutorials/first_push.html")
    page.wait_for_selector(".highlight-python button.copybtn", state="attached")
    assert page.locator(".highlight-text button.copybtn").count() == 0
    page.goto(f"file://{SITE}/reference/api/fixel.Scene.html")
    page.evaluate("document.addEventListener('copy', e => window.copied = e.target.value)")
    page.locator(".doctest button.copybtn").first.dispatch_event("click")
    assert page.evaluate("window.copied").startswith("from fixel.model import Disk")


@pytest.mark.parametrize(("name", "target"), [
    ("tutorials/first_push", "../reference/api/fixel.Polygon.html#fixel.Polygon.rectangle"),
    ("tutorials/trust", "../reference/api/fixel.map_domain.html#fixel.map_domain"),
    ("how-to/plan", "../reference/api/fixel.FreePushes.html#fixel.FreePushes"),
    ("reference/api/fixel.Simulation", "https://numpy.org/doc/stable/"),
    ("reference/api/fixel.Simulation", "../../_modules/fixel/simulation/result.html"),
    ("tutorials/plan", "plan.ipynb"),
])  # fmt: skip
def test_page_links_to(page, name, target):
    page.goto(f"file://{SITE}/{name}.html")
    assert page.locator(f"article a[href*='{target}']").count() > 0
    assert page.locator(".navbar-brand").first.inner_text().strip() == f"fixel {fixel.__version__}"
    assert page.locator("link[rel=icon]").count() == 1


@pytest.mark.parametrize("name", NAMES)
def test_public_name_is_in_the_reference(name):
    assert (SITE / "reference" / "api" / f"fixel.{name}.html").exists()
