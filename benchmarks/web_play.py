"""How fast the Compare and Simulate pages answer: ``python -m benchmarks.web_play``.

A project of two simulated runs, its server, and a Chromium without a window that draws in software.
A round trip is from the key press on a slider until its new simulation is in the picture, the
charts and the table; frames are pictures of a whole run of 11 s at speed 1.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from fixel.database.project import Project
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.context import ProjectContext
from fixel.web.project import project_server
from fixel.web.views.live_comparison import LiveComparison

MOVES = 60
SERVER = "a comparison, processor time of the server"
SLIDER = "slider to new simulation on the screen"
FRAMES = "between two frames of a run of 11 s"
PART = "part moved to new simulation"
PLAY = """async () => {
  const { player } = document.querySelector("#player");
  const gaps = [];
  let [drawn, last] = [player.stage.drawn, performance.now()];
  player.seek(player.start);
  player.play();
  await new Promise((done) => {
    const look = (now) => {
      if (player.stage.drawn !== drawn) {
        gaps.push(now - last);
        [last, drawn] = [now, player.stage.drawn];
      }
      if (player.playing) requestAnimationFrame(look);
      else done();
    };
    requestAnimationFrame(look);
  });
  return gaps;
}"""


def main() -> None:
    """Measure and print."""
    for what, values in measured().items():
        middle, most = np.quantile(values, (0.5, 0.95))
        print(f"{what:46} {middle:6.1f} ms, 95 % under {most:.1f} ms")


def measured() -> dict[str, list[float]]:
    """Milliseconds, by what was measured."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        project = Project.create(Path(folder) / "lab")
        with project.store() as store:
            for experiment in SimulatedTestbed(seed=1).run(thesis_plan().experiments[:2]):
                store.add_experiment(experiment)
        context = ProjectContext(project)
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.set_default_timeout(120_000)
        try:
            with project_server(context) as server:
                found = {SERVER: _without_browser(context)}
                page.goto(server.link)
                found |= _compare(page, server.home)
                found |= _simulate(page, server.home)
        finally:
            browser.close()
            context.close()
    return found


def _without_browser(context: ProjectContext) -> list[float]:
    at_hand, spent = LiveComparison(context.store), []
    for k in range(MOVES):
        begun = time.process_time()
        at_hand.compared(1, {"mu_pusher": 0.1 + 0.01 * k}, "dynamic", context.folder)
        spent.append(1e3 * (time.process_time() - begun))
    return spent[1:]


def _compare(page: Any, address: str) -> dict[str, list[float]]:
    page.goto(address + "compare?experiment=1")
    page.wait_for_selector("#sets svg")
    page.focus("#slide-mu_pusher")
    command = "document.getElementById('copy-command').dataset.copy"
    trips = []
    for k in range(MOVES):
        old, begun = page.evaluate(command), time.perf_counter()
        page.keyboard.press("ArrowRight" if k % 10 < 5 else "ArrowLeft")
        page.wait_for_function(f"old => {command} !== old", arg=old)
        trips.append(1e3 * (time.perf_counter() - begun))
    return {SLIDER: trips, FRAMES: page.evaluate(PLAY)}


def _simulate(page: Any, address: str) -> dict[str, list[float]]:
    page.goto(address + "simulate")
    page.wait_for_selector("#simulate[data-simulated]")
    page.focus("#editor")
    trips = []
    for k in range(MOVES):
        before = page.get_attribute("#simulate", "data-simulated")
        page.keyboard.press("ArrowUp" if k % 10 < 5 else "ArrowDown")
        page.wait_for_function(
            "n => document.getElementById('simulate').dataset.simulated !== n", arg=before
        )
        trips.append(float(page.get_attribute("#simulate", "data-round-trip")))
    return {PART: trips}


if __name__ == "__main__":
    main()
