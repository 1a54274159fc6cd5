"""Report of a sensitivity analysis: sentences, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from fixel.drawing.sensitivity import Bars, FanChart, IndicesChart
from fixel.model import Parameters
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.uncertainty.indices import Indices
from fixel.uncertainty.outcomes import FLAGS
from fixel.workflows.analysis import Analysis, rounded
from fixel.workflows.figures import Picture
from fixel.workflows.sensitivity.request import Finding, SensitivityRequest, Subject

MAX_PICTURES: Final = 12  # of the pushes to avoid first; the table has all

MEANING: Final[Mapping[str, str]] = {
    FLAGS[0]: "its outcomes fall apart into groups",
    FLAGS[1]: "some starts that lie side by side end far apart",
    FLAGS[2]: "an error of the start at least doubles",
    FLAGS[3]: "an error of the start stays about as it is, or shrinks",
}


def analysis_of(
    found: Sequence[Finding],
    skipped: Mapping[str, str],
    request: SensitivityRequest,
    command: str,
    seconds: float,
) -> Analysis:
    """Return the analysis to store, with the push to avoid first in front."""
    keys = [finding.subject.key for finding in found]
    one = found[0]
    title = keys[0] if len(keys) == 1 else f"{len(keys)} pushes"
    return Analysis(
        kind="sensitivity",
        title=f"Sensitivity to the start: {title}",
        question=request.question(sorted(keys)),
        headline=tuple(_headline(found, request)),
        warnings=tuple(_warnings(found, skipped)),
        tables=tuple(_tables(found)),
        methods=tuple(_methods(one, request)),
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


def _headline(found: Sequence[Finding], request: SensitivityRequest) -> list[str]:
    said = []
    if len(found) > 1:
        counts = {flag: sum(f.sensitivity.flag == flag for f in found) for flag in FLAGS}
        told = ", ".join(f"{n} {flag}" for flag, n in counts.items() if n)
        said.append(f"Of {len(found)} pushes: {told}.")
    for finding in found[:3]:
        own = finding.sensitivity
        said.append(
            f"{finding.subject.key}: {own.flag}: {MEANING[own.flag]}. Starts"
            f" {request.error.written()} end {rounded(1e3 * own.after.position)} mm and"
            f" {rounded(math.degrees(own.after.angle))} deg (rms) from their mean: the spread grows"
            f" {own.amplification:.2g} times, a small error up to {own.gain:.2g} times."
        )
        if len(own.share) > 1:
            shares = ", ".join(f"{share:.0%}" for share in own.share)
            said.append(
                f"{finding.subject.key} has {len(own.share)} outcomes ({shares}), up to"
                f" {1e3 * own.apart:.3g} mm apart, turns counted at {1e3 * own.arm:.3g} mm/rad."
            )
        said += _largest_share(finding)
    return said


def _largest_share(finding: Finding) -> list[str]:
    """Sentence on the input that causes most of the spread of the most variable outcome."""
    own = finding.indices
    if own is None or not (own.deviation > 0.0).any():
        return []
    weight = np.array([1.0, 1.0, finding.sensitivity.arm])
    k = int(np.argmax(own.deviation * weight))
    j = int(np.argmax(own.total[k]))
    return [
        f"{finding.subject.key}: most of the spread {own.outcomes[k]} comes from"
        f" {own.factors[j].name} (total index {own.total[k, j]:.2f} +-"
        f" {own.total_error[k, j]:.2f})."
    ]


def _warnings(found: Sequence[Finding], skipped: Mapping[str, str]) -> list[str]:
    said = []
    for finding in found:
        failed = sum(finding.sensitivity.failed.values())
        if failed:
            why = "; ".join(f"{n} x {r}" for r, n in finding.sensitivity.failed.items())
            n = len(finding.ensemble.reasons)
            said.append(f"{finding.subject.key}: {failed} of {n} starts have no outcome: {why}.")
        if finding.ensemble.moved_apart > 0.0:
            said.append(
                f"{finding.subject.key}: {finding.ensemble.moved_apart:.0%} of the starts would"
                " overlap a neighbour and were moved beside it."
            )
        if finding.indices is not None and float(finding.indices.total_error.max()) > 0.2:
            said.append(
                f"{finding.subject.key}: some indices are uncertain by more than 0.2; ask for more"
                " samples."
            )
    said += [f"{key} was left out: {reason}" for key, reason in skipped.items()]
    return said


def _tables(found: Sequence[Finding]) -> list[Table]:
    head = (
        "push", "flag", "amplification", "gain", "spread [mm]", "spread [deg]", "outcomes",
        "contact modes",
    )  # fmt: skip
    tables = [Table(head, map(_row, found), title="Pushes, to avoid first", left=2)]
    for finding in found:
        if finding.indices is not None:
            tables.append(_index_table(finding.subject.key, finding.indices))
    return tables


def _row(finding: Finding) -> tuple[str, ...]:
    own = finding.sensitivity
    return (
        finding.subject.key,
        own.flag,
        f"{own.amplification:.2f}",
        f"{own.gain:.2f}",
        rounded(1e3 * own.after.position, 4),
        rounded(math.degrees(own.after.angle), 4),
        " + ".join(f"{share:.0%}" for share in own.share),
        " ".join(f"{mode}: {share:.0%}" for mode, share in own.modes.items()),
    )


def _index_table(key: str, own: Indices) -> Table:
    rows = [
        (
            outcome,
            factor.name,
            f"{own.first[k, j]:z.3f} +- {own.first_error[k, j]:.3f}",
            f"{own.total[k, j]:z.3f} +- {own.total_error[k, j]:.3f}",
        )
        for k, outcome in enumerate(own.outcomes)
        for j, factor in enumerate(own.factors)
    ]
    return Table(
        ("outcome", "input", "first order", "total"), rows, title=f"Sobol indices of {key}"
    )


def _methods(one: Finding, request: SensitivityRequest) -> list[str]:
    said = [
        f"The outcome of each push was simulated ({one.ensemble.motion}) for {request.samples}"
        f" starts {request.error.written()}, drawn as a scrambled Sobol sequence; starts that would"
        " overlap a neighbour were moved out the shortest way.",
        "Amplification is the root mean square spread of end poses over that of starts, turns"
        " counted at the body's radius of gyration; outcomes are groups of end poses with a gap"
        " between them that a cloud without one shows with a chance of 0.1 %.",
    ]
    if one.indices is not None:
        said.append(
            "Sobol indices were estimated by the method of Saltelli et al. (2010) with SALib from"
            f" {one.indices.evaluations} simulations a push, intervals by bootstrap."
        )
    return said


def _numbers(finding: Finding) -> dict[str, Any]:
    found: dict[str, Any] = {
        "key": finding.subject.key,
        "experiment_id": finding.subject.id,
        **finding.sensitivity.summary(),
        "moved_apart": finding.ensemble.moved_apart,
        "nominal_end": finding.ensemble.nominal[-1].tolist(),
        "values": dict(Parameters(finding.subject.values)),
    }
    if finding.indices is not None:
        found["indices"] = finding.indices.summary()
    return found


def pictures_of(found: Sequence[Finding]) -> list[Picture]:
    """Draw charts of the pushes to avoid first."""
    pictures = []
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        own, ensemble, subject = finding.sensitivity, finding.ensemble, finding.subject
        stem = f"{k:02d}-" + "".join(c if c.isalnum() else "-" for c in subject.key)
        chart = FanChart(
            title=f"{subject.key}: {own.flag}",
            scene=subject.scene,
            drawn=ensemble.drawn[ensemble.ended],
            end=ensemble.end,
            nominal=ensemble.nominal[-1],
            outcome=own.outcome,
            share=own.share,
        )
        pictures.append(
            Picture(
                f"{stem}-ensemble",
                chart,
                subject.banner,
                f"End poses of {subject.key} over starts {ensemble.error.written()}: {own.flag},"
                f" amplification {own.amplification:.2g}. Colours are outcomes; the black outline"
                " is the end without an error.",
            )
        )
        if finding.indices is not None:
            pictures.append(_index_picture(stem, subject, finding.indices))
    return pictures


def _index_picture(stem: str, subject: Subject, own: Indices) -> Picture:
    bars = [
        Bars(
            outcome,
            own.units[k],
            float(own.deviation[k]),
            own.first[k],
            own.first_error[k],
            own.total[k],
            own.total_error[k],
        )
        for k, outcome in enumerate(own.outcomes)
    ]
    names = [factor.name for factor in own.factors]
    return Picture(
        f"{stem}-indices",
        IndicesChart(title=f"{subject.key}: where the spread comes from", names=names, bars=bars),
        subject.banner,
        f"Sobol indices of the end of {subject.key} with 95 % intervals; above each panel the"
        " standard deviation that is shared out.",
    )


def arrays_of(found: Sequence[Finding]) -> dict[str, FloatArray]:
    """Return the starts and poses shown in the charts."""
    arrays: dict[str, FloatArray] = {}
    for k, finding in enumerate(found[:MAX_PICTURES], 1):
        arrays[f"drawn_{k}"] = finding.ensemble.drawn
        arrays[f"pose_{k}"] = finding.ensemble.pose
        arrays[f"ended_{k}"] = finding.ensemble.ended.astype(np.float64)
    return arrays
