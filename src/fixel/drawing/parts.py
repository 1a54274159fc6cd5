"""Charts of parts that have hardly been pushed: errors of left-out parts, proposed pushes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, AbstractChart, clean, legend_below, plot_axes, sheet, tint
from fixel.drawing.top_view import closed_line
from fixel.drawing.view import unit_for
from fixel.parts.model import PartModel
from fixel.parts.next_pushes import NextPushes
from fixel.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDE: Final = 3.6  # [inch]
ARROW: Final = 0.3  # largest length of an arrow, as a share of the part


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOutChart(AbstractChart):
    """Mean errors of parts that were left out, on every surface.

    Parameters
    ----------
    title : str
    model : PartModel
    """

    title: str
    model: PartModel

    def figure(self) -> Figure:
        left = self.model.left_out
        names = list(dict.fromkeys(left.group))
        figure = sheet(WIDE, 0.9 + 0.2 * len(names), self.title)
        place = np.arange(len(names))
        row = figure.subplots(1, 2, sharey=True, squeeze=False)[0]
        for axes, values, unit in zip(row, self._means().T, ("mm", "deg"), strict=True):
            axes.barh(place, values, 0.62, color=palette.BODY)
            mean = float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
            axes.axvline(mean, color=palette.INK, linewidth=1.0, label="mean of the groups")
            what = "position" if unit == "mm" else "angle"
            axes.set_xlabel(f"mean error of the {what} [{unit}]")
            clean(axes)
        row[0].set_yticks(place, names)
        row[0].invert_yaxis()
        legend_below(figure, row[:1])
        return figure

    def _means(self) -> np.ndarray:
        """Mean errors (n_group, 2) [mm], [deg] of the pushes whose simulations ended."""
        left = self.model.left_out
        group = np.array(left.group)
        rows = []
        for name in dict.fromkeys(left.group):
            own = left.errors[group == name]
            own = own[np.isfinite(own).all(axis=1)]
            rows.append(own.mean(axis=0) if len(own) else np.full(2, np.nan))
        return np.array(rows).reshape(-1, 2) * (1e3, np.degrees(1.0))

    def table(self) -> Table:
        names = list(dict.fromkeys(self.model.left_out.group))
        means = self._means() / (1e3, np.degrees(1.0))
        return Table.from_columns(
            {"left_out": names, "position_m": means[:, 0], "angle_rad": means[:, 1]}
        )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class NextPushesChart(AbstractChart):
    """Outline of a part with the proposed pushes as numbered arrows.

    Parameters
    ----------
    title : str
    pushes : NextPushes
    """

    title: str
    pushes: NextPushes

    def figure(self) -> Figure:
        from matplotlib.patches import Circle

        own = self.pushes
        figure = sheet(SIDE, SIDE, self.title)
        axes = figure.subplots()
        size = float(np.ptp(own.outline, axis=0).max())
        unit = unit_for(size)
        line = closed_line(own.outline, unit)
        axes.fill(*line, color=tint(palette.BODY, 0.25), linewidth=0.0)
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
                       facecolor=tint(palette.PUSHER, 0.5), linewidth=0.0)
            )  # fmt: skip
            axes.plot(*tail, ".", alpha=0.0)  # so that the limits include the numbers
        axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=6.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        axes.set(xlabel=f"x of the part [{unit.name}]", ylabel=f"y of the part [{unit.name}]")
        axes.spines[["top", "right"]].set_visible(False)
        return figure

    def table(self) -> Table:
        own = self.pushes
        return Table.from_columns(
            {
                "push": np.arange(len(own.order)) + 1,
                "start_x_m": own.start[:, 0],
                "start_y_m": own.start[:, 1],
                "end_x_m": own.end[:, 0],
                "end_y_m": own.end[:, 1],
                "expected_ratio_of_bound": own.shrinking,
            }
        )


def draw_errors(model: PartModel, *, ax: Axes | None = None) -> Any:
    """Draw the mean errors of parts that were left out, after as many of their pushes."""
    n = model.left_out.pushes
    when = f"after {n} of their pushes" if n else "before any of their pushes"
    title = f"Parts that were left out, {when}"
    return plot_axes(LeftOutChart(title=title, model=model).figure, ax)


def draw_next(pushes: NextPushes, *, ax: Axes | None = None) -> Any:
    """Draw the outline of a part with the proposed pushes as numbered arrows."""
    return plot_axes(NextPushesChart(title="Next pushes", pushes=pushes).figure, ax)
