"""Convergence of searches for support points: trails in the part, errors and simplex sizes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, log_scale, sheet, tint
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT: Final = 3.4  # [inch]
UM: Final = 1e6
_COLOURS: Final = (palette.BODY, palette.FORCE, palette.TOUCHED, palette.PUSHER)
_DASHES: Final = ("-", (0, (4, 2)), (0, (1, 1)), (0, (6, 2, 1, 2)))


class BestSoFar(NamedTuple):
    """Best point of a search after each of its steps."""

    label: str
    evaluations: IntArray  # (n,)
    error: FloatArray  # (n,) [mm]
    size: FloatArray  # (n,) size of the simplex, in scales
    points: FloatArray  # (n, 3, 2) support points [m]
    friction: FloatArray  # (2,) coefficients of probe and plane, at the end


def convergence_figure(
    outline: FloatArray, truth: FloatArray, descents: Sequence[BestSoFar]
) -> Figure:
    """Draw trails of the support points in the part, next to error and simplex size.

    Parameters
    ----------
    outline : (n, 2) float64
        Outline of the part [m].
    truth : (3, 2) float64
        Support points that generated the data [m].
    descents : sequence of BestSoFar
    """
    page = sheet(WIDE, HEIGHT)
    n = len(descents)
    grid = page.add_gridspec(2, n + 2)
    for k, one in enumerate(descents):
        axes = page.add_subplot(grid[:, k])
        _trails(axes, outline, truth, one)
        if k:
            axes.set_ylabel("")
    above, below = page.add_subplot(grid[0, n:]), page.add_subplot(grid[1, n:])
    for one, colour, dash in zip(descents, _COLOURS, _DASHES, strict=False):
        for axes, values in ((above, 1e3 * one.error), (below, one.size)):
            axes.plot(one.evaluations, values, color=colour, linestyle=dash, linewidth=1.0,
                      label=one.label)  # fmt: skip
    above.set_ylabel("F of the best [µm]")
    below.set_ylabel("size of the simplex [scales]")
    below.set_xlabel("evaluations")
    log_scale(above, "y", 1e3 * np.concatenate([one.error for one in descents]))
    log_scale(below, "y", np.concatenate([one.size for one in descents]))
    for axes in (above, below):
        axes.grid(color=palette.FAINT, linewidth=0.4)
    above.legend(frameon=False)
    handles, labels = page.axes[0].get_legend_handles_labels()
    page.legend(handles, labels, frameon=False, ncols=4, loc="outside lower center")
    return page


def _trails(axes: Axes, outline: FloatArray, truth: FloatArray, one: BestSoFar) -> None:
    closed = np.vstack((outline, outline[:1])) * UM
    axes.fill(*closed.T, color=tint(palette.BODY, 0.10))
    axes.plot(*closed.T, color=palette.BODY, linewidth=0.8)
    made = np.vstack((truth, truth[:1])) * UM
    axes.plot(*made.T, color=palette.INK, linewidth=0.8, linestyle=(0, (3, 2)),
              label="p1*, which made the data")  # fmt: skip
    last = np.vstack((one.points[-1], one.points[-1, :1])) * UM
    axes.plot(*last.T, color=palette.FORCE, linewidth=0.7, alpha=0.6)
    for corner in range(3):
        trail = one.points[:, corner] * UM
        axes.plot(*trail.T, color=palette.FORCE, linewidth=0.7, label="way of a support point")
        axes.plot(*trail[0], "o", color=palette.FORCE, markerfacecolor="white", markersize=3.5,
                  label="at first")  # fmt: skip
        axes.plot(*trail[-1], "^", color=palette.FORCE, markersize=4.5, label="at the end")
        if corner == 0:
            continue
        for line in axes.lines[-3:]:
            line.set_label(f"_{line.get_label()}")
    axes.set_aspect("equal")
    axes.set_title(one.label, loc="left")
    axes.set_xlabel("x [µm]")
    axes.set_ylabel("y [µm]")
