"""The pages under load: twenty clients that browse, ten thousand experiments, cold and warm.

``python -m benchmarks web`` measures all of it; a browser's figures only where there is a Chromium.
The server is a process of its own (`fixel serve`), and the clients are in this one, on the same
machine: what they cost is in the figures, too.
"""

from __future__ import annotations

import asyncio
import random
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import NamedTuple

import httpx
import numpy as np

from benchmarks.figures import FULL, Figure, Size, at_least, at_most
from benchmarks.report import console
from benchmarks.web import FIRST_PAINT, Served, filled

TABLE = "/api/v1/experiments?limit=100"
THINKS = (0.5, 3.0)  # [s] between two pages that somebody opens
HANDFUL = 12  # thumbnails on the screen


class Load(NamedTuple):
    """What so many clients saw."""

    spent: dict[str, list[float]]  # [s] by kind of request
    errors: list[str]
    memory: list[float]  # [MB] of the server, once a second


def run(size: Size) -> list[Figure]:
    """Load, table and pictures; small: does it run at all?"""
    n, clients, seconds = (10_000, 20, 60.0) if size is FULL else (60, 3, 3.0)
    repeats = 5 if size is FULL else 1
    for line in _skipped(size):
        console().print(f"      {line}")
    with tempfile.TemporaryDirectory() as folder:
        project = filled(Path(folder) / "many", n)
        figures = _cold(project, n, repeats)
        figures += _browsed(project, n, clients, seconds)
    return figures + (_moving() if size is FULL and _chromium() else [])


def _skipped(size: Size) -> list[str]:
    """Lines on the figures that are left out."""
    if not _chromium():
        return ["first paint, frames and slider: skipped (no Chromium here)"]
    return [] if size is FULL else ["frames and slider: skipped (tiny size)"]


# --- a table that was not requested before ---------------------------------------------------


def _cold(project: Path, n: int, repeats: int) -> list[Figure]:
    answers, paints = [], []
    for _ in range(repeats):
        with Served(project) as served:
            answers.append(1e3 * served.ask(TABLE))
        if _chromium():
            with Served(project) as served:
                paints.append(_first_paint(served))
    found = [Figure(f"{n} experiments, first answer", "ms", tuple(answers), at_most(150))]
    if paints:
        found.append(Figure(f"{n} experiments, first paint", "ms", tuple(paints), at_most(1000)))
    return found


def _first_paint(served: Served) -> float:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=_chromium(), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(served.link)
        page.wait_for_selector("tr[data-id]")
        painted = float(page.evaluate(FIRST_PAINT))
        browser.close()
    return painted


# --- clients ----------------------------------------------------------------------------------


def _browsed(project: Path, n: int, clients: int, seconds: float) -> list[Figure]:
    with Served(project) as served:
        load = asyncio.run(_crowd(served, n, clients, seconds))
    every = np.array([spent for kind in load.spent.values() for spent in kind])
    slowest = max(load.spent, key=lambda kind: float(np.quantile(load.spent[kind], 0.95)))
    third = max(1, len(load.memory) // 3)
    begin, end = median(load.memory[third : 2 * third] or load.memory), median(load.memory[-third:])
    for error in load.errors[:5]:
        print(f"      {error}")
    at_once = f"{clients} clients"
    return [
        Figure(f"{at_once}, {seconds:g} s: errors", "-", (float(len(load.errors)),), at_most(0)),
        Figure(f"{at_once}: requests", "1/s", (len(every) / seconds,)),
        Figure(f"{at_once}: median", "ms", (1e3 * float(np.median(every)),)),
        Figure(f"{at_once}: 95 %", "ms", (1e3 * float(np.quantile(every, 0.95)),), at_most(500)),
        Figure(
            f"{at_once}: 95 % of the slowest kind, {slowest}",
            "ms",
            (1e3 * float(np.quantile(load.spent[slowest], 0.95)),),
        ),
        Figure("memory of the server, middle third", "MB", (begin,)),
        Figure("memory, last third over middle", "-", (end / begin,), at_most(1.05)),
    ]


async def _crowd(served: Served, n: int, clients: int, seconds: float) -> Load:
    load = Load(defaultdict(list), [], [])
    until = time.monotonic() + seconds
    async with asyncio.TaskGroup() as everybody:
        for number in range(clients):
            everybody.create_task(_browse(served, n, random.Random(number), until, load))
        everybody.create_task(_watch(served.process.pid, until, load))
    return load


async def _browse(served: Served, n: int, chance: random.Random, until: float, load: Load) -> None:
    """One person: opens pages with all they fetch, as a browser does, and looks at them."""
    headers = {"Authorization": f"Bearer {served.token}"}
    async with httpx.AsyncClient(base_url=served.address, headers=headers, timeout=30.0) as client:
        await asyncio.sleep(chance.uniform(0.0, THINKS[1]))
        while time.monotonic() < until:
            for kind, path in _page(n, chance):
                await _ask(client, kind, path, load)
            await asyncio.sleep(chance.uniform(*THINKS))


async def _ask(client: httpx.AsyncClient, kind: str, path: str, load: Load) -> None:
    begun = time.perf_counter()
    try:
        if kind == "comparison":
            body = {"parameters": {"mu_support": random.uniform(0.1, 0.5)}}
            answer = await client.post(path, json=body)
        else:
            answer = await client.get(path)
        if answer.status_code >= 400:
            load.errors.append(f"{answer.status_code} {path}: {answer.text[:200]}")
    except httpx.HTTPError as problem:
        load.errors.append(f"{type(problem).__name__} {path}")
    load.spent[kind].append(time.perf_counter() - begun)


def _page(n: int, chance: random.Random) -> Iterator[tuple[str, str]]:
    """What one page asks for."""
    number, api = chance.randint(1, n), "/api/v1"
    match chance.choice(("table", "table", "one", "one", "compare", "simulate", "jobs", "system")):
        case "table":
            yield "page", "/experiments"
            offset = 100 * chance.randrange(max(1, n // 100))
            sort = chance.choice(("id", "moved", "duration", "surface"))
            yield "table", f"{api}/experiments?limit=100&offset={offset}&sort={sort}"
            yield "table", f"{api}/experiments?limit=100&filter=surface=abs"
            for k in range(HANDFUL):
                yield "thumbnail", f"{api}/experiments/{1 + (number + k) % n}/thumbnail.svg"
            if chance.random() < 0.2:
                yield "coverage", f"{api}/coverage"
        case "one":
            yield "page", f"/experiments/{number}"
            yield "motion", f"{api}/experiments/{number}/motion"
            yield "tactile", f"{api}/experiments/{number}/tactile"
        case "compare":
            yield "page", "/compare"
            yield "offer", f"{api}/experiments/1/comparison"
            for _ in range(5):
                yield "comparison", f"{api}/experiments/1/comparison"
        case "simulate":
            yield "page", "/simulate"
            yield "scene", f"{api}/scenes/examples/grasp"
        case "jobs":
            yield "page", "/jobs"
            yield "jobs", f"{api}/jobs"
        case _:
            yield "page", "/system"
            yield "script", "/static/system.js"


async def _watch(pid: int, until: float, load: Load) -> None:
    while time.monotonic() < until:
        load.memory.append(_memory(pid))
        await asyncio.sleep(1.0)


def _memory(pid: int) -> float:
    """Resident memory of a process [MB]; not a number where /proc does not tell."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return float("nan")
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1e3


# --- what moves -------------------------------------------------------------------------------


def _moving() -> list[Figure]:
    """Frames of a run, and a slider until its simulation is in the picture."""
    from benchmarks import web_play

    measured = web_play.measured()
    frames, trips = measured[web_play.FRAMES], measured[web_play.SLIDER]
    return [
        Figure("frames of an 11 s run", "1/s", (1e3 * len(frames) / sum(frames),), at_least(30)),
        Figure("slider until it is drawn", "ms", (median(trips),), at_most(100)),
    ]


def _chromium() -> str | None:
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)
