"""Content and sections of a report: measurements, errors before and after, parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.noise import shown_ratio
from fixel.calibration.objective import lengths_of
from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.database.store import Store
from fixel.errors import some_of
from fixel.model.selection import ExperimentQuery, ExperimentRow
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.workflows.analysis import write_picture
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.report import pictures_of
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
    tables = [
        Table(("parameters", *columns), rows, title="Root mean square error of the trajectory")
    ]
    if len(after) >= 2 * MAX_NAMED:
        order = np.argsort(-np.where(np.isfinite(after), after, -1.0), kind="stable")[:MAX_NAMED]
        worst = [(fit.keys_of_experiments[k], after[k]) for k in order]
        error = Column("error", "mm", ".3g")
        tables.append(Table(("experiment", error), worst, title="Largest errors"))
    if len(fit.run) > 1:
        tables.append(replace(fit.run.analysis.tables[0], title="Calibrations of the run"))
    shown = [figure for figure in figures if not _of_parameters(figure)]
    shown.sort(key=lambda figure: figure.name.endswith("seconds"))  # durations last
    return Section(
        title="Nominal and calibrated",
        anchor="errors",
        lead=sentences("calibration", "errors", scale_mm=_scale_mm(fit), n_set=len(fit.run)),
        tables=tuple(tables),
        figures=tuple(shown),
    )


def parameters_section(fit: Calibration, figures: list[Figure]) -> Section:
    """Build the section with the values, their intervals and verdicts."""
    (table,) = fit.analysis.tables
    fitted = (e.text(e.predictor) for e in fit.estimates.values())
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
        notes=(*([fit.prediction_check.text] if fit.prediction_check else []), *fit.analysis.notes),
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
        failed=some_of([keys[k] for k in np.flatnonzero(~np.isfinite(after))], MAX_NAMED),
        far=some_of(far, MAX_NAMED),
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
    unit = fit.request.made_error.unit
    return lengths_of(fit.nominal_errors, unit), lengths_of(fit.found.errors, unit)


def _scale_mm(fit: Calibration) -> float:
    """Length that the error counts an angle as [mm/rad]."""
    return 1e3 * fit.request.made_error.angle_scale


def _middle(values: FloatArray) -> str:
    good = values[np.isfinite(values)]
    return f"{np.median(good):.3g} mm RMS{' (median)' * (len(values) > 1)}" if len(good) else ""


def _of_parameters(figure: Figure) -> bool:
    name = figure.name.removeprefix("calibration_")
    return any(name.startswith(stem) for stem in OF_PARAMETERS)


class Figure(NamedTuple):
    """Picture with its files."""

    name: str  # name of its files, unique in the report
    caption: str
    png: Path  # its PDF and CSV are in the same folder


class Section(NamedTuple):
    """Part of a report under a heading."""

    title: str
    anchor: str  # for links within the page
    lead: tuple[str, ...] = ()  # sentences before tables and figures
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: tuple[str, ...] = ()  # sentences after tables and figures, in small print
    commands: tuple[str, ...] = ()  # that repeat its analyses


class Content(NamedTuple):
    """Content of a whole report."""

    title: str
    banner: str  # for data that no camera has seen; empty if all of it is real
    facts: tuple[tuple[str, str], ...]  # provenance: name and value
    warnings: tuple[str, ...]  # in plain words, the gravest first
    findings: tuple[str, ...]  # main results in a few sentences
    sections: tuple[Section, ...]
    methods: tuple[str, ...]  # sentences of the methods section
    references: tuple[str, ...] = ()  # keys of the bibliography, in the order they are needed
    commands: tuple[str, ...] = ()  # that repeat everything, in order


MAX_VALUES: Final = 8  # values of one condition that are written out
FEW_EXPERIMENTS: Final = 10  # number of experiments below which little can be concluded


@dataclass(frozen=True)
class ReportData:
    """Experiments of a report."""

    summaries: list[ExperimentRow]  # experiments that are used
    flags: Mapping[str, int]  # how many experiments of the project carry each flag
    left_out: int  # number of experiments of the project that are left out for their flags

    @property
    def simulated(self) -> int:
        """Number of simulated experiments."""
        return sum(not summary.is_real for summary in self.summaries)

    @property
    def banner(self) -> str:
        """Banner over the report; empty if all experiments are real."""
        if not self.simulated:
            return ""
        if self.simulated == len(self.summaries):
            return "All experiments are SIMULATED; none was recorded"
        return f"{self.simulated} of {len(self.summaries)} experiments are SIMULATED"

    @cached_property
    def conditions(self) -> dict[str, list[str | float]]:
        """Values of each condition that differs among the experiments."""
        found: dict[str, set[str | float]] = {}
        for summary in self.summaries:
            for name, value in summary.conditions.items():
                if not name.startswith("truth_"):
                    found.setdefault(name, set()).add(value)
        return {name: sorted(v, key=_as_listed) for name, v in sorted(found.items()) if len(v) > 1}


def data_of(store: Store, ids: Sequence[int]) -> ReportData:
    """Load the summaries and flags of experiments."""
    listed = store.experiments(ALL_EXPERIMENTS).rows
    wanted = set(ids)
    clean = store.experiments(ExperimentQuery())
    return ReportData([s for s in listed if s.id in wanted], store.flags(), clean.left_out)


def data_section(data: ReportData) -> Section:
    """Build the section on the experiments and their conditions."""
    summaries = data.summaries
    sets = Counter(summary.dataset for summary in summaries)
    frames = np.array([s.n_frame for s in summaries])
    lasted = np.array([s.duration_s for s in summaries])
    start = np.array([(s.start_x_m, s.start_y_m, s.start_theta_rad) for s in summaries])
    end = np.array([(s.end_x_m, s.end_y_m, s.end_theta_rad) for s in summaries])
    moved = 1e3 * np.hypot(*(end - start)[:, :2].T)
    angle = np.degrees([abs(s.turned_rad) for s in summaries])
    rows = (
        ("frames of an experiment", *_spread(frames)),
        ("duration [s]", *_spread(lasted)),
        ("object moved [mm]", *_spread(moved)),
        ("object turned [deg]", *_spread(angle)),
    )
    tables = [Table(("", "least", "median", "most"), rows, title="Experiments")]
    if data.conditions:
        tables.append(_conditions(data))
    if data.flags:
        title = "Flags on the data of this project"
        tables.append(Table(("flag", "experiments"), sorted(data.flags.items()), title=title))
    return Section(
        title="Measurements",
        anchor="data",
        lead=sentences(
            "data", "counted", n=len(summaries), simulated=data.simulated, sets=sorted(sets.items())
        ),
        tables=tuple(tables),
        commands=("fixel list",),
    )


def data_warnings(data: ReportData) -> tuple[str, ...]:
    """Return warnings about the experiments."""
    return sentences(
        "data",
        "warnings",
        simulated=data.simulated,
        n=len(data.summaries),
        few=FEW_EXPERIMENTS,
        left_out=data.left_out,
    )


def _spread(values: np.ndarray) -> tuple[str, str, str]:
    return f"{values.min():.4g}", f"{np.median(values):.4g}", f"{values.max():.4g}"


def _conditions(data: ReportData) -> Table:
    rows = []
    for name, values in data.conditions.items():
        shown = [(value if isinstance(value, str) else f"{value:.4g}") for value in values]
        if len(shown) > MAX_VALUES:
            shown = [*shown[: MAX_VALUES // 2], "...", *shown[-MAX_VALUES // 2 :]]
        rows.append((name, str(len(values)), ", ".join(shown)))
    return Table(("condition", "values", "which"), rows, title="Conditions that differ")


def _as_listed(value: str | float) -> tuple[bool, float, str]:
    """Sort key: numbers by size, then words alphabetically."""
    words = isinstance(value, str)
    return words, 0.0 if isinstance(value, str) else value, str(value)
