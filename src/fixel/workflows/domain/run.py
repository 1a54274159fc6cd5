"""Compute a domain map with its evidence and charts, and store it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from fixel.database.project import Project
from fixel.domain.cells import Cells, cells_of, varying
from fixel.domain.claim import CellVerdict, Claim
from fixel.domain.domain import DomainMap, default_threshold, domain_map
from fixel.domain.evidence import HeldOutErrors
from fixel.domain.next_experiment import Proposal
from fixel.domain.predicted_cells import predicted_cells
from fixel.domain.surface import Surface
from fixel.errors import InvalidInput
from fixel.progress import ProgressOption, show_progress
from fixel.typing import FloatArray
from fixel.workflows.analysis import Analysis, StoredAnalysis, store_analysis
from fixel.workflows.domain.charts import pictures_of
from fixel.workflows.domain.evidence import DomainEvidence, gather, store_evidence
from fixel.workflows.domain.report import headline, methods_of, numbers, tables, warnings_of
from fixel.workflows.domain.request import OFFSETS, DomainRequest, asked_again
from fixel.workflows.figures import make_folder

MAX_EXAMPLES: Final = 3
SURFACE: Final = "surface_"  # prefix of the arrays stored with a map
BOUNDS: Final = "promised"  # name of the error bounds in stored maps
MOST_BYTES: Final = 64_000_000  # largest size of a stored surface
USUAL: Final = ("surface", "shape", "contact_angle_rad")  # axes if nothing was offset


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class DomainResult:
    """Domain map with its verdicts, proposals and stored analysis.

    Attributes
    ----------
    gathered : DomainEvidence
    domain : DomainMap
    claim : Claim
    verdicts : list of list of CellVerdict
        Verdict on every cell of every map.
    next : list of Proposal
    warnings : tuple of str
    kept : StoredAnalysis
        Analysis stored in the project.
    files : tuple of Path
        Charts, if requested.
    """

    gathered: DomainEvidence
    domain: DomainMap
    claim: Claim
    verdicts: list[list[CellVerdict]]
    next: list[Proposal]
    warnings: tuple[str, ...]
    kept: StoredAnalysis
    files: tuple[Path, ...] = ()


def map_stored(
    project: Project,
    asked: DomainRequest,
    *,
    plot: Path | None = None,
    progress: ProgressOption = None,
    command: str = "",
) -> DomainResult:
    """Map the experiments of a project for which one parameter set can be trusted, and store it.

    Parameters
    ----------
    project : Project
    asked : DomainRequest
    plot : Path, optional
        Folder for charts, in addition to those in the project.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.
    command : str
        Command as typed.

    Raises
    ------
    InvalidInput
        Too few experiments, a threshold below the noise, a nominal without data, or an axis that
        no experiment has.
    """
    begun = time.perf_counter()
    if plot is not None:
        make_folder(plot)
    with show_progress(progress, "holding out") as report:
        gathered = gather(project, asked, report)
    domain, aside = mapped(gathered, asked)
    return _stored(project, asked, gathered, domain, aside, plot, command, begun)


def store_map(project: Project, domain: DomainMap) -> StoredAnalysis:
    """Store a map of experiments that a project has.

    Raises
    ------
    NotStored
        The project does not have one of its experiments.
    """
    begun = time.perf_counter()
    claim = domain.claimed
    asked = replace(
        asked_again(domain.question),
        threshold=claim.threshold,
        level=claim.level,
        confidence=claim.confidence,
    )
    gathered = store_evidence(project, domain.source, asked)
    number = dict(zip(gathered.evidence.keys, gathered.evidence.ids, strict=True))
    evidence = domain.evidence
    own = replace(domain, evidence=replace(evidence, ids=tuple(number[k] for k in evidence.keys)))
    aside = len(number) - len(evidence)
    return _stored(project, asked, gathered, own, aside, None, "", begun).kept


def _stored(
    project: Project,
    asked: DomainRequest,
    gathered: DomainEvidence,
    domain: DomainMap,
    aside: int,
    plot: Path | None,
    command: str,
    begun: float,
) -> DomainResult:
    """Store a map as an analysis, with charts."""
    claim, evidence = domain.claimed, domain.evidence
    verdicts = domain.verdicts(claim)
    found = domain.proposals(claim, verdicts=verdicts)
    warnings = warnings_of(gathered, domain, claim, aside, verdicts)
    pictures = pictures_of(domain, claim, verdicts, "" if gathered.is_real else "SIMULATED")
    analysis = Analysis(
        kind="domain",
        title=f"Domain in which one parameter set stays within {claim.text()}",
        question=asked.question(),
        headline=headline(domain, claim, verdicts, found),
        warnings=warnings,
        tables=tables(domain, claim, verdicts, found),
        methods=methods_of(gathered, domain, claim),
        references=("vovk2005", "barber2021"),
        numbers=numbers(domain, claim, verdicts, found) | {"evidence": gathered.mark},
        calibrations=() if gathered.calibration is None else (gathered.calibration,),
        experiments=tuple(evidence.ids),
        command=command,
        seed=asked.seed,
        seconds=time.perf_counter() - begun,
    )
    arrays = {"error_mm2": evidence.error_mm2, "fold": evidence.fold, "place": domain.place}
    arrays |= _fitted(domain)
    kept = store_analysis(project, analysis, pictures, arrays)
    files = [] if plot is None else kept.copy_pictures(plot)
    return DomainResult(
        gathered=gathered,
        domain=domain,
        claim=claim,
        verdicts=verdicts,
        next=found,
        warnings=warnings,
        kept=kept,
        files=tuple(files),
    )


def mapped(gathered: DomainEvidence, asked: DomainRequest) -> tuple[DomainMap, int]:
    """Return the map of some evidence, and the number of experiments left out of it.

    Raises
    ------
    InvalidInput
        A threshold below the noise, a nominal without data, or an axis that no experiment has.
    """
    evidence, cells, aside = _cut(gathered, asked)
    claim = _claim(asked, gathered, evidence)
    domain = _spread(evidence, cells, asked)
    return replace(domain, claim=claim, facets=tuple(asked.by)), aside


def spread_out(
    gathered: DomainEvidence, asked: DomainRequest, fitted: Mapping[str, FloatArray] | None = None
) -> tuple[DomainMap, int]:
    """Return the map for every threshold at once, and the number of experiments left out of it.

    Parameters
    ----------
    gathered : DomainEvidence
    asked : DomainRequest
    fitted : mapping of name to array, optional
        Arrays stored with the same map; with them nothing is fitted.
    """
    evidence, cells, aside = _cut(gathered, asked)
    known = fitted or {}
    if not is_fitted(known):
        return _spread(evidence, cells, asked), aside
    surface = Surface(**{field.name: known[f"{SURFACE}{field.name}"] for field in fields(Surface)})
    bounds = known.get(BOUNDS)
    return domain_map(evidence, cells, asked.measure, asked.seed, bounds, surface), aside


def is_fitted(known: Mapping[str, FloatArray]) -> bool:
    """Whether the arrays stored with a map include its fitted surface."""
    return f"{SURFACE}mean" in known


def refuse_axes(gathered: DomainEvidence, asked: DomainRequest) -> None:
    """Raise if no map can be made with these axes, before anything is fitted."""
    _cut(gathered, asked)


def _fitted(domain: DomainMap) -> dict[str, Any]:
    """Arrays of the fitted surface, stored so that pages can show the map at once."""
    surface = domain.surface
    if surface.covariance.nbytes > MOST_BYTES:
        return {}
    found = {f"{SURFACE}{field.name}": getattr(surface, field.name) for field in fields(surface)}
    return found if domain.predicted_mm is None else found | {BOUNDS: domain.predicted_mm}


def _cut(gathered: DomainEvidence, asked: DomainRequest) -> tuple[HeldOutErrors, Cells, int]:
    axes = list(asked.axes) or usual_axes(gathered.evidence, asked.by)
    evidence, aside = _at_nominal(gathered.evidence, axes)
    return evidence, cells_of(evidence, axes, asked.nominal, asked.steps), aside


def _spread(evidence: HeldOutErrors, cells: Cells, asked: DomainRequest) -> DomainMap:
    bounds = _bounds(evidence, cells, asked)
    domain = domain_map(evidence, cells, asked.measure, asked.seed, bounds)
    _refuse_empty_nominal(domain)
    return domain


def _bounds(evidence: HeldOutErrors, cells: Cells, asked: DomainRequest) -> FloatArray | None:
    """Error bounds of the cells; only for the error itself, not relative to the own best."""
    if asked.measure != "absolute":
        return None
    return predicted_cells(evidence, cells, asked.level, asked.seed)


def usual_axes(evidence: HeldOutErrors, by: tuple[str, ...] | Any = ()) -> list[str]:
    """Return the offsets that were varied; else conditions that differ, two at most."""
    offsets = varying(evidence, OFFSETS)
    if offsets:
        return offsets
    others = [name for name in varying(evidence, USUAL) if name not in by]
    if not others:
        raise InvalidInput(
            "axes",
            found="no offset, surface, shape or contact that differs",
            expected="one of " + ", ".join(varying(evidence, sorted(evidence.coordinates))),
        )
    return others[:2]


def _at_nominal(evidence: HeldOutErrors, axes: list[str]) -> tuple[HeldOutErrors, int]:
    """Remove experiments that were offset along something that is no axis of the map."""
    keep_row = np.ones(len(evidence), bool)
    for name in varying(evidence, OFFSETS):
        if name not in axes:
            column = evidence.column(name)
            keep_row &= np.array([value is None or value == 0.0 for value in column])
    if keep_row.all():
        return evidence, 0
    if not keep_row.any():
        raise InvalidInput("axes", found="every experiment offset along others", expected="them")
    return evidence.rows(np.flatnonzero(keep_row)), int((~keep_row).sum())


def _claim(asked: DomainRequest, gathered: DomainEvidence, evidence: HeldOutErrors) -> Claim:
    threshold = asked.threshold
    if threshold is None:
        threshold = default_threshold(evidence, asked.measure)
    floor = gathered.floor_mm
    if asked.measure == "absolute" and floor is not None and threshold < floor:
        raise InvalidInput(
            "threshold",
            found=f"{threshold:.3g} mm, below the error that measurement noise alone causes",
            expected=f"at least {floor:.3g} mm ({gathered.floor_from})",
            hint="no simulator can be more accurate than the measurement",
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
        names = "; ".join(cells.text(int(c)) for c in filled[:MAX_EXAMPLES])
        raise InvalidInput(
            "nominal",
            found=f"no experiment at {cells.text(cells.nominal)}",
            expected=f"a cell with experiments, such as {names}",
        )
