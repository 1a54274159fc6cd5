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

from fixel.calibration.target import Target
from fixel.datasets.mit_push import MitPushes
from fixel.io.array_bytes import ResultCache
from fixel.model.space import ParameterSpace, Unknown
from fixel.replay.base import Row, errors_in_mm_and_deg
from fixel.simulation.simulate import get_ready
from fixel.typing import FloatArray, IntArray, ProgressCallback
from fixel.workflows.calibration.run import calibrate
from reproductions.protocols import PROTOCOLS, RUN, BenchmarkData, BenchmarkRequest, Piece
from reproductions.pushes import (
    DURATION,
    PushGroup,
    rows_by_key,
)
from reproductions.result import Benchmark, HeldOutScores

PUSHES: Final = 1000  # of the joint calibration

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
    *,
    pushes: int = PUSHES,
    threads: int | None = None,
) -> Row:
    """Calibrate five parameters jointly on many real pushes of all plates and surfaces.

    It is `fixel.calibrate` with its default search, as a user runs it, with the robust error.

    Returns
    -------
    dict
        Times, best values, verdicts, and errors at the start and at the best values.
    """
    rows = data.usable
    chosen = rows[np.arange(min(pushes, len(rows))) * len(rows) // min(pushes, len(rows))]
    targets = _targets(data, chosen, threads)
    get_ready(targets[0].case.scene)  # before the clock runs
    started = clock.perf_counter()
    found = calibrate(targets, SPACE, error="robust", threads=threads)
    return {
        "pushes": len(targets),
        "parameters": len(found),
        "evaluations": found.evaluations,
        "seconds": round(found.found.seconds, 1),
        "error_unit": found.objective.unit,
        "error_at_start": float(found.nominal_errors.mean()),
        "error_at_best": float(found.found.errors.mean()),
        "best": dict(found),
        "seconds_with_verdicts": round(clock.perf_counter() - started, 1),
        "verdicts": found.verdicts,
    }


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
