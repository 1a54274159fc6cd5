"""Report of proposed pushes, to store: sentences, table and picture."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fixel.database.project import Project
from fixel.domain.error_bound import min_experiments
from fixel.drawing.parts import NextPushesChart
from fixel.parts.next_pushes import NextPushes
from fixel.workflows.analysis import Analysis, StoredAnalysis, store_analysis
from fixel.workflows.figures import Picture, banner_of
from fixel.workflows.next_pushes.run import NextPushesRequest, PushProposal


def store_proposal(project: Project, found: PushProposal, command: str = "") -> StoredAnalysis:
    """Store a proposal in its project, with its picture and what is unseen as warnings."""
    pushes, model = found.pushes, found.model
    where = " on ".join(x for x in (found.part or "the part of the scene", found.surface) if x)
    table = pushes.table()
    n = len(model.parts)
    headline = [_headline(pushes)]
    headline.append(
        f"The bounds come from {n} parts that were left out. They prove at most"
        f" {100.0 * model.proved_level:.1f} %, and a guarantee of {100.0 * model.level:g} % needs"
        f" {min_experiments(model.level)} parts."
    )
    chart = NextPushesChart(title=f"Next pushes of {where}", pushes=pushes)
    simulated = [
        "" if own.real else f"SIMULATED by {own.simulated_by}" for own in model.experiments
    ]
    analysis = Analysis(
        kind="next",
        title=f"Next pushes of {where}",
        question=asdict(found.request) | {"where": list(found.request.where)},
        headline=tuple(headline),
        warnings=tuple([*pushes.unseen, *_warnings(found)]),
        tables=(table,),
        numbers=numbers_of(found),
        command=command,
        seed=found.request.seed,
        seconds=found.seconds,
    )
    caption = "Outline of the part with the proposed pushes, the best first."
    picture = Picture("pushes", chart, banner_of(simulated), caption)
    return store_analysis(project, analysis, [picture])


def command_of(request: NextPushesRequest, folder: Path = Path()) -> str:
    """Return the command that repeats a proposal; without a folder for the current one."""
    values = {
        "--part": request.part,
        "--surface": request.surface,
        "--scene": request.scene,
        "--candidates": request.candidates,
        "--travel-mm": _scaled(request.travel),
        "--speed-mm-s": _scaled(request.speed),
        "--radius-mm": _scaled(request.radius),
        "--project": "" if folder == Path() else str(folder),
    }
    words = ["fixel", "next", *(word for k, v in values.items() if v for word in (k, v))]
    words += [word for text in request.where for word in ("--where", text)]
    words += ["--chosen"] * request.chosen
    for name, default in (("n", 5), ("contacts", 24), ("seed", 0)):
        value = getattr(request, name)
        words += [f"--{'number' if name == 'n' else name}", str(value)] * (value != default)
    return shlex.join(words)


def _scaled(value: float | None) -> str:
    return "" if value is None else f"{1e3 * value:g}"


def _headline(pushes: NextPushes) -> str:
    if not pushes.bounded[0]:
        return "None of the intended pushes has a bound."
    ratio = float(pushes.shrinking[-1])
    return (
        f"Bounds now: {pushes.now}; expected after these {len(pushes.order)} pushes:"
        f" {100.0 * ratio:.0f} % of that."
    )


def _warnings(found: PushProposal) -> list[str]:
    """Return sentences on intended pushes without a bound, and on what was left out."""
    return [
        *found.pushes.gaps,
        *(f"{n} experiment{'s' * (n != 1)} {why}: not used" for why, n in found.skipped.items()),
    ]


def numbers_of(found: PushProposal) -> dict[str, object]:
    """Return a proposal as plain values in SI units, for `--json` and the page."""
    own = found.pushes

    def finite(values: np.ndarray) -> list[float | None]:
        return [float(x) if math.isfinite(x) else None for x in values]

    return {
        "unseen": list(own.unseen),
        "part": found.part,
        "surface": found.surface,
        "pushes_made": own.pushes,
        "candidates": own.candidates,
        "left_out_candidates": own.idle,
        "now": {"position_m": finite(own.position), "angle_rad": finite(own.angle)},
        "without_bound": {"pushes": own.bounded[1] - own.bounded[0], "reasons": list(own.reasons)},
        "pushes": [
            {
                "candidate": own.order[k],
                "name": own.name_of(k),
                "start_m": own.start[k].tolist(),
                "end_m": own.end[k].tolist(),
                "expected_ratio": ratio,
                "position_m": finite(ratio * own.position),
                "angle_rad": finite(ratio * own.angle),
            }
            for k, ratio in enumerate(own.shrinking.tolist())
        ],
        "outline_m": own.outline.tolist(),
        "radius_m": own.radius,
        "known_parts": list(found.model.parts),
        "level": found.model.level,
        "proved_level": found.model.proved_level,
        "skipped": found.skipped,
        "seconds": found.seconds,
    }
