"""Charts of the range of one set of parameters: growth of domains, and single axes.

Source: RPI thesis, appendix C.6 and figures 6.1 to 6.13.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.domain.along_axis import AxisStudy
from fixel.domain.growth import Growth
from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark, Style
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import displayed, unit_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Layouts differ in dashes and colour; the average has a wider line.
_COLOURS: Final = (palette.TRAIL, palette.PUSHER, palette.TOUCHED, palette.CONE, palette.FIXEL)
_DASHES: Final = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
AVERAGE: Final[Style] = {"color": palette.INK, "linewidth": 1.8, "zorder": 4}
BAND: Final[Style] = {"color": palette.TOUCHED, "alpha": 0.16, "linewidth": 0.0, "zorder": 0}
PER_STEP: Final = 24  # number of points of a line between two experiments


def growth_matrix(growth: Growth, unit: str) -> Chart:
    """Draw the largest error of every group at every step, as numbers on coloured cells."""
    errors, names = error_matrix(growth), [group.name for group in growth.groups]
    steps = {f"step_{k}_{chart.column_unit(unit)}": own for k, own in enumerate(errors.T)}
    return Chart(
        title=f"Largest error in the domain [{unit_text(unit)}]",
        size=(0.55 * chart.WIDE + 0.28 * errors.shape[1], 0.55 + 0.165 * len(errors)),
        fill=lambda figure: _draw_matrix(figure, errors, names),
        data=Table.from_columns({"group": names, **steps}),
    )


def _draw_matrix(figure: Figure, errors: FloatArray, names: Sequence[str]) -> None:
    from matplotlib.colors import LogNorm

    axes = figure.subplots()
    shown = chart.positive(errors)
    good = shown[np.isfinite(shown)]
    low, high = (float(good.min()), float(good.max())) if len(good) else (0.1, 1.0)
    norm = LogNorm(low, max(high, 1.001 * low))
    # Text is white on dark cells, so that every number can be read.
    axes.imshow(np.ma.masked_invalid(shown), norm=norm, cmap="Blues", aspect="auto")
    axes.set_facecolor(palette.FAINT)
    for (row, k), value in np.ndenumerate(errors):
        dark = np.isfinite(value) and float(norm(max(float(value), low))) > 0.55
        text = f"{value:.3g}" if np.isfinite(value) else "none"
        colour = "white" if dark else palette.INK
        axes.text(k, row, text, ha="center", va="center", color=colour)
    axes.set_yticks(range(len(names)), names)
    ticks = ["0\nnominal", *(f"{k}" for k in range(1, errors.shape[1]))]
    axes.set_xticks(range(len(ticks)), ticks)
    axes.set_xlabel("step: number of offsets from the nominal pose along x, ±y and θ")
    axes.tick_params(length=0.0)


def error_matrix(growth: Growth) -> FloatArray:
    """Return the largest errors (n_group, n_step) of a growth; nan where there is none."""
    return np.array([[np.nan if x is None else x for x in row] for row in growth.matrix])


def growth_steps(growth: Growth, threshold: float, unit: str) -> Chart:
    """Draw the largest error against step: a panel per shape, a line per layout, the average."""
    groups, errors = growth.groups, error_matrix(growth)
    layouts = list(dict.fromkeys(group.layout for group in groups))
    steps = np.arange(errors.shape[1])
    row: list[Mark] = []
    for shape in dict.fromkeys(group.shape for group in groups):
        own = [k for k, group in enumerate(groups) if group.shape == shape]
        lines = [_layout(steps, errors[k], groups[k].layout, layouts) for k in own]
        # NaN where a group has no error.
        average = chart.line(steps, errors[own].mean(axis=0), label="average", **AVERAGE)
        row.append(
            chart.panel(
                *lines,
                average,
                _level(threshold, unit),
                title=shape,
                log={"y": np.append(chart.positive(errors).ravel(), threshold)},
                whole="x",
                xlabel="step of the growth",
                ylabel="" if row else f"largest error [{unit_text(unit)}]",
            )
        )
    head = ("shape", "layout", "step", f"largest_error_{chart.column_unit(unit)}")
    pairs = zip(groups, errors, strict=True)
    return Chart(
        size=(chart.WIDE, 3.1),
        fill=chart.panels([row], 5, sharey=True),
        data=Table(
            head, [(g.shape, g.layout, k, x) for g, own in pairs for k, x in enumerate(own)]
        ),
    )


def axis_chart(
    studies: Sequence[AxisStudy], threshold: float, unit: str, length: float | None = None
) -> Chart:
    """Draw errors along one axis with parameters found on intervals of several sizes.

    There is a column per size: above every layout and the average, below the average of each
    experiment's best as well. The studies are of one shape and axis; `length` is that of a step,
    [m] or [rad].
    """
    axis = studies[0].axis.replace("theta", "θ")
    shown = displayed("rad" if axis == "θ" else "m")
    step = "" if length is None else f" of {shown.text(length)} {shown.name}"
    errors = np.append(
        np.concatenate([chart.positive(s.error).ravel() for s in studies]), threshold
    )
    averages = np.concatenate([x for s in studies for x in (s.average, s.own_average)])
    texts = [f"error [{unit_text(unit)}]", f"average error [{unit_text(unit)}]"]
    return Chart(
        title=f"{studies[0].shape}, along {axis}",
        size=(chart.WIDE, 4.6),
        fill=chart.panels(
            [
                [_absolute(s, errors, threshold, unit, texts[0] * (not k))
                 for k, s in enumerate(studies)],
                [_relative(s, averages, f"offset in {axis} [steps{step}]", texts[1] * (not k))
                 for k, s in enumerate(studies)],
            ],
            5, sharex=True, sharey="row", height_ratios=(1.25, 1.0),
        ),
        data=_table_of(studies, chart.column_unit(unit)),
    )  # fmt: skip


def _table_of(studies: Sequence[AxisStudy], unit: str) -> Table:
    head = ("shape", "axis", "size", "interval_first", "interval_last", "layout", "step",
            f"error_{unit}", f"own_error_{unit}", f"relative_error_{unit}")  # fmt: skip
    rows: list[tuple[Any, ...]] = []
    for study in studies:
        begin = (study.shape, study.axis, study.size, *study.interval)
        averages = (study.average, study.own_average, study.average_excess)
        per_layout = zip(study.error, study.own, study.excess, strict=True)
        for name, values in [*zip(study.layouts, per_layout, strict=True), ("average", averages)]:
            rows += [(*begin, name, *entry) for entry in zip(study.steps, *values, strict=True)]
    return Table(head, rows)


def _absolute(
    study: AxisStudy, errors: FloatArray, threshold: float, unit: str, ylabel: str
) -> Mark:
    low, high = study.interval
    lines = [_layout(study.steps, study.error[k], name, study.layouts)
             for k, name in enumerate(study.layouts)]  # fmt: skip
    # The average is linear between its points also on a logarithmic axis, as edges are computed.
    n = PER_STEP * int(study.steps[-1] - study.steps[0])
    fine = np.linspace(study.steps[0], study.steps[-1], n + 1)
    known = np.where(np.isfinite(study.average), study.average, np.nan)
    at = np.searchsorted(fine, study.steps - 1e-9).tolist()
    average = chart.positive(np.interp(fine, study.steps, known))
    found = study.edges(threshold)
    edges = [
        chart.line([edge], [threshold], marker="D", markersize=4.0, linestyle="none",
                   color=palette.FORCE, zorder=5, label="edge of the domain")
        for edge, is_open in ((found.low, found.low_open), (found.high, found.high_open))
        if edge is not None and not is_open
    ]  # fmt: skip
    return chart.panel(
        chart.vspan(low, high, label="samples of the set", **BAND),
        *lines,
        chart.line(fine, average, label="average", markevery=at, **AVERAGE),
        _level(threshold, unit),
        *edges,
        title=f"set calibrated on {study.size} samples, {low} to {high}",
        log={"y": errors},
        ylabel=ylabel,
    )


def _relative(study: AxisStudy, errors: FloatArray, xlabel: str, ylabel: str) -> Mark:
    average, own = chart.positive(study.average), chart.positive(study.own_average)
    return chart.panel(
        chart.vspan(*study.interval, **BAND),
        chart.band(study.steps, own, average, color=palette.FAINT, linewidth=0.0, zorder=1),
        chart.line(study.steps, average, **AVERAGE),
        chart.line(study.steps, own, label="average of smallest errors", color=palette.BODY,
                   linewidth=1.3, marker="o", markersize=2.5, zorder=3),
        log={"y": errors},
        whole="x",
        xlabel=xlabel,
        ylabel=ylabel,
    )  # fmt: skip


def _layout(steps: Any, errors: FloatArray, name: str, layouts: Sequence[str]) -> Mark:
    """Line of the errors of one layout."""
    k = list(layouts).index(name)
    dash = _DASHES[(k // len(_COLOURS)) % len(_DASHES)]
    style: Style = {"color": _COLOURS[k % len(_COLOURS)], "linestyle": dash, "linewidth": 0.8}
    return chart.line(
        steps, chart.positive(errors), marker="o", markersize=1.8, label=name, **style
    )


def _level(threshold: float, unit: str) -> Mark:
    return chart.hline(threshold, label=f"threshold {threshold:.3g} {unit_text(unit)}",
                       color=palette.FORCE, linewidth=0.9, linestyle=chart.DASHED)  # fmt: skip
