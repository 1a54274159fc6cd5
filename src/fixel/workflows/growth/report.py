"""Report of a domain exploration: sentences, tables, charts and plain numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from fixel.domain.along_axis import AxisEdges, AxisStudy
from fixel.domain.growth import AVERAGED, STORED
from fixel.drawing.chart import plain, readable, written
from fixel.drawing.growth import AxisChart, GrowthMatrix, GrowthSteps
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.workflows.figures import Picture
from fixel.workflows.growth.explore import Exploration


def matrix_of(found: Exploration) -> FloatArray:
    """Return the largest errors (n_group, n_step); nan where there is none."""
    rows = found.growth.matrix
    return np.array([[math.nan if x is None else x for x in row] for row in rows])


# --- sentences ----------------------------------------------------------------------------------


def headline(found: Exploration) -> list[str]:
    """Return the main results as sentences, the most important first."""
    return [*_growth_sentences(found), *(_edge_sentence(found, study) for study in found.studies)]


def _growth_sentences(found: Exploration) -> list[str]:
    matrix, unit = matrix_of(found), written(found.unit)
    sentences = []
    for shape in dict.fromkeys(group.shape for group in found.growth.groups):
        own = [k for k, group in enumerate(found.growth.groups) if group.shape == shape]
        whole = np.asarray(np.isfinite(matrix[own]).all(axis=0))
        last = int(np.flatnonzero(whole)[-1]) if whole[0] else 0
        rows = matrix[own]
        if not whole[0] or last == 0:
            sentences.append(f"{shape}: too few experiments to say how its domain grows.")
            continue
        within = [int((rows[:, k] <= found.threshold).sum()) for k in (0, 1)]
        sentences.append(
            f"{shape}: the largest error in the domain, on average over {len(own)} layouts, grows"
            f" from {rows[:, 0].mean():.3g} {unit} at the nominal pose to"
            f" {rows[:, 1].mean():.3g} {unit} at step 1 and {rows[:, last].mean():.3g} {unit} at"
            f" step {last}; within {found.threshold:.3g} {unit} are {within[0]} and {within[1]} of"
            f" {len(own)} at steps 0 and 1."
        )
    return sentences


def _edge_sentence(found: Exploration, study: AxisStudy) -> str:
    about = f"{study.shape}, {study.axis}, set of {study.size} samples"
    at = f"at E = {found.threshold:.3g} {written(found.unit)}"
    text = edges_text(study.edges(found.threshold), study)
    if text is None:
        k = int(np.flatnonzero(study.steps == 0)[0])
        value = study.average[k]
        beyond = f"{value:.3g} {written(found.unit)}" if math.isfinite(value) else "not to be had"
        return (
            f"{about}: no domain {at}; at the nominal pose the average error is"
            f" {beyond}{_without_worst(study, k)}."
        )
    length = found.samples.lengths.get(study.axis)
    return f"{about}: {text} {at}{_in_units(study, length, found.threshold)}."


def _without_worst(study: AxisStudy, k: int) -> str:
    """Average error without the largest one, as in the thesis (6.2.2, 6.4.1)."""
    errors = study.error[:, k]
    known = np.flatnonzero(np.isfinite(errors))
    if len(known) < 3:
        return ""
    worst = int(known[errors[known].argmax()])
    rest = errors[known[known != worst]].mean()
    return f", without {study.layouts[worst]}, the worst, {rest:.3g}"


def edges_text(edges: AxisEdges, study: AxisStudy) -> str | None:
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


def _in_units(study: AxisStudy, length: float | None, threshold: float) -> str:
    if length is None:
        return ""
    unit = readable("rad" if study.axis == "theta" else "m")
    ends = _ends(study.edges(threshold), study, unit.factor * length, ".3g")
    return f", which is {ends} {unit.name}"


def methods(found: Exploration) -> list[str]:
    """Return sentences for the methods section of a paper."""
    method, growth = found.stored.method, found.growth
    sets = [step.used for row in growth.steps for step in row[1:] if step.used.point is not None]
    averaged = sum(one.source == AVERAGED for one in sets)
    stored = sum(one.source == STORED for one in sets)
    printed = (
        " Rows were taken as the thesis's code is printed, where theta comes one row too early:"
        " the fifth angle never joins, and y-5 joins at the first step."
        if growth.index == "printed"
        else ""
    )
    return [
        f"Domains of applicability were grown from the nominal experiment of {len(growth.groups)}"
        f" groups of equal shape and layout: step i adds x+i, y+i, y-i and theta+i.{printed}",
        f"Each domain was simulated ({method.motion} motion, {found.rollouts} simulations in all)"
        f" under one set of parameters ({', '.join(method.names)}): {averaged} means of single"
        f" calibrations weighted with inverse errors, {stored} joint calibrations. Its error is the"
        f" largest {method.error} error [{written(method.unit)}] of its members.",
        "Along single axes, one set from the samples of an interval about the nominal pose was"
        " simulated on all samples of the axis; the edge of the domain is where the average over"
        f" layouts, linear between samples, first exceeds {found.threshold:.3g}"
        f" {written(method.unit)}.",
    ]


# --- tables -------------------------------------------------------------------------------------


def matrix_table(found: Exploration) -> Table:
    """Table of the largest errors, one row per group."""
    unit = written(found.unit)
    n = found.growth.steps[0][-1].step
    rows = [
        (row[0].group.name, *("none" if s.largest is None else f"{s.largest:.3g}" for s in row))
        for row in found.growth.steps
    ]
    return Table(
        ("group", "nominal", *(f"step {k}" for k in range(1, n + 1))),
        rows,
        title=f"Largest error in the domain [{unit}]",
    )


def edges_table(found: Exploration) -> Table:
    """Table of the domain's ends along each axis, absolute and relative."""
    unit = written(found.unit)
    rows = []
    for study in found.studies:
        k = int(np.flatnonzero(study.steps == 0)[0])
        ratio = study.ratio[k]
        rows.append(
            (
                study.shape,
                study.axis,
                str(study.size),
                edges_text(study.edges(found.threshold), study) or "none",
                edges_text(study.relative_edges(found.threshold), study) or "none",
                f"{study.average[k]:.3g}" if math.isfinite(study.average[k]) else "none",
                f"{ratio:.3g}" if math.isfinite(ratio) else "none",
            )
        )
    head = (
        *("shape", "axis", "samples", "absolute error", "relative error"),
        *(f"average at nominal [{unit}]", "over own best"),
    )
    title = f"Domain along each axis at {found.threshold:.3g} {unit}"
    return Table(head, rows, title=title, left=2)


# --- pictures -----------------------------------------------------------------------------------


def pictures(found: Exploration) -> Iterator[Picture]:
    """Yield charts of the matrix, of the growth step by step, and of each axis of each shape."""
    matrix, unit, banner = matrix_of(found), found.unit, found.samples.banner
    groups = found.growth.groups
    yield Picture(
        "growth_matrix",
        GrowthMatrix(groups=[g.name for g in groups], errors=matrix, unit=unit),
        banner,
        "Largest error of any experiment in the domain, by shape and layout, as the domain grows.",
    )
    yield Picture(
        "growth_steps",
        GrowthSteps(
            shapes=[g.shape for g in groups],
            layouts=[g.layout for g in groups],
            errors=matrix,
            threshold=found.threshold,
            unit=unit,
        ),
        banner,
        "The same against the step, with the average over layouts and the threshold.",
    )
    by_axis: dict[tuple[str, str], list[AxisStudy]] = {}
    for study in found.studies:
        by_axis.setdefault((study.shape, study.axis), []).append(study)
    for (shape, axis), studies in by_axis.items():
        chart = AxisChart(
            studies=studies,
            threshold=found.threshold,
            unit=unit,
            length=found.samples.lengths.get(axis),
        )
        yield Picture(
            f"axis_{shape}_{axis}",
            chart,
            banner,
            f"{shape}, along {axis}: error under one set of parameters, found on the samples in"
            " green, of every layout and on average; below, beside what each experiment's own set"
            " leaves.",
        )


# --- plain numbers ------------------------------------------------------------------------------


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
                        "values": None if step.used.point is None else step.used.point.tolist(),
                        "errors": plain(step.errors),
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
        "steps": study.steps.tolist(),
        "layouts": list(study.layouts),
        "layouts_counted": study.counted().tolist(),
        "average": plain(study.average),
        "own_average": plain(study.own_average),
        "relative": plain(study.average_excess),
        "ratio": plain(study.ratio),
        "error": [plain(row) for row in study.error],
        "own_error": [plain(row) for row in study.own],
        "sets": [None if one.point is None else one.point.tolist() for one in study.sets],
        "reasons": [one.reason for one in study.sets],
        "edges": study.edges(found.threshold)._asdict(),
        "relative_edges": study.relative_edges(found.threshold)._asdict(),
    }
