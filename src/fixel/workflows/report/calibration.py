"""Report sections on a calibration: errors before and after, parameters and verdicts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration.misfit import shown_ratio
from fixel.database.project import Project
from fixel.model.records import Estimate, interval_name
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import displayed
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.charts import pictures_of
from fixel.workflows.calibration.report_data import CalibrationReportData
from fixel.workflows.calibration.stored import CalibratedValues, misfit_of
from fixel.workflows.figures import write_picture
from fixel.workflows.report.content import Figure, Section
from fixel.workflows.sentences import sentences

# Factor of the median error beyond which an experiment is named in a warning.
FAR_RATIO: Final = 3.0
MAX_NAMED: Final = 5
OF_PARAMETERS: Final = ("parameters", "profiles", "starts", "search")


def figures_of(calibration: Calibrations, folder: Path, project: Project) -> list[Figure]:
    """Draw the charts of a calibration that is stored in a project into a folder."""
    found = []
    for picture in pictures_of(CalibrationReportData(calibration, project)):
        files = write_picture(folder, picture._replace(name=f"calibration_{picture.name}"))
        found.append(Figure(name=files[0].stem, caption=picture.caption, png=files[0]))
    return found


def errors_section(
    one: CalibratedValues,
    nominal: FloatArray | None,
    keys: Mapping[int, str],
    figures: list[Figure],
) -> Section:
    """Build the section that compares nominal with calibrated errors.

    Parameters
    ----------
    one : CalibratedValues
    nominal : (n_member,) float64, optional
        Errors before calibration.
    keys : mapping from id to name of an experiment
    figures : list of Figure
    """
    after = errors_of(one)
    rows = [] if nominal is None else [("nominal", *_spread(rms(one, nominal)))]
    rows.append(("calibrated", *_spread(rms(one, after))))
    head = ("parameters", "mean [mm]", "median [mm]", "largest [mm]")
    tables = [Table(head, rows, title="Root mean square error of the trajectory")]
    worst = _worst(one, after, keys)
    if worst:
        tables.append(worst)
    return Section(
        title="Nominal and calibrated",
        anchor="errors",
        lead=sentences("calibration", "errors", scale_mm=1e3 * scale_of(one)),
        tables=tuple(tables),
        figures=_in_order([figure for figure in figures if not _of_parameters(figure)]),
    )


def parameters_section(one: CalibratedValues, figures: list[Figure]) -> Section:
    """Build the section with the values, their intervals and verdicts."""
    estimates = one.record.estimates
    head = ("parameter", "value", interval_name(one.level), "unit", "verdict")
    rows = [row for estimate in estimates for row in _rows(estimate)]
    rows += [
        (name, f"{value:.4g}", "", "SI", "not assessed")
        for name, value in one.record.parameters.items()
        if not estimates
    ]
    reasons = [f"{e.label}: {e.reason}" for e in estimates if e.reason]
    return Section(
        title="Estimates of the parameters",
        anchor="parameters",
        lead=sentences(
            "calibration",
            "parameters",
            estimates=estimates,
            misfit=misfit_of(one.record),
            fitted=_best_fit(one),
        ),
        tables=(Table(head, rows, title="Parameters"),),
        figures=tuple(figure for figure in figures if _of_parameters(figure)),
        notes=tuple(reasons),
    )


def calibration_warnings(one: CalibratedValues, keys: Mapping[int, str]) -> tuple[str, ...]:
    """Return warnings to read before the values are used."""
    members = one.record.members
    failed = [keys.get(m.experiment_id, "?") for m in members if not _has(m.error_mm2)]
    return sentences(
        "calibration",
        "warnings",
        misfit=misfit_of(one.record),
        estimates=one.record.estimates,
        failed=_named(failed),
        far=_named(_far(one, errors_of(one), keys)),
        far_ratio=FAR_RATIO,
    )


def headline(one: CalibratedValues, nominal: FloatArray | None) -> str:
    """Summarise the calibration in one paragraph."""
    estimates = one.record.estimates
    found = sentences(
        "calibration",
        "headline",
        n=len(one.record.members),
        before=None if nominal is None else _middle(rms(one, nominal)),
        after=_middle(rms(one, errors_of(one))),
        estimates=estimates,
        good=[e.label for e in estimates if e.verdict == "identified"],
        misfit=misfit_of(one.record),
        ratio=shown_ratio(float(one.record.method.get("misfit_ratio", math.nan))),
    )
    return " ".join(found)


def methods(one: CalibratedValues) -> tuple[str, ...]:
    """Return sentences on the calibration for a methods section."""
    return sentences(
        "calibration",
        "methods",
        names=list(one.record.parameters),
        n=len(one.record.members),
        method=one.record.method,
        scale_mm=1e3 * scale_of(one),
        estimates=one.record.estimates,
        misfit=misfit_of(one.record),
        ratio=shown_ratio(float(one.record.method.get("misfit_ratio", math.nan))),
    )


def scale_of(one: CalibratedValues) -> float:
    """Length that the error counts an angle as [m/rad]."""
    scale: float = one.error.angle_scale
    return scale


def errors_of(one: CalibratedValues) -> FloatArray:
    """(n_member,) errors that were minimised; inf where there is none."""
    return np.array([error if _has(error) else math.inf for error in one.record.errors])


def rms(one: CalibratedValues, errors: FloatArray) -> FloatArray:
    """Convert errors to root mean square errors of the path [mm]."""
    return errors if one.error.unit == "mm" else np.sqrt(errors)


def _has(error: float | None) -> bool:
    return error is not None and math.isfinite(error)


def _finite(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)])


def _spread(values: FloatArray) -> tuple[str, str, str]:
    good = _finite(values)
    if len(good) == 0:
        return ("none", "none", "none")
    return f"{good.mean():.3g}", f"{np.median(good):.3g}", f"{good.max():.3g}"


def _middle(values: FloatArray) -> str:
    good = _finite(values)
    if len(good) == 0:
        return "without result"
    return f"{np.median(good):.3g} mm RMS{' (median)' * (len(values) > 1)}"


def _far(one: CalibratedValues, errors: FloatArray, keys: Mapping[int, str]) -> list[str]:
    values = rms(one, errors)
    good = _finite(values)
    if len(good) < 4:
        return []
    limit = FAR_RATIO * float(np.median(good))
    return [
        f"{keys.get(member.experiment_id, '?')} ({value:.3g} mm)"
        for member, value in sorted(
            zip(one.record.members, values.tolist(), strict=True), key=lambda pair: -pair[1]
        )
        if limit < value < math.inf
    ]


def _worst(one: CalibratedValues, errors: FloatArray, keys: Mapping[int, str]) -> Table | None:
    if len(errors) < 2 * MAX_NAMED:
        return None
    values = rms(one, errors)
    order = np.argsort(-np.where(np.isfinite(values), values, -1.0), kind="stable")[:MAX_NAMED]
    members = one.record.members
    rows = tuple((keys.get(members[k].experiment_id, "?"), f"{values[k]:.3g}") for k in order)
    return Table(("experiment", "error [mm]"), rows, title="Largest errors")


def _named(names: list[str]) -> str:
    more = len(names) - MAX_NAMED
    return ", ".join(names[:MAX_NAMED]) + (f" and {more} more" if more > 0 else "")


def _best_fit(one: CalibratedValues) -> str:
    """Values that the search found, for simulations."""
    units = {estimate.label: displayed(estimate.unit) for estimate in one.record.estimates}
    named = [(name, x, *units.get(name, ("", 1.0))) for name, x in one.record.parameters.items()]
    return ", ".join(
        f"{name} {factor * x:.4g} {unit}".rstrip(" -") for name, x, unit, factor in named
    )


def _rows(estimate: Estimate) -> list[tuple[str, ...]]:
    """Row of an estimate, and below it that from noise alone."""
    unit, factor = displayed(estimate.unit)
    ends = [estimate.low, estimate.high]
    low, high = ("open" if x is None else f"{factor * x:.4g}" for x in ends)
    interval = "none" if (low, high) == ("open", "open") else f"{low} to {high}"
    if estimate.verdict == "frozen":
        interval = ""
    rows: list[tuple[str, ...]] = [
        (estimate.label, f"{factor * estimate.value:.4g}", interval, unit, estimate.verdict)
    ]
    if (narrow := estimate.noise_alone) is not None:
        rows += [("noise alone", *row[1:4], "") for row in _rows(narrow)]
    return rows


def _in_order(figures: list[Figure]) -> tuple[Figure, ...]:
    """Order the figures, with the durations last."""
    return tuple(sorted(figures, key=lambda figure: figure.name.endswith("seconds")))


def _of_parameters(figure: Figure) -> bool:
    name = figure.name.removeprefix("calibration_")
    return any(name.startswith(stem) for stem in OF_PARAMETERS)
