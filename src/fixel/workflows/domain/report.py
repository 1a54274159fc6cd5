"""Report of a domain map: sentences, tables and plain values."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from fixel.domain.claim import DOUBTFUL, NO_DATA, CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.held_out import reasons_text
from fixel.domain.next_experiment import Proposal
from fixel.domain.surface import NAMES
from fixel.drawing.domain import map_chart, size_chart
from fixel.table import Table
from fixel.workflows.analysis import Analysis, AnalysisReport, Picture, StoredAnswer
from fixel.workflows.domain.mapping import DomainAnswer, arrays_of, claimed
from fixel.workflows.domain.run import DOMAIN
from fixel.workflows.sentences import sentences


def report_of(answer: DomainAnswer) -> AnalysisReport:
    """Return headline, warnings, tables, charts and numbers of a map."""
    domain, gathered = answer.domain, answer.gathered
    claim, errors = domain.claimed, domain.evidence
    verdicts = domain.verdicts(claim)
    found = domain.proposals(claim, verdicts=verdicts)
    calibration = gathered.found["calibration"]
    numbers = {
        "unseen": list(gathered.found.get("unseen", ())),
        "floor_mm": gathered.found["floor_mm"],
        "evidence": gathered.mark,
    }
    return AnalysisReport(
        Analysis(
            kind="domain",
            title=f"Domain in which one parameter set stays within {claim.text()}",
            question={},
            headline=_headline(domain, claim, found),
            warnings=_warnings(answer, verdicts),
            tables=_tables(domain, claim, verdicts, found),
            methods=sentences(
                "domain", "methods", found=gathered.found, claim=claim, n=len(errors)
            ),
            references=("vovk2005", "barber2021"),
            numbers=_numbers(domain, claim, verdicts, found) | numbers,
            calibrations=() if calibration is None else (calibration,),
            experiments=tuple(errors.ids),
        ),
        _pictures(domain, claim, verdicts, "" if gathered.is_real else "SIMULATED"),
        arrays_of(domain),
    )


def content(done: StoredAnswer) -> dict[str, Any]:
    """Return the content of `--json`."""
    analysis = done.analysis
    return {
        "unseen": analysis.numbers["unseen"],
        "title": analysis.title,
        "numbers": analysis.numbers,
        "calibration": next(iter(analysis.calibrations), None),
        "folder": str(done.folder),
        "pictures": [str(path) for path in done.files.values()],
    }


def next_words(done: StoredAnswer) -> list[str]:
    """Return the next command: charts, then a tighter threshold or, below the noise, a report."""
    if not done.drawn:
        return [*done.again, "--plot", "domain"]
    numbers = done.analysis.numbers
    claim = Claim(**{own.name: numbers[own.name] for own in fields(Claim)})
    half = replace(claim, threshold=float(f"{0.5 * claim.threshold:.4g}"))
    if claim.measure == "absolute" and half.threshold < (numbers["floor_mm"] or 0.0):
        return ["report"]
    return DOMAIN.words(claimed(done.request, half))


def _headline(domain: DomainMap, claim: Claim, found: list[Proposal]) -> tuple[str, ...]:
    count = domain.colours(claim)
    sizes = [len(own) for own in domain.domains(claim)]
    return sentences(
        "domain",
        "headline",
        claim=claim,
        count=count,
        total=sum(count.values()) - count[NO_DATA] - count["predicted"],
        sizes=sizes,
        empty=sizes.count(0),
        cells=len(domain.cells),
        begins=None if any(sizes) else _begins(domain, claim),
        best=found[0] if found else None,
    )


def _begins(domain: DomainMap, claim: Claim) -> float | None:
    """Threshold at which an empty domain would begin; None if it is empty for every threshold."""
    thresholds = domain.usual_thresholds
    filled = np.flatnonzero(domain.curve(claim, thresholds.tolist()).sum(axis=0))
    return float(thresholds[filled[0]]) if len(filled) else None


def _warnings(answer: DomainAnswer, verdicts: list[list[CellVerdict]]) -> tuple[str, ...]:
    """Return warnings about the evidence of a map, without full stops."""
    domain, claim, found = answer.domain, answer.domain.claimed, answer.gathered.found
    nominal = domain.counts[:, domain.cells.nominal]
    few = any(
        verdict.colour == DOUBTFUL and domain.counts[g, c] < claim.needed
        for g, own in enumerate(verdicts)
        for c, verdict in enumerate(own)
    )
    return sentences(
        "domain",
        "warnings",
        found=found,
        counted=reasons_text,
        left_out=[why.replace(f" {key}", "") for key, why in found["left_out"].items()],
        claim=claim,
        aside=answer.n_aside,
        failed=int(np.isinf(domain.evidence.error_mm2).sum()),
        unknown=[note for note in domain.evidence.notes if note],
        empty=[group or "the map" for g, group in enumerate(domain.groups) if nominal[g] == 0],
        few=few and not domain.colours(claim)["trusted"],
    )


def _tables(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], found: list[Proposal]
) -> tuple[Table, ...]:
    """Tables of the extents of D(tau) by map, of bounds, and of the most useful experiments."""
    axes = domain.cells.axes
    rows = []
    extents, domains = domain.extents(claim), domain.domains(claim)
    for g, group in enumerate(domain.groups):
        own = [verdict.colour for verdict in verdicts[g]]
        ends = [extents[g][axis.name] for axis in axes]
        reach = ["empty" if own is None else " to ".join(filter(None, own)) for own in ends]
        cells = [str(own.count(c)) for c in ("trusted", "doubtful", "not trusted", NO_DATA)]
        rows.append((group or "all", *reach, str(len(domains[g])), *cells))
    names = (f"{axis.name}{f' [{axis.unit}]' if axis.unit else ''}" for axis in axes)
    head = ("map", *names, "cells in D", "trusted", "doubtful", "not trusted", "no data")
    first = Table(head, rows, title=f"D(tau) at {claim.text()}")
    second = Table(
        ("map", "experiment", "expected information [bit]", "why"),
        ((p.group or "all", p.where, f"{p.bits:.2f}", p.reason) for p in found),
        title="Suggested experiments",
        left=4,
    )
    return (first, *_bound_table(domain, claim), *([second] if found else []))


def _numbers(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], found: list[Proposal]
) -> dict[str, Any]:
    """Return plain values in SI units; None for missing ones."""
    inside = [set(own) for own in domain.domains(claim)]
    seen, bound = domain.statistic(claim.level), domain.predicted_mm
    return {
        **asdict(claim),
        "threshold_unit": "mm" if claim.measure == "absolute" else "share above the smallest E",
        "needed_by_counting": claim.needed,
        "cells": [
            {
                "group": group,
                "cell": domain.cells.text(c),
                "place": domain.cells.values(c),
                "members": domain.counts[g, c],
                "error": seen[g, c],
                "confidence": verdict.confidence,
                "promised_mm": None if bound is None else bound[g, c],
                "colour": verdict.colour,
                "in_domain": c in inside[g],
                "reason": verdict.reason,
            }
            for g, group in enumerate(domain.groups)
            for c, verdict in enumerate(verdicts[g])
        ],
        "surface": dict(zip(NAMES, domain.surface.values, strict=True)),
        "next": [
            {"group": p.group, "cell": p.where, "bits": p.bits, "reason": p.reason} for p in found
        ],
    }


def _bound_table(domain: DomainMap, claim: Claim) -> list[Table]:
    """Table of the error bounds of new experiments, by map; empty if there are no bounds."""
    if domain.predicted_mm is None:
        return []
    errors = np.sqrt(domain.evidence.error_mm2)
    rows = []
    for g, group in enumerate(domain.groups):
        bound = domain.predicted_mm[g][np.isfinite(domain.predicted_mm[g])]
        own = errors[np.concatenate([np.zeros(0, np.int64), *domain.members[g]])]
        few = len(bound) == 0
        shown = [f"{x:.3g}" for x in ([] if few else [bound.min(), np.median(bound), bound.max()])]
        rows.append((group or "all", f"{np.median(own):.3g}", *(shown or ["nothing"] * 3)))
    head = ("map", "median error [mm]", "smallest bound [mm]", "median bound [mm]", "largest [mm]")
    likely = f"{100.0 * claim.level:g} %"
    title = f"Error bounds of new experiments in these cells, each with a probability of {likely}"
    return [Table(head, rows, title=title)]


def _pictures(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], banner: str
) -> list[Picture]:
    """Charts of the map, one per axis if only one differs at a time, and of D(tau) by tau."""
    names = [axis.name for axis in domain.cells.axes]
    maps: dict[str, tuple[str, int, int | None]] = {"map": (" and ".join(names), 0, 1)}
    if domain.cells.is_strips:
        maps = {f"map-{name}": (name, k, None) for k, name in enumerate(names)}
    found = []
    for stem, (title, across, up) in maps.items():
        chart = map_chart(domain, claim, verdicts, across, up)
        (caption,) = sentences("domain", "map_caption", claim=claim, names=title)
        found.append(Picture(stem, chart, banner, caption))
    (caption,) = sentences("domain", "size_caption", claim=claim)
    return [*found, Picture("size", size_chart(domain, claim), banner, caption)]
