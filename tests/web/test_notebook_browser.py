"""Players in cells of an exported notebook, in a browser without a network."""

import pytest
from tests.web.conftest import opened_page

from fixel.simulation import simulate
from fixel.testing.scenes import grasp

pytestmark = pytest.mark.system


def test_players_of_two_cells_play_apart(chromium, tmp_path):
    cell = simulate(grasp("seated"), duration=2.0).animate()._repr_html_()
    (tmp_path / "notebook.html").write_text(f"<!doctype html><body>{cell}<p>{cell}", "utf-8")
    small = {"width": 700, "height": 1000}
    with opened_page(chromium, offline=True, viewport=small) as page:
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"file://{tmp_path}/notebook.html")
        one, other = (page.frame_locator("iframe").nth(k) for k in (0, 1))
        rest, before = (player.locator("canvas").screenshot() for player in (one, other))

        one.get_by_role("button", name="Play").click()
        one.locator("output", has_text="2.00 s").wait_for(timeout=20_000)

        assert one.locator("canvas").screenshot() != rest
        assert other.locator("canvas").screenshot() == before
        assert other.locator("output").inner_text() == "0.00 s"
        other.get_by_role("slider").fill("1.5")
        assert other.locator("output").inner_text() == "1.50 s"
        assert [url for url in asked if not url.startswith("file:")] == []
