"""Calibrations and the domain, in a real browser."""

import re

import pytest
from tests.laboratories import trusted_laboratory
from tests.web.conftest import page_fixture
from tests.web.test_play_browser import TRIP

from fixel.database.project import Project
from fixel.workflows.calibration.stored import stored_calibration

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return trusted_laboratory(tmp_path_factory.mktemp("copy") / "my_lab")


domain = page_fixture("domain", "#panels td")
one = page_fixture("calibrations/1", "#calibration")


def evaluations(page):
    return int(re.sub(r"\D", "", page.inner_text("#evaluations")))


def until_more(page, than):
    page.wait_for_function(
        "n => Number(document.querySelector('#evaluations')?.textContent.replace(/\\D/g, '')) > n",
        arg=than,
        timeout=60_000,
    )


# --- calibrations -------------------------------------------------------------------------------


def test_a_calibration_is_begun_watched_stopped_and_resumed(browser_page, server):
    page = browser_page
    page.click("nav >> text=Calibrations")
    page.wait_for_selector("#rows tr")
    page.click("text=Calibrate…")
    page.click("summary >> text=Options")
    page.fill("#where", "shape=square")
    page.fill("#fit", "mu_pusher\nmu_fixel\ntripod_radius_mm=10:60")
    page.fill("#name", "seen")
    page.fill("#starts", "9")
    page.select_option("#optimiser", "pattern-search")
    page.select_option("#verdicts", "no")
    page.click("button[type=submit]")  # simulates a few experiments first
    page.wait_for_selector("#calibrating")
    until_more(page, 10)
    assert page.get_attribute(".graph path.best", "d").startswith("M")
    assert "best so far" in page.inner_text(".figures")
    assert "evaluations/s" in page.inner_text(".figures")
    page.click("#stop")
    page.wait_for_selector("#calibrating[data-state=cancelled]")
    assert "Resume continues from there" in page.inner_text(".notice")
    before = evaluations(page)
    page.click("nav >> text=Calibrations")
    page.wait_for_selector("#running >> text=seen")
    page.click("#running a")
    page.wait_for_selector("#resume:visible")
    page.click("#resume")
    until_more(page, before)
    page.click("#stop")
    page.wait_for_selector("#calibrating[data-state=cancelled]")


def test_a_form_is_sent_once_its_script_listens_and_shows_why_it_was_refused(browser_page, server):
    page = browser_page
    page.expected_problems.append("422")
    slow = []
    # Playwright sets an attribute of the function, which `slow.append` cannot have.
    page.route("**/static/page.js", lambda route: slow.append(route))
    asked = "run/calibrate?experiments=6&experiments=7&fit=mu_pusher%3D1:-1"
    page.goto(server.home + asked, wait_until="commit")
    page.wait_for_selector("button[type=submit]", state="attached")
    with pytest.raises(Exception, match="Timeout 2000ms"):
        page.click("button[type=submit]", timeout=2000)
    slow[0].continue_()
    page.click("button[type=submit]")
    page.wait_for_selector("#fit[aria-invalid=true]")
    assert "fit mu_pusher: found bounds 1 to -1" in page.inner_text("#about-fit")
    assert page.input_value("#experiments").split() == ["6", "7"]


def test_the_page_shows_the_report_and_leads_to_the_worst_experiments(one, project):
    shown = stored_calibration(Project(project), 1).analysis
    assert one.locator(".result tbody tr").count() == len(shown.tables[0].rows)
    text = one.inner_text("#calibration")
    assert all(word in text for word in (*shown.headline, *shown.warnings, *shown.notes))
    drawn = "async image => { image.loading = 'eager'; await image.decode(); return image.width }"
    pictures = one.locator(".pictures img").all()
    assert len(pictures) == 3
    assert all(picture.evaluate(drawn) > 100 for picture in pictures)
    assert one.locator(".bars tbody tr").count() == 6
    link = one.locator(".worst a").first
    key = link.inner_text()
    link.click()
    one.wait_for_selector("#experiment")
    assert one.inner_text("h1") == key


# --- the domain ---------------------------------------------------------------------------------


def test_the_threshold_slider_repaints_the_map(domain):
    command = "document.getElementById('copy-command').dataset.copy"
    for _ in range(6):
        domain.evaluate(TRIP, ["slider", -100])
    low = domain.inner_text("#found")
    domain.focus("#slider")
    domain.keyboard.press("End")
    domain.wait_for_function(
        "before => document.getElementById('found').innerText !== before", arg=low
    )
    box = domain.locator("#slider").bounding_box()
    domain.mouse.move(box["x"] + box["width"] - 8, box["y"] + box["height"] / 2)
    domain.mouse.down()
    domain.mouse.move(box["x"] + 10, box["y"] + box["height"] / 2, steps=10)
    domain.mouse.up()
    domain.wait_for_function(
        f"() => {command}.includes(` ${{document.getElementById('threshold').value}} `)"
    )
    assert domain.locator("td.trusted").count() == 0


def test_the_map_has_signs_and_keys_for_who_sees_no_colour_and_has_no_mouse(domain):
    signs = {"trusted": "✓", "doubtful": "?", "not-trusted": "✕"}
    cells = domain.locator("td[role]")
    assert cells.count() >= 6
    for k in range(cells.count()):
        kind = cells.nth(k).get_attribute("class").split()[0]
        assert cells.nth(k).locator(".sign").inner_text() == signs.get(kind, "")
        assert cells.nth(k).locator("button").get_attribute("aria-label")
    column = "document.activeElement.closest('td').cellIndex"
    domain.locator("td [tabindex='0']").first.focus()
    start = domain.evaluate(column)
    domain.keyboard.press("ArrowRight" if start == 1 else "ArrowLeft")
    assert abs(domain.evaluate(column) - start) == 1
    domain.keyboard.press("Enter")
    domain.wait_for_selector("td.picked")
    assert domain.locator("td.picked").count() == 1
    assert abs(domain.evaluate(column) - start) == 1


def test_a_cell_shows_its_experiments(domain):
    cell = domain.locator("td:has(.dots:not(:empty))").first
    cell.click()
    link = domain.locator("#cell .members a").first
    assert domain.locator("#cell .members .number").first.inner_text().split()[1] == "mm"
    key = link.inner_text()
    link.click()
    domain.wait_for_selector("#experiment")
    assert domain.inner_text("h1") == key


def test_the_next_experiment_and_other_axes_are_offered(domain):
    domain.wait_for_selector("#next .after")
    assert "fixel domain" in domain.inner_text("#next code")
    domain.click("text=Change axes")
    domain.wait_for_selector("h1")
    assert domain.input_value("[name=threshold]") == "6.0"


def test_no_map_yet(browser_page, server, project):
    (project / "analyses").rename(project / "aside")
    try:
        browser_page.goto(server.home + "domain")
        assert "fixel domain" in browser_page.inner_text("#nothing")
        assert browser_page.is_visible("text=Make a map")
    finally:
        (project / "aside").rename(project / "analyses")


# --- nominal against calibrated -------------------------------------------------------------------


def test_an_experiment_and_a_comparison_open_with_nominal_against_calibrated(browser_page, server):
    page = browser_page
    page.goto(server.home + "experiments/7")
    page.wait_for_selector("#figures td")
    heads = page.locator("#figures thead th").all_inner_texts()
    assert [head.strip() for head in heads] == ["nominal", "calibrated"]
    before, after = page.locator("#figures tbody tr:first-child td").all_inner_texts()
    assert float(after) < float(before)  # it was calibrated on this experiment
    assert "calibrated on this experiment" in page.inner_text("#which")
    page.goto(server.home + "compare?experiment=id:7")
    page.wait_for_selector("#sets svg")
    shown = [row.get_attribute("data-set") for row in page.locator("#sets tr").all()]
    assert shown[:2] == ["adjusted", "nominal"]
    assert shown[2].startswith("calibration-")


def test_jobs_fit_on_a_phone(browser_page, server):
    page = browser_page
    page.set_viewport_size({"width": 390, "height": 800})
    page.goto(server.home + "jobs")
    wide = page.evaluate(
        """() => [...document.querySelectorAll('tbody tr, tbody td, tbody th, #table')]
            .map((one) => one.getBoundingClientRect().right)"""
    )
    assert max(wide) <= 390
    # In one call: a cell that is found first may be replaced before its style is read.
    shown = page.evaluate(
        """() => getComputedStyle(
            document.querySelector('tbody td[data-label=workers]'), '::before').content"""
    )
    assert "workers" in shown or "data-label" in shown
