"""Axes of the charts: what a tick states is the value at its line."""

import json
import re

import numpy as np
import pytest

pytestmark = pytest.mark.system

# Shows one panel of values against 0, 1, 2, ...; its texts, the heights of its lines, its path.
DRAWN = """async ([root, values]) => {
  const { Charts } = await import(`${root}static/charts.js`);
  const host = document.createElement("div");
  document.querySelector("main").prepend(host);
  const charts = new Charts(host);
  const time = values.map((_, k) => k);
  const series = [{ label: "a", colour: "blue", text: "blue", dash: [], time, values }];
  charts.show([{ title: "x", unit: "mm", series }], [0, values.length - 1]);
  charts.cursor(0);
  const panel = host.querySelector("svg.panel");
  const found = {
    texts: [...panel.querySelectorAll("text[text-anchor=end]")].map((node) => node.textContent),
    places: [...panel.querySelectorAll("path.grid")].map((node) => node.getAttribute("d")),
    path: panel.querySelector("path.line").getAttribute("d"),
    shown: host.querySelector("output").textContent,
    words: panel.getAttribute("aria-label"),
  };
  host.remove();
  return JSON.stringify(found);
}"""


@pytest.fixture
def drawn(browser_page, server):
    browser_page.goto(server.home + "api")
    return lambda values: json.loads(browser_page.evaluate(DRAWN, [server.home, list(values)]))


def ticks(found):
    """Heights of the horizontal lines [px], and the values that they state."""
    places = [float(p[1]) for d in found["places"] if (p := re.match(r"M58 ([\d.]+)H", d))]
    values = [float(text.replace("\u2212", "-")) for text in found["texts"] if text != "t [s]"]
    assert len(places) == len(values) >= 2
    return np.array(places), np.array(values)


@pytest.mark.parametrize(
    ("low", "high"), [(134.0, 134.09), (-12.0, 7.0), (0.0, 1e-4), (22.49, 22.5), (12345.0, 12351.0)]
)
def test_a_tick_states_the_value_at_its_line(drawn, low, high):
    found = drawn(np.linspace(low, high, 9))
    places, values = ticks(found)
    down = np.array([float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", found["path"])])
    slope = (high - low) / (down[-1] - down[0])  # of the line that is drawn [mm/px]
    assert len(set(values)) == len(values)
    np.testing.assert_allclose(values, low + slope * (places - down[0]), atol=1.2 * abs(slope))


@pytest.mark.parametrize("value", [0.0, 4.0, 100.0, -1234.5])
def test_rounding_is_not_drawn_as_motion(drawn, value):
    """Centred pushes leave y but for the last digits; steps below those would never end."""
    noise = np.spacing(max(abs(value), 1e-17)) * np.array([0, 1, 0, -1, 1, 0])
    _, values = ticks(drawn(value + noise))
    assert len(values) < 10
    assert np.ptp(values) > 1e-6


def test_texts_have_no_minus_before_zero_and_the_ends_of_the_data(drawn):
    found = drawn([-0.04, 3.0, 12.5])
    assert found["shown"] == "0.0"
    assert found["words"] == "x in mm against time in seconds: a from 0.0 to 12.5"


# Shows a panel in a wide place that becomes narrow, and measures before it can be drawn again.
SHRUNK = """async (root) => {
  const { Charts } = await import(`${root}static/charts.js`);
  const host = document.createElement("div");
  document.body.append(host);
  host.style.width = `${innerWidth + 300}px`;
  const charts = new Charts(host);
  charts.show([{ title: "x", unit: "mm", series: [] }], [0, 1]);
  charts.cursor(1);
  host.style.width = "200px";
  return [document.documentElement.scrollWidth - innerWidth, charts.width - innerWidth];
}"""


def test_charts_of_a_window_that_shrinks_do_not_widen_the_page(browser_page, server):
    """Else a phone that is turned shows a page to scroll sideways for a moment."""
    browser_page.goto(server.home + "compare")  # has the styles of charts
    beyond, drawn_beyond = browser_page.evaluate(SHRUNK, server.home)
    assert beyond <= 0 < drawn_beyond
