"""Charts of searches: error against evaluation, and end points of several starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

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
    room_above,
    sheet,
    shorten,
    unit_text,
    whole_numbers,
)
from fixel.model.space import Unknown
from fixel.table import Table
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class SearchPanel(NamedTuple):
    """Evaluations of one search."""

    title: str
    errors: FloatArray  # (n,) of the evaluations in order; inf for failed ones
    begins: IntArray  # (m,) first evaluation of each iteration; empty if unknown

    @property
    def best(self) -> FloatArray:
        """Smallest error so far, (n,); inf before the first success."""
        return np.minimum.accumulate(self.errors) if len(self.errors) else self.errors

    @property
    def iteration(self) -> IntArray:
        """Iteration of each evaluation, (n,), from 0; all -1 if unknown."""
        return np.searchsorted(self.begins, np.arange(len(self.errors)), side="right") - 1


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SearchChart(AbstractChart):
    """Error against evaluation, one panel per search.

    Source: RPI thesis, figure 5.5.

    Parameters
    ----------
    panels : sequence of SearchPanel
        One to three searches.
    unit : str
        Unit of the errors.
    what : str
        Name of the objective, such as `"sum of errors"` for several experiments.
    """

    panels: Sequence[SearchPanel]
    unit: str
    what: str = "error"

    def figure(self) -> Figure:
        n = len(self.panels)
        figure = sheet(4.6 if n == 1 else WIDE, 2.9 if n == 1 else 2.7)
        row = figure.subplots(1, n, squeeze=False)[0]
        for axes, panel in zip(row, self.panels, strict=True):
            _draw_search(axes, panel, 70 if n == 1 else 38)
        row[0].set_ylabel(f"{self.what} [{unit_text(self.unit)}]")
        legend_below(figure, row)
        return figure

    def table(self) -> Table:
        unit = column_unit(self.unit)
        columns = ("search", "evaluation", "iteration", f"error_{unit}", f"best_{unit}")
        rows = [
            (panel.title.replace("\n", " "), k, None if i < 0 else i, error, best)
            for panel in self.panels
            for k, (i, error, best) in enumerate(
                zip(panel.iteration, panel.errors, panel.best, strict=True), 1
            )
        ]
        return Table(columns, rows)


def _draw_search(axes: Axes, panel: SearchPanel, letters: int) -> None:
    number = np.arange(1, len(panel.errors) + 1)
    failed = ~np.isfinite(panel.errors)
    shown = positive(panel.errors)
    dot: Style = {"marker": "o", "color": palette.TRAIL, "markeredgewidth": 0.0}
    axes.plot(number, shown, linestyle="none", markersize=3.0 if len(number) < 30 else 1.8,
              label="evaluation", **dot)  # fmt: skip
    # Compute the best from the values shown, which are positive on the logarithmic axis.
    best = np.fmin.accumulate(shown) if len(shown) else shown
    axes.step(number, best, where="post", color=palette.BODY, linewidth=1.2, label="best so far")
    crosses: Style = {"markersize": 3.5, "markeredgewidth": 0.7, "label": "no simulation"}
    mark_missing(axes, number[failed], 0.975, **crosses)
    log_scale(axes, "y", shown)
    room_above(axes, bool(failed.any()))
    margin = max(0.6, 0.02 * len(number))
    axes.set_xlim(1.0 - margin, max(len(number), 1) + margin)
    title = "\n".join(shorten(line, letters) for line in panel.title.split("\n"))
    axes.set_title(title, fontsize=palette.FONT_SIZE)
    axes.set_xlabel("evaluation")
    whole_numbers(axes)
    clean(axes)
    if failed.all():
        axes.text(0.5, 0.5, "nothing could be evaluated", transform=axes.transAxes, ha="center")
        axes.tick_params(labelleft=False)
    _iteration_axis(axes, panel)


def _iteration_axis(axes: Axes, panel: SearchPanel) -> None:
    """Add an axis at the top that marks where iterations begin."""
    # With one evaluation per iteration, the axis would repeat the one below.
    n, spread = len(panel.begins), len(panel.errors)
    if not 2 < n < spread:
        return
    step = next(s for s in _round_steps() if (n - 1) / s <= 6)
    wanted = np.arange(0, n, step)
    places = panel.begins[wanted] + 1.0
    # Drop labels that would overlap, as of short first iterations.
    keep = np.concatenate(([True], np.diff(places) > 0.05 * spread))
    above = axes.secondary_xaxis("top")
    above.set_xticks(places[keep], [str(k) for k in wanted[keep]])
    above.set_xlabel("iteration", labelpad=2.0)
    above.tick_params(pad=1.0)


def _round_steps() -> list[int]:
    return [k * 10**p for p in range(9) for k in (1, 2, 5)]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartsChart(AbstractChart):
    """Final errors of searches from several starts, sorted, and their end points.

    Parameters
    ----------
    title : str
    unit : str
        Unit of the errors.
    errors : (k,) float64
        Final errors; inf if a search found nothing.
    points : (k, n) float64
        End points of the searches.
    unknowns : sequence of Unknown
        Parameters, with their bounds.
    evaluations : sequence of int
        Number of evaluations of each search.
    nearly : float
        Excess over the best error, as a share of it, up to which a start counts as good.
    what : str
        Name of the objective, as in `SearchChart`.
    """

    title: str
    unit: str
    errors: FloatArray
    points: FloatArray
    unknowns: Sequence[Unknown]
    evaluations: Sequence[int]
    nearly: float = 0.02
    what: str = "error"

    @property
    def order(self) -> list[int]:
        """Indices of starts, from the best to the worst."""
        return [int(k) for k in np.argsort(self.errors, kind="stable")]

    @property
    def good(self) -> list[bool]:
        """Mask of the starts that ended as well as the best, or nearly."""
        best = float(self.errors.min())
        return [math.isfinite(e) and e <= best * (1.0 + self.nearly) for e in self.errors.tolist()]

    def figure(self) -> Figure:
        figure = sheet(WIDE, 2.7, self.title)
        # More than two parameters get a wider panel.
        share = max(1.0, 0.35 * len(self.unknowns))
        left, right = figure.subplots(1, 2, width_ratios=(1.0, share))
        _draw_waterfall(left, self)
        _draw_ends(right, self)
        legend_below(figure, (left,))
        return figure

    def table(self) -> Table:
        error = f"error_{column_unit(self.unit)}"
        first = ("rank", "start", error, "nearly_as_good", "evaluations")
        names = [f"{unknown.label} [{unknown.unit}]" for unknown in self.unknowns]
        good = ["true" if good else "false" for good in self.good]
        rows = [
            (rank, k + 1, self.errors[k], good[k], self.evaluations[k], *self.points[k])
            for rank, k in enumerate(self.order, 1)
        ]
        return Table((*first, *names), rows)


def _draw_waterfall(axes: Axes, chart: StartsChart) -> None:
    ordered = chart.errors[chart.order]
    shown, rank = positive(ordered), np.arange(1, len(ordered) + 1)
    nearly = np.array(chart.good)[chart.order]
    axes.step(rank, shown, where="mid", color=palette.FAINT, linewidth=1.0, zorder=1)
    few = len(rank) <= 40
    for which, style in ((nearly, _good(chart)), (~nearly & np.isfinite(ordered), _other())):
        if which.any():
            axes.plot(rank[which], shown[which], linestyle="none", markersize=4 if few else 2.5,
                      **style)  # fmt: skip
    none = ~np.isfinite(ordered)
    mark_missing(axes, rank[none], 0.96, label="without result")
    log_scale(axes, "y", shown)
    room_above(axes, bool(none.any()))
    axes.set_xlim(0.4, len(rank) + 0.6)
    axes.set(
        xlabel="start, sorted by error", ylabel=f"final {chart.what} [{unit_text(chart.unit)}]"
    )
    whole_numbers(axes)
    clean(axes)


def _good(chart: StartsChart) -> Style:
    return {
        "marker": "o",
        "color": palette.BODY,
        "label": f"smallest error, or within {100 * chart.nearly:g} % of it",
    }


def _other() -> Style:
    return {"marker": "D", "color": palette.PUSHER, "label": "larger error"}


def _draw_ends(axes: Axes, chart: StartsChart) -> None:
    """Draw each end point as a line across the parameters, as shares of their ranges."""
    place = np.arange(len(chart.unknowns))
    low, high = np.array([(unknown.low, unknown.high) for unknown in chart.unknowns]).T
    shares = (chart.points - low) / (high - low)
    for k in reversed(chart.order):
        if math.isfinite(chart.errors[k]):
            style = _good(chart) if chart.good[k] else _other()
            line = {"linewidth": 1.0, "alpha": 0.9, "zorder": 3}
            if not chart.good[k]:
                line = {"linewidth": 0.5, "alpha": 0.6, "zorder": 2}
            axes.plot(place, shares[k], markersize=2.8, **style | line | {"label": ""})
    names = []
    for unknown in chart.unknowns:
        own = display_unit(unknown.unit)
        ends = f"{own.text(unknown.low)} … {own.text(unknown.high)} {own.name}".rstrip()
        names.append(f"{broken(unknown.label)}\n{ends}")
    axes.set_xticks(place, names)
    if len(names) > 6:
        axes.tick_params(axis="x", rotation=60, labelsize=palette.FONT_SIZE - 1.5)
    axes.set_xlim(-0.4, len(place) - 0.6)
    axes.set_ylim(-0.04, 1.04)
    axes.set_ylabel("position between the bounds")
    clean(axes)
