"""Pages that stay open when their server ends, and when another one takes its port."""

import pytest
from tests.web.conftest import opened_page

from fixel.database.project import Project
from fixel.web.context import ProjectContext
from fixel.web.project import project_server

pytestmark = pytest.mark.system

GONE = "Cannot reach the fixel server. Is it still running?"
OTHER = "Open this page with the link that fixel printed when it started."


def served(project, port=None):
    context = ProjectContext(Project(project))
    return context, project_server(context, port=port).start()


def test_a_page_says_that_its_server_has_ended_or_is_another(chromium, project):
    context, server = served(project)
    with opened_page(chromium) as page:
        page.expected_problems = ["ERR_CONNECTION_REFUSED", "403"]
        page.goto(server.link)
        server.stop()
        context.close()
        says(page, GONE)
        context, server = served(project, server.port)
        says(page, OTHER)
        server.stop()
        context.close()


def says(page, sentence):
    """A part that is fetched again, and a change, both lead to one message with the sentence."""
    message = page.locator(".toast.bad", has_text=sentence)
    for act in ("#filter", "Delete"):
        if act == "Delete":
            page.locator("#filter").blur()
            page.keyboard.press(act)
        else:
            page.fill(act, page.input_value(act) + "x")
        page.wait_for_function("() => document.querySelector('.toast.bad')")
        message.wait_for()
        page.wait_for_timeout(300)
    assert message.count() == 1
    assert page.locator(".toast").count() == 1
    page.click(".toast button[aria-label=Close]")


def test_a_scene_is_not_wrong_because_the_server_has_ended(chromium, project):
    context, server = served(project)
    with opened_page(chromium) as page:
        page.expected_problems = ["ERR_CONNECTION_REFUSED"]
        page.goto(server.link)
        page.goto(server.home + "simulate")
        page.wait_for_selector("#simulate[data-simulated]")
        server.stop()
        context.close()
        page.focus("#editor")
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("#verdict:text-is('failed')")
        assert page.inner_text("#verdict-words") == GONE


def test_a_page_that_is_renewed_by_the_clock_says_so_once(chromium, project):
    """Without its server, a page that is renewed would always show a running job."""
    context, server = served(project)
    with opened_page(chromium) as page:
        page.expected_problems = ["ERR_CONNECTION_REFUSED"]
        page.goto(server.link)
        page.evaluate("document.body.setAttribute('data-every', '100')")
        page.click("th.name a")
        page.wait_for_selector("th.name[aria-sort=ascending]")
        server.stop()
        context.close()
        page.locator(".toast.bad", has_text=GONE).wait_for()
        page.wait_for_timeout(500)
        assert page.locator(".toast").count() == 1
