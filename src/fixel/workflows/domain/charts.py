"""Draw the charts of a domain map."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from fixel.domain.cells import CellAxis
from fixel.domain.domain import CellVerdict, Claim, DomainMap
from fixel.drawing.domain import MapChart, MapPanel, SizeChart, Strip
from fixel.workflows.figures import Picture

HEAD: Final = ("group", "cell", "members", "error", "confidence", "colour", "in_domain", "reason")

Verdicts = list[list[CellVerdict]]


def pictures_of(
    domain: DomainMap, claim: Claim, verdicts: Verdicts, banner: str = ""
) -> list[Picture]:
    """Charts of the map, one per axis if only one differs at a time, and of D(tau) by tau."""
    inside = domain.domains(claim)
    found = []
    if domain.cells.arms or len(domain.cells.axes) == 1:
        for a, axis in enumerate(domain.cells.axes):
            chart = _chart(domain, claim, verdicts, inside, (a, None))
            found.append(Picture(f"map-{axis.name}", chart, banner, _caption(claim, axis.name)))
    else:
        chart = _chart(domain, claim, verdicts, inside, (0, 1))
        names = " and ".join(axis.name for axis in domain.cells.axes)
        found.append(Picture("map", chart, banner, _caption(claim, names)))
    found.append(Picture("size", _sizes(domain, claim), banner, _size_caption(claim)))
    return found


def _caption(claim: Claim, names: str) -> str:
    return (
        f"Where one parameter set predicts held-out experiments within {claim.text()}, by {names}."
        f" Blue: at least {100.0 * claim.level:g} % of new experiments stay below, with"
        f" {100.0 * claim.confidence:g} % confidence. Numbers count experiments; grey has none."
        " The line surrounds D(tau), the ring is the nominal."
    )


def _size_caption(claim: Claim) -> str:
    return (
        "How far the domain of applicability D(tau) grows with the threshold tau that held-out"
        f" errors have to stay below ({100.0 * claim.level:g} % of new experiments,"
        f" {100.0 * claim.confidence:g} % confidence)."
    )


def _chart(
    domain: DomainMap,
    claim: Claim,
    verdicts: Verdicts,
    inside: list[list[int]],
    which: tuple[int, int | None],
) -> MapChart:
    across = domain.cells.axes[which[0]]
    up = None if which[1] is None else domain.cells.axes[which[1]]
    table = _table(domain, which)
    panels = []
    for g, group in enumerate(domain.groups):
        own = set(inside[g])
        panels.append(
            MapPanel(
                title=group or "all experiments",
                colour=[[verdicts[g][c].colour for c in row] for row in table],
                count=[[int(domain.counts[g, c]) for c in row] for row in table],
                inside=[[c in own for c in row] for row in table],
                nominal=_place(table, domain.cells.nominal),
            )
        )
    said = "held-out error" if claim.measure == "absolute" else "held-out excess"
    return MapChart(
        across=_strip(across),
        up=Strip("", ("",)) if up is None else _strip(up),
        panels=tuple(panels),
        heading=f"{said} within τ = {claim.text()} for {100.0 * claim.level:g} % of experiments",
        head=HEAD,
        rows=_rows(domain, claim, verdicts, inside),
    )


def _table(domain: DomainMap, which: tuple[int, int | None]) -> list[list[int]]:
    """Arrange cells in rows from below; along one axis, those through the nominal."""
    number = {index: c for c, index in enumerate(domain.cells.index)}
    centre = list(domain.cells.index[domain.cells.nominal])
    a, b = which
    rows = []
    for up in range(1 if b is None else len(domain.cells.axes[b])):
        row = []
        for across in range(len(domain.cells.axes[a])):
            index = list(centre)
            index[a] = across
            if b is not None:
                index[b] = up
            row.append(number[tuple(index)])
        rows.append(row)
    return rows


def _place(table: list[list[int]], cell: int) -> tuple[int, int] | None:
    return next(((i, row.index(cell)) for i, row in enumerate(table) if cell in row), None)


def _strip(axis: CellAxis) -> Strip:
    name = axis.name
    for ending in ("_m_s", "_rad", "_m", "_s"):
        if axis.unit and name.endswith(ending):
            name = name.removesuffix(ending)
            break
    name = name.replace("_", " ")
    unit = f" [{axis.unit}]" if axis.unit else ""
    centred = [axis.text(k) for k in range(len(axis))]
    if axis.edges:
        centred = [f"{axis.factor * centre + 0.0:.3g}" for centre in axis.centres]
    return Strip(f"{name}{unit}", tuple(centred))


def _rows(
    domain: DomainMap, claim: Claim, verdicts: Verdicts, inside: list[list[int]]
) -> list[tuple[Any, ...]]:
    seen = domain.statistic(claim.level)
    rows: list[tuple[Any, ...]] = []
    for g, group in enumerate(domain.groups):
        for c, verdict in enumerate(verdicts[g]):
            rows.append(
                (
                    group,
                    domain.cells.text(c),
                    int(domain.counts[g, c]),
                    float(seen[g, c]) if np.isfinite(seen[g, c]) else None,
                    None if np.isnan(verdict.confidence) else verdict.confidence,
                    verdict.colour,
                    int(c in inside[g]),
                    verdict.reason,
                )
            )
    return rows


def _sizes(domain: DomainMap, claim: Claim) -> SizeChart:
    thresholds = domain.usual_thresholds
    sizes = domain.curve(claim, thresholds.tolist())
    absolute = claim.measure == "absolute"
    return SizeChart(
        thresholds=thresholds,
        sizes={group: sizes[g] for g, group in enumerate(domain.groups)},
        cells=len(domain.cells),
        threshold=claim.threshold,
        label="threshold τ [mm]" if absolute else "threshold τ, share above the own best",
        column="threshold_mm" if absolute else "threshold_share",
    )
