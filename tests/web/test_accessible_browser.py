"""Every page for everybody: axe-core's rules, light and dark, wide and narrow; and the keyboard.

One look of each page here; all four with

    make test-slow PYTEST_ARGS=tests/web/test_accessible_browser.py
"""

import pytest
from tests.laboratories import trusted_laboratory
from tests.web.conftest import width_fault

from fixel.testbed.recorder import RecordingStatus
from fixel.testing.toy_work import MAKER
from fixel.web.live import LiveView
from fixel.web.live_pages import RecordPreview, overlay_page
from fixel.web.serve import WebServer
from fixel.workflows import jobs

pytestmark = pytest.mark.system

WIDE, NARROW = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
SMALL = {"width": 320, "height": 568}
LOOKS = [("light", WIDE), ("dark", NARROW)]
OTHER_LOOKS = [("dark", WIDE), ("light", NARROW)]
PATIENCE = 60_000  # [ms]

# What can be reached; of a group of radio buttons or tabs, one.
REACHABLE = """() => {
  const wanted = "a[href], button, input, select, textarea, summary, [tabindex]";
  const rect = (node) => node.getBoundingClientRect();
  const groups = new Set();
  const seen = [...document.querySelectorAll(wanted)].filter((node) => {
    if (node.disabled || node.tabIndex < 0) return false;
    if (!node.checkVisibility({ visibilityProperty: true })) return false;
    if (node.matches("input[type=radio]")) {
      if (groups.has(node.name)) return false;
      groups.add(node.name);
    }
    return rect(node).width > 0 && rect(node).height > 0;
  });
  return seen.map((node, k) => {
    node.dataset.wanted = k;
    return `${k} ${node.tagName}#${node.id}.${node.className} ${node.textContent.slice(0, 30)}`;
  });
}"""
FOCUSED = """() => {
  const node = document.activeElement;
  if (!node || node === document.body) return null;
  const style = getComputedStyle(node);
  const ring = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0;
  const name = node.matches("input[type=radio]") ? CSS.escape(node.name) : "";
  const group = name && document.querySelector(`input[name="${name}"][data-wanted]`);
  return { place: (group || node).dataset.wanted ?? "", ring: ring || style.boxShadow !== "none",
           what: `${node.tagName}#${node.id}` };
}"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Laboratory with calibrations and a map."""
    return trusted_laboratory(tmp_path_factory.mktemp("copy") / "my_lab")


@pytest.fixture(scope="module")
def places(project, server):
    """Every page, with something on it."""
    folder = project / "jobs" / "toy"
    jobs.prepare_job(folder, maker=MAKER, options={"rounds": 1, "chunks": 2})
    assert jobs.run_here(folder).state == "done"
    (own,) = (path.parent.name for path in (project / "jobs").glob("first-*/job.json"))
    (result, *_) = (path.parent.name for path in (project / "analyses").glob("*/analysis.json"))
    names = {"/run/{name}": "filter", "/results/{name}": result}
    found = {
        page.path.replace("{number}", "1").replace("{name}", names.get(page.path, own))
        for page in server._pages
    }
    return [server.home.rstrip("/") + path for path in (*sorted(found), "/nowhere")]


def opened(chromium, link, look, size):
    context = chromium.new_context(viewport=size, color_scheme=look, reduced_motion="reduce")
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(link)
    return context, page


def settled(page, address):
    page.goto(address)
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(100)


def keyboard_faults(page):
    """Controls that Tab alone does not reach, or that have no ring then, and where it is caught."""
    wanted = page.evaluate(REACHABLE)
    assert wanted
    page.evaluate("document.activeElement?.blur()")
    reached, found = set(), []
    for _ in range(len(wanted) + 40):
        page.keyboard.press("Tab")
        now = page.evaluate(FOCUSED)
        if now is None or (now["place"] == "0" and "0" in reached):
            break
        reached.add(now["place"])
        if not now["ring"]:
            found.append(("no ring", now["what"]))
    missed = [one for one in wanted if one.split(" ")[0] not in reached]
    return found + [("not reached", one, now) for one in missed]


def judged(chromium, link, addresses, faults, looks):
    """Faults of pages in some looks, on a phone, and for the keyboard."""
    bad = []
    for look, size in looks:
        context, page = opened(chromium, link, look, size)
        for address in addresses:
            settled(page, address)
            found = faults(page)
            for phone in (NARROW, SMALL):
                page.set_viewport_size(phone)
                found += width_fault(page)
            page.set_viewport_size(WIDE)
            found += keyboard_faults(page)
            page.set_viewport_size(size)
            bad += [(address, look, size["width"], one) for one in found]
        context.close()
    return bad


@pytest.mark.parametrize("k", [0, 1], ids=["light", "dark"])
def test_no_fault_and_everything_is_reached_with_the_keyboard(chromium, server, places, faults, k):
    """Every page has one of the looks."""
    assert judged(chromium, server.link, places[k::2], faults, [LOOKS[k]]) == []


@pytest.mark.slow
def test_no_fault_in_any_look(chromium, server, places, faults):
    assert judged(chromium, server.link, places, faults, LOOKS + OTHER_LOOKS) == []


def test_nor_on_live_pages(chromium, faults):
    view, preview = LiveView(), RecordPreview("pushes/141")
    view.show(None, {"problems": ["a problem"], "remarks": ["a remark"], "state": "off"})
    preview.show(None, RecordingStatus(1.0, 30, 2, 30.0, 0b010, 5 * 10**10, ()))
    bad = []
    with WebServer([overlay_page(view, "a scene"), preview.page()]) as server:
        for look, size in LOOKS:
            context, page = opened(chromium, server.link, look, size)
            for path in ("overlay", "record"):
                page.goto(server.home + path)
                page.wait_for_timeout(400)  # the streams never end
                bad += [(path, one) for one in faults(page)]
            context.close()
    assert bad == []


@pytest.mark.system
def test_numbers_of_five_digits_fit_into_their_fields(browser_page, server):
    for page, field, number in (
        ("compare?experiment=1", "#value-mu_pusher", "0.22358"),
        ("plan", "#angle_deg", "-126.63"),
    ):
        browser_page.goto(f"{server.home}{page}")
        browser_page.fill(field, number)
        assert width_fault(browser_page) == []
