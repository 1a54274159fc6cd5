"""Error against work of the three steppers: ``python -m benchmarks.work_precision``.

Draws docs/pictures/work_precision.png and writes its numbers to the other results.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from benchmarks import report
from benchmarks.accuracy import (
    FINE,
    POSITION_BAR,
    apart,
    characteristic_length,
    converged_batch,
    random_sets,
)
from benchmarks.figures import seconds
from fixel.model import Scene
from fixel.simulation import (
    Adaptive,
    BatchResult,
    Dynamic,
    Midpoint,
    QuasiStatic,
    StewartTrinkle,
    simulate_batch,
)
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.stepping import AbstractStepper
from fixel.testing.scenes import grasp
from fixel.typing import FloatArray

DOCS = Path(__file__).resolve().parents[1] / "docs"
PICTURE = DOCS / "pictures" / "work_precision.png"
PAGE = DOCS / "theory" / "stepping.md"
SETS = 200
STEPS = (0.04, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)  # [s]
TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)  # characteristic lengths
MOTIONS: tuple[AbstractMotionModel, ...] = (Dynamic(), QuasiStatic())
REPEATS = 3


class Point(NamedTuple):
    """One stepper at one setting."""

    motion: str
    stepper: str
    setting: float  # step [s], or tolerance in characteristic lengths
    work: float  # [us] of one core a rollout, the best of REPEATS
    steps: float  # mean
    fallbacks: float  # mean
    median: float  # of the larger of error [mm] and error [deg]
    percentile_95: float
    within: float  # share of rollouts, 0 to 1


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.work_precision")
    parser.add_argument("--sets", type=int, default=SETS, help="random parameter sets a layout")
    parser.add_argument("--picture", type=Path, default=PICTURE)
    parser.add_argument(
        "--page", action="store_true", help="also rewrite the tables in docs/theory/stepping.md"
    )
    parser.add_argument("--output", type=Path, default=report.RESULTS, metavar="FOLDER")
    chosen = parser.parse_args(arguments)
    points = list(measured(chosen.sets))
    chosen.output.mkdir(parents=True, exist_ok=True)
    name = f"work-precision-{report.machine()}-{date.today().isoformat()}.csv"
    write(points, chosen.output / name)
    draw(points, chosen.picture)
    if chosen.page:
        report.write_into(PAGE, "figures", as_markdown(points, 2 * chosen.sets))


def measured(sets: int) -> Iterator[Point]:
    """Every stepper at every setting, under both motion models, over both layouts."""
    scenes = (grasp("seated"), grasp("slip"))
    parameters = random_sets(sets)
    for motion in MOTIONS:
        fine = [converged_batch(scene, parameters, motion, FINE) for scene in scenes]
        for setting, stepper in _steppers(characteristic_length(scenes[0])):
            point = _point(scenes, parameters, motion, stepper, setting, fine)
            print(
                f"{point.motion:13}{point.stepper:16}{setting:8g}{point.work:9.0f} us"
                f"{point.median:10.4f}{point.percentile_95:10.4f}{100 * point.within:7.1f} %",
                flush=True,
            )
            yield point


def _steppers(length: float) -> Iterator[tuple[float, AbstractStepper]]:
    for step in STEPS:
        yield step, StewartTrinkle(step=step)
    for step in STEPS:
        yield step, Midpoint(step=step)
    for tolerance in TOLERANCES:
        yield tolerance, Adaptive(tolerance=tolerance * length)


def _point(
    scenes: tuple[Scene, ...],
    parameters: dict[str, FloatArray],
    motion: AbstractMotionModel,
    stepper: AbstractStepper,
    setting: float,
    fine: list[BatchResult],
) -> Point:
    taken, errors, steps, fallbacks = 0.0, [], [], []
    for scene, reference in zip(scenes, fine, strict=True):
        last: list[BatchResult] = []

        def call(scene: Scene = scene, last: list[BatchResult] = last) -> None:
            result = simulate_batch(scene, parameters, motion=motion, stepper=stepper, threads=1)
            last.append(result)

        taken += min(seconds(call, REPEATS, warm_up=False, clock=time.process_time))
        errors.append(_error(last[-1], reference))
        steps.append(last[-1].steps.mean())
        fallbacks.append(last[-1].fallbacks.mean())
    error = np.concatenate(errors)
    n = sum(len(one.status) for one in fine)
    return Point(
        motion=motion.name,
        stepper=stepper.name,
        setting=setting,
        work=1e6 * taken / n,
        steps=float(np.mean(steps)),
        fallbacks=float(np.mean(fallbacks)),
        median=float(np.quantile(error, 0.5, method="higher")),
        percentile_95=float(np.quantile(error, 0.95, method="higher")),
        within=float(np.mean(error <= POSITION_BAR)),
    )


def _error(result: BatchResult, reference: BatchResult) -> FloatArray:
    """The larger of distance [mm] and angle [deg]; infinite where a rollout stopped early.

    Rollouts without a converged answer are left out.
    """
    worst = np.maximum(*apart(result.final[:, 0], reference.final[:, 0]))
    worst[~result.converged] = np.inf
    return worst[reference.converged]


def write(points: Iterable[Point], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Point._fields)
        for point in points:
            writer.writerow([f"{x:.6g}" if isinstance(x, float) else x for x in point])


def as_markdown(points: list[Point], rollouts: int) -> str:
    """Two tables: the cheapest settings that do, and what a tolerance buys."""
    return "\n".join(
        [
            f"Measured {date.today().isoformat()} at commit {report.commit()} on"
            f" {report.machine()}, {rollouts} rollouts a setting.",
            "",
            "The cheapest setting of each stepper that puts 95 % of the rollouts within 0.1 mm and"
            " 0.1 degree:",
            "",
            "| motion | stepper | setting | us per rollout | within | median error |",
            "|---|---|---|---|---|---|",
            *_cheapest(points),
            "",
            "What a tolerance buys (in characteristic lengths):",
            "",
            "| motion | tolerance | us per rollout | steps | fallbacks | within | median error |"
            " 95th percentile |",
            "|---|---|---|---|---|---|---|---|",
            *(_tolerance_row(point) for point in points if point.stepper == "adaptive"),
            "",
        ]
    )


def _cheapest(points: list[Point]) -> Iterator[str]:
    for motion, stepper in dict.fromkeys((point.motion, point.stepper) for point in points):
        own = [p for p in points if (p.motion, p.stepper) == (motion, stepper) and p.within >= 0.95]
        if not own:
            yield f"| {motion} | {stepper} | none | | | |"
            continue
        best = min(own, key=lambda point: point.work)
        setting = f"{best.setting:g}" if stepper == "adaptive" else f"{1e3 * best.setting:g} ms"
        yield (
            f"| {motion} | {stepper} | {setting} | {best.work:.0f} | {100 * best.within:.1f} % |"
            f" {best.median:.2g} |"
        )


def _tolerance_row(p: Point) -> str:
    return (
        f"| {p.motion} | {p.setting:g} | {p.work:.0f} | {p.steps:.0f} | {p.fallbacks:.1f} |"
        f" {100 * p.within:.1f} % | {p.median:.2g} | {p.percentile_95:.2g} |"
    )


def read(path: Path) -> list[Point]:
    """What `write` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            Point(row["motion"], row["stepper"], *(float(row[key]) for key in Point._fields[2:]))
            for row in csv.DictReader(file)
        ]


# Okabe and Ito's colours, with shapes that differ as well.
STYLES = {
    "stewart-trinkle": ("Stewart–Trinkle", "#D55E00", "s"),
    "midpoint": ("midpoint", "#0072B2", "^"),
    "adaptive": ("adaptive", "#009E73", "o"),
}
# Which settings are written next to their points; the two fixed steps cost the same at each step.
LABELLED = {
    "stewart-trinkle": {0.04: "40 ms", 0.01: "10 ms", 0.001: "1 ms"},
    "midpoint": {},
    "adaptive": {1e-2: "$10^{-2}$", 1e-4: "$10^{-4}$", 1e-6: "$10^{-6}$"},
}
OFFSETS = {"stewart-trinkle": (-5, 13), "midpoint": (0, 0), "adaptive": (-20, -2)}
HALO = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}


def draw(points: list[Point], path: Path) -> None:
    """One panel a motion model: median as lines, 95th percentile above it as dashes."""
    matplotlib.use("Agg")
    motions = list(dict.fromkeys(point.motion for point in points))
    figure, panels = pyplot.subplots(
        1, len(motions), figsize=(11.0, 4.9), sharex=True, sharey=True, layout="constrained"
    )
    for panel, motion in zip(np.atleast_1d(panels), motions, strict=True):
        _panel(panel, [point for point in points if point.motion == motion])
        panel.set_title({"dynamic": "Dynamic", "quasistatic": "Quasi-static"}[motion])
        panel.set_xlabel("time of one core per rollout of 11 s [µs]")
    np.atleast_1d(panels)[0].set_ylabel("error of the final pose [mm or deg]")
    handles, labels = np.atleast_1d(panels)[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def _panel(panel: Axes, points: list[Point]) -> None:
    for name, (label, colour, marker) in STYLES.items():
        own = [point for point in points if point.stepper == name]
        work = [point.work for point in own]
        middle = [point.median for point in own]
        panel.loglog(work, middle, color=colour, marker=marker, markersize=6, label=label)
        panel.loglog(
            work, [point.percentile_95 for point in own],
            color=colour, marker=marker, markersize=4, markerfacecolor="white", linestyle="--",
        )  # fmt: skip
        for point in own:
            if text := LABELLED[name].get(point.setting):
                panel.annotate(
                    text, (point.work, point.median), xytext=OFFSETS[name],
                    textcoords="offset points", ha="center", va="center", color=colour,
                    fontsize=8, bbox=HALO,
                )  # fmt: skip
    panel.plot([], [], color="0.4", label="median")
    panel.plot([], [], color="0.4", linestyle="--", label="95th percentile")
    panel.axhline(POSITION_BAR, color="0.4", linewidth=1, linestyle=":")
    panel.annotate(
        "0.1 mm, 0.1 deg", (1.0, POSITION_BAR), xycoords=("axes fraction", "data"),
        xytext=(-4, 3), textcoords="offset points", ha="right", color="0.3", fontsize=8,
    )  # fmt: skip
    panel.margins(x=0.08)
    panel.grid(which="major", color="0.9")
    panel.set_axisbelow(True)


if __name__ == "__main__":
    main()
