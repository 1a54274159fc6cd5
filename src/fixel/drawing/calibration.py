"""Charts of a calibration's experiments: errors, computing times, values against offsets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    broken,
    clean,
    column_unit,
    display_unit,
    legend_below,
    log_scale,
    mark_missing,
    positive,
    sheet,
    shorten,
    unit_text,
    without_common,
)
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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorsChart(AbstractChart):
    """Error of every experiment, before and after a calibration, sorted from worst to best.

    Parameters
    ----------
    keys : sequence of str
    series : mapping of str to (n,) float64
        Errors by label, at most three series; not finite if missing. The last one sets the order.
    unit : str
    """

    keys: Sequence[str]
    series: Mapping[str, FloatArray]
    unit: str

    @property
    def order(self) -> list[int]:
        """Indices of experiments, sorted from the largest to the smallest error."""
        last = list(self.series.values())[-1]
        return [int(k) for k in np.argsort(-np.where(np.isnan(last), np.inf, last), kind="stable")]

    def figure(self) -> Figure:
        n = len(self.keys)
        named = n <= MAX_NAMES
        figure = sheet(WIDE, max(1.5, 0.75 + 0.135 * n) if named else 3.2)
        axes = figure.subplots()
        _draw_errors(axes, self, named)
        legend_below(figure, (axes,))
        return figure

    def table(self) -> Table:
        unit = column_unit(self.unit)
        columns = ("experiment", *(f"{_column_name(name)}_{unit}" for name in self.series))
        values = self.series.values()
        return Table(columns, [(self.keys[k], *(own[k] for own in values)) for k in self.order])


def _column_name(name: str) -> str:
    return name.replace(" ", "_").replace(",", "")


def _draw_errors(axes: Axes, chart: ErrorsChart, named: bool) -> None:
    """Draw errors in rows with the names of experiments, or in columns without names."""
    order, n = chart.order, len(chart.keys)
    place = np.arange(1, n + 1)
    every = np.concatenate([positive(errors) for errors in chart.series.values()])
    table = np.array([positive(errors)[order] for errors in chart.series.values()])
    known = np.isfinite(table).any(axis=0)
    low = np.nanmin(table[:, known], axis=0) if known.any() else np.zeros(0)
    high = np.nanmax(table[:, known], axis=0) if known.any() else np.zeros(0)
    stems = axes.hlines if named else axes.vlines
    stems(place[known], low, high, color=palette.FAINT, linewidth=1.4 if named else 0.6, zorder=1)
    log_scale(axes, "x" if named else "y", every)
    size = 3.8 if named else 1.8
    styles = (*MARKS[: len(table) - 1], LAST)
    for row, (name, errors), style in zip(table, chart.series.items(), styles, strict=True):
        label = _with_mean(name, errors, chart.unit)
        pair = (row, place) if named else (place, row)
        axes.plot(*pair, linestyle="none", markersize=size, markeredgewidth=0.8, label=label,
                  zorder=3, **style)  # fmt: skip
        missing, which = place[~np.isfinite(row)], "y" if named else "x"
        mark_missing(axes, missing, 0.995, which, color=style["color"], clip_on=False)
    text = f"error [{unit_text(chart.unit)}]"
    clean(axes)
    if named:
        names = without_common(chart.keys)
        axes.set_yticks(place, [shorten(names[k], 44) for k in order])
        axes.set_ylim(n + 0.7, 0.3)
        axes.set_xlabel(text)
        axes.tick_params(axis="y", length=0.0)
        axes.grid(axis="y", visible=False)
    else:
        axes.set_xlim(0.0, n + 1.0)
        axes.set(xlabel=f"experiment, worst of {n} first", ylabel=text)


def _with_mean(name: str, errors: FloatArray, unit: str) -> str:
    good = errors[np.isfinite(errors)]
    lost = len(errors) - len(good)
    if not len(good):
        return f"{name}: no simulation"
    mean, median = float(good.mean()), float(np.median(good))
    both = f"{mean:.3g}" if len(good) == 1 else f"mean {mean:.3g}, median {median:.3g}"
    failed = f"; × {lost} without a simulation" if lost else ""
    return f"{name}: {both} {unit_text(unit)}{failed}"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SecondsChart(AbstractChart):
    """Histogram of the computing time of calibrations.

    Source: RPI thesis, figure 5.4.

    Parameters
    ----------
    keys : sequence of str
        Names of the experiments.
    seconds : (n,) float64
    evaluations : sequence of int
    """

    keys: Sequence[str]
    seconds: FloatArray
    evaluations: Sequence[int]

    def figure(self) -> Figure:
        figure = sheet(palette.COLUMN, 2.4)
        axes = figure.subplots()
        n = len(self.seconds)
        bins = min(MAX_BARS, max(4, math.ceil(2.0 * math.sqrt(n))))
        axes.hist(self.seconds, bins=bins, range=self._range(), color=palette.BODY,
                  edgecolor="white", linewidth=0.5)  # fmt: skip
        middle = float(np.median(self.seconds))
        axes.axvline(middle, color=palette.INK, linewidth=0.8, linestyle=(0, (4, 2)))
        axes.set_title(
            f"{n} calibrations, {self._text(self.seconds.sum())} in all;"
            f" median {self._text(middle)} (dashed)",
            fontsize=palette.FONT_SIZE,
        )
        axes.set(xlabel="time of one calibration [s]", ylabel="calibrations")
        axes.locator_params(axis="y", integer=True)
        clean(axes)
        return figure

    def _range(self) -> tuple[float, float]:
        """Range of the bins: the exact range of times, widened if all times are equal."""
        low, high = float(self.seconds.min()), float(self.seconds.max())
        return (low, high) if high > 1.001 * low else (0.5 * low, 1.5 * high or 1.0)

    @staticmethod
    def _text(seconds: float) -> str:
        return f"{seconds / 3600.0:.3g} h" if seconds >= 7200.0 else f"{seconds:.3g} s"

    def table(self) -> Table:
        return Table.from_columns(
            {"experiment": self.keys, "seconds": self.seconds, "evaluations": self.evaluations}
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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetsChart(AbstractChart):
    """Values against offsets: a row per quantity, a column per axis, and histograms.

    Source: RPI thesis, figures 5.6 and 5.7.

    Parameters
    ----------
    title : str
    keys : sequence of str
        Names of the experiments.
    groups : sequence of str
        Shape and layout of each experiment, from which it was offset.
    axes : sequence of OffsetSeries
        Axes of the offsets; if empty, values are drawn in the order of the experiments.
    quantities : sequence of Quantity
    """

    title: str
    keys: Sequence[str]
    groups: Sequence[str]
    axes: Sequence[OffsetSeries]
    quantities: Sequence[Quantity]

    @property
    def columns(self) -> Sequence[OffsetSeries]:
        """Axes of the offsets, or else the order of the experiments."""
        place = np.arange(len(self.keys))
        return self.axes or [
            OffsetSeries("experiment", "", place, np.asarray(place + 1.0, np.float64))
        ]

    def figure(self) -> Figure:
        n, m = len(self.quantities), len(self.columns)
        figure = sheet(WIDE, 0.7 + (1.05 if n > 1 else 1.7) * n, self.title)
        widths = (*(1.0 for _ in self.columns), 0.45)
        grid = figure.subplots(n, m + 1, squeeze=False, sharey="row", width_ratios=widths)
        for row, quantity in zip(grid, self.quantities, strict=True):
            _scale(row[0], quantity)
            for axes, axis in zip(row, self.columns, strict=False):
                self._draw(axes, axis, quantity)
            _draw_histogram(row[-1], quantity)
            row[0].set_ylabel(display_unit(quantity.unit).on(broken(quantity.label)))
        for axes, axis in zip(grid[-1], self.columns, strict=False):
            text = f"offset in {axis.name.replace('theta', 'θ')}" if self.axes else axis.name
            axes.set_xlabel(display_unit(axis.unit or "-").on(text))
        for row in grid[:-1]:
            for axes in row[:m]:
                axes.tick_params(labelbottom=False)
        grid[-1, -1].set_xlabel("experiments")
        figure.align_ylabels(grid[:, 0])
        if len(grid[0, 0].get_legend_handles_labels()[1]) > 1:
            legend_below(figure, grid[0, :1], 2)
        return figure

    def _draw(self, axes: Axes, axis: OffsetSeries, quantity: Quantity) -> None:
        """Draw every experiment as a dot, joined within a layout, and the mean over layouts."""
        clean(axes)
        unit, scale = display_unit(axis.unit or "-"), display_unit(quantity.unit).factor
        values = positive(quantity.values) if quantity.log else quantity.values
        groups = list(dict.fromkeys(self.groups))
        joined = bool(self.axes) and len(groups) <= MAX_LINES
        for group in groups:
            own = np.array([self.groups[m] == group for m in axis.members], bool)
            own[own] = np.isfinite(values[axis.members[own]])
            order = np.flatnonzero(own)[np.argsort(axis.offsets[own], kind="stable")]
            axes.plot(
                unit.factor * axis.offsets[order],
                scale * values[axis.members[order]],
                linestyle="-" if joined else "none",
                linewidth=0.6,
                marker="o",
                markersize=2.6 if len(axis.members) < 60 else 1.6,
                color=palette.TRAIL,
                label="" if group != groups[0] else "experiment",
            )
        if self.axes and len(groups) > 1:
            offsets, means = _means(axis.offsets, values[axis.members], quantity.log)
            axes.plot(unit.factor * offsets, scale * means, color=palette.BODY, linewidth=1.4,
                      label="mean over layouts")  # fmt: skip

    def table(self) -> Table:
        columns = ("experiment", "group", "axis", "offset", "offset_unit",
                   *(f"{q.label} [{q.unit}]" for q in self.quantities))  # fmt: skip
        values = [quantity.values for quantity in self.quantities]
        rows = [
            (self.keys[m], self.groups[m], axis.name, offset, axis.unit, *(v[m] for v in values))
            for axis in self.columns
            for m, offset in zip(axis.members, axis.offsets, strict=True)
        ]
        return Table(columns, rows)


def _scale(axes: Axes, quantity: Quantity) -> None:
    factor = display_unit(quantity.unit).factor
    if quantity.log:
        log_scale(axes, "y", factor * quantity.values)
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
    factor = display_unit(quantity.unit).factor
    values = factor * (positive(quantity.values) if quantity.log else quantity.values)
    low, high = axes.get_ylim()
    edges = np.geomspace(low, high, BINS + 1) if quantity.log else np.linspace(low, high, BINS + 1)
    axes.hist(values[np.isfinite(values)], bins=edges.tolist(), orientation="horizontal",
              color=palette.BODY, edgecolor="white", linewidth=0.4)  # fmt: skip
    axes.set_ylim(low, high)
    axes.locator_params(axis="x", nbins=3, integer=True)
    axes.tick_params(labelleft=False)
    clean(axes)
