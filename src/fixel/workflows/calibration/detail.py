"""A stored calibration, as one who has to believe it wants to see it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np

from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import FixelError
from fixel.model.records import CalibrationRecord, Estimate, ProfileRecord
from fixel.typing import FloatArray
from fixel.workflows.calibration.job import NEARLY
from fixel.workflows.calibration.report_data import CalibrationReportData
from fixel.workflows.calibration.result import ParameterSet
from fixel.workflows.calibration.run import Calibration, reopened
from fixel.workflows.calibration.stored import split_label

WORST: Final = 3


@final
@dataclass(frozen=True, slots=True)
class Residual:
    """One experiment."""

    id: int
    key: str
    before: float | None  # in the unit of the error
    after: float | None


@final
@dataclass(frozen=True, slots=True)
class Start:
    """End of one of several searches."""

    error: float | None  # None where it found nothing
    point: list[float]
    evaluations: int
    good: bool  # as good as the best, or nearly


class CalibrationDetail(NamedTuple):
    """All there is to see.

    Attributes
    ----------
    id : int
    record : CalibrationRecord
    unit : str
        Of errors, `"mm^2"` or `"mm"`.
    rows : list of Estimate
    residuals : list of Residual
        The worst first.
    objective : (n,) float64
        Of every evaluation, shared out among the experiments where it is a sum.
    starts : list of Start
        The best first; none where there was one.
    curves : tuple of ProfileRecord
        Profiles, one an unknown.
    level : float
        Of the intervals.
    misfit : list of str
        Warning that the model is wrong by more than the noise explains; empty where it is not.
    noise, note : str
    siblings : list of (int, str)
        Ids and names of the sets that came of the same job.
    complete : bool
        Whether its job is still there; without it there are no profiles and no starts.
    """

    id: int
    record: CalibrationRecord
    unit: str
    rows: list[Estimate]
    residuals: list[Residual]
    objective: FloatArray
    starts: list[Start]
    curves: tuple[ProfileRecord, ...]
    level: float
    misfit: list[str]
    noise: str
    note: str
    siblings: list[tuple[int, str]]
    complete: bool

    @property
    def worst(self) -> list[Residual]:
        """The experiments to look at first."""
        return self.residuals[:WORST]


def load_detail(project: Project, store: Store, calibration_id: int) -> CalibrationDetail:
    """Load the detail of a stored calibration."""
    record = store.calibration(calibration_id)
    calibration = one = data = None
    starts: list[Start] = []
    trouble = ""
    try:
        calibration = reopened(project, record)
        if calibration is not None and calibration_id in calibration.ids:
            one = calibration.outcome.found[calibration.ids.index(calibration_id)]
            data = CalibrationReportData(calibration)
            starts = starts_of(data, one)
    except FixelError as problem:  # what is stored can be shown all the same
        calibration = one = data = None
        trouble = str(problem)
    return CalibrationDetail(
        id=calibration_id,
        record=record,
        unit=record.error_unit,
        rows=_rows(record, data, one),
        residuals=_residuals(store, record, calibration, one),
        objective=_objective(record),
        starts=starts,
        curves=() if one is None else one.profiles,
        level=0.95 if data is None else data.request.level,
        misfit=misfit_of(record),
        noise="" if one is None else one.noise,
        note=trouble if one is None else one.note,
        siblings=_siblings(calibration, store),
        complete=one is not None,
    )


def starts_of(data: CalibrationReportData, one: ParameterSet) -> list[Start]:
    """Return the ends of several searches, best first; empty for a single search."""
    if data.request.starts == 1 or one.trace is None:
        return []
    ends = one.trace.ends()
    best = min((end.error for end in ends), default=math.inf)
    evaluations = np.bincount(one.trace.starts, minlength=len(ends)).tolist()
    shared = len(one.members) if data.request.combine == "sum" else 1
    found = [
        Start(
            _finite(end.error / shared),
            end.point.tolist(),
            count,
            math.isfinite(end.error) and end.error <= best * (1.0 + NEARLY),
        )
        for end, count in zip(ends, evaluations, strict=True)
    ]
    return sorted(found, key=lambda start: math.inf if start.error is None else start.error)


def misfit_of(record: CalibrationRecord) -> list[str]:
    """Warning that was stored with a calibration, one sentence each."""
    return str(record.method.get("misfit", "")).splitlines()


def _rows(
    record: CalibrationRecord, data: CalibrationReportData | None, one: ParameterSet | None
) -> list[Estimate]:
    if data is None or one is None:
        values = dict(record.parameters)
        return [
            replace(estimate, best_fit=values.get(split_label(estimate.label)[0], estimate.value))
            for estimate in record.estimates
        ] or [
            Estimate(label=name, unit="", value=value, best_fit=value)
            for name, value in values.items()
        ]
    return data.estimates(record.estimates, one)


def _residuals(
    store: Store,
    record: CalibrationRecord,
    calibration: Calibration | None,
    one: ParameterSet | None,
) -> list[Residual]:
    before: list[float] = [math.nan] * len(record.members)
    if calibration is not None and one is not None:
        before = calibration.outcome.nominal[list(one.members)].tolist()
    keys = keys_of(store, [member.experiment_id for member in record.members])
    found = [
        Residual(member.experiment_id, key, _finite(start), _finite(error))
        for member, error, key, start in zip(
            record.members, record.errors, keys, before, strict=True
        )
    ]
    return sorted(found, key=lambda r: -math.inf if r.after is None else -r.after)


def keys_of(store: Store, ids: Sequence[int]) -> list[str]:
    """Names of experiments, deleted and replaced ones too."""
    from fixel.database.query import ALL_EXPERIMENTS

    known = {row.id: row.key for row in store.experiments(ALL_EXPERIMENTS).rows}
    return [known.get(own, f"experiment {own}") for own in ids]


def _objective(record: CalibrationRecord) -> FloatArray:
    if record.evaluations is None:
        return np.zeros(0)
    share = len(record.members) if record.method.get("combine") == "sum" else 1
    return np.asarray(record.evaluations.error / share)


def _siblings(calibration: Calibration | None, store: Store) -> list[tuple[int, str]]:
    if calibration is None:
        return []
    names = {
        calibration_id: record.name
        for calibration_id, record in store.calibration_summaries().items()
    }
    return [
        (calibration_id, names[calibration_id])
        for calibration_id in calibration.ids
        if calibration_id in names
    ]


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# --- the list -----------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True)
class CalibrationSummary:
    """Result of one job, or a calibration without a job.

    Attributes
    ----------
    id : int
        Of the calibration to open: the last set for several experiments, else the first.
    name, how, mode, optimiser, unit, created_utc : str
    sets : int
        Calibrations that came of it.
    experiments : int
    before, after : float or None
        Mean errors.
    verdicts : dict from verdict to int
        Unknowns of the set to open.
    evaluations : int
    """

    id: int
    name: str
    how: str
    mode: str
    optimiser: str
    unit: str
    created_utc: str
    sets: int
    experiments: int
    before: float | None
    after: float | None
    verdicts: dict[str, int]


def list_calibrations(store: Store) -> list[CalibrationSummary]:
    """Stored calibrations, those of one job together, the newest first."""
    jobs: dict[str, list[tuple[int, CalibrationRecord]]] = {}
    for calibration_id, record in store.calibration_summaries().items():
        name = str(record.method.get("job", f" {calibration_id}"))
        jobs.setdefault(name, []).append((calibration_id, record))
    found = [_listed(sets) for sets in jobs.values()]
    return sorted(found, key=lambda one: -one.id)


def _listed(sets: list[tuple[int, CalibrationRecord]]) -> CalibrationSummary:
    together = [pair for pair in sets if len(pair[1].members) > 1]
    calibration_id, record = together[-1] if together else sets[0]
    shown = [record] if together else [one for _, one in sets]
    before = [float(one.method.get("nominal_error", math.nan)) for one in shown]
    after = [float(np.mean(one.errors)) for one in shown]
    verdicts: dict[str, int] = {}
    for estimate in record.estimates:
        if estimate.verdict:
            verdicts[estimate.word] = verdicts.get(estimate.word, 0) + 1
    return CalibrationSummary(
        id=calibration_id,
        name=record.name.partition(":")[0],
        how=str(record.method.get("how", "")),
        mode=str(record.method.get("mode", "")),
        optimiser=str(record.method.get("optimiser", "")),
        unit=record.error_unit,
        created_utc=record.provenance.created,
        sets=len(sets),
        experiments=len({m.experiment_id for _, one in sets for m in one.members}),
        before=_finite(float(np.mean(before))),
        after=_finite(float(np.mean(after))),
        verdicts=verdicts if together or len(sets) == 1 else {},
    )
