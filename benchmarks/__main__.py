"""``python -m benchmarks [NAME ...] [--peers]``: measure, print a table, append to a CSV file."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from benchmarks import report
from benchmarks.figures import FULL, SMALL, Figure, Size

# name -> (module, function, what it measures)
SCENARIOS: dict[str, tuple[str, str, str]] = {
    "start": (
        "processes",
        "run_start",
        "import fixel, fixel --help and a process's first simulation",
    ),
    "wheel": ("processes", "run_wheel", "the package that pip installs"),
    "compile": ("processes", "run_compile", "the first simulation ever"),
    "grasp": ("grasp", "run", "one grasp on one core"),
    "steps": ("step_cost", "run", "where the time of a grasp goes"),
    "corners": ("step_cost", "run_corners", "what many corners cost, over a square"),
    "points": ("step_cost", "run_points", "a grasp on 64 pressure points over a tripod's"),
    "batch": ("batch", "run_grasps", "grasps with random parameters on two cores"),
    "push": ("batch", "run_pushes", "free pushes with random parameters on two cores"),
    "contract": ("batch", "run_contract", "grasps through the contract of other engines"),
    "varied": ("varied", "run", "accuracy over grasps of varied layouts, shapes and poses"),
    "seated": ("seated", "run", "random grasps and pushes: how many are wrong, or flagged"),
    "filter": ("filter", "run", "a particle filter frame by frame on one core"),
    "filter-coverage": ("filter_coverage", "run", "intervals of 200 filter runs with known truth"),
    "filter-wrong": (
        "filter_coverage",
        "run_wrong",
        "the same with other camera noise than believed, and in an imperfect laboratory",
    ),
    "calibration": ("calibration", "run", "calibrations of the thesis's campaign on two cores"),
    "coverage": ("calibration", "run_coverage", "intervals of 200 calibrations with known truth"),
    "misfit": ("misfit", "run", "intervals of 100 laboratories that the model misfits"),
    "next-rows": ("next_rows", "run", "experiments that a bench needs, chosen or in order"),
    "new-parts": ("new_parts", "run", "learning curves of parts never pushed, with their bounds"),
    "domain": ("domain", "run", "maps of the simulated laboratory, judged by new experiments"),
    "planning": ("planning", "run", "plans carried out in another model: stated and held success"),
    "sbc": ("sbc", "run", "posteriors of 300 data sets drawn from the prior"),
    "policies": ("policies", "run", "plans with looks carried out: stated and held success"),
    "planning-statistics": (
        "planning_statistics",
        "run",
        "races, stated probabilities, trials and causes, on problems with known truths",
    ),
    "tracking": ("tracking", "run", "rendered films tracked on one core, against their truth"),
    "camera": ("camera", "run", "cameras from rendered pictures of boards, and their errors in mm"),
    "other-camera": (
        "other_camera",
        "run",
        "stated errors of cameras calibrated from pictures of another renderer",
    ),
    "bench": ("bench", "run", "what a person at the bench waits for, and frames that are lost"),
    "arrival": ("arrival", "run", "poses lost and time taken where frames arrive unevenly"),
    "memory": ("processes", "run_memory", "memory of a batch"),
    "record": ("recording", "run", "frames written and read, by codec"),
    "heap": ("heap", "run", "many bodies swept by a bar"),
    "web": ("web_load", "run", "twenty clients that browse, ten thousand experiments"),
    "push-t": ("push_t", "run", "steps of 64 Push-T environments, compared with gym-pusht"),
    "push-t-planner": (
        "push_t",
        "run_planner",
        "success of a scripted policy in 500 episodes, with Wilson intervals",
    ),
    "peers": ("peers", "run", "the same grasp by other engines"),
}
ONLY_WHEN_ASKED = {
    *("peers", "varied", "seated", "tracking", "arrival", "coverage", "misfit", "domain", "sbc"),
    *("new-parts", "next-rows", "camera", "other-camera", "web", "filter-coverage", "filter-wrong"),
    *("planning", "policies", "planning-statistics", "push-t", "push-t-planner", "bench"),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the chosen scenarios; 1 where one of them broke down."""
    parser = _parser()
    chosen = parser.parse_args(arguments)
    if chosen.page and chosen.small:
        parser.error("--page shows figures of full sizes: leave out --small")
    names = chosen.names or [name for name in SCENARIOS if name not in ONLY_WHEN_ASKED]
    if chosen.peers and "peers" not in names:
        names.append("peers")
    if chosen.peer_python:
        os.environ["FIXEL_PEER_PYTHON"] = chosen.peer_python
    console = report.console()
    figures: list[Figure] = []
    broken = 0
    for k, name in enumerate(names, 1):
        module, function, meaning = SCENARIOS[name]
        console.print(f"[{k}/{len(names)}] {name}: {meaning} ...", markup=False, highlight=False)
        start = time.perf_counter()
        try:
            run: Callable[[Size], list[Figure]] = getattr(
                import_module(f"benchmarks.{module}"), function
            )
            figures += run(SMALL if chosen.small else FULL)
        except Exception as error:  # the other scenarios still count
            console.print(f"      broke down: {error!r}", markup=False, style="red")
            broken = 1
        console.print(f"      {time.perf_counter() - start:.1f} s", highlight=False)
    if chosen.small:
        figures = [replace(figure, bar=None) for figure in figures]
    report.show(console, figures)
    if chosen.small:
        console.print("Tiny sizes show that everything runs: no figure counts, and none has a bar.")
    if chosen.page:
        report.write_into(report.PAGE, "figures", report.as_markdown(figures, names))
    path = report.append(figures, chosen.output, small=chosen.small)
    console.print(f"Appended to {os.path.relpath(path)}")
    return broken


def _parser() -> argparse.ArgumentParser:
    left_out = ", ".join(sorted(ONLY_WHEN_ASKED))
    listing = "\n".join(f"  {name:<20}{s[2]}" for name, s in SCENARIOS.items())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description=__doc__,
        epilog=f"names:\n{listing}\n\nWhere none is given, all but {left_out}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*SCENARIOS, []])
    parser.add_argument("--peers", action="store_true", help="also run other engines side by side")
    parser.add_argument(
        "--peer-python", metavar="PATH", help="interpreter that has gym-pusht, for push-t"
    )
    parser.add_argument("--small", action="store_true", help="tiny sizes: does it run at all?")
    parser.add_argument(
        "--output", type=Path, default=report.RESULTS, metavar="FOLDER", help="of the CSV file"
    )
    parser.add_argument(
        "--page", action="store_true", help="also rewrite the table in docs/evidence/benchmarks.md"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
