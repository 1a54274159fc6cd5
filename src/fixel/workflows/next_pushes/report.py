"""Report of proposed pushes: sentences, table and picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.domain.error_bound import min_experiments
from fixel.drawing.parts import next_pushes_chart
from fixel.parts.next_pushes import NextPushes
from fixel.workflows.analysis import Analysis, AnalysisReport
from fixel.workflows.figures import Picture, banner_of
from fixel.workflows.next_pushes.selection import PushProposal

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnswer


def report_of(found: PushProposal) -> AnalysisReport:
    """Return sentences, table, numbers and picture of a proposal, with what is unseen."""
    pushes, model, own = found.pushes, found.model, found.selection
    where = " on ".join(
        x for x in (own.part.value or "the part of the scene", own.surface.value) if x
    )
    simulated = [
        "" if one.real else f"SIMULATED by {one.simulated_by}" for one in model.experiments
    ]
    chart = next_pushes_chart(pushes, f"Next pushes of {where}")
    caption = "Outline of the part with the proposed pushes, the best first."
    parts = {own.part.name and str(one.conditions[own.part.name]) for one in own.known}
    analysis = Analysis(
        kind="next",
        title=f"Next pushes of {where}",
        question={},
        headline=(
            f"Next pushes of {where}, after {pushes.pushes} pushes"
            f" ({pushes.candidates} candidates).",
            _headline(pushes),
            f"The bounds come from {len(model.parts)} parts that were left out. They prove at most"
            f" {100.0 * model.proved_level:.1f} %, and a guarantee of {100.0 * model.level:g} %"
            f" needs {min_experiments(model.level)} parts.",
        ),
        warnings=(
            *pushes.unseen,
            *pushes.gaps,
            *(f"{n} experiment{'s' * (n != 1)} {why}: not used" for why, n in own.skipped.items()),
        ),
        tables=(pushes.table(),),
        notes=(
            pushes.notes[0],
            f"learned from {len(own.known)} pushes of {len(parts)} parts",
        ),
        numbers=_numbers(found),
    )
    return AnalysisReport(analysis, [Picture("pushes", chart, banner_of(simulated), caption)])


def content(done: StoredAnswer) -> dict[str, Any]:
    """Return the content of `--json`."""
    files = [str(file) for file in done.files.values()]
    return done.analysis.numbers | {
        "seconds": done.analysis.seconds, "folder": str(done.folder), "files": files
    }  # fmt: skip


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that performs the pushes, or writes them to a file."""
    if "out" in done.files:
        return ["testbed", "run", done.files["out"]]
    return [*done.again, "--out", "next.yaml"]


def _headline(pushes: NextPushes) -> str:
    if not pushes.bounded[0]:
        return "None of the intended pushes has a bound."
    ratio = float(pushes.shrinking[-1])
    return (
        f"Bounds now: {pushes.now}; expected after these {len(pushes.order)} pushes:"
        f" {100.0 * ratio:.0f} % of that."
    )


def _numbers(found: PushProposal) -> dict[str, Any]:
    """Return a proposal as plain values in SI units, for `--json` and the page."""
    own, selected = found.pushes, found.selection

    def finite(values: np.ndarray) -> list[float | None]:
        return [float(x) if math.isfinite(x) else None for x in values]

    return {
        "unseen": list(own.unseen),
        "part": selected.part.value,
        "surface": selected.surface.value,
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
        "skipped": selected.skipped,
    }
