"""Domain maps of evidence: cells, claim, fitted surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.target import Target
from fixel.capability.options import FACTORS, in_unit
from fixel.domain.cells import Cells, cells_of, coordinates_of, varying
from fixel.domain.claim import Claim
from fixel.domain.domain import DomainMap, default_threshold, domain_map
from fixel.domain.evidence import HeldOutErrors
from fixel.domain.held_out import CalibrationModel, Finished, own_errors
from fixel.domain.next_experiment import predicted_cells
from fixel.domain.surface import Surface
from fixel.errors import InvalidInput
from fixel.progress import ProgressOption, show_progress
from fixel.typing import FloatArray
from fixel.workflows.domain.evidence import DomainEvidence, errors_of, evidence_of

MAX_EXAMPLES: Final = 3
SURFACE: Final = "surface_"  # prefix of the arrays stored with a map
BOUNDS: Final = "promised"  # name of the error bounds in stored maps
MOST_BYTES: Final = 64_000_000  # largest size of a stored surface
USUAL: Final = ("surface", "shape", "contact_angle_rad")  # axes if nothing was offset
LIMITS: Final = ("threshold", "relative")  # options of which one is given
OFFSETS: Final = ("offset_x_m", "offset_y_m", "offset_theta_rad")


class DomainAnswer(NamedTuple):
    """Domain map of experiments of a project."""

    asked: Any  # request
    gathered: DomainEvidence
    domain: DomainMap
    n_aside: int  # number of experiments left out, which are offset along something that is no axis


def map_targets(
    targets: Sequence[Target],
    model: CalibrationModel,
    asked: Any,
    finished: Finished,
    progress: ProgressOption,
) -> DomainMap:
    """Return the map of experiments in memory, with the evidence and the request."""
    with show_progress(progress, "holding out") as report:
        content = evidence_of(targets, model, asked, finished, report)
        errors = errors_of(content, asked)
        if asked.relative is not None:
            report.stage = "calibrating each alone"
            own = own_errors(targets, model, asked.seed, asked.threads, report)
            errors = replace(errors, own_mm2=own)
    domain, _ = map_of(DomainEvidence(errors, content), asked)
    known = KnownPushes.of(targets, asked.facets)
    return replace(domain, known=known, source=content)


def map_of(
    gathered: DomainEvidence, asked: Any, fitted: Mapping[str, FloatArray] | None = None
) -> tuple[DomainMap, int]:
    """Return the map of some evidence, and the number of experiments left out of it.

    With the arrays that were stored with the same map, nothing is fitted. Raise `InvalidInput` for
    a threshold below the noise, a nominal without data, or an axis that no experiment has.
    """
    errors, cells, n_aside = cut(gathered.errors, asked)
    claim = _claim(asked, gathered, errors)
    known = fitted or {}
    bounds, surface = known.get(BOUNDS), None
    if f"{SURFACE}mean" in known:
        surface = Surface(**{own.name: known[f"{SURFACE}{own.name}"] for own in fields(Surface)})
    elif claim.measure == "absolute":  # bounds are of the error itself
        bounds = predicted_cells(errors, cells, asked.level, asked.seed)
    domain = domain_map(errors, cells, claim.measure, asked.seed, bounds, surface)
    _refuse_empty_nominal(domain)
    return replace(domain, claim=claim, facets=asked.facets), n_aside


def arrays_of(domain: DomainMap) -> dict[str, Any]:
    """Arrays to store with a map; the fitted surface, so that pages show the map at once."""
    errors, surface = domain.evidence, domain.surface
    found = {"error_mm2": errors.error_mm2, "fold": errors.fold, "place": domain.place}
    if surface.covariance.nbytes <= MOST_BYTES:
        found |= {f"{SURFACE}{own.name}": getattr(surface, own.name) for own in fields(surface)}
        found |= {} if domain.predicted_mm is None else {BOUNDS: domain.predicted_mm}
    return found


# --- request ------------------------------------------------------------------------------------


def claim_of(asked: Any, usual: float) -> Claim:
    """Return the requested claim, with a usual threshold [mm] if there is none."""
    absolute, relative = (getattr(asked, name) for name in LIMITS)
    if absolute is not None and relative is not None:
        raise InvalidInput(LIMITS[1], found=f"{LIMITS[0]} too", expected="one of them")
    own = asked.model_dump(include={one.name for one in fields(Claim)})
    if relative is not None:
        return Claim(**{**own, LIMITS[0]: relative}, measure="relative")
    return Claim(**{**own, LIMITS[0]: usual if absolute is None else in_unit(absolute, "mm")})


def claimed(asked: Any, claim: Claim) -> Any:
    """Return a request with the threshold, the level and the confidence of a claim."""
    now = asdict(claim)
    absolute = now.pop("measure") == "absolute"
    values = (FACTORS["mm"] * claim.threshold, None) if absolute else (None, claim.threshold)
    return asked.model_copy(update={**now, **dict(zip(LIMITS, values, strict=True))})


def check(targets: Sequence[Target], asked: Any) -> None:
    """Raise if no map can be made with these axes, before anything is fitted."""
    rows = [coordinates_of(target) for target in targets]
    keys = [target.key for target in targets]
    zeros = [0] * len(rows)
    content = {"keys": keys, "ids": zeros, "coordinates": rows, "error": zeros, "fold": zeros,
               "configuration": keys}  # fmt: skip
    cut(errors_of(content, asked), asked)


def cut(errors: HeldOutErrors, asked: Any) -> tuple[HeldOutErrors, Cells, int]:
    """Return the errors in a map, its cells, and the number of experiments left out.

    Experiments that were offset along something that is no axis of the map are left out.
    """
    axes = list(asked.axes) or _usual_axes(errors, asked)
    keep_row = np.ones(len(errors), bool)
    for name in varying(errors, OFFSETS):
        if name not in axes:
            column = errors.column(name)
            keep_row &= np.array([value is None or value == 0.0 for value in column])
    if not keep_row.any():
        raise InvalidInput("axes", found="offsets along others only", expected="offsets")
    if not keep_row.all():
        errors = errors.rows(np.flatnonzero(keep_row))
    return errors, cells_of(errors, axes, asked.nominal, asked.cells), int((~keep_row).sum())


def _usual_axes(errors: HeldOutErrors, asked: Any) -> list[str]:
    """Return the offsets that were varied; else conditions that differ, two at most."""
    offsets = varying(errors, OFFSETS)
    others = [name for name in varying(errors, USUAL) if name not in asked.facets]
    if not (offsets or others):
        known = varying(errors, sorted(errors.coordinates))
        found = "no offset, surface, shape or contact that differs"
        expected = " or ".join(known) or "experiments that differ in a condition"
        raise InvalidInput("axes", found=found, expected=expected)
    return offsets or others[:2]


def _claim(asked: Any, gathered: DomainEvidence, errors: HeldOutErrors) -> Claim:
    given = asked.threshold is not None or asked.relative is not None
    claim = claim_of(asked, 1.0 if given else default_threshold(errors))
    floor = gathered.found["floor_mm"]
    if claim.measure == "absolute" and floor is not None and claim.threshold < floor:
        found = f"{claim.threshold:.3g} mm, below the error that measurement noise alone causes"
        expected = f"at least {floor:.3g} mm ({gathered.found['floor_from']})"
        hint = "no simulator can be more accurate than the measurement"
        raise InvalidInput(LIMITS[0], found=found, expected=expected, hint=hint)
    return claim


def _refuse_empty_nominal(domain: DomainMap) -> None:
    cells = domain.cells
    if (domain.counts[:, cells.nominal] == 0).all():
        filled = np.flatnonzero(domain.counts.sum(axis=0))
        names = "; ".join(cells.text(int(c)) for c in filled[:MAX_EXAMPLES])
        found = f"no experiment at {cells.text(cells.nominal)}"
        expected = f"a cell with experiments, such as {names}"
        raise InvalidInput("nominal", found=found, expected=expected)
