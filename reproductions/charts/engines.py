"""Chart of where each engine can be trusted, by plate, surface and speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def engines_figure(groups: Sequence[dict[str, Any]]) -> Figure:
    """Draw the share of held-out pushes within 5 mm, by engine and group.

    Parameters
    ----------
    groups : sequence of mapping
        `engine`, `condition`, `surface`, `shape`, `speed_mm_s` and `within_5_mm` of each cell.
    """
    rows = list(dict.fromkeys((own["engine"], own["condition"]) for own in groups))
    columns = list(
        dict.fromkeys((own["surface"], own["shape"], own["speed_mm_s"]) for own in groups)
    )
    share = np.full((len(rows), len(columns)), np.nan)
    for own in groups:
        column = (own["surface"], own["shape"], own["speed_mm_s"])
        share[rows.index((own["engine"], own["condition"])), columns.index(column)] = (
            100.0 * own["within_5_mm"]
        )
    figure = sheet(WIDE, 1.2 + 0.2 * len(rows))
    axes = figure.subplots()
    axes.imshow(share, cmap="RdYlGn", vmin=0.0, vmax=100.0, aspect="auto")
    for (i, j), value in np.ndenumerate(share):
        colour = palette.INK if 20.0 < value < 85.0 else "white"
        axes.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=6, color=colour)
    axes.set_yticks(range(len(rows)), [" ".join(filter(None, row)) for row in rows])
    names = [f"{surface}\n{shape}\n{speed:g} mm/s" for surface, shape, speed in columns]
    axes.set_xticks(range(len(columns)), names, fontsize=6)
    axes.set_title("Held-out pushes within 5 mm [%]", fontsize=8, loc="left")
    axes.tick_params(length=0)
    return figure
