"""Charts of a calibration's experiments: errors, computing times, values against offsets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import methodcaller
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark, Style
from fixel.progress import time_text
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


def errors_chart(keys: Sequence[str], series: Mapping[str, FloatArray]) -> Chart:
    """Draw the error [mm] of every experiment before and after a calibration, from worst to best.

    There are at most three series (n,) by label; not finite if missing. The last one sets the
    order. Rows of many experiments have no names.
    """
    last = list(series.values())[-1]
    order = np.argsort(-np.where(np.isnan(last), np.inf, last), kind="stable").tolist()
    n, at = len(keys), np.arange(len(keys))
    named = n <= MAX_NAMES
    shown = np.array([chart.positive(errors)[order] for errors in series.values()])
    least, most = np.fmin.reduce(shown), np.fmax.reduce(shown)
    known = np.isfinite(least)
    marks: list[Mark] = [
        methodcaller("hlines", at[known], least[known], most[known], color=palette.FAINT,
                     linewidth=1.4 if named else 0.6, zorder=1)
    ]  # fmt: skip
    styles = (*MARKS[: len(shown) - 1], LAST)
    for row, (name, errors), style in zip(shown, series.items(), styles, strict=True):
        marks += [
            chart.line(row, at, linestyle="none", zorder=3, markersize=3.8 if named else 1.8,
                       markeredgewidth=0.8, label=_with_mean(name, errors), **style),
            chart.mark_missing(at[~np.isfinite(row)], 0.995, "y", color=style["color"],
                               clip_on=False),
        ]  # fmt: skip
    errors_panel = chart.panel(
        *marks,
        log={"x": shown.ravel()},
        rows=_row_names([keys[k] for k in order]) if named else (),
        xlabel="error [mm]",
        ylabel="" if named else f"experiment, worst of {n} first",
        ylim=(n - 0.4, -0.6),
    )
    names = (name.replace(" ", "_").replace(",", "") for name in series)
    columns = ("experiment", *(f"{name}_mm" for name in names))
    return Chart(
        size=(chart.WIDE, max(1.5, 0.75 + 0.135 * n) if named else 3.2),
        fill=chart.panels([[errors_panel]]),
        data=Table(columns, [(keys[k], *(own[k] for own in series.values())) for k in order]),
    )


def _row_names(keys: Sequence[str]) -> list[str]:
    """Return names of experiments, without the dataset if all of them share it."""
    heads = {key.partition("/")[0] for key in keys}
    alike = len(heads) == 1 and all("/" in key for key in keys)
    return [chart.shorten(key.partition("/")[2] if alike else key, 44) for key in keys]


def _with_mean(name: str, errors: FloatArray) -> str:
    good = errors[np.isfinite(errors)]
    lost = len(errors) - len(good)
    if not len(good):
        return f"{name}: no simulation"
    mean, median = float(good.mean()), float(np.median(good))
    both = f"{mean:.3g}" if len(good) == 1 else f"mean {mean:.3g}, median {median:.3g}"
    failed = f"; × {lost} without a simulation" if lost else ""
    return f"{name}: {both} mm{failed}"


def seconds_chart(keys: Sequence[str], seconds: FloatArray, evaluations: Sequence[int]) -> Chart:
    """Draw a histogram of the computing time of calibrations.

    Source: RPI thesis, figure 5.4.
    """
    n, middle = len(seconds), float(np.median(seconds))
    low, high = float(seconds.min()), float(seconds.max())
    # The exact range of times, widened if all times are equal.
    ends = (low, high) if high > 1.001 * low else (0.5 * low, 1.5 * high or 1.0)
    times = chart.panel(
        chart.histogram(seconds, bins=min(MAX_BARS, max(4, math.ceil(2.0 * math.sqrt(n)))),
                        range=ends, color=palette.BODY, edgecolor="white", linewidth=0.5),
        chart.vline(middle, color=palette.INK, linewidth=0.8, linestyle=chart.DASHED),
        title=f"n = {n}, {time_text(seconds.sum())} in all; median {time_text(middle)} (dashed)",
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
    bounds: tuple[float, float] = (0.0, 1.0)  # ends of an axis that is not logarithmic

    @property
    def shown(self) -> FloatArray:
        """Values (n,) in the unit of the axis."""
        factor = displayed(self.unit).factor
        return factor * (chart.positive(self.values) if self.log else self.values)

    @property
    def scale(self) -> dict[str, Any]:
        """Options of panels for the axis of the values."""
        if self.log:
            return {"log": {"y": self.shown}}
        low, high = (displayed(self.unit).factor * end for end in self.bounds)
        margin = 0.05 * (high - low)
        return {"ylim": (low - margin, high + margin)}


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
    series = axes or [OffsetSeries("experiment", "", at, np.asarray(at + 1.0, np.float64))]
    columns = ("experiment", "group", "axis", "offset", "offset_unit",
               *(f"{q.label} [{q.unit}]" for q in quantities))  # fmt: skip
    rows = [
        (keys[m], groups[m], own.name, offset, own.unit, *(q.values[m] for q in quantities))
        for own in series
        for m, offset in zip(own.members, own.offsets, strict=True)
    ]
    n, joined = len(quantities), bool(axes)
    grid = [
        [
            *(_values(own, q, groups, joined, not k, q is quantities[-1])
              for k, own in enumerate(series)),
            _histogram(q, "experiments" if q is quantities[-1] else ""),
        ]
        for q in quantities
    ]  # fmt: skip
    widths = (*(1.0 for _ in series), 0.45)
    return Chart(
        title=title,
        size=(chart.WIDE, 0.7 + (1.05 if n > 1 else 1.7) * n),
        fill=chart.panels(grid, 2, sharex="col", sharey="row", width_ratios=widths),
        data=Table(columns, rows),
    )


def _values(
    own: OffsetSeries, q: Quantity, groups: Sequence[str], joined: bool, first: bool, last: bool
) -> Mark:
    """Panel with every experiment as a dot, joined within a layout, and the mean over layouts.

    Labels are on the first panel of a row and on the last one of a column.
    """
    unit, layouts = displayed(own.unit or "-"), list(dict.fromkeys(groups))
    style: Style = {"linestyle": "-" if joined and len(layouts) <= MAX_LINES else "none",
                    "linewidth": 0.6, "marker": "o", "color": palette.TRAIL,
                    "markersize": 2.6 if len(own.members) < 60 else 1.6}  # fmt: skip
    averaged = joined and len(layouts) > 1
    values, offsets = q.shown[own.members], unit.factor * own.offsets
    marks: list[Mark] = []
    for layout in layouts:
        some = np.array([groups[m] == layout for m in own.members], bool) & np.isfinite(values)
        order = np.flatnonzero(some)[np.argsort(own.offsets[some], kind="stable")]
        label = "experiment" if averaged and layout == layouts[0] else ""
        marks.append(chart.line(offsets[order], values[order], label=label, **style))
    if averaged:
        marks.append(chart.line(*_means(offsets, values, q.log), color=palette.BODY, linewidth=1.4,
                                label="mean over layouts"))  # fmt: skip
    across = f"offset in {own.name.replace('theta', 'θ')}" if joined else own.name
    return chart.panel(
        *marks,
        xlabel=unit.on(across) if last else "",
        ylabel=displayed(q.unit).on(chart.broken(q.label)) if first else "",
        **q.scale,
    )


def _means(offsets: FloatArray, values: FloatArray, log: bool) -> tuple[FloatArray, FloatArray]:
    """Mean at each offset; on a logarithmic axis the geometric mean, robust against outliers."""
    known = np.isfinite(values)
    places = np.unique(offsets[known].round(6))
    at = [values[known & np.isclose(offsets, place, atol=1e-6)] for place in places]
    means = [float(np.exp(np.log(v).mean()) if log else v.mean()) for v in at]
    return places, np.array(means)


def _histogram(q: Quantity, xlabel: str) -> Mark:
    """Panel with a histogram of a quantity, on the axis that the panels of its values share."""

    def draw(axes: Axes) -> None:
        low, high = axes.get_ylim()
        edges = (np.geomspace if q.log else np.linspace)(low, high, BINS + 1)
        axes.hist(q.shown[np.isfinite(q.shown)], bins=edges.tolist(), orientation="horizontal",
                  color=palette.BODY, edgecolor="white", linewidth=0.4)  # fmt: skip
        axes.locator_params(axis="x", nbins=3, integer=True)

    return chart.panel(draw, xlabel=xlabel, **q.scale)
