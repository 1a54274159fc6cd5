"""The form of next pushes and its result, in a real browser."""

import pytest
from tests.fixtures import project_of

from fixel.testing.pushes import example_parts

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts") / "my_lab"
    project_of(folder, example_parts(4, 14))
    return folder


def test_pushes_are_proposed_and_shown_with_what_is_unseen_first(browser_page, server):
    page = browser_page
    page.click("nav >> text=Next pushes")
    assert page.locator("#offered-part option").count() == 4
    page.fill("#part", "part-2")
    page.fill("#number", "4")
    page.click("text=Start")
    page.click("#result", timeout=120_000)
    page.wait_for_load_state("load")  # with its style
    page.wait_for_selector(".problems")
    assert "only 14 pushes of it" in page.inner_text(".problems li >> nth=0")
    rows = page.locator("table tbody tr")
    assert rows.count() == 4
    assert " / " in rows.nth(0).inner_text()  # both bounds
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
