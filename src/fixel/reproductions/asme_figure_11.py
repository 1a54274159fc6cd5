"""Figure 11 of the ASME paper: convergence of the search for support points.

Two searches of the paper, from random vertices, on its tests 3 and 4. The table has the best vertex
after each step, its error, and the size of the simplex, which the paper uses as uncertainty.

Source: ASME 2006 paper on meso-scale manipulation, figure 11 and "Parameter estimation". The figure
is not legible in the copy at hand; its title is "Convergence of Support Points".
"""

from __future__ import annotations

import time as clock
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration import NelderMead
from fixel.calibration.nelder_mead import NelderMeadSearch
from fixel.calibration.optimiser import feasible_points
from fixel.calibration.study import box_of
from fixel.reproductions.asme_table_1 import IDENTIFICATION, P1, made_targets, objective, space
from fixel.reproductions.charts.convergence import BestSoFar, ConvergenceChart
from fixel.reproductions.reproduction import Reproduction, Row
from fixel.sampling.eight_push import PART_LENGTH, PART_WIDTH
from fixel.testing.scenes import box
from fixel.typing import Progress

SEARCHES: Final = 2  # number of searches in the figure
SEED: Final = 3


def run(folder: Path | None, progress: Progress, *, quick: bool = False) -> Reproduction:
    """Run two searches from random vertices until their simplex is small.

    Parameters
    ----------
    folder : Path or None
        Unused, since the data are generated.
    progress : callable
    quick : bool
        Run short searches.
    """
    begun = clock.perf_counter()
    evaluations = 300 if quick else 3000
    targets = made_targets(seed=1)
    wanted = objective(targets, IDENTIFICATION)
    feasible = wanted.comparer.feasible
    region = box_of(space())
    starts = feasible_points(region, SEARCHES, SEED, feasible)
    descents = []
    for k, start in enumerate(starts):
        options = NelderMead(random_simplex=True, size=1e-3, max_evaluations=evaluations)
        search = options.start(region._replace(start=start), SEED + k, feasible)
        steps: list[tuple[int, float, float, tuple[float, ...]]] = []
        while not search.done:
            search.tell(wanted(search.ask()))
            point, error = search.best
            steps.append((search.evaluations, error, search.size, tuple(point.tolist())))
        descents.append(_descent(k + 1, steps, search))
        progress(k + 1, SEARCHES, f"search {k + 1}: {search.reason}")
    return Reproduction(
        name="asme-figure-11",
        tables={"convergence": [row for one in descents for row in _rows(one)]},
        conclusions=[_sentence(one) for one in descents],
        settings={
            "searches": SEARCHES,
            "seed": SEED,
            "evaluations": [int(one.evaluations[-1]) for one in descents],
            "identification_tests": list(IDENTIFICATION),
            "quick": quick,
        },
        picture=ConvergenceChart(
            box(PART_WIDTH, PART_LENGTH).outline, np.array(P1[2:]).reshape(3, 2), descents
        ),
        seconds=clock.perf_counter() - begun,
    )


def _descent(
    number: int,
    steps: list[tuple[int, float, float, tuple[float, ...]]],
    search: NelderMeadSearch,
) -> BestSoFar:
    evaluations, errors, sizes, points = zip(*steps, strict=True)
    return BestSoFar(
        f"search {number}",
        np.array(evaluations),
        np.array(errors),
        np.array(sizes),
        np.array(points)[:, 2:].reshape(-1, 3, 2),
        np.array(search.best.point[:2]),
    )


def _rows(one: BestSoFar) -> list[Row]:
    return [
        {
            "search": one.label,
            "evaluations": int(evaluations),
            "f_um": float(1e3 * error),
            "simplex_size": float(size),
            "points_um": np.round(1e6 * points, 1).tolist(),
        }
        for evaluations, error, size, points in zip(
            one.evaluations, one.error, one.size, one.points, strict=True
        )
    ]


def _sentence(one: BestSoFar) -> str:
    ends = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in 1e6 * one.points[-1])
    return (
        f"{one.label}: F {1e3 * one.error[0]:.1f} -> {1e3 * one.error[-1]:.2f} um in"
        f" {one.evaluations[-1]} evaluations, the simplex {one.size[0]:.2g} -> {one.size[-1]:.2g}"
        f" scales; support points {ends} um, mu_pusher {one.friction[0]:.3f}, mu_support"
        f" {one.friction[1]:.3f}."
    )
