"""Report sections on a calibration: errors before and after, parameters and verdicts."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from fixel.calibration.misfit import shown_ratio
from fixel.database.project import Project
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.charts import pictures_of
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
    for picture in pictures_of(calibration, project):
        files = write_picture(folder, picture._replace(name=f"calibration_{picture.name}"))
        found.append(Figure(name=files[0].stem, caption=picture.caption, png=files[0]))
    return found


def errors_section(fit: Calibration, figures: list[Figure]) -> Section:
    """Build the section that compares errors before and after the calibration."""
    before, after = errors_of(fit)
    rows = [
        (name, values.mean(), np.median(values), values.max())
        for name, own in (("nominal", before), ("calibrated", after))
        if len(values := own[np.isfinite(own)])
    ]
    columns = [Column(name, "mm", ".3g") for name in ("mean", "median", "largest")]
    title = "Root mean square error of the trajectory"
    tables = [Table(("parameters", *columns), rows, title=title)]
    if len(after) >= 2 * MAX_NAMED:
        order = np.argsort(-np.where(np.isfinite(after), after, -1.0), kind="stable")[:MAX_NAMED]
        worst = [(fit.keys_of_experiments[k], after[k]) for k in order]
        error = Column("error", "mm", ".3g")
        tables.append(Table(("experiment", error), worst, title="Largest errors"))
    return Section(
        title="Nominal and calibrated",
        anchor="errors",
        lead=sentences("calibration", "errors", scale_mm=_scale_mm(fit)),
        tables=tuple(tables),
        figures=_in_order([figure for figure in figures if not _of_parameters(figure)]),
    )


def parameters_section(fit: Calibration, figures: list[Figure]) -> Section:
    """Build the section with the values, their intervals and verdicts."""
    (table,) = fit.analysis.tables
    fitted = (e.text(e.value if e.best_fit is None else e.best_fit) for e in fit.estimates.values())
    return Section(
        title="Estimates of the parameters",
        anchor="parameters",
        lead=sentences(
            "calibration",
            "parameters",
            estimates=fit.found.estimates,
            misfit=fit.found.misfit,
            fitted=", ".join(map(" ".join, zip(fit.estimates, fitted, strict=True))),
        ),
        tables=(replace(table, title="Parameters"),),
        figures=tuple(figure for figure in figures if _of_parameters(figure)),
        notes=fit.analysis.notes,
    )


def calibration_warnings(fit: Calibration) -> tuple[str, ...]:
    """Return warnings to read before the values are used."""
    (_, after), keys = errors_of(fit), fit.keys_of_experiments
    good = after[np.isfinite(after)]
    limit = FAR_RATIO * float(np.median(good)) if len(good) >= 4 else math.inf
    far = [f"{keys[k]} ({after[k]:.3g} mm)" for k in np.argsort(-after, kind="stable").tolist()
           if limit < after[k] < math.inf]  # fmt: skip
    return sentences(
        "calibration",
        "warnings",
        misfit=fit.found.misfit,
        estimates=fit.found.estimates,
        failed=_named([keys[k] for k in np.flatnonzero(~np.isfinite(after))]),
        far=_named(far),
        far_ratio=FAR_RATIO,
    )


def headline(fit: Calibration) -> str:
    """Summarise the calibration in one paragraph."""
    before, after = map(_middle, errors_of(fit))
    found = sentences(
        "calibration",
        "headline",
        n=len(fit.found.members),
        before=before,
        after=after or "without result",
        estimates=fit.found.estimates,
        good=fit.identified,
        misfit=fit.found.misfit,
        ratio=shown_ratio(fit.misfit.ratio),
    )
    return " ".join(found)


def methods(fit: Calibration) -> tuple[str, ...]:
    """Return sentences on the calibration for a methods section."""
    return sentences(
        "calibration",
        "methods",
        names=[*fit],
        n=len(fit.found.members),
        method=fit.request.model_dump() | {"how": fit.found.how},
        scale_mm=_scale_mm(fit),
        estimates=fit.found.estimates,
        misfit=fit.found.misfit,
        ratio=shown_ratio(fit.misfit.ratio),
    )


def errors_of(fit: Calibration) -> tuple[FloatArray, FloatArray]:
    """Root mean square errors (n_member,) before and after [mm]; not finite where unknown."""
    before = fit.run.outcome.nominal[list(fit.found.members)]
    is_square = fit.request.made_error.unit == "mm^2"
    return tuple(np.sqrt(e) if is_square else e for e in (before, fit.found.errors))  # type: ignore[return-value]


def _scale_mm(fit: Calibration) -> float:
    """Length that the error counts an angle as [mm/rad]."""
    return 1e3 * fit.request.made_error.angle_scale


def _middle(values: FloatArray) -> str:
    good = values[np.isfinite(values)]
    return f"{np.median(good):.3g} mm RMS{' (median)' * (len(values) > 1)}" if len(good) else ""


def _named(names: list[str]) -> str:
    more = len(names) - MAX_NAMED
    return ", ".join(names[:MAX_NAMED]) + (f" and {more} more" if more > 0 else "")


def _in_order(figures: list[Figure]) -> tuple[Figure, ...]:
    """Order the figures, with the durations last."""
    return tuple(sorted(figures, key=lambda figure: figure.name.endswith("seconds")))


def _of_parameters(figure: Figure) -> bool:
    name = figure.name.removeprefix("calibration_")
    return any(name.startswith(stem) for stem in OF_PARAMETERS)
