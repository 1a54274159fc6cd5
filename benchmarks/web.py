"""How fast the table of experiments is there, with many experiments.

``python -m benchmarks.web [--n 10000] [--project FOLDER]``: a project as `benchmarks.store` fills
it, unless a folder with one is given; `fixel serve` in a fresh process; the
first answers to a program, and the first paint in a real browser.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from benchmarks.store import experiments
from fixel.database.project import Project

QUESTIONS = {
    "the first page": "limit=100",
    "sorted by way": "limit=100&sort=moved&descending=true",
    "sorted by a condition": "limit=100&sort=surface",
    "words": "limit=100&filter=77+abs",
    "a condition and a range": "limit=100&filter=surface=abs+moved%3E500",
    "the last page": "limit=100&offset=9900",
}

FIRST_PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0].startTime"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=10_000)
    parser.add_argument("--project", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        project = given.project or filled(Path(folder) / "many", given.n)
        for name, query in QUESTIONS.items():
            with Served(project) as served:
                before = served.cpu
                cold = served.ask(f"/api/v1/experiments?{query}")
                cpu = served.cpu - before
                warm = min(served.ask(f"/api/v1/experiments?{query}") for _ in range(5))
            print(
                f"{name:24s} {1e3 * cold:6.0f} ms cold, {1e3 * cpu:4.0f} ms of them computing; "
                f"{1e3 * warm:6.0f} ms warm"
            )
        with Served(project) as served:
            _paint(served)


def filled(folder: Path, n: int) -> Path:
    """A project with so many experiments."""
    project = Project.create(folder)
    with project.store() as store:
        for experiment in experiments(n):
            store.add_experiment(experiment)
    return folder


class Served:
    """`fixel serve` in a fresh process."""

    def __init__(self, project: Path) -> None:
        code = "from fixel.cli.main import run; run()"
        command = [sys.executable, "-c", code, "serve", str(project), "--json", "--no-open"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.link = json.loads(self.process.stdout.readline())["link"]
        self.address, _, self.token = self.link.partition("/?token=")
        time.sleep(3.0)  # other pages get ready in the background

    def ask(self, path: str) -> float:
        headers = {"Authorization": f"Bearer {self.token}"}
        begun = time.perf_counter()
        with urllib.request.urlopen(
            urllib.request.Request(self.address + path, headers=headers)
        ) as answer:
            answer.read()
        return time.perf_counter() - begun

    @property
    def cpu(self) -> float:
        """Spent so far by the server [s]; on Linux, to a hundredth."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def __enter__(self) -> "Served":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.communicate()


def _paint(served: Served) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(served.link)
        page.wait_for_selector("tr[data-id]")
        painted = page.evaluate(FIRST_PAINT)
        rows = page.evaluate("() => performance.getEntriesByType('navigation')[0].responseEnd")
        print(f"first paint {painted:.0f} ms, rows there {rows:.0f} ms after the link was opened")
        browser.close()


if __name__ == "__main__":
    main()
