"""The pages as a browser shows them: with the Chromium of this machine, skipped without one."""

import numpy as np
import pytest
from tests.jobs.helpers import await_true
from tests.vision.plate import plate_picture, small_rig
from tests.web.conftest import opened_page
from tests.workflows.acquisition.test_overlay import SCENE, TOLERANCE, WANTED

from fixel.formats.video_file import VideoWriter, open_video
from fixel.testbed.recorder import RecordingStatus
from fixel.vision.frame import Frame
from fixel.web.live import LiveView
from fixel.web.live_pages import RecordPreview, overlay_page
from fixel.web.serve import WebServer
from fixel.workflows.acquisition.overlay import Overlay, watch

pytestmark = pytest.mark.system

RIG = small_rig()
# Whether the table shows this error, to the hundredth of a mm it is written with.
SHOWS = """wanted => {
  const text = document.querySelector("#parts td").textContent.replace("\u2212", "-");
  return Math.abs(Number(text) - wanted) < 0.006;
}"""


@pytest.fixture
def page(chromium):
    with opened_page(chromium) as page:
        yield page


def film(path):
    """The part is brought home: 14 mm and 8 degrees off, 5 mm and 3, then in place."""
    x, y, angle = WANTED
    with VideoWriter(path, (640, 360)) as writer:
        for k, off in enumerate((1.0, 0.36, 0.0)):
            pose = (x + 0.014 * off, y, angle + 0.14 * off)
            poses = {"object": pose, "actuator": (0.0, 0.0, 0.0)}
            writer.write(Frame(k / 30.0, plate_picture(RIG, poses)))
    return path


def test_the_error_falls_and_the_page_turns_green(page, tmp_path):
    view = LiveView()
    frames = open_video(film(tmp_path / "placing.mp4")).frames()
    looks = watch(Overlay(RIG, SCENE, TOLERANCE), frames, view.show)
    shown = []
    with WebServer([overlay_page(view, "peg_slip.yaml on small")]) as server:
        page.goto(server.link)
        for state in ("off", "off", "placed"):
            look = next(looks)
            page.wait_for_selector(f'#verdict[data-state="{state}"]')
            page.wait_for_function(SHOWS, arg=1e3 * look.parts[0].error[0])
            shown.append(float(page.inner_text("#push")))
        assert shown[0] > 13.0 > 6.0 > shown[1] > shown[2]
        assert page.inner_text("#verdict-words") == "In place"
        assert page.inner_text("#mark") == "\u2713"
        assert "in place" in page.inner_text("#parts")
        # It is green, and what a person sees there is the picture with its outlines.
        green = page.evaluate("getComputedStyle(document.querySelector('#verdict')).color")
        assert green == "rgb(6, 105, 63)"
        page.wait_for_function("() => document.querySelector('#picture').naturalWidth === 640")
        page.screenshot(path=tmp_path / "placed.png")
    page.wait_for_function("() => document.querySelector('#link-state').textContent === 'ended'")


def test_stop_ends_the_recording(page):
    preview = RecordPreview("pushes/141")
    with WebServer([preview.page()]) as server:
        preview.show(None, RecordingStatus(75.0, 2250, 2, 30.0, 0b010, 5 * 10**10, ()))
        page.goto(server.link)
        page.wait_for_selector('#verdict[data-state="recording"]')
        assert page.inner_text("#elapsed") == "1:15"
        assert page.inner_text("#frames") == "2,250"
        lamps = "blue free red touched green free"
        assert page.inner_text("#lamps").split() == lamps.split()
        page.keyboard.press("Tab")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "stop"
        page.keyboard.press("Enter")
        page.wait_for_function("() => document.querySelector('#stop').disabled")
        await_true(lambda: preview.stop_wanted)  # the button is quicker than the request
        text = "document.querySelector('#stop').innerText"
        page.wait_for_function(f"() => {text} === 'Stopping\u2026'")


def test_the_picture_is_the_newest(page, monkeypatch):
    """A browser that waits for the next picture to show this one would show black."""
    monkeypatch.setattr("fixel.web.live.HEARTBEAT", 60.0)  # or the same picture is sent again
    view = LiveView()
    with WebServer([overlay_page(view, "light")]) as server:
        view.show(np.zeros((48, 64, 3), dtype=np.uint8), {})
        page.goto(server.link)
        page.wait_for_function("() => document.querySelector('#picture').naturalWidth === 64")
        view.show(np.full((48, 64, 3), 250, dtype=np.uint8), {})
        page.wait_for_function(
            """() => {
              const pen = document.createElement("canvas").getContext("2d");
              pen.drawImage(document.querySelector("#picture"), 0, 0, 1, 1);
              return pen.getImageData(0, 0, 1, 1).data[0] > 240;
            }"""
        )
