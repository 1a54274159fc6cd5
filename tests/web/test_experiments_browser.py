"""The pages of experiments in a real browser: table, filter, marks, undo, keys, scrubbing."""

import re

import pytest
from tests.fixtures import bare_experiment
from tests.web.conftest import SCRIPTS, page_fixture

from fixel.model import Flag, Provenance
from fixel.workflows.project.filters import view_of

pytestmark = pytest.mark.system

ROW = "tr[data-id]"


def names(page):
    return page.locator(f"{ROW} .named a").all_inner_texts()


def total(page):
    return int(re.match(r"[\d\u202f]+", page.inner_text("#counted"))[0].replace("\u202f", ""))


def wait_for_total(page, wanted):
    page.wait_for_function(
        "wanted => document.getElementById('counted').textContent.startsWith(`${wanted} exp`)",
        arg=wanted,
    )


@pytest.fixture
def table(browser_page):
    browser_page.wait_for_selector(ROW)
    return browser_page


def test_the_table_shows_runs_and_sorts(table):
    assert table.url.endswith("/experiments")
    assert total(table) == 30
    assert table.locator(f"{ROW} img").first.evaluate(
        "async image => { await image.decode(); return image.naturalWidth > 0 }"
    )
    table.click("th.name a")
    table.wait_for_selector("th.name[aria-sort=ascending]")
    table.click("th.name a")
    table.wait_for_function("() => location.search.includes('descending')")
    table.wait_for_selector("th[aria-sort=descending]")
    shown = names(table)
    assert shown == sorted(shown, reverse=True)


def test_filtering_as_one_types(table):
    table.keyboard.press("/")
    table.keyboard.type("shape=pentagon")
    table.wait_for_function("() => location.search.includes('pentagon')")
    table.wait_for_function(
        "() => [...document.querySelectorAll('td.shape')]"
        ".every(cell => cell.textContent.includes('pentagon'))"
    )
    assert total(table) < 30
    table.expected_problems = ["422"]
    table.fill("#filter", "is:odd")
    table.wait_for_selector("#filter-problem:not([hidden])")
    assert "must be one of clean" in table.inner_text("#filter-problem")
    table.fill("#filter", "nothing is like this")
    table.wait_for_selector("#nothing")
    table.keyboard.press("Escape")
    table.click("#clear")
    wait_for_total(table, 30)
    assert table.is_hidden("#filter-problem")
    table.fill("#filter", "shape=pentagn")
    table.click("#meant:has-text('shape=pentagon')")
    table.wait_for_function("() => document.getElementById('filter').value === 'shape=pentagon'")
    table.wait_for_selector(ROW)


def test_picking_and_coverage(table):
    table.select_option("[data-pick=shape]", "square")
    table.wait_for_selector("[data-pick=shape].set")
    table.click("#show-coverage")
    table.wait_for_selector("#coverage")
    place = table.locator(".place").first
    wanted = int(re.match(r"\d+", place.get_attribute("aria-label"))[0])
    place.click()
    table.wait_for_selector(".place.here")
    assert "offset_x_m>=" in table.input_value("#filter")
    # The coverage is of all shapes, for its own table chooses among them.
    assert 0 < total(table) <= wanted
    table.locator(".place.here").click()
    table.wait_for_function("() => document.getElementById('filter').value === 'shape=square'")


def test_keys_move_select_delete_and_undo(table):
    first, second = table.locator(ROW).nth(0), table.locator(ROW).nth(1)
    assert "active" in first.get_attribute("class")
    table.keyboard.press("j")
    assert "active" in second.get_attribute("class")
    table.keyboard.press("x")
    assert table.inner_text("#chosen") == "1 selected"
    number = second.get_attribute("data-id")
    table.keyboard.press("Delete")
    wait_for_total(table, 29)
    assert table.locator(f"tr[data-id='{number}']").count() == 0
    table.keyboard.press("Control+z")
    wait_for_total(table, 30)
    table.wait_for_selector(f"tr[data-id='{number}']")
    table.keyboard.press("k")
    table.keyboard.press("Enter")
    table.wait_for_url("**/experiments/1")


def test_deleted_ones_are_shown_and_restored_and_not_calibrated(table):
    table.locator(f"{ROW} td.select").nth(2).click()
    table.locator(f"{ROW} td.select").nth(5).click(modifiers=["Shift"])
    table.wait_for_selector("#chosen:text-is('4 selected')")  # painted after the click
    table.click("#act-delete")
    wait_for_total(table, 26)
    table.select_option("[data-pick=is]", "deleted")
    wait_for_total(table, 4)
    table.keyboard.press("x")
    assert table.is_hidden("#act-calibrate")
    table.keyboard.press("c")
    assert table.url.endswith("filter=is%3Adeleted")
    table.keyboard.press("x")
    table.check("#all")
    table.click("#act-delete")
    table.wait_for_selector("#nothing")
    table.click("#clear")
    wait_for_total(table, 30)


def test_calibrating_the_selected_ones(table):
    for place in (3, 6):
        table.locator(f"{ROW} td.select").nth(place).click()
    ids = [table.locator(ROW).nth(place).get_attribute("data-id") for place in (3, 6)]
    table.click("#act-calibrate")
    table.wait_for_url(f"**/run/calibrate?experiments={'&experiments='.join(ids)}")
    assert table.input_value("#experiments").split() == ids
    table.go_back()
    table.wait_for_selector(ROW)
    table.keyboard.press("j")
    table.keyboard.press("c")  # the one that the keys are on
    table.wait_for_url("**/run/calibrate?experiments=2")


def test_errors_before_are_made_for_those_that_have_none(table, server):
    table.fill("#filter", "shape=square")
    wanted = server.context.store.unsimulated_ids(view_of("shape=square"))
    table.click(f"#simulate:has-text('Simulate {len(wanted)} experiments')")
    table.wait_for_selector(f"text=Simulated {len(wanted)} experiments")
    table.wait_for_selector("#simulate", state="hidden")
    table.wait_for_function("() => !document.querySelector('td.before.unknown')")
    assert server.context.store.unsimulated_ids(view_of("shape=square")) == []


def test_flagging_many_with_undo_by_the_toast(table):
    table.locator(f"{ROW} td.select").nth(0).click()
    table.locator(f"{ROW} td.select").nth(1).click()
    table.keyboard.press("f")
    table.fill("#flag-name", "slipped")
    table.fill("#flag-detail", "before the pusher came")
    table.keyboard.press("Enter")
    table.wait_for_selector("text=Flagged 2 experiments as slipped.")
    table.wait_for_selector("tr[data-id='2'] .tag.fault:has-text('slipped')")
    assert table.locator(".tag.fault", has_text="slipped").count() == 2
    table.click(".toast button.undo")
    table.wait_for_function(
        "() => !document.querySelector('td.marks').textContent.includes('slipped')"
    )


def test_acts_are_taken_back_one_after_the_other(table):
    for name in ("first-flag", "second-flag"):
        table.locator(f"{ROW} td.select").nth(8).click()
        table.keyboard.press("f")
        table.fill("#flag-name", name)
        table.keyboard.press("Enter")
        table.wait_for_selector(f"tr[data-id='9'] .tag.fault:has-text('{name}')")
    table.locator(".toast", has_text="second-flag").locator("[aria-label=Close]").click()
    table.keyboard.press("Control+z")  # of the older one, whose message is still there
    table.wait_for_function(
        "() => !document.querySelector(\"tr[data-id='9']\").textContent.includes('first-flag')"
    )
    assert "second-flag" in table.inner_text("tr[data-id='9']")
    assert table.locator(".toast", has_text="first-flag").count() == 0


def test_a_late_answer_is_not_drawn_over_the_newest(table):
    held = []
    table.route("**/experiments?filter=contacts%3D000", lambda route: held.append(route))
    with table.expect_request("**/experiments?filter=contacts%3D000"):
        table.fill("#filter", "contacts=000")
    with table.expect_response("**/experiments?filter=contacts%3D111"):
        table.fill("#filter", "contacts=111")
    table.wait_for_function("() => location.search.includes('111')")
    shown = names(table)
    for route in held:
        route.continue_()
    table.wait_for_timeout(300)
    assert names(table) == shown


def test_a_long_table_has_pages(table, server):
    store = server.context.store
    many = (bare_experiment(f"{k:04d}", dataset="many") for k in range(130))
    made = [store.add_experiment(one).id for one in many]
    try:
        table.goto(server.home + "experiments?filter=dataset:many")
        wait_for_total(table, 130)
        assert table.locator(ROW).count() == 100
        table.check("#all")
        table.wait_for_function(
            "() => document.getElementById('chosen').textContent === '130 selected'"
        )
        table.click("#page-after")
        table.wait_for_selector("text=0129")
        assert table.locator(ROW).count() == 30
        assert table.locator("tr[aria-selected=true]").count() == 30
        table.click("#page-before")
        table.wait_for_selector("text=0000")
    finally:
        store.delete(made)


# --- one experiment -----------------------------------------------------------------------------


one = page_fixture("experiments/1", "#figures td")


def test_an_experiment_has_its_simulation_a_player_and_neighbours(one):
    assert "simulation 1, nominal values" in one.inner_text("#which")
    assert one.locator(".legend li").count() == 2
    assert "mm" in one.inner_text("#figures")
    assert one.locator("#charts svg.panel").count() == 6
    charts = one.locator("#charts").bounding_box()
    one.mouse.move(charts["x"] + charts["width"] / 2, charts["y"] + 150)
    one.mouse.down()
    one.mouse.move(charts["x"] + charts["width"] * 0.8, charts["y"] + 150)
    one.mouse.up()
    time = one.evaluate("document.getElementById('player').player.time")
    assert 6.0 < time < 11.0
    assert f"{time:.2f} s" in one.inner_text("#player .time")
    one.keyboard.press("Space")
    one.wait_for_function("t => document.getElementById('player').player.time > t", arg=time)
    one.keyboard.press("Space")
    one.keyboard.press("j")
    one.wait_for_url("**/experiments/2")
    one.wait_for_selector("#previous[href]")
    one.wait_for_load_state("networkidle")
    one.keyboard.press("k")
    one.wait_for_url("**/experiments/1")


def test_notes_and_flags_of_one(one):
    one.keyboard.press("n")
    one.fill("#note-text", SCRIPTS[0] + "\nsecond line")
    one.click("#note-form .primary")
    one.wait_for_selector("#notes li:has-text('second line')")
    assert SCRIPTS[0] in one.inner_text("#notes")
    assert one.evaluate("window.hacked") is None
    one.keyboard.press("Control+z")
    one.wait_for_selector("#notes li:has-text('No notes')")
    one.click("#flag")
    one.fill("#flag-name", "odd-one")
    one.uncheck("#flag-fault")
    one.click("#flag-form .primary")
    one.wait_for_selector("#flags .tag:not(.fault)")
    one.click("#flags button")
    one.wait_for_function("() => !document.querySelector('#flags .tag')")


def test_names_are_never_markup(browser_page, server):
    store = server.context.store
    evil = bare_experiment(
        SCRIPTS[1],
        dataset=SCRIPTS[0],
        provenance=Provenance(version="0", command=SCRIPTS[0], source=SCRIPTS[1]),
        conditions={"shape": SCRIPTS[0], "layout": SCRIPTS[1], "x": SCRIPTS[0]},
        flags=(Flag("late", SCRIPTS[0]),),
    )
    made = store.add_experiment(evil).id
    try:
        for path in ("experiments?filter=late", f"experiments/{made}"):
            browser_page.goto(server.home + path)
            browser_page.wait_for_selector(f"{ROW} :text('onerror')" if "?" in path else "dd")
            browser_page.wait_for_selector(":text('late')")
            browser_page.wait_for_load_state("networkidle")
            assert browser_page.evaluate("window.hacked") is None
    finally:
        store.delete([made])


def test_progress_survives_a_change_of_the_filter(table, server):
    waiting = []
    table.route("**/experiments/simulate", lambda route: waiting.append(route))
    table.click("#simulate")
    table.wait_for_selector("#simulate:text-is('Stop')")
    table.fill("#filter", "shape=pentagon")
    wait_for_total(table, 15)
    assert table.inner_text("#simulate") == "Stop"
    assert table.inner_text("#simulating").startswith("simulated 0 of")
    table.click("#simulate")
    waiting[0].fulfill(json={"stored": [], "refused": {}})
    table.wait_for_selector("#simulate:has-text('with nominal values')")
    assert table.inner_text("#simulating") == ""


def test_what_is_selected_elsewhere_is_counted(table):
    table.locator(f"{ROW} td.select").nth(0).click()
    table.wait_for_selector("#chosen:text-is('1 selected')")
    table.fill("#filter", "shape=pentagon")
    table.wait_for_selector("#elsewhere:text-is('1 not in these rows')")
    assert table.inner_text("#chosen") == "1 selected"


def test_no_box_is_ticked_after_going_back(table, server):
    table.locator(f"{ROW} td.select").nth(0).click()
    table.wait_for_selector("#acts:not([hidden])")
    table.goto(server.home + "api")
    table.go_back()
    table.wait_for_selector(ROW)
    table.wait_for_timeout(300)
    assert table.locator(f"{ROW} input:checked").count() == 0


def test_a_change_does_not_take_back_what_is_typed_meanwhile(table):
    """The parts that are fetched after a change belong to the filter of now."""
    held, released = [], []

    def hold(route):
        if released:  # on a busy machine the page asks for its parts later than below
            route.continue_()
        else:
            held.append(route)

    table.route("**/experiments?filter=*", hold)
    table.route("**/experiments/flag", hold)
    table.keyboard.press("f")
    table.fill("#flag-name", "meanwhile")
    table.click("#flag-form button.primary")
    while not held:
        table.wait_for_timeout(20)
    table.fill("#filter", "shape=pentagon")
    while len(held) < 2:
        table.wait_for_timeout(20)
    held[0].continue_()
    table.wait_for_timeout(500)
    released.append(True)
    for route in held[1:]:
        route.continue_()
    wait_for_total(table, 15)
    table.click(".toast .undo")
