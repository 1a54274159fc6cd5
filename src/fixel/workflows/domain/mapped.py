"""The whole of `fixel domain`: evidence, map, pictures, the answer that is kept."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.applicability.cells import Cells, cells_of, varying
from fixel.applicability.domain import (
    COLOURS,
    DOUBTFUL,
    NO_DATA,
    Claim,
    DomainMap,
    Verdict,
    domain_map,
    usual_threshold,
)
from fixel.applicability.evidence import Evidence
from fixel.applicability.next_experiment import Proposal, proposals
from fixel.applicability.promised_cells import promised_cells
from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.kernels.arrays import FloatArray
from fixel.workflows.analysis import Analysis, Kept, TextTable, keep
from fixel.workflows.domain.gather import Gathered, gather
from fixel.workflows.domain.held_out import Progress
from fixel.workflows.domain.pictures import pictures_of
from fixel.workflows.domain.request import OFFSETS, Asked
from fixel.workflows.pictures import make_folder, write_picture

USUAL: Final = ("surface", "shape", "contact_angle_rad")  # axes where nothing was offset
MOST_EXAMPLES: Final = 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Mapped:
    """A map, and all that is said of it.

    Attributes
    ----------
    gathered : Gathered
    domain : DomainMap
    claim : Claim
    verdicts : list of list of Verdict
        Of every cell of every map.
    next : list of Proposal
    warnings : tuple of str
    kept : Kept
        In the project.
    files : tuple of Path
        Pictures where they were asked for.
    """

    gathered: Gathered
    domain: DomainMap
    claim: Claim
    verdicts: list[list[Verdict]]
    next: list[Proposal]
    warnings: tuple[str, ...]
    kept: Kept
    files: tuple[Path, ...] = ()


def map_domain(
    project: Project,
    asked: Asked,
    *,
    plot: Path | None = None,
    progress: Progress | None = None,
    command: str = "",
) -> Mapped:
    """Say where one parameter set can be trusted.

    Parameters
    ----------
    project : Project
    asked : Asked
    plot : Path, optional
        Folder for pictures, besides those in the project.
    progress : callable, optional
        Told how many fits of how many are done.
    command : str
        That was typed.

    Raises
    ------
    InvalidInput
        Too few experiments, a threshold below the noise, a nominal without data, or an axis that
        no experiment has.
    """
    begun = time.perf_counter()
    if plot is not None:
        make_folder(plot)
    gathered = gather(project, asked, progress)
    axes = list(asked.axes) or usual_axes(gathered.evidence, asked.by)
    evidence, aside = _at_nominal(gathered.evidence, axes)
    cells = cells_of(evidence, axes, asked.nominal, asked.steps)
    claim = _claim(asked, gathered, evidence)
    promised = _promised(evidence, cells, asked)
    domain = domain_map(evidence, cells, asked.measure, asked.seed, promised)
    _refuse_empty_nominal(domain)
    verdicts = domain.verdicts(claim)
    found = proposals(domain, claim, verdicts=verdicts)
    warnings = _warnings(gathered, domain, claim, aside, verdicts)
    pictures = pictures_of(domain, claim, verdicts, "" if gathered.is_real else "SIMULATED")
    analysis = Analysis(
        kind="domain",
        title=f"Where one parameter set stays within {claim.text()}",
        question=asked.question(),
        headline=headline(domain, claim, verdicts, found),
        warnings=warnings,
        tables=tables(domain, claim, verdicts, found),
        methods=_methods(gathered, domain, claim),
        references=("vovk2005", "barber2021"),
        numbers=numbers(domain, claim, verdicts, found),
        calibrations=() if gathered.calibration is None else (gathered.calibration,),
        experiments=tuple(evidence.ids),
        command=command,
        seed=asked.seed,
        seconds=time.perf_counter() - begun,
    )
    arrays = {"error_mm2": evidence.error_mm2, "fold": evidence.fold, "place": domain.place}
    kept = keep(project, analysis, pictures, arrays)
    files = [] if plot is None else [path for p in pictures for path in write_picture(plot, p)]
    return Mapped(
        gathered=gathered,
        domain=domain,
        claim=claim,
        verdicts=verdicts,
        next=found,
        warnings=warnings,
        kept=kept,
        files=tuple(files),
    )


def _promised(evidence: Evidence, cells: Cells, asked: Asked) -> FloatArray | None:
    """Bounds are of the error itself, not of what is above an experiment's own best."""
    if asked.measure != "absolute":
        return None
    return promised_cells(evidence, cells, asked.level, asked.seed)


def usual_axes(evidence: Evidence, by: tuple[str, ...] | Any = ()) -> list[str]:
    """Offsets that were varied; else conditions that differ, two at most."""
    offsets = varying(evidence, OFFSETS)
    if offsets:
        return offsets
    others = [name for name in varying(evidence, USUAL) if name not in by]
    if not others:
        raise InvalidInput(
            "--axes",
            found="no offset, surface, shape or contact that differs",
            expected="one of " + ", ".join(varying(evidence, sorted(evidence.coordinates))),
        )
    return others[:2]


def _at_nominal(evidence: Evidence, axes: list[str]) -> tuple[Evidence, int]:
    """Without experiments that were offset along something that is no axis of the map."""
    keep_row = np.ones(len(evidence), bool)
    for name in varying(evidence, OFFSETS):
        if name not in axes:
            column = evidence.column(name)
            keep_row &= np.array([value is None or value == 0.0 for value in column])
    if keep_row.all():
        return evidence, 0
    if not keep_row.any():
        raise InvalidInput("--axes", found="every experiment offset along others", expected="them")
    return evidence.rows(np.flatnonzero(keep_row)), int((~keep_row).sum())


def _claim(asked: Asked, gathered: Gathered, evidence: Evidence) -> Claim:
    threshold = asked.threshold
    if threshold is None:
        threshold = usual_threshold(evidence, asked.measure)
    floor = gathered.floor_mm
    if asked.measure == "absolute" and floor is not None and threshold < floor:
        raise InvalidInput(
            "--threshold-mm",
            found=f"{threshold:.3g}, below what the measurement alone makes",
            expected=f"{floor:.3g} at least ({gathered.floor_from})",
            hint="no simulator can be held to less than the noise",
        )
    return Claim(
        threshold=threshold,
        measure=asked.measure,
        level=asked.level,
        confidence=asked.confidence,
    )


def _refuse_empty_nominal(domain: DomainMap) -> None:
    cells = domain.cells
    if (domain.counts[:, cells.nominal] == 0).all():
        filled = np.flatnonzero(domain.counts.sum(axis=0))
        names = "; ".join(cells.text(int(c)) for c in filled[:MOST_EXAMPLES])
        raise InvalidInput(
            "--nominal",
            found=f"no experiment at {cells.text(cells.nominal)}",
            expected=f"a cell with evidence, like {names}",
        )


# --- what is said -------------------------------------------------------------------------------


def headline(
    domain: DomainMap, claim: Claim, verdicts: list[list[Verdict]], found: list[Proposal]
) -> tuple[str, ...]:
    """What was found, in sentences."""
    count = colour_counts(verdicts)
    total = sum(count.values()) - count[NO_DATA] - count["predicted"]
    sizes = [len(own) for own in domain.domains(claim)]
    first = (
        f"Within {claim.text()} for {100.0 * claim.level:.0f} % of new experiments:"
        f" {count['trusted']} of {total} cells with data are trusted, {count['doubtful']} doubtful,"
        f" {count['not trusted']} not trusted; {count[NO_DATA]} have no data."
    )
    none = f"; it is empty in {sizes.count(0)}" if 0 in sizes else ""
    second = (
        f"D(tau) around the nominal has {_spread(sizes)} of {len(domain.cells)} cells in"
        f" {len(sizes)} maps{none}."
    )
    if len(sizes) == 1:
        second = f"D(tau) around the nominal has {sizes[0]} of {len(domain.cells)} cells."
    if not any(sizes):
        second += _begins(domain, claim)
    third = ""
    if found:
        best = found[0]
        where = f"{best.group}: " if best.group else ""
        third = f"Most would teach an experiment at {where}{best.where} ({best.reason})."
    return tuple(sentence for sentence in (first, second, third) if sentence)


def _begins(domain: DomainMap, claim: Claim) -> str:
    """Where an empty domain would begin."""
    thresholds = domain.usual_thresholds
    filled = np.flatnonzero(domain.curve(claim, thresholds.tolist()).sum(axis=0))
    if not len(filled):
        return ""
    return f" It begins at about {claim.text(float(thresholds[filled[0]]))}."


def _spread(sizes: list[int]) -> str:
    low, high = min(sizes), max(sizes)
    return str(low) if low == high else f"{low} to {high}"


def colour_counts(verdicts: list[list[Verdict]]) -> dict[str, int]:
    """Cells of each colour, over all maps."""
    every = [verdict.colour for own in verdicts for verdict in own]
    return {colour: every.count(colour) for colour in COLOURS}


def _warnings(
    gathered: Gathered, domain: DomainMap, claim: Claim, aside: int, verdicts: Any
) -> tuple[str, ...]:
    found = []
    if aside:
        found.append(
            f"{aside} experiments were offset along something that is no axis of the map, and are"
            " left out"
        )
    if gathered.left_out:
        reason = next(iter(gathered.left_out.values()))
        found.append(f"{len(gathered.left_out)} experiments cannot be compared: {reason}")
    failed = int(np.isinf(domain.evidence.error_mm2).sum())
    if failed:
        found.append(f"{failed} simulations failed and count as above every threshold")
    unknown = [note for note in domain.evidence.notes if note]
    if unknown and claim.measure == "relative":
        found.append(f"{len(unknown)} experiments are no evidence: {unknown[0]}")
    if gathered.calibration is None:
        found.append(f"no stored calibration was used: {gathered.started}")
    if gathered.floor_mm is None:
        found.append("the noise of the measurement is not known: no repetitions, too few frames")
    empty = [
        group or "the map"
        for g, group in enumerate(domain.groups)
        if domain.counts[g, domain.cells.nominal] == 0
    ]
    if empty:
        found.append(f"no experiment at the nominal in {len(empty)} maps, first {empty[0]}")
    few = any(
        verdict.colour == DOUBTFUL and domain.counts[g, c] < claim.needed
        for g, own in enumerate(verdicts)
        for c, verdict in enumerate(own)
    )
    if few and not colour_counts(verdicts)["trusted"]:
        found.append(
            f"no cell is trusted; {claim.needed} experiments below {claim.text()} in one cell make"
            " the claim by themselves, fewer where neighbours agree"
        )
    if gathered.scale_mm != 35.0:
        found.append(f"a radian counts as {gathered.scale_mm:g} mm, not as the thesis's 35 mm")
    return tuple(found)


def tables(
    domain: DomainMap, claim: Claim, verdicts: list[list[Verdict]], found: list[Proposal]
) -> tuple[TextTable, ...]:
    """Extents of D(tau) by map, and the experiments that would teach most."""
    axes = domain.cells.axes
    rows = []
    extents, domains = domain.extents(claim), domain.domains(claim)
    for g, group in enumerate(domain.groups):
        count = colour_counts([verdicts[g]])
        reach = [_reach_text(extents[g][axis.name]) for axis in axes]
        cells = [str(count[c]) for c in ("trusted", "doubtful", "not trusted", NO_DATA)]
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
    first = TextTable(title=f"D(tau) at {claim.text()}", head=head, rows=tuple(rows))
    second = TextTable(
        title="What to try next",
        head=("map", "experiment", "expected to settle [bit]", "why"),
        rows=tuple((p.group or "all", p.where, f"{p.bits:.2f}", p.reason) for p in found),
    )
    return (first, *promise_table(domain, claim), *([second] if found else []))


def _reach_text(reach: tuple[str, str] | None) -> str:
    if reach is None:
        return "empty"
    return f"{reach[0]} to {reach[1]}" if reach[1] else reach[0]


def numbers(
    domain: DomainMap, claim: Claim, verdicts: list[list[Verdict]], found: list[Proposal]
) -> dict[str, Any]:
    """Plain values in SI units; None where there is none."""
    inside = [set(own) for own in domain.domains(claim)]
    seen = domain.statistic(claim.level)
    values = dict(zip(("reach", "shared", "own", "offset", "cell", "scatter"),
                      domain.surface.values.tolist(), strict=True))  # fmt: skip
    return {
        "threshold": claim.threshold,
        "threshold_unit": "mm" if claim.measure == "absolute" else "share above the own best E",
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
                "promised_mm": _promise_at(domain, g, c),
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


def _promise_at(domain: DomainMap, g: int, c: int) -> float | None:
    return None if domain.predicted_mm is None else _finite(domain.predicted_mm[g, c])


def promise_table(domain: DomainMap, claim: Claim) -> list[TextTable]:
    """What new experiments stay within, by map; nothing where that cannot be promised."""
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
    head = ("map", "median error [mm]", "least bound [mm]", "median bound [mm]", "most [mm]")
    title = f"Promised for new experiments in these cells, with a probability of {claim.level:.0%}"
    return [TextTable(title=title, head=head, rows=tuple(rows))]


def _place(cells: Cells, c: int) -> dict[str, str | float]:
    return {
        axis.name: axis.labels[k] if axis.is_text else axis.centres[k]
        for axis, k in zip(cells.axes, cells.index[c], strict=True)
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _methods(gathered: Gathered, domain: DomainMap, claim: Claim) -> tuple[str, ...]:
    n = len(domain.evidence)
    return (
        f"Errors of {n} experiments were held out in {gathered.folds} folds ({gathered.fits} fits"
        f" of {', '.join(gathered.labels)} by least squares, {gathered.motion} motion,"
        f" {gathered.stepper} steps, started from {gathered.started}); repetitions of one"
        " configuration were held out together.",
        f"A cell is trusted where at least {100.0 * claim.level:.0f} % of new experiments stay"
        f" within {claim.text()} with a probability of {100.0 * claim.confidence:.0f} %: by"
        f" counting where it has {claim.needed} members, else by a Gaussian process on the"
        " logarithm of the error; a cell without experiments is never trusted. Bounds for new"
        " experiments are conformal (CV+), on the same held-out errors.",
    )
