"""Calibrated values of many experiments against the offsets of their start poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    broken,
    clean,
    log_scale,
    positive,
    readable,
    sheet,
)
from fixel.table import Table
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_LINES: Final = 8  # maximum number of layouts whose points are joined by lines
BINS: Final = 14


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
            row[0].set_ylabel(readable(quantity.unit).on(broken(quantity.label)))
        for axes, axis in zip(grid[-1], self.columns, strict=False):
            text = f"offset in {axis.name.replace('theta', 'θ')}" if self.axes else axis.name
            axes.set_xlabel(readable(axis.unit or "-").on(text))
        for row in grid[:-1]:
            for axes in row[:m]:
                axes.tick_params(labelbottom=False)
        grid[-1, -1].set_xlabel("experiments")
        figure.align_ylabels(grid[:, 0])
        self._legend(figure, grid[0, 0])
        return figure

    def _draw(self, axes: Axes, axis: OffsetSeries, quantity: Quantity) -> None:
        """Draw every experiment as a dot, joined within a layout, and the mean over layouts."""
        clean(axes)
        unit, scale = readable(axis.unit or "-"), readable(quantity.unit).factor
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

    def _legend(self, figure: Figure, axes: Axes) -> None:
        handles, labels = axes.get_legend_handles_labels()
        if len(labels) > 1:
            figure.legend(handles, labels, frameon=False, ncols=2, loc="outside lower center")

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
    factor = readable(quantity.unit).factor
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
    factor = readable(quantity.unit).factor
    values = factor * (positive(quantity.values) if quantity.log else quantity.values)
    low, high = axes.get_ylim()
    edges = np.geomspace(low, high, BINS + 1) if quantity.log else np.linspace(low, high, BINS + 1)
    axes.hist(values[np.isfinite(values)], bins=edges.tolist(), orientation="horizontal",
              color=palette.BODY, edgecolor="white", linewidth=0.4)  # fmt: skip
    axes.set_ylim(low, high)
    axes.locator_params(axis="x", nbins=3, integer=True)
    axes.tick_params(labelleft=False)
    clean(axes)
