"""Charts of a calibration's parameters: intervals within their bounds, and profiles."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark, Style
from fixel.model.records import Estimate, ProfileRecord, interval_name
from fixel.table import Table
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW: Final = 0.42  # [inch], height of the row of a parameter
COLUMNS: Final = 4  # maximum number of profiles side by side
NOISE_ALONE: Final = "interval from noise alone"
# Profiles are drawn up to this multiple of the threshold.
SHOWN: Final = 3.0

IDENTIFIED: Final = "identified"
# Styles of further sets of parameters, without intervals.
OTHERS: Final[tuple[Style, ...]] = (
    {"marker": "D", "color": palette.TOUCHED},
    {"marker": "^", "color": palette.CONE},
    {"marker": "s", "color": palette.PUSHER},
)


def parameters_chart(
    title: str,
    rows: Sequence[Estimate],
    others: Mapping[str, Sequence[float]] | None = None,
    level: float | None = 0.95,
) -> Chart:
    """Draw values and intervals, one row per parameter, each scaled to its bounds.

    Estimates have the bounds of the search and the values before. At most three `others` are drawn,
    by name, each with a value per row. The level is None if it is unknown.
    """
    others = others or {}
    columns = ("parameter", "unit", "bound_low", "bound_high", "before", "value",
               "interval_low", "interval_high", "noise_value", "noise_low", "noise_high",
               "verdict", *others)  # fmt: skip
    return Chart(
        size=(chart.WIDE, 0.85 + ROW * len(rows)),
        fill=lambda figure: _draw_rows(figure, title, rows, others, level),
        data=Table(columns, [
            (row.label, row.unit, *_bounds(row), row.before, row.value, row.low, row.high,
             row.noise_value, row.noise_low, row.noise_high, row.verdict,
             *(own[k] for own in others.values()))
            for k, row in enumerate(rows)
        ]),
    )  # fmt: skip


def _draw_rows(
    figure: Figure,
    title: str,
    rows: Sequence[Estimate],
    others: Mapping[str, Sequence[float]],
    level: float | None,
) -> None:
    width = 0.72 if any(row.is_assessed for row in rows) else 0.22
    axes, words = figure.subplots(1, 2, width_ratios=(1.0, width), sharey=True)
    for k, row in enumerate(rows):
        _draw_row(axes, k, row, [own[k] for own in others.values()])
        _write_row(words, k, row)
    words.set_xlim(0.0, width)
    axes.set(xlim=(-0.03, 1.03), ylim=(len(rows) - 0.4, -0.6), xticks=[])
    axes.set_yticks(range(len(rows)), [chart.broken(row.label) for row in rows])
    axes.tick_params(axis="y", length=0.0)
    axes.spines[:].set_visible(False)
    axes.set_title(chart.shorten(title, 60), loc="left")
    words.axis("off")
    entries = _entries(rows, others, level)
    columns = len(entries) if len(entries) < 5 else 3
    chart.legend_of(figure, entries, columns, loc="outside lower left")


def _entries(
    rows: Sequence[Estimate], others: Mapping[str, Sequence[float]], level: float | None
) -> list[Any]:
    from matplotlib.lines import Line2D

    styles: list[Style] = [{"label": "value", **_dot(palette.BODY, "o")}]
    if any(row.is_assessed for row in rows):
        label = f"{interval_name(level)}; an arrow: unbounded by the data"
        styles.append({"color": palette.BODY, "linewidth": 3.0, "alpha": 0.4, "label": label})
    if any(row.noise_alone for row in rows):
        styles.append({"color": palette.BODY, "linewidth": 1.2, "label": NOISE_ALONE})
    styles.append({"linestyle": "none", "marker": "|", "markersize": 7, "color": palette.INK,
                   "label": "before"})  # fmt: skip
    styles += [
        {"label": name, **_dot(style["color"], style["marker"], hollow=True)}
        for name, style in zip(others, OTHERS, strict=False)
    ]
    return [Line2D([], [], **style) for style in styles]


def _dot(colour: str, marker: str, hollow: bool = False) -> Style:
    return {
        "linestyle": "none",
        "marker": marker,
        "markersize": 5.0,
        "color": colour,
        "markerfacecolor": "none" if hollow else colour,
        "markeredgewidth": 0.9,
    }


def _bounds(row: Estimate) -> tuple[float, float]:
    assert row.bounds is not None
    return row.bounds


def _draw_row(axes: Axes, k: int, row: Estimate, others: Sequence[float]) -> None:
    low, high = _bounds(row)

    def share(value: float) -> float:
        return (value - low) / (high - low)

    axes.plot([0.0, 1.0], [k, k], color=palette.FAINT, linewidth=1.2, zorder=1)
    for end in (0.0, 1.0):
        axes.plot([end, end], [k - 0.12, k + 0.12], color=palette.FIXEL, linewidth=0.8, zorder=1)
    unit = displayed(row.unit)
    small: Style = {"fontsize": palette.FONT_SIZE - 1.5, "color": palette.FIXEL, "va": "top"}
    axes.text(0.0, k + 0.16, unit.text(low), ha="left", **small)
    axes.text(1.0, k + 0.16, f"{unit.text(high)} {unit.name}".rstrip(), ha="right", **small)
    if row.is_assessed:
        colour = _colour(row.verdict)
        if (narrow := row.noise_alone) is not None:
            at = [share(low if narrow.low is None else narrow.low),
                  share(high if narrow.high is None else narrow.high)]  # fmt: skip
            axes.plot(at, [k + 0.13, k + 0.13], color=colour, linewidth=1.2, zorder=4)
        ends = [0.0 if row.low is None else share(row.low)]
        ends.append(1.0 if row.high is None else share(row.high))
        axes.plot(ends, [k, k], color=colour, alpha=0.4, linewidth=5.0, solid_capstyle="butt",
                  zorder=2)  # fmt: skip
        for end, known, marker in ((ends[0], row.low, "<"), (ends[1], row.high, ">")):
            if known is None:
                axes.plot([end], [k], marker=marker, markersize=5.0, color=colour, zorder=2.5)
    if row.before is not None:
        axes.plot([share(row.before)], [k], marker="|", markersize=10, color=palette.INK, zorder=3)
    for value, style in zip(others, OTHERS, strict=False):
        dot = _dot(style["color"], style["marker"], hollow=True)
        axes.plot([share(value)], [k], zorder=6, **dot)
    colour = _colour(row.verdict) if row.is_assessed else palette.BODY
    axes.plot([share(row.value)], [k], zorder=5, **_dot(colour, "o"))


def _colour(verdict: str) -> str:
    """Colour of a verdict: blue if identified, purple if it trades off with others or is effective
    for this model only, else vermilion."""
    if verdict in ("", IDENTIFIED):
        return palette.BODY
    return palette.CONE if verdict.startswith(("trades off", "effective")) else palette.FORCE


def _write_row(axes: Axes, k: int, row: Estimate) -> None:
    axes.text(0.0, k, row.text(row.value), weight="bold", va="center")
    if not row.is_assessed:
        return
    axes.text(0.18, k, _wrapped(row.interval_text), va="center")
    axes.text(0.42, k, _wrapped(row.verdict), va="center", color=_colour(row.verdict))


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, 24)[:3])


def profiles_chart(
    title: str,
    profiles: Sequence[ProfileRecord],
    estimates: Mapping[str, Estimate],
    level: float | None = 0.95,
) -> Chart:
    """Draw the rise of the deviance against the value, one profile per parameter.

    Estimates by label have the values and intervals. The level is None if it is unknown.
    """
    n = len(profiles)
    columns = min(n, COLUMNS) if n != 5 else 3
    every = [_profile(own, estimates[own.label], interval_name(level), k % columns == 0)
             for k, own in enumerate(profiles)]  # fmt: skip
    rows = chart.in_rows(every, columns)
    wide = columns > 2
    head = ("parameter", "unit", "curve", "value", "rise", "threshold",
            "interval_low", "interval_high", "noise_low", "noise_high")  # fmt: skip
    entries = [
        (own.label, own.unit, name, value, rise, own.threshold,
         *_ends(estimates[own.label]), own.low, own.high)
        for own in profiles
        for name, values, rises in (
            ("profile", own.values, own.deviances),
            ("slice", own.slice_values, own.slice_deviances),
        )
        for value, rise in zip(values, rises, strict=True)
    ]  # fmt: skip
    return Chart(
        title=title,
        size=(
            chart.WIDE if wide else palette.COLUMN * columns,
            (0.55 if wide else 0.75) + 1.75 * len(rows),
        ),
        fill=chart.panels(rows, 4 if wide else 2),
        data=Table(head, entries),
    )


def _ends(estimate: Estimate) -> tuple[float | None, float | None]:
    return estimate.low, estimate.high


def _profile(own: ProfileRecord, estimate: Estimate, interval: str, first: bool) -> Mark:
    unit = displayed(own.unit)
    left, right = _range(own, estimate)
    bands = [(estimate, palette.TRAIL, interval)]
    if (narrow := estimate.noise_alone) is not None:
        bands.append((narrow, palette.BODY, NOISE_ALONE))
    marks = []
    for one, colour, name in bands:
        ends = (left if one.low is None else one.low, right if one.high is None else one.high)
        marks.append(
            chart.vspan(*(unit.factor * np.array(ends)), color=colour, alpha=0.25, linewidth=0.0,
                        label=name)
        )  # fmt: skip
    if estimate.is_known:
        value = unit.factor * estimate.value
        marks.append(chart.vline(value, color=palette.INK, linewidth=1.0, label="value"))
    marks.append(
        chart.hline(1.0, color=palette.INK, linewidth=0.7, linestyle=(0, (1, 1)), label="threshold")
    )
    for values, rises, style in (
        (own.slice_values, own.slice_deviances, _SLICE),
        (own.values, own.deviances, _PROFILE),
    ):
        known = np.isfinite(rises)
        marks.append(chart.line(unit.factor * values[known], rises[known] / own.threshold, **style))
    return chart.panel(
        *marks,
        lambda axes: axes.locator_params(axis="x", nbins=4),
        xlim=(unit.factor * left, unit.factor * right),
        ylim=(0.0, SHOWN),
        xlabel=unit.on(own.label),
        ylabel="increase of the deviance\nover its threshold" if first else "",
    )


_SLICE: Final[Style] = {
    "color": palette.PUSHER,
    "linewidth": 1.0,
    "linestyle": chart.DASHED,
    "label": "others fixed",
}
_PROFILE: Final[Style] = {
    "color": palette.BODY,
    "linewidth": 1.2,
    "marker": "o",
    "markersize": 2.0,
    "label": "profile, others fitted",
}


def _range(profile: ProfileRecord, estimate: Estimate) -> tuple[float, float]:
    """Range of values to show: where the profile is low, and the estimate with its interval."""
    left, right = _low_range(profile)
    known = [x for x in (estimate.value, *_ends(estimate)) if x is not None]
    margin = 0.04 * (max(right, *known) - min(left, *known))
    return min(left, min(known) - margin), max(right, max(known) + margin)


def _low_range(profile: ProfileRecord) -> tuple[float, float]:
    """Range where the profile is low, and one more value on either side."""
    near = np.flatnonzero(profile.deviances <= SHOWN * profile.threshold)
    if not len(near):
        return float(profile.values[0]), float(profile.values[-1])
    first, last = max(0, near[0] - 1), min(len(profile.values) - 1, near[-1] + 1)
    left, right = _cut(profile, first, near[0]), _cut(profile, last, near[-1])
    if left == right:
        right, left = right + 1e-3, left - 1e-3
    margin = 0.04 * (right - left)
    return left - margin, right + margin


def _cut(profile: ProfileRecord, outer: int, inner: int) -> float:
    """Value between two others at which the profile exceeds the axes, so that far ones are cut."""
    a, b = float(profile.values[inner]), float(profile.values[outer])
    rise, far = float(profile.deviances[inner]), float(profile.deviances[outer])
    if outer == inner or not np.isfinite(far):
        return a if outer == inner else b
    share = (SHOWN * profile.threshold - rise) / (far - rise)
    return a + (b - a) * min(1.0, max(0.0, share))
