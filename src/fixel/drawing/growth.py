"""Charts of the range of one set of parameters: growth of domains, and single axes.

Source: RPI thesis, appendix C.6 and figures 6.1 to 6.13.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.domain.along_axis import AxisStudy
from fixel.domain.growth import Growth
from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    clean,
    column_unit,
    display_unit,
    legend_below,
    log_scale,
    positive,
    sheet,
    unit_text,
    whole_numbers,
)
from fixel.table import Table
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Layouts differ in dashes and colour; the average has a wider line.
_COLOURS: Final = (palette.TRAIL, palette.PUSHER, palette.TOUCHED, palette.CONE, palette.FIXEL)
_DASHES: Final = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
AVERAGE: Final[Style] = {"color": palette.INK, "linewidth": 1.8, "zorder": 4}
OPTIMAL: Final[Style] = {
    "color": palette.BODY, "linewidth": 1.3, "marker": "o", "markersize": 2.5, "zorder": 3,
}  # fmt: skip
THRESHOLD: Final[Style] = {"color": palette.FORCE, "linewidth": 0.9, "linestyle": (0, (4, 2))}
BAND: Final[Style] = {"color": palette.TOUCHED, "alpha": 0.16, "linewidth": 0.0, "zorder": 0}
PER_STEP: Final = 24  # number of points of a line between two experiments
SYMBOLS: Final = {"theta": "θ"}


def _line(k: int) -> Style:
    """Line style of the k-th layout."""
    dash: Any = _DASHES[(k // len(_COLOURS)) % len(_DASHES)]
    return {
        "color": _COLOURS[k % len(_COLOURS)], "linestyle": dash, "linewidth": 0.8,
        "marker": "o", "markersize": 1.8,
    }  # fmt: skip


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GrowthMatrix(AbstractChart):
    """Largest error of every group at every step, as numbers on coloured cells."""

    growth: Growth
    unit: str

    def figure(self) -> Figure:
        from matplotlib.colors import LogNorm

        errors = error_matrix(self.growth)
        n, m = errors.shape
        title = f"Largest error in the domain [{unit_text(self.unit)}]"
        figure = sheet(0.55 * WIDE + 0.28 * m, 0.55 + 0.165 * n, title)
        axes = figure.subplots()
        shown = positive(errors)
        good = shown[np.isfinite(shown)]
        low, high = (float(good.min()), float(good.max())) if len(good) else (0.1, 1.0)
        norm = LogNorm(low, max(high, 1.001 * low))
        # Text is white on dark cells, so that every number can be read.
        axes.imshow(np.ma.masked_invalid(shown), norm=norm, cmap="Blues", aspect="auto")
        axes.set_facecolor(palette.FAINT)
        for (row, k), value in np.ndenumerate(errors):
            dark = np.isfinite(value) and float(norm(max(float(value), low))) > 0.55
            text = f"{value:.3g}" if np.isfinite(value) else "none"
            axes.text(k, row, text, ha="center", va="center",
                      color="white" if dark else palette.INK)  # fmt: skip
        axes.set_yticks(range(n), [group.name for group in self.growth.groups])
        axes.set_xticks(range(m), ["0\nnominal", *(f"{k}" for k in range(1, m))])
        axes.set_xlabel("step: number of offsets from the nominal pose along x, ±y and θ")
        axes.tick_params(length=0.0)
        return figure

    def table(self) -> Table:
        unit, errors = column_unit(self.unit), error_matrix(self.growth)
        steps = {f"step_{k}_{unit}": own for k, own in enumerate(errors.T)}
        return Table.from_columns({"group": [g.name for g in self.growth.groups], **steps})


def error_matrix(growth: Growth) -> FloatArray:
    """Return the largest errors (n_group, n_step) of a growth; nan where there is none."""
    return np.array([[np.nan if x is None else x for x in row] for row in growth.matrix])


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GrowthSteps(AbstractChart):
    """Largest error against step: a panel per shape, a line per layout, and the average."""

    growth: Growth
    threshold: float
    unit: str

    def figure(self) -> Figure:
        groups, errors = self.growth.groups, error_matrix(self.growth)
        shapes = list(dict.fromkeys(group.shape for group in groups))
        layouts = list(dict.fromkeys(group.layout for group in groups))
        figure = sheet(WIDE, 3.1)
        row = figure.subplots(1, len(shapes), squeeze=False, sharey=True)[0]
        log_scale(row[0], "y", np.append(positive(errors).ravel(), self.threshold))
        steps = np.arange(errors.shape[1])
        for axes, shape in zip(row, shapes, strict=True):
            clean(axes)
            own = [k for k, group in enumerate(groups) if group.shape == shape]
            for k in own:
                layout = groups[k].layout
                style = _line(layouts.index(layout))
                axes.plot(steps, positive(errors[k]), label=layout, **style)
            # NaN where a group has no error.
            axes.plot(steps, errors[own].mean(axis=0), label="average", **AVERAGE)
            axes.axhline(self.threshold, label=_level(self.threshold, self.unit), **THRESHOLD)
            axes.set_title(shape)
            axes.set_xlabel("step of the growth")
            whole_numbers(axes)
        row[0].set_ylabel(f"largest error [{unit_text(self.unit)}]")
        legend_below(figure, row, most=5)
        return figure

    def table(self) -> Table:
        head = ("shape", "layout", "step", f"largest_error_{column_unit(self.unit)}")
        pairs = zip(self.growth.groups, error_matrix(self.growth), strict=True)
        return Table(
            head,
            [(g.shape, g.layout, step, x) for g, row in pairs for step, x in enumerate(row)],
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AxisChart(AbstractChart):
    """Errors along one axis with parameters found on intervals of several sizes, one per column.
    Upper row: every layout and the average. Lower row: average, and that of each experiment's best.

    Parameters
    ----------
    studies : sequence of AxisStudy
        Studies of one shape and axis.
    threshold : float
    unit : str
        Unit of the errors.
    length : float, optional
        Length of a step [m], or [rad] for theta.
    """

    studies: Sequence[AxisStudy]
    threshold: float
    unit: str
    length: float | None = None

    def figure(self) -> Figure:
        first = self.studies[0]
        axis = SYMBOLS.get(first.axis, first.axis)
        figure = sheet(WIDE, 4.6, f"{first.shape}, along {axis}")
        grid = figure.subplots(2, len(self.studies), squeeze=False, sharex=True, sharey="row",
                               height_ratios=(1.25, 1.0))  # fmt: skip
        every = [positive(study.error).ravel() for study in self.studies]
        log_scale(grid[0, 0], "y", np.append(np.concatenate(every), self.threshold))
        averages = [x for study in self.studies for x in (study.average, study.own_average)]
        log_scale(grid[1, 0], "y", np.concatenate(averages))
        for above, below, study in zip(grid[0], grid[1], self.studies, strict=True):
            self._draw_absolute(above, study)
            self._draw_relative(below, study)
            below.set_xlabel(self._label(axis))
            whole_numbers(below)
        grid[0, 0].set_ylabel(f"error [{unit_text(self.unit)}]")
        grid[1, 0].set_ylabel(f"average error [{unit_text(self.unit)}]")
        figure.align_ylabels(grid[:, 0])
        legend_below(figure, grid.ravel(), most=5)
        return figure

    def _label(self, axis: str) -> str:
        unit = display_unit("rad" if axis == "θ" else "m")
        step = "" if self.length is None else f" of {unit.text(self.length)} {unit.name}"
        return f"offset in {axis} [steps{step}]"

    def _draw_absolute(self, axes: Axes, study: AxisStudy) -> None:
        clean(axes)
        low, high = study.interval
        axes.axvspan(low, high, label="samples of the set", **BAND)
        for k, layout in enumerate(study.layouts):
            axes.plot(study.steps, positive(study.error[k]), label=layout, **_line(k))
        _plot(axes, study.steps, study.average, {"label": "average", **AVERAGE})
        axes.axhline(self.threshold, label=_level(self.threshold, self.unit), **THRESHOLD)
        found = study.edges(self.threshold)
        for edge, is_open in ((found.low, found.low_open), (found.high, found.high_open)):
            if edge is not None and not is_open:
                axes.plot([edge], [self.threshold], marker="D", markersize=4.0, linestyle="none",
                          color=palette.FORCE, zorder=5, label="edge of the domain")  # fmt: skip
        axes.set_title(f"set calibrated on {study.size} samples, {low} to {high}")

    def _draw_relative(self, axes: Axes, study: AxisStudy) -> None:
        clean(axes)
        axes.axvspan(*study.interval, **BAND)
        average, own = positive(study.average), positive(study.own_average)
        axes.fill_between(study.steps, own, average, color=palette.FAINT, linewidth=0.0, zorder=1)
        axes.plot(study.steps, average, **AVERAGE)
        axes.plot(study.steps, own, label="average of smallest errors", **OPTIMAL)

    def table(self) -> Table:
        unit = column_unit(self.unit)
        head = ("shape", "axis", "size", "interval_first", "interval_last", "layout", "step",
                f"error_{unit}", f"own_error_{unit}", f"relative_error_{unit}")  # fmt: skip
        rows: list[tuple[Any, ...]] = []
        for study in self.studies:
            begin = (study.shape, study.axis, study.size, *study.interval)
            averages = (study.average, study.own_average, study.average_excess)
            per_layout = zip(study.error, study.own, study.excess, strict=True)
            for name, values in [*zip(study.layouts, per_layout, strict=True),
                                 ("average", averages)]:  # fmt: skip
                columns = zip(study.steps, *values, strict=True)
                rows += [(*begin, name, *entry) for entry in columns]
        return Table(head, rows)


def _plot(axes: Axes, steps: IntArray, errors: FloatArray, style: Style) -> None:
    """Plot errors, interpolated linearly also on a logarithmic axis, as the edges are computed."""
    fine = np.linspace(steps[0], steps[-1], PER_STEP * int(steps[-1] - steps[0]) + 1)
    known = np.where(np.isfinite(errors), errors, np.nan)
    at = np.searchsorted(fine, steps - 1e-9)
    axes.plot(fine, positive(np.interp(fine, steps, known)), markevery=at.tolist(), **style)


def _level(threshold: float, unit: str) -> str:
    return f"threshold {threshold:.3g} {unit_text(unit)}"
