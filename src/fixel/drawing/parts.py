"""Charts of pushed parts: errors of left-out parts, proposed pushes, equal pushes on a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import line
from fixel.drawing.top_view import closed_line, plain_view
from fixel.drawing.view import unit_for
from fixel.parts.model import PartModel
from fixel.parts.next_pushes import NextPushes
from fixel.parts.table_check import ELSEWHERE, SPOT, TURNED, TableCheck
from fixel.parts.table_fit import DEVIATION
from fixel.parts.table_map import UNSEEN, TableMap
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE: Final = 3.6  # [inch]
ARROW: Final = 0.3  # largest length of an arrow, as a share of the part


def left_out_chart(model: PartModel) -> chart.Chart:
    """Draw the mean errors of parts that were left out, after as many of their pushes."""
    left = model.left_out
    group, names = np.array(left.group), list(dict.fromkeys(left.group))
    means = np.full((len(names), 2), np.nan)
    for k, name in enumerate(names):
        own = left.errors[group == name]
        own = own[np.isfinite(own).all(axis=1)]  # pushes whose simulations ended
        if len(own):
            means[k] = own.mean(axis=0)
    row: list[chart.Mark] = []
    for what, unit, values in zip(
        ("position", "angle"), ("mm", "deg"), (means * (1e3, np.degrees(1.0))).T, strict=True
    ):
        mean = float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
        row.append(
            chart.panel(
                chart.bars(np.arange(len(names)), values, 0.62, color=palette.BODY),
                chart.vline(mean, color=palette.INK, linewidth=1.0, label="mean of the groups"),
                rows=() if row else names,
                xlabel=f"mean error of the {what} [{unit}]",
            )
        )
    n = left.pushes
    when = f"after {n} of their pushes" if n else "before any of their pushes"
    return chart.Chart(
        title=f"Parts that were left out, {when}",
        size=(chart.WIDE, 0.9 + 0.2 * len(names)),
        fill=chart.panels([row], sharey=True),
        data=Table.from_columns(
            {"left_out": names, "position_m": means[:, 0], "angle_rad": means[:, 1]}
        ),
    )


def next_pushes_chart(pushes: NextPushes, title: str = "Next pushes") -> chart.Chart:
    """Draw the outline of a part with the proposed pushes as numbered arrows."""
    return chart.Chart(
        title=title,
        size=(SIDE, SIDE),
        fill=lambda figure: _draw_pushes(figure, pushes),
        data=Table.from_columns(
            {
                "push": np.arange(len(pushes.order)) + 1,
                "start_x_m": pushes.start[:, 0],
                "start_y_m": pushes.start[:, 1],
                "end_x_m": pushes.end[:, 0],
                "end_y_m": pushes.end[:, 1],
                "expected_ratio_of_bound": pushes.shrinking,
            }
        ),
    )


def _draw_pushes(figure: Figure, own: NextPushes) -> None:
    from matplotlib.patches import Circle

    axes = figure.subplots()
    size = float(np.ptp(own.outline, axis=0).max())
    unit = unit_for(size)
    line = closed_line(own.outline, unit)
    axes.fill(*line, color=chart.tint(palette.BODY, 0.25), linewidth=0.0)
    axes.plot(*line, color=palette.BODY, linewidth=1.2)
    for k, (start, end) in enumerate(zip(own.start, own.end, strict=True), 1):
        way = end - start
        length = float(np.hypot(*way)) or 1.0
        way = way / length
        tip = unit.factor * start
        tail = unit.factor * (start - min(length, ARROW * size) * way)
        axes.annotate(
            "", tip, tail, annotation_clip=False,
            arrowprops={"arrowstyle": "-|>", "color": palette.PUSHER, "linewidth": 1.4,
                        "shrinkA": 7.0, "shrinkB": 0.0},
        )  # fmt: skip
        axes.text(
            float(tail[0]), float(tail[1]), str(k), ha="center", va="center", color=palette.INK
        )
        axes.add_patch(
            Circle(tuple(tip.tolist()), unit.factor * own.radius,
                   facecolor=chart.tint(palette.PUSHER, 0.5), linewidth=0.0)
        )  # fmt: skip
        axes.plot(*tail, ".", alpha=0.0)  # so that the limits include the numbers
    axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=6.0)
    plain_view(axes, unit, " of the part", 0.08)


BINS: Final = 8  # of distance, beyond one spot


def table_chart(check: TableCheck) -> chart.Chart:
    """Draw the differences of equal pushes against distance, by their turn on the table."""
    x, turn, *away = check.pairs.T
    bins = np.digitize(x, np.linspace(SPOT[0], max(x.max(), 2.0 * SPOT[0]), BINS + 1)[:-1])
    kinds = {
        "same orientation": (turn < ELSEWHERE[1], palette.BODY),
        "turned by 90 deg or more": (turn > TURNED, palette.FORCE),
    }
    row = []
    for what, factor, values in zip(
        ("position [mm]", "angle [deg]"), (1e3, np.degrees(1.0)), away, strict=True
    ):
        marks: list[chart.Mark] = []
        for name, (own, colour) in kinds.items():
            points = np.column_stack((1e3 * x, factor * values))
            groups = [points[own & (bins == k)] for k in np.unique(bins[own])]
            means = np.array([group.mean(axis=0) for group in groups]).reshape(-1, 2)
            marks.append(line(*points[own].T, ".", color=chart.tint(colour, 0.4), markersize=2.5))
            marks.append(line(*means.T, "o-", color=colour, markersize=3.5, label=name, zorder=3))
        row.append(chart.panel(*marks, xlabel="distance [mm]", ylabel=f"difference of the {what}"))
    names = ("distance_m", "turn_rad", "position_m", "angle_rad")
    return chart.Chart(
        title="Pushes that are equal in the frame of the part",
        size=(chart.WIDE, 2.6),
        fill=chart.panels([row]),
        data=Table(names, check.pairs.tolist()),
    )


def map_chart(table: TableMap) -> chart.Chart:
    """Draw the map of a table, its standard deviation, and the places of the pushes."""
    places = np.concatenate([own.pose[:, :2] for own in table.own.values()])
    rows = [("node", *row) for row in table._data().rows]
    rows += [("push", x, y, None, None) for x, y in places.tolist()]
    return chart.Chart(
        title=f"Table {table.name}".rstrip(),
        size=(chart.WIDE, 3.7),
        fill=lambda figure: _draw_map(figure, table, places),
        data=Table(("what", "x_m", "y_m", "log_load", "deviation"), rows),
    )


def _draw_map(figure: Figure, table: TableMap, places: FloatArray) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    grid = table.load_map
    n_y, n_x = grid.log_load.shape
    unit = unit_for(float((grid.cell * (n_x, n_y)).max()))
    x, y = (
        unit.factor * (grid.origin[k] + grid.cell[k] * np.arange(n))
        for k, n in enumerate((n_x, n_y))
    )
    # Beyond the places that were seen, the map is hardly more than its prior.
    seen = np.where(table.deviation < UNSEEN * DEVIATION, np.abs(grid.log_load), 0.0)
    most, way = max(float(seen.max()), 0.1), [palette.BODY, "white", palette.FORCE]
    every = (
        ("logarithm of the load factor", grid.log_load, -most, most, way),
        ("its standard deviation", table.deviation, 0.0, DEVIATION, ["white", palette.FIXEL]),
    )
    for axes, (label, values, *ends, own) in zip(figure.subplots(1, 2), every, strict=True):
        look = {"cmap": LinearSegmentedColormap.from_list(label, own), "shading": "gouraud"}
        shown = axes.pcolormesh(x, y, values, vmin=ends[0], vmax=ends[1], rasterized=True, **look)
        if values is table.deviation:  # they would hide the map
            axes.plot(
                *(unit.factor * places.T), ".", color=palette.INK, markersize=1.0, label="push"
            )
        style = {"linestyles": [chart.DASHED], "linewidths": 0.8, "colors": palette.INK}
        axes.contour(x, y, table.deviation, [UNSEEN * DEVIATION], **style)
        axes.plot([], [], linestyle=chart.DASHED, color=palette.INK, label="border of places seen")
        figure.colorbar(shown, ax=axes, location="bottom", shrink=0.7, aspect=30, label=label)
        axes.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]", aspect="equal")
    chart.legend_below(figure, figure.axes[1:2])
