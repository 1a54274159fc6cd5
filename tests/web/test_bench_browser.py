"""The page of the bench, in a real browser, before an emulated laboratory."""

import json
import re
import time

import pytest
from tests.fixtures import short_plan
from tests.jobs.helpers import await_true

from fixel.database.project import Project
from fixel.formats.plan_file import plan_text
from fixel.sampling import thesis_plan
from fixel.web.bench_session import LOST

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("small_laboratory")]

PATIENCE = 180.0  # [s]


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return Project.create(tmp_path_factory.mktemp("bench") / "lab").folder


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Two quick pushes in place of the plan that a form performs."""
    plan = short_plan(thesis_plan().name)
    monkeypatch.setattr("fixel.sampling.thesis_plan", lambda: plan)


@pytest.fixture
def session(server):
    """The bench of the server, which ends in any case."""
    yield server.context.bench
    server.context.bench.close()


def until(condition, page, patience=PATIENCE):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, page.inner_text("#side")
        page.wait_for_timeout(50)


def begin(page, server, name):
    """Start a campaign by the form."""
    page.goto(server.home + "bench?new=1")
    page.click("details summary")
    page.select_option("#emulated", "yes")
    page.fill("#name", name)
    page.fill("#fit", "mu_support")
    page.click("button:has-text('Start')", no_wait_after=True)
    page.wait_for_selector("button[data-do=place]", timeout=1e3 * PATIENCE)


def place(page):
    """Press *Move the part* until the page offers to push."""

    def placed():
        if page.locator("button[data-do=push]").count():
            return True
        button = page.locator("button[data-do=place]:enabled")
        if button.count():
            button.click(timeout=5000)
        page.wait_for_timeout(700)
        return False

    until(placed, page)


def phase(session):
    return json.loads(session.view.report)["phase"]


def test_a_row_is_placed_pushed_tracked_accepted_and_calibrated(
    browser_page, server, session, faults
):
    page = browser_page
    begin(page, server, "whole")
    assert "not" not in page.inner_text("#link-state")
    assert page.evaluate("document.querySelector('#picture').naturalWidth") > 300
    assert faults(page) == []
    place(page)
    assert page.locator("#checks [data-state=off]").count() == 0
    page.click("button[data-do=push]")
    page.wait_for_selector("button[data-do=stop]")
    page.wait_for_selector("[data-attempt] [data-state=accepted]", timeout=1e3 * PATIENCE)
    page.wait_for_selector("#estimates:has-text('mu_support')", timeout=1e3 * PATIENCE)
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 800})
        page.wait_for_timeout(300)
        assert faults(page) == []
        heading = page.locator("h1:has-text('Bench: whole')")  # the navigation left no space for it
        assert heading.evaluate("own => own.clientWidth >= own.scrollWidth && own.clientWidth > 60")
    page.click("button[data-do=end]")
    page.wait_for_selector("#finish", timeout=1e3 * PATIENCE)
    until(lambda: not session.running, page)
    page.goto(server.home + "bench")
    assert faults(page) == []
    page.click("#attempts a")
    page.wait_for_url("**/experiments/1")
    page.goto(server.home + "bench?new=1")
    assert page.inner_text("tr:has-text('whole')").split() == ["whole", "1", "0", "1"]


def test_the_button_stops_the_drive(browser_page, server, session, faults):
    page = browser_page
    begin(page, server, "stopped")
    place(page)
    page.click("button[data-do=push]")
    page.click("button[data-do=stop]")
    page.wait_for_selector("#problems:has-text('stopped by the person')")
    assert not session.loop.devices.drive.moving
    assert faults(page) == []
    page.click("button[data-do=again]")
    page.wait_for_selector("button[data-do=place]")


@pytest.mark.parametrize("begin_of", ["press", "release"])
def test_a_slow_press_of_the_button_stops_the_drive(browser_page, server, session, begin_of):
    """The status came 20 times per second, and replaced the button between press and release."""
    page = browser_page
    begin(page, server, f"slow-{begin_of}")
    source = session.loop.devices.laboratory.advance
    session.loop.devices.laboratory.advance = lambda: (time.sleep(0.1), source())[1]
    if begin_of == "release":  # a click alone has to do, as on other buttons
        listen = "addEventListener('pointerdown', (own) => own.stopImmediatePropagation(), true)"
        page.evaluate(listen)
    place(page)
    page.click("button[data-do=push]")
    page.wait_for_selector("#side p:has-text('frames,')")
    box = page.locator("button[data-do=stop]").bounding_box()
    page.mouse.move(box["x"] + 10.0, box["y"] + 10.0)
    page.mouse.down()
    frames = page.inner_text("#side p:has-text('frames,')")
    until(lambda: frames not in page.inner_text("#side"), page)  # a status came
    page.mouse.up()
    page.wait_for_selector("#problems:has-text('stopped by the person')")
    assert not session.loop.devices.drive.moving


def test_a_page_that_is_closed_during_a_push_stops_the_drive(browser_page, server, session):
    page = browser_page
    begin(page, server, "lost")
    # Slow enough, in accelerated time, that the page is lost during the push.
    source = session.loop.devices.laboratory.advance
    session.loop.devices.laboratory.advance = lambda: (time.sleep(0.3), source())[1]
    place(page)
    page.click("button[data-do=push]")
    page.wait_for_selector("button[data-do=stop]")
    page.goto("about:blank")
    await_true(lambda: phase(session) == "trouble", "the loss to be noticed", PATIENCE)
    problem = json.loads(session.view.report)["problems"][0]
    found = re.fullmatch(r"the page has not answered for ([0-9.]+) s", problem)
    # A busy machine notices it later; never before the page could have been heard again.
    assert found, problem
    assert float(found[1]) >= LOST
    assert not session.loop.devices.drive.moving


def check(page, server, name):
    """Start a check of the bench by the form."""
    page.goto(server.home + "bench?new=1")
    page.click("details summary")
    for field in ("emulated", "check"):
        page.select_option("#" + field, "yes")
    page.fill("#name", name)
    page.click("button:has-text('Start')", no_wait_after=True)
    page.wait_for_selector("#side", timeout=1e3 * PATIENCE)


def test_a_check_shows_what_it_measured_and_that_it_ended(browser_page, server, session, faults):
    page = browser_page
    check(page, server, "checked")
    page.wait_for_selector("a:has-text('Perform another plan')", timeout=1e3 * PATIENCE)
    cells = page.locator("#figures tr:has-text('camera noise')").first.locator("td").all()
    value, unit = cells[0].inner_text().split()
    assert 0.0 < float(value) < 0.1
    assert unit == "mm"
    assert cells[2].inner_text() == "good"
    assert page.locator("#figures tbody tr").count() == 8
    assert page.locator("[data-post]").count() == 0  # nothing answers them any more
    assert faults(page) == []


def test_a_check_ends_with_the_page_that_began_it(browser_page, server, session):
    page = browser_page
    check(page, server, "left")
    drive = session.loop.devices.drive
    await_true(lambda: drive.moving, "the head to move", PATIENCE)
    page.goto("about:blank")
    await_true(lambda: not session.running, "the check to end", PATIENCE)
    assert re.fullmatch(r"the page has not answered for [0-9.]+ s", session.trouble)
    assert not drive.moving
    page.goto(server.home + "bench")
    assert session.trouble in page.inner_text("#problems")
    assert page.locator("[data-post]").count() == 0


def test_a_fault_of_the_form_is_shown_at_its_field(browser_page, server, faults):
    page = browser_page
    page.expected_problems = ["422"]
    (server.context.project.folder / "mine.yaml").write_text(plan_text(short_plan("mine")))
    page.goto(server.home + "bench?new=1")
    page.select_option("#plan", "mine.yaml")
    page.click("details summary")
    page.fill("#rig", "no-such")
    page.click("button:has-text('Start')")
    page.wait_for_selector("#rig[aria-invalid=true]")
    assert page.input_value("#plan") == "mine.yaml"  # else the next start performs another plan
    assert "no file 'no-such'" in page.inner_text("#about-rig")
    assert faults(page) == []
