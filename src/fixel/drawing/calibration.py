"""Calibrations as pictures: searches, starts, errors before and after, times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    Table,
    Value,
    clean,
    column,
    log_scale,
    plain,
    positive,
    readable,
    sheet,
    shortened,
    without_common,
    written,
)
from fixel.kernels.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_NAMES: Final = 45  # experiments with a row of their own
MOST_BARS: Final = 30

BEFORE: Final = "before"
# Series of errors in the order they come: marks that differ in shape as well as colour.
MARKS: Final[tuple[Style, ...]] = (
    {"color": palette.PUSHER, "marker": "o", "markerfacecolor": "white"},
    {"color": palette.TOUCHED, "marker": "^"},
    {"color": palette.BODY, "marker": "o"},
    {"color": palette.CONE, "marker": "s"},
)


class SearchPanel(NamedTuple):
    """One search."""

    title: str
    errors: FloatArray  # (n,) of the evaluations in order; inf where one failed
    begins: IntArray  # (m,) first evaluation of each iteration; none where they are not known

    @property
    def best(self) -> FloatArray:
        """(n,) least so far; inf before the first success."""
        return np.minimum.accumulate(self.errors) if len(self.errors) else self.errors

    @property
    def iteration(self) -> IntArray:
        """(n,) of each evaluation, from 0; nothing is known where all are -1."""
        return np.searchsorted(self.begins, np.arange(len(self.errors)), side="right") - 1


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SearchChart(AbstractChart):
    """Error against evaluation, a panel a search.

    Source: RPI thesis, figure 5.5.

    Parameters
    ----------
    panels : sequence of SearchPanel
        One to three.
    unit : str
        Of the errors.
    """

    panels: Sequence[SearchPanel]
    unit: str

    def figure(self) -> Figure:
        n = len(self.panels)
        figure = sheet(4.6 if n == 1 else WIDE, 2.9 if n == 1 else 2.7)
        row = figure.subplots(1, n, squeeze=False)[0]
        for axes, panel in zip(row, self.panels, strict=True):
            _draw_search(axes, panel)
        row[0].set_ylabel(f"error [{written(self.unit)}]")
        _legend_below(figure, row)
        return figure

    def table(self) -> Table:
        unit = column(self.unit)
        columns = ("search", "evaluation", "iteration", f"error_{unit}", f"best_{unit}")
        rows: list[tuple[Value, ...]] = [
            (panel.title, k + 1, None if i < 0 else i, error, best)
            for panel in self.panels
            for k, (i, error, best) in enumerate(
                zip(panel.iteration.tolist(), plain(panel.errors), plain(panel.best), strict=True)
            )
        ]
        return Table(columns, rows)


def _draw_search(axes: Axes, panel: SearchPanel) -> None:
    number = np.arange(1, len(panel.errors) + 1)
    failed = ~np.isfinite(panel.errors)
    shown = positive(panel.errors)
    axes.plot(
        number,
        shown,
        linestyle="none",
        marker="o",
        markersize=3.0 if len(number) < 30 else 1.8,
        color=palette.TRAIL,
        markeredgewidth=0.0,
        label="evaluation",
    )
    # Not below zero on a logarithmic axis, so both from the same values.
    best = np.fmin.accumulate(shown) if len(shown) else shown
    axes.step(number, best, where="post", color=palette.BODY, linewidth=1.2, label="best so far")
    if failed.any():
        axes.plot(
            number[failed],
            np.full(failed.sum(), 0.975),
            linestyle="none",
            marker="x",
            markersize=3.5,
            markeredgewidth=0.7,
            color=palette.FORCE,
            transform=axes.get_xaxis_transform(),
            label="no simulation",
        )
    log_scale(axes, "y", shown)
    _room_above(axes, bool(failed.any()))
    margin = max(0.6, 0.02 * len(number))
    axes.set_xlim(1.0 - margin, max(len(number), 1) + margin)
    axes.set_title(shortened(panel.title, 46), fontsize=palette.FONT_SIZE)
    axes.set_xlabel("evaluation")
    _whole_numbers(axes)
    clean(axes)
    if failed.all():
        axes.text(0.5, 0.5, "nothing could be evaluated", transform=axes.transAxes, ha="center")
        axes.tick_params(labelleft=False)
    _iteration_axis(axes, panel)


def _room_above(axes: Axes, wanted: bool) -> None:
    """For the marks of failures, above all errors."""
    if wanted:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.06)


def _whole_numbers(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, min_n_ticks=1))


def _iteration_axis(axes: Axes, panel: SearchPanel) -> None:
    """A second axis above, which counts iterations where each begins."""
    # One evaluation an iteration says nothing new.
    n, spread = len(panel.begins), len(panel.errors)
    if not 2 < n < spread:
        return
    step = next(s for s in _round_steps() if (n - 1) / s <= 6)
    wanted = np.arange(0, n, step)
    places = panel.begins[wanted] + 1.0
    # The first iterations may be one evaluation each: numbers would lie on each other.
    keep = np.concatenate(([True], np.diff(places) > 0.05 * spread))
    above = axes.secondary_xaxis("top")
    above.set_xticks(places[keep], [str(k) for k in wanted[keep]])
    above.set_xlabel("iteration", labelpad=2.0)
    above.tick_params(pad=1.0)


def _round_steps() -> list[int]:
    return [k * 10**p for p in range(9) for k in (1, 2, 5)]


def _legend_below(figure: Figure, row: Sequence[Axes]) -> None:
    """One legend for all panels; a label counts once."""
    entries: dict[str, Any] = {}
    for axes in row:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        list(entries.values()),
        list(entries),
        frameon=False,
        ncols=len(entries),
        loc="outside lower center",
    )


# --- several starts -----------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartsChart(AbstractChart):
    """Final errors of searches from several starts, sorted, and where each ended.

    Parameters
    ----------
    title : str
    unit : str
        Of the errors.
    errors : (k,) float64
        Final; inf where a search found nothing.
    points : (k, n) float64
        Where each ended.
    labels, units : sequences of str
        Of the unknowns.
    low, high : (n,) float64
        Bounds.
    evaluations : sequence of int
        Of each search.
    nearly : float
        Share of the best error by which another may exceed it and count as good.
    """

    title: str
    unit: str
    errors: FloatArray
    points: FloatArray
    labels: Sequence[str]
    units: Sequence[str]
    low: FloatArray
    high: FloatArray
    evaluations: Sequence[int]
    nearly: float = 0.02

    @property
    def order(self) -> list[int]:
        """Starts from the best to the worst."""
        return [int(k) for k in np.argsort(self.errors, kind="stable")]

    @property
    def good(self) -> list[bool]:
        """Which starts are as good as the best, or nearly."""
        best = float(self.errors.min())
        return [math.isfinite(e) and e <= best * (1.0 + self.nearly) for e in self.errors.tolist()]

    def figure(self) -> Figure:
        figure = sheet(WIDE, 2.8)
        # Four unknowns and more need the room that three leave empty.
        share = max(1.0, 0.35 * len(self.labels))
        left, right = figure.subplots(1, 2, width_ratios=(1.0, share))
        _draw_waterfall(left, self)
        _draw_ends(right, self)
        figure.suptitle(shortened(self.title, 90), fontsize=palette.FONT_SIZE + 1.0)
        _legend_below(figure, (left,))
        return figure

    def table(self) -> Table:
        head = ("rank", "start", f"error_{column(self.unit)}", "nearly_as_good", "evaluations")
        names = tuple(
            f"{label} [{unit}]" for label, unit in zip(self.labels, self.units, strict=True)
        )
        errors = plain(self.errors)
        rows = [
            (rank, k + 1, errors[k], str(self.good[k]).lower(), self.evaluations[k],
             *self.points[k].tolist())
            for rank, k in enumerate(self.order, 1)
        ]  # fmt: skip
        return Table((*head, *names), rows)


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
    if none.any():
        axes.plot(rank[none], np.full(none.sum(), 0.96), linestyle="none", marker="x",
                  markersize=4.0, color=palette.FORCE, label="found nothing",
                  transform=axes.get_xaxis_transform())  # fmt: skip
    log_scale(axes, "y", shown)
    _room_above(axes, bool(none.any()))
    axes.set_xlim(0.4, len(rank) + 0.6)
    axes.set(xlabel="start, best first", ylabel=f"final error [{written(chart.unit)}]")
    _whole_numbers(axes)
    clean(axes)


def _good(chart: StartsChart) -> Style:
    return {
        "marker": "o",
        "color": palette.BODY,
        "label": f"the best, or within {100 * chart.nearly:g} % of it",
    }


def _other() -> Style:
    return {"marker": "D", "color": palette.PUSHER, "label": "a worse end"}


def _draw_ends(axes: Axes, chart: StartsChart) -> None:
    """Each start a line across the unknowns, as shares of their ranges: ends that differ show."""
    place = np.arange(len(chart.labels))
    shares = (chart.points - chart.low) / (chart.high - chart.low)
    for k in reversed(chart.order):
        if math.isfinite(chart.errors[k]):
            style = _good(chart) if chart.good[k] else _other()
            axes.plot(
                place,
                shares[k],
                color=style["color"],
                marker=style["marker"],
                markersize=2.8,
                linewidth=1.0 if chart.good[k] else 0.5,
                alpha=0.9 if chart.good[k] else 0.6,
                zorder=3 if chart.good[k] else 2,
            )
    names = []
    for label, unit, low, high in zip(
        chart.labels, chart.units, chart.low.tolist(), chart.high.tolist(), strict=True
    ):
        own = readable(unit)
        ends = f"{own.text(low)} … {own.text(high)} {own.name}".rstrip()
        names.append(f"{_broken(label)}\n{ends}")
    axes.set_xticks(place, names)
    if len(names) > 6:
        axes.tick_params(axis="x", rotation=60, labelsize=palette.FONT_SIZE - 1.5)
    axes.set_xlim(-0.4, len(place) - 0.6)
    axes.set_ylim(-0.04, 1.04)
    axes.set_ylabel("place between the bounds")
    clean(axes)


def _broken(label: str) -> str:
    """A label over two lines where it says for whom it is."""
    return label.replace("[", "\n[", 1)


# --- experiments --------------------------------------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorsChart(AbstractChart):
    """Error of every experiment, before and after, the worst first.

    Parameters
    ----------
    keys : sequence of str
    series : mapping of str to (n,) float64
        Errors by what they are with; inf where there is none. The last one sorts.
    unit : str
    """

    keys: Sequence[str]
    series: Mapping[str, FloatArray]
    unit: str

    @property
    def order(self) -> list[int]:
        """Experiments from the worst to the best."""
        last = list(self.series.values())[-1]
        return [int(k) for k in np.argsort(-last, kind="stable")]

    def figure(self) -> Figure:
        n = len(self.keys)
        named = n <= MOST_NAMES
        figure = sheet(WIDE, max(1.5, 0.75 + 0.135 * n) if named else 3.2)
        axes = figure.subplots()
        _draw_errors(axes, self, named)
        _legend_below(figure, (axes,))
        return figure

    def table(self) -> Table:
        unit = column(self.unit)
        columns = ("experiment", *(f"{_column_name(name)}_{unit}" for name in self.series))
        values = [plain(errors) for errors in self.series.values()]
        return Table(columns, [(self.keys[k], *(own[k] for own in values)) for k in self.order])


def _column_name(name: str) -> str:
    return name.replace(" ", "_").replace(",", "")


def _draw_errors(axes: Axes, chart: ErrorsChart, named: bool) -> None:
    """With names, rows from above to below; without, from left to right."""
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
    for row, (name, errors), style in zip(table, chart.series.items(), MARKS, strict=False):
        label = _with_median(name, errors, chart.unit)
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
    """Experiments without a simulation, at the far end."""
    if not len(place):
        return
    far = np.full(len(place), 0.995)
    pair = (far, place) if named else (place, far)
    transform = axes.get_yaxis_transform() if named else axes.get_xaxis_transform()
    axes.plot(*pair, linestyle="none", marker="x", markersize=4.0, color=style["color"],
              transform=transform, clip_on=False)  # fmt: skip


def _with_median(name: str, errors: FloatArray, unit: str) -> str:
    good = errors[np.isfinite(errors)]
    lost = len(errors) - len(good)
    if not len(good):
        return f"{name}: no simulation"
    median = f"{float(np.median(good)):.3g} {written(unit)}"
    text = f"{name}: {median}" if len(good) == 1 else f"{name}: median {median}"
    return text + (f"; × {lost} without a simulation" if lost else "")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SecondsChart(AbstractChart):
    """How long calibrations took.

    Source: RPI thesis, figure 5.4.

    Parameters
    ----------
    keys : sequence of str
        Of the experiments.
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
        bins = min(MOST_BARS, max(4, math.ceil(2.0 * math.sqrt(n))))
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
        """Round bins from zero would hide what differs; equal times still get a width."""
        low, high = float(self.seconds.min()), float(self.seconds.max())
        return (low, high) if high > 1.001 * low else (0.5 * low, 1.5 * high or 1.0)

    @staticmethod
    def _text(seconds: float) -> str:
        return f"{seconds / 3600.0:.3g} h" if seconds >= 7200.0 else f"{seconds:.3g} s"

    def table(self) -> Table:
        columns = ("experiment", "seconds", "evaluations")
        rows = zip(self.keys, self.seconds.tolist(), self.evaluations, strict=True)
        return Table(columns, list(rows))
