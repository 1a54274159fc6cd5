"""Timing of a joint calibration of many pushes."""

from __future__ import annotations

import time as clock
from typing import Final

import numpy as np

from fixel.calibration.objective import Comparer, Objective, Robust
from fixel.calibration.optimiser import Best, SearchBox
from fixel.calibration.pattern_search import PatternSearch
from fixel.calibration.target import Target
from fixel.datasets.raw.mit_push import MitPushes
from fixel.model.space import ParameterSpace, Unknown
from fixel.reproductions.pushes import DURATION, STEP, PushGroup, rows_by_key, usable_rows
from fixel.reproductions.result import Row
from fixel.simulation import StewartTrinkle
from fixel.typing import FloatArray, IntArray, Progress

PUSHES: Final = 1000
EVALUATIONS: Final = 2000

SPACE: Final = ParameterSpace(
    unknowns=(
        Unknown(name="mu_pusher", low=0.05, high=0.5, nominal=0.25),
        Unknown(name="registration_x", low=-3e-3, high=3e-3, nominal=0.0),
        Unknown(name="registration_y", low=-3e-3, high=3e-3, nominal=0.0),
        Unknown(name="contact_offset", low=-5e-4, high=5e-4, nominal=0.0),
        Unknown(name="anisotropy_xy", low=-0.3, high=0.3, nominal=0.0),
    )
)


def joint_calibration(
    data: MitPushes,
    progress: Progress,
    *,
    pushes: int = PUSHES,
    evaluations: int = EVALUATIONS,
    threads: int | None = None,
) -> Row:
    """Calibrate five parameters jointly on many real pushes of all plates and surfaces.

    Pattern searches start from the nominal values, then from random points, until the given number
    of evaluations of the objective is reached.

    Returns
    -------
    dict
        Times, best values, and errors at the start and at the best values.
    """
    rows = usable_rows(data)
    chosen = rows[np.arange(min(pushes, len(rows))) * len(rows) // min(pushes, len(rows))]
    targets = _targets(data, chosen, threads)
    stepper = StewartTrinkle(step=STEP)
    objective = Objective(Comparer(targets, SPACE, Robust(), stepper=stepper, threads=threads))
    box = SearchBox(SPACE.low, SPACE.high, SPACE.nominal, SPACE.scale)
    objective(SPACE.nominal[None])  # compile, or load compiled code
    started = clock.perf_counter()
    best, made, first = _searched(objective, box, evaluations, progress)
    seconds = clock.perf_counter() - started
    return {
        "pushes": len(targets),
        "parameters": box.n,
        "evaluations": made,
        "seconds": round(seconds, 1),
        "pushes_per_second": round(made * len(targets) / seconds),
        "error_unit": objective.comparer.error.unit,
        "error_at_start": first,
        "error_at_best": best.error,
        "best": SPACE.values(best.point),
    }


def _searched(
    objective: Objective, box: SearchBox, evaluations: int, progress: Progress
) -> tuple[Best, int, float]:
    rng = np.random.default_rng(0)
    best, made, first = Best(box.start, np.inf), 0, np.nan
    while made < evaluations:
        search = PatternSearch().start(box)
        while not search.done and made < evaluations:
            points: FloatArray = search.ask()
            errors = objective(points)
            first = float(errors[0]) if made == 0 else first
            made += len(points)
            search.tell(errors)
            progress(min(made, evaluations), evaluations, "joint calibration")
        best = min(best, search.best, key=lambda own: own.error)
        box = box._replace(start=rng.uniform(box.low, box.high))
    return best, made, first


def _targets(data: MitPushes, rows: IntArray, threads: int | None) -> list[Target]:
    names = data.table.text("push_id")
    found = []
    for key, own in rows_by_key(data, rows).items():
        group = PushGroup(data, key, own, threads)
        for k, case in enumerate(group.cases):
            conditions: dict[str, str | float] = {"surface": key[0], "shape": key[1]}
            found.append(Target(str(names[own[k]]), conditions, case, group.end[k : k + 1]))
    assert all(target.case.times[-1] == DURATION for target in found)
    return found
