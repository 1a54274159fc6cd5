"""Figure of the measured and predicted spread of repeated pushes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, AbstractChart, clean, legend_below, log_scale, sheet
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class RepeatPoint(NamedTuple):
    """Group of repetitions; spreads are (2,): position [m] and angle [rad]."""

    name: str
    kind: str
    measured: FloatArray
    median: FloatArray
    least: FloatArray
    limit: FloatArray


@final
@dataclass(frozen=True)
class RepeatPicture(AbstractChart):
    """Predicted range and measured spread, one row per group."""

    groups: Sequence[RepeatPoint]

    def figure(self) -> Figure:
        figure = sheet(WIDE, 0.7 + 0.145 * len(self.groups))
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, k, label, factor in (
            (left, 0, "spread of end positions [mm]", 1e3),
            (right, 1, "spread of end angles [deg]", math.degrees(1.0)),
        ):
            _panel(axes, self.groups, k, factor)
            axes.set_xlabel(label)
        left.set_yticks(range(len(self.groups)), [group.name for group in self.groups])
        left.invert_yaxis()
        legend_below(figure, [left])
        return figure

    def table(self) -> Table:
        names = ("measured", "median", "least", "limit")
        columns = tuple(f"{n}_{unit}" for n in names for unit in ("m", "rad"))
        return Table(
            ("group", "kind", *columns),
            [
                (g.name, g.kind, *(float(x) for n in names for x in getattr(g, n)))
                for g in self.groups
            ],
        )


def _panel(axes: Axes, groups: Sequence[RepeatPoint], k: int, factor: float) -> None:
    place = np.arange(len(groups))
    least, median, limit, measured = (
        factor * np.array([getattr(group, name)[k] for group in groups])
        for name in ("least", "median", "limit", "measured")
    )
    inside = measured <= limit
    bar = "predicted, 95 %"
    axes.hlines(place, least, limit, color=palette.TRAIL, linewidth=4.0, alpha=0.6, label=bar)
    axes.plot(median, place, "|", color=palette.BODY, markersize=6.0, label="its median")
    axes.plot(
        measured[inside], place[inside], "o", color=palette.INK, markersize=3.5, label="measured"
    )
    if not inside.all():
        axes.plot(
            measured[~inside], place[~inside], "X", color=palette.FORCE, markersize=5.0,
            label="measured, wider than predicted",
        )  # fmt: skip
    log_scale(axes, "x", np.concatenate((least, limit, measured)))
    clean(axes)
