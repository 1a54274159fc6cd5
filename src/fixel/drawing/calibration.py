"""Charts of a calibration's experiments: errors before and after, and computing times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    clean,
    column,
    legend_below,
    log_scale,
    positive,
    sheet,
    shortened,
    without_common,
    written,
)
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_NAMES: Final = 45  # maximum number of experiments with a named row
MAX_BARS: Final = 30

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
        unit = column(self.unit)
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
        _draw_missing(axes, place[~np.isfinite(row)], style, named)
    text = f"error [{written(chart.unit)}]"
    clean(axes)
    if named:
        names = without_common(chart.keys)
        axes.set_yticks(place, [shortened(names[k], 44) for k in order])
        axes.set_ylim(n + 0.7, 0.3)
        axes.set_xlabel(text)
        axes.tick_params(axis="y", length=0.0)
        axes.grid(axis="y", visible=False)
    else:
        axes.set_xlim(0.0, n + 1.0)
        axes.set(xlabel=f"experiment, worst of {n} first", ylabel=text)


def _draw_missing(axes: Axes, place: FloatArray, style: Style, named: bool) -> None:
    """Mark experiments without a simulation at the far end of the error axis."""
    if not len(place):
        return
    far = np.full(len(place), 0.995)
    pair = (far, place) if named else (place, far)
    transform = axes.get_yaxis_transform() if named else axes.get_xaxis_transform()
    axes.plot(*pair, linestyle="none", marker="x", markersize=4.0, color=style["color"],
              transform=transform, clip_on=False)  # fmt: skip


def _with_mean(name: str, errors: FloatArray, unit: str) -> str:
    good = errors[np.isfinite(errors)]
    lost = len(errors) - len(good)
    if not len(good):
        return f"{name}: no simulation"
    mean, median = float(good.mean()), float(np.median(good))
    both = f"{mean:.3g}" if len(good) == 1 else f"mean {mean:.3g}, median {median:.3g}"
    return f"{name}: {both} {written(unit)}" + (f"; × {lost} without a simulation" if lost else "")


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
