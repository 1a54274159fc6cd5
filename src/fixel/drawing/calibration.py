"""Charts of a calibration's experiments: errors, computing times, values against offsets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Style
from fixel.table import Table
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_NAMES: Final = 45  # maximum number of experiments with a named row
MAX_BARS: Final = 30
MAX_LINES: Final = 8  # maximum number of layouts whose points are joined by lines
BINS: Final = 14

BEFORE: Final = "before"
# Styles of the series of errors in order, and of the last one; they differ in shape and colour.
MARKS: Final[tuple[Style, ...]] = (
    {"color": palette.CONE, "marker": "o", "markerfacecolor": "white"},
    {"color": palette.TOUCHED, "marker": "^"},
)
LAST: Final[Style] = {"color": palette.BODY, "marker": "o"}


def errors_chart(keys: Sequence[str], series: Mapping[str, FloatArray], unit: str) -> Chart:
    """Draw the error of every experiment before and after a calibration, from worst to best.

    There are at most three series (n,) by label; not finite if missing. The last one sets the
    order.
    """
    last = list(series.values())[-1]
    order = np.argsort(-np.where(np.isnan(last), np.inf, last), kind="stable").tolist()
    named = len(keys) <= MAX_NAMES

    def fill(figure: Figure) -> None:
        axes = figure.subplots()
        _draw_errors(axes, series, order, unit, named)
        if named:
            _name_rows(axes, [keys[k] for k in order])
        chart.legend_below(figure, (axes,))

    names = [name.replace(" ", "_").replace(",", "") for name in series]
    columns = ("experiment", *(f"{name}_{chart.column_unit(unit)}" for name in names))
    rows = [(keys[k], *(own[k] for own in series.values())) for k in order]
    return Chart(
        size=(chart.WIDE, max(1.5, 0.75 + 0.135 * len(keys)) if named else 3.2),
        fill=fill,
        data=Table(columns, rows),
    )


def _draw_errors(
    axes: Axes, series: Mapping[str, FloatArray], order: list[int], unit: str, named: bool
) -> None:
    """Draw errors in rows, or in columns without names."""
    at = np.arange(1, len(order) + 1)
    table = np.array([chart.positive(errors)[order] for errors in series.values()])
    known = np.isfinite(table).any(axis=0)
    ends = [pick(table[:, known], axis=0) if known.any() else [] for pick in (np.nanmin, np.nanmax)]
    stems = axes.hlines if named else axes.vlines
    stems(at[known], *ends, color=palette.FAINT, linewidth=1.4 if named else 0.6, zorder=1)
    chart.log_scale(axes, "x" if named else "y", table.ravel())
    styles = (*MARKS[: len(table) - 1], LAST)
    for row, (name, errors), style in zip(table, series.items(), styles, strict=True):
        axes.plot(*((row, at) if named else (at, row)), linestyle="none", zorder=3,
                  markersize=3.8 if named else 1.8, markeredgewidth=0.8,
                  label=_with_mean(name, errors, unit), **style)  # fmt: skip
        missing = at[~np.isfinite(row)]
        chart.mark_missing(
            missing, 0.995, "y" if named else "x", color=style["color"], clip_on=False
        )(axes)
    text = f"error [{chart.unit_text(unit)}]"
    chart.clean(axes)
    if named:
        axes.set_xlabel(text)
    else:
        n = len(order)
        axes.set(xlim=(0.0, n + 1.0), xlabel=f"experiment, worst of {n} first", ylabel=text)


def _name_rows(axes: Axes, keys: Sequence[str]) -> None:
    """Label rows with the names of experiments, without the dataset if all of them share it."""
    heads = {key.partition("/")[0] for key in keys}
    alike = len(heads) == 1 and all("/" in key for key in keys)
    names = [key.partition("/")[2] if alike else key for key in keys]
    axes.set_yticks(range(1, len(keys) + 1), [chart.shorten(name, 44) for name in names])
    axes.set_ylim(len(keys) + 0.7, 0.3)
    axes.tick_params(axis="y", length=0.0)
    axes.grid(axis="y", visible=False)


def _with_mean(name: str, errors: FloatArray, unit: str) -> str:
    good = errors[np.isfinite(errors)]
    lost = len(errors) - len(good)
    if not len(good):
        return f"{name}: no simulation"
    mean, median = float(good.mean()), float(np.median(good))
    both = f"{mean:.3g}" if len(good) == 1 else f"mean {mean:.3g}, median {median:.3g}"
    failed = f"; × {lost} without a simulation" if lost else ""
    return f"{name}: {both} {chart.unit_text(unit)}{failed}"


def seconds_chart(keys: Sequence[str], seconds: FloatArray, evaluations: Sequence[int]) -> Chart:
    """Draw a histogram of the computing time of calibrations.

    Source: RPI thesis, figure 5.4.
    """
    n, middle = len(seconds), float(np.median(seconds))
    low, high = float(seconds.min()), float(seconds.max())
    # The exact range of times, widened if all times are equal.
    ends = (low, high) if high > 1.001 * low else (0.5 * low, 1.5 * high or 1.0)

    def text(time: float) -> str:
        return f"{time / 3600.0:.3g} h" if time >= 7200.0 else f"{time:.3g} s"

    times = chart.panel(
        chart.histogram(seconds, bins=min(MAX_BARS, max(4, math.ceil(2.0 * math.sqrt(n)))),
                        range=ends, color=palette.BODY, edgecolor="white", linewidth=0.5),
        chart.vline(middle, color=palette.INK, linewidth=0.8, linestyle=chart.DASHED),
        title=f"{n} calibrations, {text(seconds.sum())} in all; median {text(middle)} (dashed)",
        whole="y",
        xlabel="time of one calibration [s]",
        ylabel="calibrations",
    )  # fmt: skip
    return Chart(
        size=(palette.COLUMN, 2.4),
        fill=chart.panels([[times]]),
        data=Table.from_columns(
            {"experiment": keys, "seconds": seconds, "evaluations": evaluations}
        ),
    )


class OffsetSeries(NamedTuple):
    """Experiments whose start poses differ along one axis."""

    name: str
    unit: str
    members: IntArray  # (k,) indices of the experiments
    offsets: FloatArray  # (k,) in SI units


class Quantity(NamedTuple):
    """Value of every experiment."""

    label: str
    unit: str
    values: FloatArray  # (n,); not finite if missing
    log: bool = False
    bounds: tuple[float, float] | None = None


def offsets_chart(
    title: str,
    keys: Sequence[str],
    groups: Sequence[str],
    axes: Sequence[OffsetSeries],
    quantities: Sequence[Quantity],
) -> Chart:
    """Draw values against offsets: a row per quantity, a column per axis, and histograms.

    Each experiment was offset from its group, which is its shape and layout. Without axes, values
    are drawn in the order of the experiments.

    Source: RPI thesis, figures 5.6 and 5.7.
    """
    at = np.arange(len(keys))
    in_order = OffsetSeries("experiment", "", at, np.asarray(at + 1.0, np.float64))
    series, n = axes or [in_order], len(quantities)
    columns = ("experiment", "group", "axis", "offset", "offset_unit",
               *(f"{q.label} [{q.unit}]" for q in quantities))  # fmt: skip
    rows = [
        (keys[m], groups[m], own.name, offset, own.unit, *(q.values[m] for q in quantities))
        for own in series
        for m, offset in zip(own.members, own.offsets, strict=True)
    ]
    return Chart(
        title=title,
        size=(chart.WIDE, 0.7 + (1.05 if n > 1 else 1.7) * n),
        fill=lambda figure: _draw_offsets(figure, groups, series, quantities, bool(axes)),
        data=Table(columns, rows),
    )


def _draw_offsets(
    figure: Figure,
    groups: Sequence[str],
    series: Sequence[OffsetSeries],
    quantities: Sequence[Quantity],
    offset: bool,
) -> None:
    widths = (*(1.0 for _ in series), 0.45)
    grid = figure.subplots(
        len(quantities), len(widths), squeeze=False, sharey="row", width_ratios=widths
    )
    for k, (row, quantity) in enumerate(zip(grid, quantities, strict=True), 1):
        _scale(row[0], quantity)
        for axes, own in zip(row, series, strict=False):
            _draw_values(axes, groups, own, quantity, offset)
            axes.tick_params(labelbottom=k == len(quantities))
        _draw_histogram(row[-1], quantity)
        row[0].set_ylabel(chart.display_unit(quantity.unit).on(chart.broken(quantity.label)))
    for axes, own in zip(grid[-1], series, strict=False):
        text = f"offset in {own.name.replace('theta', 'θ')}" if offset else own.name
        axes.set_xlabel(chart.display_unit(own.unit or "-").on(text))
    grid[-1, -1].set_xlabel("experiments")
    figure.align_ylabels(grid[:, 0])
    if len(grid[0, 0].get_legend_handles_labels()[1]) > 1:
        chart.legend_below(figure, grid[0, :1], 2)


def _draw_values(
    axes: Axes, groups: Sequence[str], own: OffsetSeries, quantity: Quantity, offset: bool
) -> None:
    """Draw every experiment as a dot, joined within a layout, and the mean over layouts."""
    chart.clean(axes)
    unit, scale = chart.display_unit(own.unit or "-"), chart.display_unit(quantity.unit).factor
    values = chart.positive(quantity.values) if quantity.log else quantity.values
    layouts = list(dict.fromkeys(groups))
    style: Style = {"linestyle": "-" if offset and len(layouts) <= MAX_LINES else "none",
                    "linewidth": 0.6, "marker": "o", "color": palette.TRAIL,
                    "markersize": 2.6 if len(own.members) < 60 else 1.6}  # fmt: skip
    for layout in layouts:
        some = np.array([groups[m] == layout for m in own.members], bool)
        some[some] = np.isfinite(values[own.members[some]])
        order = np.flatnonzero(some)[np.argsort(own.offsets[some], kind="stable")]
        label = "" if layout != layouts[0] else "experiment"
        shown = scale * values[own.members[order]]
        axes.plot(unit.factor * own.offsets[order], shown, label=label, **style)
    if offset and len(layouts) > 1:
        offsets, means = _means(own.offsets, values[own.members], quantity.log)
        axes.plot(unit.factor * offsets, scale * means, color=palette.BODY, linewidth=1.4,
                  label="mean over layouts")  # fmt: skip


def _scale(axes: Axes, quantity: Quantity) -> None:
    factor = chart.display_unit(quantity.unit).factor
    if quantity.log:
        chart.log_scale(axes, "y", factor * quantity.values)
    elif quantity.bounds is not None:
        low, high = quantity.bounds
        margin = 0.05 * (high - low)
        axes.set_ylim(factor * (low - margin), factor * (high + margin))
        axes.locator_params(axis="y", nbins=4)


def _means(offsets: FloatArray, values: FloatArray, log: bool) -> tuple[FloatArray, FloatArray]:
    """Mean at each offset; on a logarithmic axis the geometric mean, robust against outliers."""
    known = np.isfinite(values)
    places = np.unique(offsets[known].round(9))
    at = [values[known & np.isclose(offsets, place, atol=1e-9)] for place in places]
    means = [float(np.exp(np.log(v).mean()) if log else v.mean()) for v in at]
    return places, np.array(means)


def _draw_histogram(axes: Axes, quantity: Quantity) -> None:
    """Draw a histogram of a quantity, on its shared axis."""
    factor = chart.display_unit(quantity.unit).factor
    values = factor * (chart.positive(quantity.values) if quantity.log else quantity.values)
    low, high = axes.get_ylim()
    edges = np.geomspace(low, high, BINS + 1) if quantity.log else np.linspace(low, high, BINS + 1)
    axes.hist(values[np.isfinite(values)], bins=edges.tolist(), orientation="horizontal",
              color=palette.BODY, edgecolor="white", linewidth=0.4)  # fmt: skip
    axes.set_ylim(low, high)
    axes.locator_params(axis="x", nbins=3, integer=True)
    axes.tick_params(labelleft=False)
    chart.clean(axes)
