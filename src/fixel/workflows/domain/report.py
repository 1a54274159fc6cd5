"""Report of a domain map: sentences, tables and plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from fixel.domain.cells import Cells
from fixel.domain.claim import DOUBTFUL, NO_DATA, CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.next_experiment import Proposal
from fixel.table import Table
from fixel.workflows.domain.evidence import DomainEvidence
from fixel.workflows.sentences import sentences


def headline(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], found: list[Proposal]
) -> tuple[str, ...]:
    """Return the main results as sentences."""
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


def warnings_of(
    gathered: DomainEvidence, domain: DomainMap, claim: Claim, aside: int, verdicts: Any
) -> tuple[str, ...]:
    """Return warnings about the evidence of a map, without full stops."""
    nominal = domain.counts[:, domain.cells.nominal]
    few = any(
        verdict.colour == DOUBTFUL and domain.counts[g, c] < claim.needed
        for g, own in enumerate(verdicts)
        for c, verdict in enumerate(own)
    )
    return sentences(
        "domain",
        "warnings",
        gathered=gathered,
        claim=claim,
        aside=aside,
        failed=int(np.isinf(domain.evidence.error_mm2).sum()),
        unknown=[note for note in domain.evidence.notes if note],
        empty=[group or "the map" for g, group in enumerate(domain.groups) if nominal[g] == 0],
        few=few and not domain.colours(claim)["trusted"],
    )


def tables(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], found: list[Proposal]
) -> tuple[Table, ...]:
    """Tables of the extents of D(tau) by map, of bounds, and of the most useful experiments."""
    axes = domain.cells.axes
    rows = []
    extents, domains = domain.extents(claim), domain.domains(claim)
    for g, group in enumerate(domain.groups):
        own = [verdict.colour for verdict in verdicts[g]]
        reach = [_reach_text(extents[g][axis.name]) for axis in axes]
        cells = [str(own.count(c)) for c in ("trusted", "doubtful", "not trusted", NO_DATA)]
        rows.append((group or "all", *reach, str(len(domains[g])), *cells))
    head = (
        "map",
        *(f"{axis.name}{f' [{axis.unit}]' if axis.unit else ''}" for axis in axes),
        "cells in D",
        "trusted",
        "doubtful",
        "not trusted",
        "no data",
    )
    first = Table(head, rows, title=f"D(tau) at {claim.text()}")
    second = Table(
        ("map", "experiment", "expected information [bit]", "why"),
        ((p.group or "all", p.where, f"{p.bits:.2f}", p.reason) for p in found),
        title="Suggested experiments",
        left=4,
    )
    return (first, *bound_table(domain, claim), *([second] if found else []))


def _reach_text(reach: tuple[str, str] | None) -> str:
    if reach is None:
        return "empty"
    return f"{reach[0]} to {reach[1]}" if reach[1] else reach[0]


def numbers(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], found: list[Proposal]
) -> dict[str, Any]:
    """Return plain values in SI units; None for missing ones."""
    inside = [set(own) for own in domain.domains(claim)]
    seen = domain.statistic(claim.level)
    values = dict(zip(("reach", "shared", "own", "offset", "cell", "scatter"),
                      domain.surface.values.tolist(), strict=True))  # fmt: skip
    return {
        "threshold": claim.threshold,
        "threshold_unit": "mm" if claim.measure == "absolute" else "share above the smallest E",
        "level": claim.level,
        "confidence": claim.confidence,
        "needed_by_counting": claim.needed,
        "cells": [
            {
                "group": group,
                "cell": domain.cells.text(c),
                "place": _place(domain.cells, c),
                "members": int(domain.counts[g, c]),
                "error": _finite(seen[g, c]),
                "confidence": _finite(verdict.confidence),
                "promised_mm": _bound_at(domain, g, c),
                "colour": verdict.colour,
                "in_domain": c in inside[g],
                "reason": verdict.reason,
            }
            for g, group in enumerate(domain.groups)
            for c, verdict in enumerate(verdicts[g])
        ],
        "surface": values,
        "next": [
            {"group": p.group, "cell": p.where, "bits": p.bits, "reason": p.reason} for p in found
        ],
    }


def _bound_at(domain: DomainMap, g: int, c: int) -> float | None:
    return None if domain.predicted_mm is None else _finite(domain.predicted_mm[g, c])


def bound_table(domain: DomainMap, claim: Claim) -> list[Table]:
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


def _place(cells: Cells, c: int) -> dict[str, str | float]:
    return {
        axis.name: axis.labels[k] if axis.is_text else axis.centres[k]
        for axis, k in zip(cells.axes, cells.index[c], strict=True)
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def methods_of(gathered: DomainEvidence, domain: DomainMap, claim: Claim) -> tuple[str, ...]:
    """Return sentences for the methods section of a paper."""
    n = len(domain.evidence)
    return sentences("domain", "methods", gathered=gathered, claim=claim, n=n)
