"""Curves of the observed coverage of bounds against their stated probability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from fixel.drawing import palette
from fixel.drawing.chart import AbstractChart, clean, sheet
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class CoveragePanel(NamedTuple):
    """Curve of coverage; shares are between 0 and 1."""

    title: str
    levels: FloatArray  # (n,) stated probabilities
    held: FloatArray  # (n,) observed shares within the bounds
    low: FloatArray  # (n,) lower end of the share by chance, if the levels are true
    high: FloatArray  # (n,) its upper end
    groups: FloatArray  # (n_group, n) observed in each group; empty for one group
    outcomes: int


class CoverageChart(AbstractChart):
    """Coverage curves side by side."""

    def __init__(self, panels: Sequence[CoveragePanel], title: str = "") -> None:
        self._panels, self._title = tuple(panels), title

    def figure(self) -> Figure:
        n = len(self._panels)
        figure = sheet(0.1 + 2.6 * n, 2.9, self._title)
        _fill(figure, self._panels)
        return figure

    def table(self) -> Table:
        rows: list[tuple[str | float | int | None, ...]] = []
        for panel in self._panels:
            told = zip(panel.levels, panel.held, panel.low, panel.high, strict=True)
            rows += [(panel.title, *map(float, row), panel.outcomes) for row in told]
        return Table(
            ("bounds", "promised", "held", "true_levels_from", "true_levels_to", "outcomes"), rows
        )


def _fill(figure: Figure, panels: Sequence[CoveragePanel]) -> None:
    row = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axes, panel in zip(row, panels, strict=True):
        _panel(axes, panel)
    row[0].set_ylabel("outcomes held [%]")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=2, loc="outside lower center")


def _panel(axes: Axes, panel: CoveragePanel) -> None:
    levels = 100.0 * panel.levels
    axes.plot((0, 100), (0, 100), color=palette.INK, linewidth=0.7, linestyle=(0, (4, 2)),
              label="as promised")  # fmt: skip
    axes.fill_between(levels, 100.0 * panel.low, 100.0 * panel.high, color=palette.TRAIL,
                      alpha=0.35, linewidth=0.0, label="chance alone, 95 %")  # fmt: skip
    for k, own in enumerate(panel.groups):
        axes.plot(levels, 100.0 * own, color=palette.FIXEL, linewidth=0.5, alpha=0.6,
                  label="single groups" if k == 0 else None)  # fmt: skip
    axes.plot(levels, 100.0 * panel.held, color=palette.FORCE, linewidth=1.2, marker="o",
              markersize=2.5, label="held")  # fmt: skip
    axes.set(xlim=(0, 100), ylim=(0, 100), xlabel="level promised [%]")
    axes.set_title(f"{panel.title}, {panel.outcomes} outcomes", fontsize=palette.FONT_SIZE)
    axes.set_aspect("equal")
    clean(axes)
