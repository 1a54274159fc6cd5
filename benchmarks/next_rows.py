"""Experiments that a bench needs, in chosen and in planned order, and the truth of its intervals.

``python -m benchmarks next-rows`` takes about 40 s of one core a laboratory, and writes one row an
estimate to `ROWS` as it goes: a run that was stopped continues. Laboratories are those of
`benchmarks.misfit`; none is the model. The plan has 60 pushes of the thesis's square around its
outline, three directions at each of 20 places.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.figures import Figure, Size, at_least, at_most
from benchmarks.misfit import NOMINAL, imperfect
from benchmarks.report import RESULTS
from fixel.model import Experiment, PlannedExperiment
from fixel.parts.next_pushes import push_candidates
from fixel.sampling.published import thesis_plan
from fixel.workflows.bench.estimates import LiveEstimates, Until, choose, estimate

# Seeds from here on were never looked at while the rule to stop was chosen; that used those from
# 101 to 112.
FIRST_SEED: Final = 9001
LABORATORIES: Final = 20
ORDERS: Final = ("chosen", "planned")
SPACE: Final = ("mu_pusher", "pressure_spread", "friction_centre_x", "friction_centre_y")
WANTED: Final = Until.parse("mu_pusher=0.02")
LIMIT: Final = 45  # experiments of one campaign
ROWS: Final = RESULTS / "next-rows.csv"
HEAD: Final = ("seed", "order", "experiments", "truth", "value", "half", "met")


def plan(contacts: int = 20) -> list[PlannedExperiment]:
    """Pushes around the outline, in order."""
    square = thesis_plan().experiments[0].scene.bodies[0]
    scenes = push_candidates(
        square, radius=4.75e-3, travel=0.05, speed=0.0135, friction=NOMINAL, contacts=contacts
    )
    return [PlannedExperiment(name=f"row-{k:02d}", scene=own) for k, own in enumerate(scenes)]


def campaign(
    rows: list[PlannedExperiment], made: Mapping[str, Experiment], order: str, limit: int
) -> Iterator[tuple[int, LiveEstimates]]:
    """Yield the number of experiments and the estimates after each, until they are met."""
    left = list(rows)
    done: list[Experiment] = []
    found = None
    while left and len(done) < limit and not (found and WANTED.met(found)):
        k: int | None = 0
        if order == "chosen" and found is not None:
            k = choose(found, left, WANTED.wanted).index
            if k is None:
                return
        done.append(made[left.pop(k or 0).name])
        found = estimate(done, SPACE, previous=found, threads=1)
        yield len(done), found


def laboratory(seed: int, contacts: int, limit: int) -> Iterator[dict[str, str | float]]:
    """One row an estimate."""
    bench, rows = imperfect(seed), plan(contacts)
    made = {own.name: own for own in bench.run(rows, threads=1)}
    truth = NOMINAL * bench.pusher_friction
    for order in ORDERS:
        for n, found in campaign(rows, made, order, limit):
            value = found.calibration.estimates["mu_pusher"].value
            half = found.half_widths["mu_pusher"]
            row = (seed, order, n, truth, value, half, int(WANTED.met(found)))
            yield dict(zip(HEAD, row, strict=True))


def run(size: Size) -> list[Figure]:
    """Experiments of campaigns, intervals at their ends, and the time of one update."""
    full = size.rollouts >= 500
    seeds = range(FIRST_SEED, FIRST_SEED + (LABORATORIES if full else 1))
    path = ROWS if full else None
    figures = figures_of(_rows(seeds, path, 20 if full else 4, LIMIT if full else 4))
    return [*figures, _update(20 if full else 4)]


def _rows(seeds: range, path: Path | None, contacts: int, limit: int) -> list[dict[str, str]]:
    known = []
    if path is not None and path.is_file():
        with path.open(newline="") as file:
            known = list(csv.DictReader(file))
    done = {int(row["seed"]) for row in known}
    for seed in seeds:
        if seed in done:
            continue
        rows = list(laboratory(seed, contacts, limit))
        known += [{name: str(value) for name, value in row.items()} for row in rows]
        if path is not None:
            fresh = not path.is_file()
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, HEAD)
                if fresh:
                    writer.writeheader()
                writer.writerows(rows)
    return [row for row in known if int(row["seed"]) in seeds]


def figures_of(rows: list[dict[str, str]]) -> list[Figure]:
    """Figures of rows of laboratories."""
    figures, needed = [], {}
    for order in ORDERS:
        ends = {row["seed"]: row for row in rows if row["order"] == order}  # the last of each
        needed[order] = np.mean([float(row["experiments"]) for row in ends.values()])
        off = [abs(float(row["value"]) - float(row["truth"])) for row in ends.values()]
        held = [own <= float(row["half"]) for own, row in zip(off, ends.values(), strict=True)]
        name = f"next rows, {order}, {len(ends)} laboratories"
        figures += [
            Figure(f"{name}: experiments until mu_pusher is within 0.02", "-",
                   tuple(float(row["experiments"]) for row in ends.values())),
            Figure(f"{name}: truth inside at the end", "%", (100.0 * float(np.mean(held)),),
                   at_least(90.0) if order == "chosen" else None),
        ]  # fmt: skip
    ratio = float(needed["chosen"] / needed["planned"])
    name = "next rows, mean of experiments, chosen over planned"
    figures.append(Figure(name, "-", (ratio,), at_most(0.6)))
    return figures


def _update(n: int) -> Figure:
    made = list(imperfect(101).run(plan()[: 3 * n : 3], threads=1))
    before = estimate(made[:-1], SPACE)
    begun = time.perf_counter()
    estimate(made, SPACE, previous=before)
    taken = time.perf_counter() - begun
    return Figure(f"next rows, estimates after one of {n} more", "s", (taken,), at_most(10.0))
