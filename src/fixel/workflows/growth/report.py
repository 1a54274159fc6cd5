"""Report of a domain exploration: sentences, tables, charts and plain numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.domain.along_axis import AxisEdges, AxisStudy
from fixel.domain.growth import AVERAGED, STORED
from fixel.drawing.growth import axis_chart, error_matrix, growth_matrix, growth_steps
from fixel.errors import counted
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.units import displayed, unit_text
from fixel.workflows.analysis import Analysis, AnalysisReport, Picture, StoredAnswer
from fixel.workflows.growth.explore import Exploration
from fixel.workflows.sentences import sentences

THESIS: Final = "rpi2011"  # key of the bibliography


def report_of(found: Exploration) -> AnalysisReport:
    """Return headline, warnings, tables, charts and numbers of an exploration."""
    banner, n = found.samples.banner, len(found.added)
    simulated = [f"{banner}: these experiments were simulated, not recorded."] if banner else []
    new = f", {counted(n, 'parameter set')} stored as calibrations" if n else ""
    matrix = error_matrix(found.growth)
    return AnalysisReport(
        Analysis(
            kind="growth",
            title="Domain of applicability, grown as in the thesis",
            question={},
            headline=_headline(found, matrix),
            warnings=(*simulated, *found.warnings),
            tables=(matrix_table(found), _edges_table(found)),
            notes=(f"{counted(found.rollouts, 'simulation')}{new}",),
            methods=_methods(found),
            references=(THESIS,),
            numbers=numbers(found),
            calibrations=tuple(sorted({one.id for one in found.stored.best})),
            experiments=tuple(found.samples.ids),
        ),
        [*_pictures(found)],
        {"largest_error": matrix},
    )


def content(done: StoredAnswer) -> dict[str, Any]:
    """Return the content of `--json`."""
    analysis, folder = done.analysis, done.folder or Path()
    return {
        "folder": str(folder),
        "pictures": [str(folder / f"{shown.name}.png") for shown in analysis.pictures],
        "copied": [str(path) for path in done.files.values()],
        "seconds": analysis.seconds,
        **analysis.numbers,
    }


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    return ["report"]


def _headline(found: Exploration, matrix: FloatArray) -> tuple[str, ...]:
    groups = found.growth.groups
    shapes = [
        _shape_growth(shape, matrix[[group.shape == shape for group in groups]], found.threshold)
        for shape in dict.fromkeys(group.shape for group in groups)
    ]
    axes = [_axis_edges(found, study) for study in found.studies]
    unit = unit_text(found.unit)
    return sentences(
        "growth", "headline", shapes=shapes, axes=axes, unit=unit, threshold=found.threshold
    )


def _shape_growth(shape: str, rows: FloatArray, threshold: float) -> dict[str, Any]:
    """Mean errors of a shape's layouts at the first steps and at the last known to all."""
    whole = np.asarray(np.isfinite(rows).all(axis=0))
    last = int(np.flatnonzero(whole)[-1]) if whole[0] else 0
    if last == 0:
        return {"shape": shape, "last": 0}
    return {
        "shape": shape,
        "layouts": len(rows),
        "nominal": rows[:, 0].mean(),
        "first": rows[:, 1].mean(),
        "last": last,
        "end": rows[:, last].mean(),
        "within": [int((rows[:, k] <= threshold).sum()) for k in (0, 1)],
    }


def _axis_edges(found: Exploration, study: AxisStudy) -> dict[str, Any]:
    """Ends of the domain along an axis, in steps and in units, or the error that prevents one."""
    k = int(np.flatnonzero(study.steps == 0)[0])
    ends = _edges_text(study.edges(found.threshold), study)
    length = found.samples.lengths.get(study.axis)
    unit = displayed("rad" if study.axis == "theta" else "m")
    in_units = None
    if ends and length is not None:
        edges = study.edges(found.threshold)
        in_units = f"{_ends(edges, study, unit.factor * length, '.3g')} {unit.name}"
    return {
        "about": f"{study.shape}, {study.axis}, set of {study.size} samples",
        "ends": ends,
        "lengths": in_units,
        "average": study.average[k] if math.isfinite(study.average[k]) else None,
        "worst": _without_worst(study, k),
    }


def _without_worst(study: AxisStudy, k: int) -> tuple[str, float] | None:
    """Worst layout, and the average error without it, as in the thesis (6.2.2, 6.4.1)."""
    errors = study.error[:, k]
    known = np.flatnonzero(np.isfinite(errors))
    if len(known) < 3:
        return None
    worst = int(known[errors[known].argmax()])
    return study.layouts[worst], float(errors[known[known != worst]].mean())


def _edges_text(edges: AxisEdges, study: AxisStudy) -> str | None:
    """Format edges: `-2.0 to +2.5 steps`; `beyond +5.0` if the last experiment is within."""
    if edges.low is None or edges.high is None:
        return None
    return f"{_ends(edges, study, 1.0, '+.1f')} steps"


def _ends(edges: AxisEdges, study: AxisStudy, factor: float, form: str) -> str:
    ends = []
    # If nothing was tried below the nominal pose, the domain begins there.
    opens = (edges.low_open and study.steps[0] < 0, edges.high_open)
    for end, is_open in zip((edges.low, edges.high), opens, strict=True):
        value = format(factor * end, form) if end else "0"
        ends.append(f"beyond {value}" if is_open else value)
    return " to ".join(ends)


def _methods(found: Exploration) -> tuple[str, ...]:
    """Return sentences for the methods section of a paper."""
    sets = [step.used for row in found.growth.steps for step in row[1:]]
    sources = [one.source for one in sets if one.point is not None]
    return sentences(
        "growth",
        "methods",
        growth=found.growth,
        method=found.stored.method,
        rollouts=found.rollouts,
        averaged=sources.count(AVERAGED),
        stored=sources.count(STORED),
        unit=unit_text(found.stored.method.unit),
        threshold=found.threshold,
    )


def matrix_table(found: Exploration) -> Table:
    """Table of the largest errors, one row per group."""
    names = ["nominal", *(f"step {k + 1}" for k in range(found.growth.steps[0][-1].step))]
    head = [Column("group"), *(Column(name, format=".3g") for name in names)]
    rows = [(row[0].group.name, *(s.largest for s in row)) for row in found.growth.steps]
    return Table(head, rows, title=f"Largest error in the domain [{unit_text(found.unit)}]")


def _edges_table(found: Exploration) -> Table:
    """Table of the domain's ends along each axis, absolute and relative."""
    unit = unit_text(found.unit)
    rows = []
    for study in found.studies:
        k = int(np.flatnonzero(study.steps == 0)[0])
        edges = study.edges(found.threshold), study.relative_edges(found.threshold)
        ends = [_edges_text(own, study) or "none" for own in edges]
        rows.append((study.shape, study.axis, study.size, *ends, study.average[k], study.ratio[k]))
    head = (
        *("shape", "axis", "samples", "absolute error", "relative error"),
        *(Column("average at nominal", unit, ".3g"), Column("over own best", format=".3g")),
    )
    title = f"Domain along each axis at {found.threshold:.3g} {unit}"
    return Table(head, rows, title=title, left=2)


def _pictures(found: Exploration) -> Iterator[Picture]:
    """Yield charts of the matrix, of the growth step by step, and of each axis of each shape."""
    unit, banner = found.unit, found.samples.banner
    yield Picture(
        "growth_matrix",
        growth_matrix(found.growth, unit),
        banner,
        "Largest error of any experiment in the domain, by shape and layout, as the domain grows.",
    )
    yield Picture(
        "growth_steps",
        growth_steps(found.growth, found.threshold, unit),
        banner,
        "Largest error against the step of the growth, with the average over layouts and the "
        "threshold.",
    )
    by_axis: dict[tuple[str, str], list[AxisStudy]] = {}
    for study in found.studies:
        by_axis.setdefault((study.shape, study.axis), []).append(study)
    for (shape, axis), studies in by_axis.items():
        chart = axis_chart(studies, found.threshold, unit, found.samples.lengths.get(axis))
        yield Picture(
            f"axis_{shape}_{axis}",
            chart,
            banner,
            f"{shape}, along {axis}: error of every layout and its average with one parameter "
            "set, calibrated on the samples in green. Below: the same next to the error with the "
            "own set of each experiment.",
        )


def numbers(found: Exploration) -> dict[str, Any]:
    """Return all results as plain values; offsets in SI units, errors in `error_unit`."""
    ids = found.samples.ids
    return {
        "error": found.stored.method.error,
        "error_unit": found.unit,
        "threshold": found.threshold,
        "motion": found.stored.method.motion,
        "parameters": list(found.stored.method.names),
        "index": found.growth.index,
        "rollouts": found.rollouts,
        "step_length": found.samples.lengths,
        "groups": [
            {
                "shape": row[0].group.shape,
                "layout": row[0].group.layout,
                "largest_error": [step.largest for step in row],
                "reasons": [step.reason for step in row],
                "sets": [
                    {
                        "source": step.used.source,
                        "calibration": step.used.calibration,
                        "experiments": [ids[m] for m in step.used.members],
                        "values": step.used.point,
                        "errors": step.errors,
                    }
                    for step in row
                ],
            }
            for row in found.growth.steps
        ],
        "axes": [_axis_numbers(found, study) for study in found.studies],
        "calibrations_added": found.added,
    }


def _axis_numbers(found: Exploration, study: AxisStudy) -> dict[str, Any]:
    return {
        "shape": study.shape,
        "axis": study.axis,
        "size": study.size,
        "interval": list(study.interval),
        "steps": study.steps,
        "layouts": list(study.layouts),
        "layouts_counted": study.counted(),
        "average": study.average,
        "own_average": study.own_average,
        "relative": study.average_excess,
        "ratio": study.ratio,
        "error": study.error,
        "own_error": study.own,
        "sets": [one.point for one in study.sets],
        "reasons": [one.reason for one in study.sets],
        "edges": study.edges(found.threshold)._asdict(),
        "relative_edges": study.relative_edges(found.threshold)._asdict(),
    }
