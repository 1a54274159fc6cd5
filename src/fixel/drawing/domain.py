"""Maps of the domain of applicability, and its size against the threshold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.domain.cells import CellAxis
from fixel.domain.claim import CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.push_bound import ErrorBound
from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    clean,
    legend_of,
    log_scale,
    plot_axes,
    sheet,
    shorten,
)
from fixel.errors import InvalidInput
from fixel.table import Table
from fixel.typing import FloatArray, IntArray

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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class MapChart(AbstractChart):
    """Small multiples of a map of the domain, with one panel per group; the first 30 are drawn.

    Parameters
    ----------
    domain : DomainMap
    claim : Claim
        Claim that holds in blue cells.
    verdicts : list of list of CellVerdict
        Verdict on every cell of every map.
    across : int
        Index of the axis of the columns.
    up : int, optional
        Index of the axis of the rows; without one, the cells through the nominal are drawn.
    """

    domain: DomainMap
    claim: Claim
    verdicts: list[list[CellVerdict]]
    across: int = 0
    up: int | None = None

    @property
    def grid(self) -> IntArray:
        """Cells (n_row, n_column) to draw, in rows from below."""
        cells = self.domain.cells
        number = {index: c for c, index in enumerate(cells.index)}
        n_up = 1 if self.up is None else len(cells.axes[self.up])
        found = np.zeros((n_up, len(cells.axes[self.across])), np.int64)
        for row, column in np.ndindex(*found.shape):
            index = list(cells.index[cells.nominal])
            index[self.across] = column
            if self.up is not None:
                index[self.up] = row
            found[row, column] = number[tuple(index)]
        return found

    def figure(self) -> Figure:
        groups, axes = self.domain.groups, self.domain.cells.axes
        shown, (n_up, n_across) = groups[:MAX_PANELS], self.grid.shape
        ticks, up_ticks = (
            _ticks(axes[self.across]),
            [""] if self.up is None else _ticks(axes[self.up]),
        )
        columns = min(len(shown), _most_columns(n_up, n_across))
        lines = math.ceil(len(shown) / columns)
        width = WIDE if columns > 1 or n_across > 8 else palette.COLUMN + 0.6
        room = (width - 0.6 - LETTER * max(map(len, up_ticks))) / columns
        longest = max(map(len, ticks))
        upwards = LETTER * (longest + 1) > room / n_across
        side = max(min(0.42, room / n_across), 0.17)
        height = lines * (side * n_up + 0.42) + 0.75 + (LETTER * longest if upwards else 0.0)
        more = f" (and {len(groups) - len(shown)} more)" if len(groups) > len(shown) else ""
        figure = sheet(width, max(height, 1.3), self._heading() + more)
        places = list(range(0, n_across, math.ceil(LINE * n_across / room)))
        for k, panel in enumerate(figure.subplots(lines, columns, squeeze=False).flat):
            if k >= len(shown):
                panel.set_visible(False)
                continue
            last, labelled = k + columns >= len(shown), k % columns == 0 and n_up > 1
            self._draw_panel(panel, k)
            panel.set_yticks(range(n_up), up_ticks if labelled else [""] * n_up)
            panel.set_xticks(places, [ticks[j] if last else "" for j in places],
                             rotation=90 if upwards else 0)  # fmt: skip
            panel.set_xlabel(_label(axes[self.across]) if last else "")
            if labelled and self.up is not None:
                panel.set_ylabel(_label(axes[self.up]))
            title = shorten(shown[k] or "all experiments", int(room / LETTER))
            panel.set_title(title, fontsize=palette.FONT_SIZE, pad=2.5)
        self._legend(figure, len(shown))
        return figure

    def _heading(self) -> str:
        kind = "error" if self.claim.measure == "absolute" else "excess"
        share = f"{100.0 * self.claim.level:g} % of experiments"
        return f"held-out {kind} within τ = {self.claim.text()} for {share}"

    def _draw_panel(self, axes: Axes, g: int) -> None:
        from matplotlib.patches import Rectangle

        grid, counts = self.grid, self.domain.counts[g]
        for (i, j), cell in np.ndenumerate(grid):
            name, count = self.verdicts[g][cell].colour, int(counts[cell])
            style = {"edgecolor": "white", "linewidth": 0.6, **FILLS[name]}
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, **style))
            if count and grid.size <= MAX_LETTERS:
                ink = "white" if name in LIGHT else palette.INK
                axes.text(j, i, str(count), ha="center", va="center", color=ink,
                          fontsize=palette.FONT_SIZE - 1.5)  # fmt: skip
            if cell == self.domain.cells.nominal:
                # Circle a short number; put the mark next to a long one.
                place, size = ((j - 0.38, i + 0.3), 5.0) if count > 99 else ((j, i), 9.0)
                axes.plot(*place, marker="o", markersize=size, markerfacecolor="none",
                          markeredgecolor="white", markeredgewidth=1.1, zorder=5)  # fmt: skip
        _outline(axes, np.isin(grid, self.domain.domains(self.claim)[g]))
        axes.set_xlim(-0.5, grid.shape[1] - 0.5)
        axes.set_ylim(-0.5, grid.shape[0] - 0.5)
        axes.tick_params(length=0.0, pad=1.5)
        axes.spines[:].set_visible(False)

    def _legend(self, figure: Figure, n: int) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        used = {self.verdicts[g][c].colour for g in range(n) for c in self.grid.flat}
        handles: list[Any] = [
            Patch(label=name, **{"edgecolor": "white", **style})
            for name, style in FILLS.items()
            if name in used or name in ("trusted", "doubtful", "not trusted", "no data")
        ]
        ring: Style = {"linestyle": "none", "marker": "o", "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=palette.INK, linewidth=1.6, label="D(τ)"))
        handles.append(Line2D([], [], markeredgecolor=palette.INK, label="nominal", **ring))
        legend_of(figure, handles, 4 if figure.get_figwidth() < 5.0 else len(handles))

    def table(self) -> Table:
        domain, inside = self.domain, self.domain.domains(self.claim)
        error = domain.statistic(self.claim.level)
        head = ("group", "cell", "members", "error", "confidence", "colour", "in_domain", "reason")
        rows = [
            (
                group,
                domain.cells.text(c),
                domain.counts[g, c],
                error[g, c],
                verdict.confidence,
                verdict.colour,
                int(c in inside[g]),
                verdict.reason,
            )
            for g, group in enumerate(domain.groups)
            for c, verdict in enumerate(self.verdicts[g])
        ]
        return Table(head, rows)


def _most_columns(n_up: int, n_across: int) -> int:
    """Number of panels side by side, by the number of cells in one."""
    if n_up == 1:
        return 2 if n_across > 6 else 3
    return max(1, min(COLUMNS, 28 // max(n_across, 4)))


def _label(axis: CellAxis) -> str:
    """Name of an axis with its unit."""
    name = axis.name
    for ending in ("_m_s", "_rad", "_m", "_s"):
        if axis.unit and name.endswith(ending):
            name = name.removesuffix(ending)
            break
    return name.replace("_", " ") + (f" [{axis.unit}]" if axis.unit else "")


def _ticks(axis: CellAxis) -> list[str]:
    if axis.edges:
        return [f"{axis.factor * centre + 0.0:.3g}" for centre in axis.centres]
    return [axis.text(k) for k in range(len(axis))]


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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SizeChart(AbstractChart):
    """Number of cells in D(tau) against the threshold."""

    domain: DomainMap
    claim: Claim

    @property
    def sizes(self) -> FloatArray:
        """Number of cells in D(tau), (n_group, n_threshold)."""
        domain = self.domain
        return np.asarray(domain.curve(self.claim, domain.usual_thresholds.tolist()), np.float64)

    def figure(self) -> Figure:
        figure = sheet(palette.COLUMN + 0.9, 2.7)
        axes = figure.subplots()
        thresholds, sizes, cells = self.domain.usual_thresholds, self.sizes, len(self.domain.cells)
        single = len(sizes) == 1
        for own in sizes:
            axes.step(thresholds, own, where="post", linewidth=0.7, alpha=0.7,
                      color=palette.BODY if single else palette.TRAIL)  # fmt: skip
        if not single:
            axes.step([], [], color=palette.TRAIL, linewidth=0.7, label=f"{len(sizes)} maps")
            axes.step(thresholds, sizes.mean(axis=0), where="post", linewidth=1.6,
                      color=palette.BODY, label="mean")  # fmt: skip
        axes.axvline(self.claim.threshold, color=palette.INK, linewidth=0.8, linestyle=(0, (4, 2)),
                     label="requested τ")  # fmt: skip
        log_scale(axes, "x", thresholds)
        axes.set_ylim(-0.02 * cells, 1.04 * max(float(sizes.max()), 1.0))
        unit = " [mm]" if self.claim.measure == "absolute" else (", share above the smallest error")
        axes.set(xlabel=f"threshold τ{unit}", ylabel=f"cells in D(τ), of {cells}")
        axes.locator_params(axis="y", integer=True)
        axes.legend(frameon=False, loc="upper left")
        clean(axes)
        return figure

    def table(self) -> Table:
        unit = "mm" if self.claim.measure == "absolute" else "share"
        names = [f"cells_{group or 'all'}".replace(" ", "_") for group in self.domain.groups]
        columns = dict(zip(names, self.sizes, strict=True))
        thresholds = self.domain.usual_thresholds
        return Table.from_columns({f"threshold_{unit}": thresholds, **columns})


# --- plots of results ---------------------------------------------------------------------------


def draw_map(found: DomainMap, *, axis: str | None = None, ax: Axes | None = None) -> Any:
    """Draw the verdicts of a map over its axes, or along one of them through the nominal."""
    names = [own.name for own in found.cells.axes]
    if axis is not None and axis not in names:
        raise InvalidInput("axis", found=repr(axis), expected="one of " + ", ".join(names))
    claim = found.claimed
    across = 0 if axis is None else names.index(axis)
    alone = found.cells.arms or len(names) == 1 or axis is not None
    chart = MapChart(
        domain=found,
        claim=claim,
        verdicts=found.verdicts(claim),
        across=across,
        up=None if alone else 1,
    )
    return plot_axes(chart.figure, ax)


def draw_size(found: DomainMap, *, ax: Axes | None = None) -> Any:
    """Draw the number of cells in the domain of applicability against the threshold."""
    return plot_axes(SizeChart(domain=found, claim=found.claimed).figure, ax)


def draw_bounds(found: ErrorBound, *, ax: Axes | None = None) -> Any:
    """Draw held-out errors of end positions against their bounds; those below the line hold."""

    def fill(axes: Axes) -> None:
        data = found.to_dict()
        pairs = zip(data["position"], data["position_bound"], strict=True)
        shown = [
            (1e3 * error, 1e3 * bound)
            for error, bound in pairs
            if isinstance(error, float) and isinstance(bound, float)
        ]
        most = 1.1 * max((bound for _, bound in shown), default=1.0)
        axes.plot([b for _, b in shown], [e for e, _ in shown], ".", color=palette.BODY)
        axes.plot([0.0, most], [0.0, most], color=palette.INK, linewidth=0.8)
        axes.set(xlabel=f"bound, {100.0 * found.level:g} % [mm]", ylabel="held-out error [mm]")
        axes.set(xlim=(0.0, most), ylim=(0.0, None))
        clean(axes)

    if ax is not None:
        fill(ax)
        return ax

    def make() -> Figure:
        figure = sheet(3.5, 2.8, "End position: held-out errors and their bounds")
        fill(figure.subplots())
        return figure

    return plot_axes(make)
