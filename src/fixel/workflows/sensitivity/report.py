"""Report of a sensitivity analysis: sentences, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from fixel.drawing.sensitivity import EnsembleChart, IndicesChart
from fixel.model import Parameters
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.uncertainty.outcomes import FLAGS, MEANING
from fixel.workflows.analysis import Analysis
from fixel.workflows.figures import Picture
from fixel.workflows.sensitivity.request import Finding, SensitivityRequest
from fixel.workflows.sentences import rounded, sentences

MAX_SENTENCES: Final = 3  # pushes with sentences in the headline
MAX_PICTURES: Final = 12  # of the pushes to avoid first; the table has all


def analysis_of(
    found: Sequence[Finding],
    skipped: Mapping[str, str],
    request: SensitivityRequest,
    command: str,
    seconds: float,
) -> Analysis:
    """Return the analysis to store, with the push to avoid first in front."""
    keys = [finding.subject.key for finding in found]
    title = keys[0] if len(keys) == 1 else f"{len(keys)} pushes"
    return Analysis(
        kind="sensitivity",
        title=f"Sensitivity to the start: {title}",
        question=request.question(sorted(keys)),
        headline=_headline(found, request),
        warnings=sentences("sensitivity", "warnings", found=found, skipped=skipped),
        tables=tuple(_tables(found)),
        methods=sentences("sensitivity", "methods", one=found[0], request=request),
        references=("asme2006", *(("saltelli2010", "herman2017") if request.indices else ())),
        numbers={
            "start_error": {
                "x_m": request.error.x,
                "y_m": request.error.y,
                "theta_rad": request.error.theta,
                "kind": request.error.kind,
            },
            "samples": request.samples,
            "pushes": [_numbers(finding) for finding in found],
            "skipped": dict(skipped),
        },
        calibrations=() if request.calibration is None else (request.calibration,),
        experiments=tuple(f.subject.id for f in found if f.subject.id is not None),
        command=command,
        seed=request.seed,
        seconds=seconds,
    )


def _headline(found: Sequence[Finding], request: SensitivityRequest) -> tuple[str, ...]:
    flags = [finding.sensitivity.flag for finding in found]
    return sentences(
        "sensitivity",
        "headline",
        keys=[finding.subject.key for finding in found],
        found=found[:MAX_SENTENCES],
        counts=", ".join(f"{flags.count(flag)} {flag}" for flag in FLAGS if flag in flags),
        meaning=MEANING,
        error=request.error,
        largest=[_largest_share(finding) for finding in found[:MAX_SENTENCES]],
    )


def _largest_share(finding: Finding) -> dict[str, Any]:
    """Input that causes most of the spread of the most variable outcome; empty if none does."""
    own = finding.sensitivity.indices
    if own is None or not (own.deviation > 0.0).any():
        return {}
    weight = np.array([1.0, 1.0, finding.sensitivity.arm])
    k = int(np.argmax(own.deviation * weight))
    j = int(np.argmax(own.total[k]))
    return {
        "outcome": own.outcomes[k],
        "name": own.factors[j].name,
        "total": own.total[k, j],
        "error": own.total_error[k, j],
    }


def _tables(found: Sequence[Finding]) -> list[Table]:
    head = (
        *("push", "flag", Column("amplification", format=".2f"), Column("gain", format=".2f")),
        *("spread [mm]", "spread [deg]", "outcomes", "contact modes"),
    )
    rows = [
        (
            finding.subject.key,
            own.flag,
            own.amplification,
            own.gain,
            rounded(1e3 * own.after.position, 4),
            rounded(math.degrees(own.after.angle), 4),
            " + ".join(f"{share:.0%}" for share in own.share),
            " ".join(f"{mode}: {share:.0%}" for mode, share in own.modes.items()),
        )
        for finding, own in ((finding, finding.sensitivity) for finding in found)
    ]
    some = [
        (f.subject.key, f.sensitivity.indices) for f in found if f.sensitivity.indices is not None
    ]
    return [
        Table(head, rows, title="Pushes, the most sensitive first", left=2),
        *(indices.table(f"Sobol indices of {key}") for key, indices in some),
    ]


def _numbers(finding: Finding) -> dict[str, Any]:
    found: dict[str, Any] = {
        "key": finding.subject.key,
        "experiment_id": finding.subject.id,
        "motion": finding.sensitivity.prediction.motion,
        **finding.sensitivity.summary(),
        "moved_apart": finding.sensitivity.prediction.moved_apart,
        "nominal_end": finding.sensitivity.prediction.nominal[-1].tolist(),
        "values": dict(Parameters(finding.subject.values)),
    }
    if finding.sensitivity.indices is not None:
        found["indices"] = finding.sensitivity.indices.summary()
    return found


def pictures_of(found: Sequence[Finding]) -> list[Picture]:
    """Draw charts of the pushes to avoid first."""
    pictures = []
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        own, subject = finding.sensitivity, finding.subject
        ensemble = own.prediction
        stem = f"{k:02d}-" + "".join(c if c.isalnum() else "-" for c in subject.key)
        chart = EnsembleChart.of(own, title=f"{subject.key}: {own.flag}")
        known = {"key": subject.key, "own": own, "ensemble": ensemble}
        (caption,) = sentences("sensitivity", "ensemble_caption", **known)
        pictures.append(Picture(f"{stem}-ensemble", chart, subject.banner, caption))
        if own.indices is not None:
            title = f"{subject.key}: sources of the spread"
            bars = IndicesChart(title=title, indices=own.indices)
            (caption,) = sentences("sensitivity", "indices_caption", key=subject.key)
            pictures.append(Picture(f"{stem}-indices", bars, subject.banner, caption))
    return pictures


def arrays_of(found: Sequence[Finding]) -> dict[str, FloatArray]:
    """Return the starts and poses shown in the charts."""
    arrays: dict[str, FloatArray] = {}
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        arrays[f"drawn_{k}"] = finding.sensitivity.prediction.drawn
        arrays[f"pose_{k}"] = finding.sensitivity.prediction.pose
        arrays[f"ended_{k}"] = finding.sensitivity.prediction.ended.astype(np.float64)
    return arrays
