"""Plots of many runs of one scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, display_unit, plot_axes, sheet
from fixel.simulation import BatchResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HEIGHT = 2.0  # [inch]


def plot_ends(runs: BatchResult, *, ax: Axes | None = None, body: str | None = None) -> Any:
    """Draw histograms of the end poses of a body over many runs.

    Parameters
    ----------
    runs : BatchResult
        Runs; those that stopped early are left out.
    ax : None
        Axes cannot be given: the plot has three.
    body : str, optional
        Name of the body; the first one by default.

    Returns
    -------
    (3,) array of matplotlib.axes.Axes
        Histograms of x, y and angle.
    """
    name = body or runs.names[0]
    ends = runs[runs.converged][name].final

    def make() -> Figure:
        figure = sheet(WIDE, HEIGHT, f"{name} at the end of {len(ends.x)} runs")
        for axes, label, values, unit in zip(
            figure.subplots(1, 3), ("x", "y", "angle"), ends, ("m", "m", "rad"), strict=True
        ):
            shown = display_unit(unit)
            axes.hist(np.asarray(values) * shown.factor, bins="auto", color=palette.BODY)
            axes.set_xlabel(shown.on(label))
            clean(axes)
        figure.axes[0].set_ylabel("runs")
        return figure

    return plot_axes(make, ax)
