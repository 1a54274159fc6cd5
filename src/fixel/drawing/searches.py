"""Charts of searches: error against evaluation, and end points of several starts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark, Style
from fixel.model.space import Unknown
from fixel.table import Table
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.units import displayed

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


def search_chart(searches: Sequence[SearchPanel], what: str = "error") -> Chart:
    """Draw the error [mm] against the evaluation, one panel for each of one to three searches.

    The objective is `what`, such as `"sum of errors"` for several experiments.

    Source: RPI thesis, figure 5.5.
    """
    n, label = len(searches), f"{what} [mm]"
    row = [_search(one, 70 if n == 1 else 38, "" if k else label) for k, one in enumerate(searches)]
    return Chart(
        size=(4.6, 2.9) if n == 1 else (chart.WIDE, 2.7),
        fill=chart.panels([row]),
        data=Table(
            ("search", "evaluation", "iteration", "error_mm", "best_mm"),
            [
                (own.title.replace("\n", " "), k, None if i < 0 else i, *values)
                for own in searches
                for k, (i, *values) in enumerate(
                    zip(own.iteration, own.errors, own.best, strict=True), 1
                )
            ],
        ),
    )


def _search(own: SearchPanel, letters: int, ylabel: str) -> Mark:
    n = len(own.errors)
    number = np.arange(1, n + 1)
    failed = ~np.isfinite(own.errors)
    shown = chart.positive(own.errors)
    # Compute the best from the values shown, which are positive on the logarithmic axis.
    best = np.fmin.accumulate(shown) if n else shown
    margin = max(0.6, 0.02 * n)
    draw = chart.panel(
        chart.line(number, shown, "o", color=palette.TRAIL, markeredgewidth=0.0,
                   markersize=3.0 if n < 30 else 1.8, label="evaluation"),
        chart.steps(number, best, where="post", color=palette.BODY, linewidth=1.2,
                    label="best so far"),
        chart.mark_missing(number[failed], 0.975, markersize=3.5, markeredgewidth=0.7,
                           label="no simulation"),
        title="\n".join(chart.shorten(text, letters) for text in own.title.split("\n")),
        log={"y": shown},
        whole="x",
        xlim=(1.0 - margin, max(n, 1) + margin),
        xlabel="evaluation",
        ylabel=ylabel,
    )  # fmt: skip

    def with_iterations(axes: Axes) -> None:
        draw(axes)
        if failed.any():
            _raise_top(axes)
        if failed.all():
            axes.text(0.5, 0.5, "nothing could be evaluated", transform=axes.transAxes, ha="center")
            axes.tick_params(labelleft=False)
        _iteration_axis(axes, own)

    return with_iterations


def _raise_top(axes: Axes) -> None:
    """Raise the upper limit of a logarithmic axis for marks of failures."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.06)


def _iteration_axis(axes: Axes, own: SearchPanel) -> None:
    """Add an axis at the top that marks where iterations begin."""
    # With one evaluation per iteration, the axis would repeat the one below.
    n, spread = len(own.begins), len(own.errors)
    if not 2 < n < spread:
        return
    round_steps = (k * 10**p for p in range(9) for k in (1, 2, 5))
    wanted = np.arange(0, n, next(s for s in round_steps if (n - 1) / s <= 6))
    places = own.begins[wanted] + 1.0
    # Drop labels that would overlap, as of short first iterations.
    keep = np.concatenate(([True], np.diff(places) > 0.05 * spread))
    above = axes.secondary_xaxis("top")
    above.set_xticks(places[keep], [str(k) for k in wanted[keep]])
    above.set_xlabel("iteration", labelpad=2.0)
    above.tick_params(pad=1.0)


def starts_chart(
    title: str,
    errors: FloatArray,
    points: FloatArray,
    unknowns: Sequence[Unknown],
    evaluations: Sequence[int],
    nearly: float = 0.02,
    what: str = "error",
) -> Chart:
    """Draw final errors (k,) of searches from several starts, sorted, and their end points (k, n).

    Errors are in mm, inf if a search found nothing. Starts count as good up to an excess `nearly`
    over the best error, as a share of it. The objective is `what`, as in `search_chart`.
    """
    order = np.argsort(errors, kind="stable").tolist()
    good = np.isfinite(errors) & (errors <= errors.min() * (1.0 + nearly))
    label = f"smallest error, or within {100 * nearly:g} % of it"
    styles: tuple[Style, Style] = (
        {"marker": "D", "color": palette.PUSHER, "label": "larger error"},
        {"marker": "o", "color": palette.BODY, "label": label},
    )

    def fill(figure: Figure) -> None:
        # More than two parameters get a wider panel.
        share = max(1.0, 0.35 * len(unknowns))
        left, right = figure.subplots(1, 2, width_ratios=(1.0, share))
        _waterfall(errors[order], good[order], styles, f"final {what} [mm]")(left)
        if not np.isfinite(errors).all():
            _raise_top(left)
        worst_first = [k for k in reversed(order) if math.isfinite(errors[k])]
        _end_points(points[worst_first], good[worst_first], styles, unknowns)(right)
        chart.legend_below(figure, (left,))

    first = ("rank", "start", "error_mm", "nearly_as_good", "evaluations")
    rows = [
        (rank, k + 1, errors[k], str(bool(good[k])).lower(), evaluations[k], *points[k])
        for rank, k in enumerate(order, 1)
    ]
    return Chart(
        title=title,
        size=(chart.WIDE, 2.7),
        fill=fill,
        data=Table((*first, *(f"{own.label} [{own.unit}]" for own in unknowns)), rows),
    )


def _waterfall(
    errors: FloatArray, good: BoolArray, styles: tuple[Style, Style], ylabel: str
) -> Mark:
    """Panel of the errors of all starts, sorted."""
    shown, rank = chart.positive(errors), np.arange(1, len(errors) + 1)
    failed = ~np.isfinite(errors)
    size = 4.0 if len(rank) <= 40 else 2.5
    dots = [
        chart.line(rank[which], shown[which], linestyle="none", markersize=size, **style)
        for which, style in ((good, styles[1]), (~good & ~failed, styles[0]))
        if which.any()
    ]
    return chart.panel(
        chart.steps(rank, shown, where="mid", color=palette.FAINT, linewidth=1.0, zorder=1),
        *dots,
        chart.mark_missing(rank[failed], 0.96, label="without result"),
        log={"y": shown},
        whole="x",
        xlim=(0.4, len(rank) + 0.6),
        xlabel="start, sorted by error",
        ylabel=ylabel,
    )


def _end_points(
    points: FloatArray, good: BoolArray, styles: tuple[Style, Style], unknowns: Sequence[Unknown]
) -> Mark:
    """Panel with each end point as a line across the parameters, as shares of their ranges."""
    low, high = np.array([(unknown.low, unknown.high) for unknown in unknowns]).T
    looks: tuple[Style, Style] = (
        {**styles[0], "linewidth": 0.5, "alpha": 0.6, "zorder": 2, "label": ""},
        {**styles[1], "linewidth": 1.0, "alpha": 0.9, "zorder": 3, "label": ""},
    )
    lines = [
        chart.line(shares, markersize=2.8, **looks[one])
        for shares, one in zip((points - low) / (high - low), good.astype(int), strict=True)
    ]
    names = []
    for unknown in unknowns:
        own = displayed(unknown.unit)
        ends = f"{own.text(unknown.low)} … {own.text(unknown.high)} {own.name}".rstrip()
        names.append(f"{chart.broken(unknown.label)}\n{ends}")

    def ticks(axes: Axes) -> None:
        axes.set_xticks(range(len(names)), names)
        if len(names) > 6:
            axes.tick_params(axis="x", rotation=60, labelsize=palette.FONT_SIZE - 1.5)

    return chart.panel(
        *lines,
        ticks,
        xlim=(-0.4, len(names) - 0.6),
        ylim=(-0.04, 1.04),
        ylabel="position between the bounds",
    )
