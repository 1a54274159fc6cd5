"""The page of next pushes, in a real browser."""

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
    assert "no proposal yet" in page.inner_text("#content")
    page.wait_for_load_state()  # before its scripts have run, the button does nothing
    page.select_option("#part", "part-2")
    page.fill("#number", "4")
    page.click("#start")
    page.wait_for_selector("svg.pushes", timeout=90_000)
    page.wait_for_load_state()  # before its styles have arrived, the table is wider than a phone
    assert page.locator("svg.pushes .head").count() == 4
    assert "only 14 pushes of it" in page.inner_text("#unseen li >> nth=0")
    rows = page.locator("table.listing tbody tr")
    assert rows.count() == 4
    assert " / " in rows.nth(0).inner_text()  # both bounds
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_the_same_question_again_shows_the_stored_proposal(browser_page, server):
    page = browser_page
    page.goto(server.home + "next")
    page.select_option("#part", "part-2")
    page.fill("#number", "4")
    with page.expect_navigation(timeout=60_000):
        page.click("#start")
    assert page.locator("svg.pushes .head").count() == 4
    assert page.locator("#which").count() == 0  # one proposal
