"""Maps of the domain of applicability, and its size against the threshold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    clean,
    log_scale,
    plain,
    sheet,
    shortened,
)
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours differ in lightness too; grey stands for no data.
FILLS: Final[Mapping[str, Style]] = {
    "trusted": {"facecolor": palette.BODY},
    "doubtful": {"facecolor": palette.PUSHER},
    "not trusted": {"facecolor": "#8C2D04"},
    "no data": {"facecolor": "#E8E8E8"},
    "predicted": {"facecolor": "#D6E6F2", "hatch": "////", "edgecolor": palette.BODY},
}
LIGHT: Final = ("trusted", "not trusted")  # cells whose letters are white
COLUMNS: Final = 5
MAX_PANELS: Final = 30
MAX_LETTERS: Final = 400  # maximum number of cells in a panel that shows counts of members
LETTER: Final = 0.62 * palette.FONT_SIZE / 72.0  # [inch], width of a letter
LINE: Final = 1.5 * palette.FONT_SIZE / 72.0  # [inch], distance of lines of text


class Strip(NamedTuple):
    """Labels of one axis of a map."""

    name: str  # with its unit
    ticks: tuple[str, ...]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MapPanel:
    """Map over one or two axes.

    Attributes
    ----------
    title : str
    colour : (n_row, n_column) sequence of sequence of str
        Colour of each cell, a key of `FILLS`; a map over one axis has one row.
    count : (n_row, n_column)
        Number of members in each cell.
    inside : (n_row, n_column)
        Whether each cell belongs to D(tau).
    nominal : (int, int), optional
        Row and column of the nominal cell.
    """

    title: str
    colour: Sequence[Sequence[str]]
    count: Sequence[Sequence[int]]
    inside: Sequence[Sequence[bool]]
    nominal: tuple[int, int] | None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MapChart(AbstractChart):
    """Small multiples of one map, with one panel per group.

    Parameters
    ----------
    across, up : Strip
        Axes of the columns and the rows; the rows have no name in a map over one axis.
    panels : tuple of MapPanel
        Maps; the first 30 are drawn.
    heading : str
        Claim that holds in blue cells.
    rows : sequence of tuple
        Data of the table, one row per cell.
    head : tuple of str
    """

    across: Strip
    up: Strip
    panels: tuple[MapPanel, ...]
    heading: str
    head: tuple[str, ...]
    rows: Sequence[tuple[Any, ...]] = field(default=())

    def figure(self) -> Figure:
        shown = self.panels[:MAX_PANELS]
        columns = min(len(shown), self._columns())
        lines = math.ceil(len(shown) / columns)
        n_up, n_across = len(self.up.ticks), len(self.across.ticks)
        width = WIDE if columns > 1 or n_across > 8 else palette.COLUMN + 0.6
        left = 0.6 + LETTER * _longest(self.up)
        room = (width - left) / columns
        side = min(0.42, room / n_across)
        upwards = LETTER * (_longest(self.across) + 1) > room / n_across
        below = LETTER * _longest(self.across) if upwards else 0.0
        height = lines * (max(side, 0.17) * n_up + 0.42) + 0.75 + below
        figure = sheet(width, max(height, 1.3), self._title(shown))
        table = figure.subplots(lines, columns, squeeze=False)
        for k, axes in enumerate(table.flat):
            if k >= len(shown):
                axes.set_visible(False)
                continue
            last = k + columns >= len(shown)
            _draw_panel(axes, shown[k], self, first=k % columns == 0, last=last)
            places = range(0, n_across, math.ceil(LINE * n_across / room))
            axes.set_xticks(list(places), [self.across.ticks[j] if last else "" for j in places],
                            rotation=90 if upwards else 0)  # fmt: skip
            axes.set_title(shortened(shown[k].title, int(room / LETTER)),
                           fontsize=palette.FONT_SIZE, pad=2.5)  # fmt: skip
        _legend(figure, shown)
        return figure

    def _columns(self) -> int:
        if len(self.up.ticks) == 1:
            return 2 if len(self.across.ticks) > 6 else 3
        longest = max(len(self.across.ticks), 4)
        return max(1, min(COLUMNS, 28 // longest))

    def _title(self, shown: Sequence[MapPanel]) -> str:
        more = len(self.panels) - len(shown)
        return self.heading + (f" (and {more} more)" if more else "")

    def table(self) -> Table:
        return Table(self.head, list(self.rows))


def _draw_panel(axes: Axes, panel: MapPanel, chart: MapChart, *, first: bool, last: bool) -> None:
    from matplotlib.patches import Rectangle

    n_up, n_across = len(chart.up.ticks), len(chart.across.ticks)
    letters = n_up * n_across <= MAX_LETTERS
    for i in range(n_up):
        for j in range(n_across):
            name = panel.colour[i][j]
            style = {"edgecolor": "white", "linewidth": 0.6, **FILLS[name]}
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, **style))
            if letters and panel.count[i][j]:
                ink = "white" if name in LIGHT else palette.INK
                axes.text(j, i, str(panel.count[i][j]), ha="center", va="center", color=ink,
                          fontsize=palette.FONT_SIZE - 1.5)  # fmt: skip
    _outline(axes, np.array(panel.inside, bool))
    if panel.nominal is not None:
        i, j = panel.nominal
        # Circle a short number; put the mark next to a long one.
        crowded = panel.count[i][j] > 99
        place = (j - 0.38, i + 0.3) if crowded else (j, i)
        axes.plot(*place, marker="o", markersize=5.0 if crowded else 9.0, markerfacecolor="none",
                  markeredgecolor="white", markeredgewidth=1.1, zorder=5)  # fmt: skip
    axes.set_xlim(-0.5, n_across - 0.5)
    axes.set_ylim(-0.5, n_up - 0.5)
    axes.tick_params(length=0.0, pad=1.5)
    axes.spines[:].set_visible(False)
    labelled = first and n_up > 1
    axes.set_yticks(range(n_up), [tick if labelled else "" for tick in chart.up.ticks])
    if last:
        axes.set_xlabel(chart.across.name)
    if labelled:
        axes.set_ylabel(chart.up.name)


def _longest(strip: Strip) -> int:
    return max(len(tick) for tick in strip.ticks)


def _outline(axes: Axes, inside: Any) -> None:
    """Draw a line around D(tau), also along the edges of the map."""
    padded = np.pad(inside, 1)
    for i, j in zip(*np.nonzero(padded), strict=True):
        y, x = i - 1.5, j - 1.5
        sides = (
            (padded[i - 1, j], (x, x + 1), (y, y)),
            (padded[i + 1, j], (x, x + 1), (y + 1, y + 1)),
            (padded[i, j - 1], (x, x), (y, y + 1)),
            (padded[i, j + 1], (x + 1, x + 1), (y, y + 1)),
        )
        for covered, across, up in sides:
            if not covered:
                axes.plot(across, up, color=palette.INK, linewidth=1.6, clip_on=False, zorder=4,
                          solid_capstyle="projecting")  # fmt: skip


def _legend(figure: Figure, panels: Sequence[MapPanel]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    used = {name for panel in panels for row in panel.colour for name in row}
    handles: list[Any] = [
        Patch(label=name, **{"edgecolor": "white", **style})
        for name, style in FILLS.items()
        if name in used or name in ("trusted", "doubtful", "not trusted", "no data")
    ]
    ring: Style = {"linestyle": "none", "marker": "o", "markerfacecolor": "none"}
    handles.append(Line2D([], [], color=palette.INK, linewidth=1.6, label="D(τ)"))
    handles.append(Line2D([], [], markeredgecolor=palette.INK, label="nominal", **ring))
    narrow = figure.get_figwidth() < 5.0
    figure.legend(handles=handles, frameon=False, ncols=4 if narrow else len(handles),
                  loc="outside lower center", handlelength=1.4, columnspacing=1.2)  # fmt: skip


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SizeChart(AbstractChart):
    """Number of cells in D(tau) against the threshold.

    Parameters
    ----------
    thresholds : (n,) float64
    sizes : mapping of group to (n,) float64
        Number of cells in D(tau).
    cells : int
        Number of cells in one map.
    threshold : float
        Requested threshold.
    label : str
        Label of the thresholds, with unit.
    column : str
        Name of their column in the table.
    """

    thresholds: FloatArray
    sizes: Mapping[str, FloatArray]
    cells: int
    threshold: float
    label: str
    column: str

    def figure(self) -> Figure:
        figure = sheet(palette.COLUMN + 0.9, 2.7)
        axes = figure.subplots()
        table = np.array(list(self.sizes.values()))
        single = len(table) == 1
        for own in table:
            axes.step(self.thresholds, own, where="post", linewidth=0.7, alpha=0.7,
                      color=palette.BODY if single else palette.TRAIL)  # fmt: skip
        if not single:
            axes.step([], [], color=palette.TRAIL, linewidth=0.7, label=f"{len(table)} maps")
            axes.step(self.thresholds, table.mean(axis=0), where="post", linewidth=1.6,
                      color=palette.BODY, label="their mean")  # fmt: skip
        axes.axvline(self.threshold, color=palette.INK, linewidth=0.8, linestyle=(0, (4, 2)),
                     label="τ asked for")  # fmt: skip
        log_scale(axes, "x", self.thresholds)
        axes.set_ylim(-0.02 * self.cells, 1.04 * max(float(table.max()), 1.0))
        axes.set(xlabel=self.label, ylabel=f"cells in D(τ), of {self.cells}")
        axes.locator_params(axis="y", integer=True)
        axes.legend(frameon=False, loc="upper left")
        clean(axes)
        return figure

    def table(self) -> Table:
        head = (self.column, *(f"cells_{name or 'all'}".replace(" ", "_") for name in self.sizes))
        columns = [plain(np.asarray(own, np.float64)) for own in self.sizes.values()]
        rows = [
            (tau, *(own[k] for own in columns)) for k, tau in enumerate(self.thresholds.tolist())
        ]
        return Table(head, rows)
