"""The page of plans, in a real browser."""

from urllib.parse import unquote_plus

import pytest
from tests.fixtures import project_of

from fixel.testing.pushes import example_pushes

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "my_lab"
    project_of(folder, example_pushes(2, duration=1.0))
    return folder


def test_a_goal_is_dragged_planned_shown_and_tried(browser_page, server):
    page = browser_page
    page.goto(server.home + "plan")
    page.wait_for_selector("#stage .goal")
    before = float(page.input_value("#x_mm"))
    box = page.locator("#stage .goal").bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 30, middle[1], steps=4)
    page.mouse.up()
    assert float(page.input_value("#x_mm")) > before + 1.0
    page.fill("#x_mm", str(before))
    assert page.input_value("#rollouts") == "160000"
    fields = {"position_mm": 2, "tolerance_deg": 3, "rollouts": 2000, "seen_mm": 0.7}
    for name, value in fields.items():
        page.fill(f"#{name}", str(value))
    with page.expect_request("**/run/plan") as sent:
        page.click("#start")
    camera = '"camera":{"x_mm":0.7,"y_mm":0.7,"theta_deg":0,"kind":"normal"}'
    assert camera in unquote_plus(sent.value.post_data)
    page.click("#result", timeout=120_000)
    page.wait_for_selector("#of-plan")
    assert "success probability" in page.inner_text("#content")
    assert "Causes of failures" in page.inner_text("#content")
    assert page.locator("figure img").count() == 3
    page.click("#try")
    page.wait_for_selector("#trials:has-text('20 trials')")
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
