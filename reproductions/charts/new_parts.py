"""Chart of predictions for plates that were never pushed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, sheet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]

MARKS: Final = {"random": (palette.FIXEL, "o"), "chosen": (palette.BODY, "D")}


def new_parts_figure(errors: Sequence[Row], bounds: Sequence[Row]) -> Figure:
    """Draw errors against the number of pushes, with even pressure and the published simulator.

    Parameters
    ----------
    errors : sequence of mapping
        `model`, `position_mm`, `angle_deg`, and `pushes` for `random` and `chosen`.
    bounds : sequence of mapping
        `pushes`, `rule`, `error`, `typical_mean` and `cautious_mean` of the bounds.
    """
    figure = sheet(WIDE, 3.4)
    panels = figure.subplots(1, 2)
    for axes, error, column in zip(
        panels.tolist(), ("position", "angle"), ("position_mm", "angle_deg"), strict=True
    ):
        unit = column.split("_")[1]
        for name, style in (("even", (0, (4, 2))), ("published", (0, (1, 1.5)))):
            value = next(row[column] for row in errors if row["model"] == name)
            label = "even pressure" if name == "even" else "published simulator"
            axes.axhline(value, color=palette.INK, linewidth=0.8, linestyle=style, label=label)
        for rule, (colour, marker) in MARKS.items():
            rows = [row for row in errors if row["model"] == rule]
            if rows:
                axes.plot([row["pushes"] for row in rows], [row[column] for row in rows], marker,
                          linestyle="-", linewidth=0.8, color=colour, markersize=4,
                          label=f"{rule} pushes")  # fmt: skip
        for kind, fill in (("typical", palette.TOUCHED), ("cautious", "none")):
            rows = [r for r in bounds if r["error"] == error and r["rule"] == "random"]
            axes.plot([row["pushes"] for row in rows], [row[f"{kind}_mean"] for row in rows], "s",
                      color=palette.TOUCHED, markerfacecolor=fill, markersize=4,
                      label=f"90 % bound, {kind}")  # fmt: skip
        axes.set_xlabel("pushes of the new plate")
        axes.set_ylabel(f"{error} [{unit}]")
        axes.set_ylim(0.0)
        clean(axes)
        axes.set_xticks([0, 5, 10, 15, 20])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside upper center")
    return figure
