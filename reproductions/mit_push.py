"""Calibration on the straight pushes of the MIT push dataset, scored on held-out pushes.

The prediction of a held-out push uses only the start of object and tip and the path of the tip.
Settings were chosen on inner splits of training pushes; see the how-to page.
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration.assess import assess
from fixel.calibration.objective import Comparer, Objective, Robust
from fixel.calibration.optimiser import Best, SearchBox
from fixel.calibration.pattern_search import PatternSearch
from fixel.calibration.target import Target
from fixel.datasets.mit_push import MitPushes
from fixel.io.array_bytes import ResultCache
from fixel.model.space import ParameterSpace, Unknown
from fixel.replay.base import Row, errors_in_mm_and_deg
from fixel.simulation import Adaptive
from fixel.typing import FloatArray, IntArray, ProgressCallback
from reproductions.protocols import PROTOCOLS, RUN, BenchmarkData, BenchmarkRequest, Piece
from reproductions.pushes import (
    DURATION,
    PushGroup,
    rows_by_key,
)
from reproductions.result import Benchmark, HeldOutScores

# Joint calibration: number of pushes, and of evaluations of the objective.
PUSHES: Final = 1000
EVALUATIONS: Final = 2000
# [m] Tolerance of a step: half of the ends are within 0.03 mm of the limit of small steps, 95 %
# within 0.12 mm, where fixed steps of `STEP` have 0.08 and 0.22 mm and are five times as many.
# With 3e-5 m the intervals are the same within a quarter; with 1e-4 m they are up to four times as
# wide, and the contact offset is not identified.
TOLERANCE: Final = 5e-5

SPACE: Final = ParameterSpace(
    unknowns=(
        Unknown(name="mu_pusher", low=0.05, high=0.5, nominal=0.25),
        Unknown(name="registration_x", low=-3e-3, high=3e-3, nominal=0.0),
        Unknown(name="registration_y", low=-3e-3, high=3e-3, nominal=0.0),
        Unknown(name="contact_offset", low=-5e-4, high=5e-4, nominal=0.0),
        Unknown(name="anisotropy_xy", low=-0.3, high=0.3, nominal=0.0),
    )
)

PUBLISHED: Final = "poly4"  # the better of the two published limit surfaces


def benchmark_pushes(
    data: MitPushes, request: BenchmarkRequest, folder: Path | None, progress: ProgressCallback
) -> Benchmark:
    """Run protocols on recorded pushes and score their predictions.

    Parameters
    ----------
    data : MitPushes
    request : BenchmarkRequest
    folder : Path, optional
        Folder in which finished fits are stored.
    progress : callable
    """
    if PUBLISHED not in data.published:
        data.published[PUBLISHED] = np.full((len(data), 3), np.nan)
    started = clock.perf_counter()
    bench = BenchmarkData(data, request, ResultCache(folder), progress)
    chosen = [name for name in PROTOCOLS if name in request.protocols]
    repeats = request.folds or request.seeds
    per_group = sum(1 if name == "new-shape" else repeats for name in chosen)
    bench.total = len(bench.rows) * per_group
    scored, fits, seconds = [], [], {}
    for name in chosen:
        begun = clock.perf_counter()
        pieces = [piece for key in bench.rows for piece in RUN[name](bench, key)]
        if pieces:
            scored.append(_scored(bench, name, pieces))
            fits += [{"protocol": name, **piece.fit} for piece in pieces]
        seconds[name] = round(clock.perf_counter() - begun, 1)
    return Benchmark(
        part="mit",
        scored=tuple(scored),
        settings=_settings(request, bench),
        timing={"seconds": round(clock.perf_counter() - started, 1), "by_protocol": seconds},
        notes=_notes(bench, chosen),
        fits=tuple(fits),
    )


def _scored(bench: BenchmarkData, protocol: str, pieces: Sequence[Piece]) -> HeldOutScores:
    models: dict[str, list[FloatArray]] = {"published": [], "uncalibrated": [], "calibrated": []}
    for piece in pieces:
        group, which = piece.group, piece.which
        nominal = np.where(group.nominal.good[:, None], group.nominal.end, np.nan)
        ends = {
            "published": bench.data.published[PUBLISHED][group.rows[which]],
            "uncalibrated": nominal[which],
            "calibrated": piece.end,
        }
        for model, end in ends.items():
            models[model].append(np.array(errors_in_mm_and_deg(end, group.end[which])))
    if all(np.isnan(part).all() for part in models["published"]):
        del models["published"]
    tables = {model: np.concatenate(parts, axis=1) for model, parts in models.items()}
    inside = [piece.inside for piece in pieces if piece.inside is not None]
    return HeldOutScores(
        protocol=protocol,
        names=tuple(n for p in pieces for n in bench.names[p.group.rows[p.which]].tolist()),
        repeat=np.concatenate([np.full(len(p.which), p.repeat) for p in pieces]),
        groups=tuple(p.group.key for p in pieces for _ in p.which),
        position={model: table[0] for model, table in tables.items()},
        angle={model: table[1] for model, table in tables.items()},
        inside=np.concatenate(inside) if inside else None,
    )


def _settings(request: BenchmarkRequest, bench: BenchmarkData) -> Row:
    return {
        "protocols": list(request.protocols),
        "seeds": 0 if request.folds else request.seeds,
        "folds": request.folds,
        "quick": request.quick,
        "iterations": request.iterations,
        "pushes": int(sum(len(rows) for rows in bench.rows.values())),
        "published": PUBLISHED,
    }


def _notes(bench: BenchmarkData, chosen: Sequence[str]) -> tuple[str, ...]:
    left_out = len(bench.data) - len(bench.data.usable)
    notes = [
        "Errors on held-out pushes only: of the object frame's origin, and of the angle.",
        f"{left_out} pushes that do not fit their own geometry are left out, as in fixel replay.",
    ]
    if bench.request.quick:
        notes.append("Quick: few plates and pushes. These numbers say that it works, no more.")
    surfaces = [key[0] for key in bench.rows]
    if "new-shape" in chosen and any(surfaces.count(name) < 2 for name in surfaces):
        notes.append("No new-shape where a surface has one plate only.")
    if "learned" in chosen:
        notes.append("learned is physics and a Gaussian process: no calibration in the sense of")
        notes[-1] += " the others."
    return tuple(notes)


# --- one calibration of many pushes ---------------------------------------------------------------


def joint_calibration(
    data: MitPushes,
    progress: ProgressCallback,
    *,
    pushes: int = PUSHES,
    evaluations: int = EVALUATIONS,
    threads: int | None = None,
) -> Row:
    """Calibrate five parameters jointly on many real pushes of all plates and surfaces.

    Pattern searches start from the nominal values, then from random points, until the given number
    of evaluations of the objective is reached. The best values are then assessed.

    Returns
    -------
    dict
        Times, best values, verdicts, and errors at the start and at the best values.
    """
    rows = data.usable
    chosen = rows[np.arange(min(pushes, len(rows))) * len(rows) // min(pushes, len(rows))]
    targets = _targets(data, chosen, threads)
    stepper = Adaptive(tolerance=TOLERANCE)
    objective = Objective(Comparer(targets, SPACE, Robust(), stepper=stepper, threads=threads))
    box = SearchBox(SPACE.low, SPACE.high, SPACE.nominal, SPACE.scale)
    objective(SPACE.nominal[None])  # compile, or load compiled code
    started = clock.perf_counter()
    best, made, first = _searched(objective, box, evaluations, progress)
    seconds = clock.perf_counter() - started
    assessed = assess(objective.comparer, range(len(targets)), best.point)
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
        "seconds_with_verdicts": round(clock.perf_counter() - started, 1),
        "verdicts": {one.label: one.verdict for one in assessed.estimates},
    }


def _searched(
    objective: Objective, box: SearchBox, evaluations: int, progress: ProgressCallback
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
    names = data.names
    found = []
    for key, own in rows_by_key(data, rows).items():
        group = PushGroup(data, key, own, threads)
        for k, case in enumerate(group.cases):
            conditions: dict[str, str | float] = {"surface": key[0], "shape": key[1]}
            found.append(Target(str(names[own[k]]), conditions, case, group.end[k : k + 1]))
    assert all(target.case.times[-1] == DURATION for target in found)
    return found
