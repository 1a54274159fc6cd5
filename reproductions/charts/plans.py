"""Chart of choices among real pushes: their success, stated probabilities, and coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = dict[str, Any]

MARKS: Final = ((palette.FORCE, "o"), (palette.BODY, "s"), (palette.PUSHER, "D"))
MIN_GOALS: Final = 30  # in a bin that is drawn
TARGET: Final = (84.0, 95.0)  # [%]


def plans_figure(tables: Mapping[str, Sequence[Row]], methods: Mapping[str, str]) -> Figure:
    """Draw success by method, held against stated probability, and conditional coverage.

    Parameters
    ----------
    tables : mapping of str to sequence of mapping
        Tables of the reproduction `plans`.
    methods : mapping of str to str
        Descriptions of the methods by name.
    """
    figure = sheet(WIDE, 5.6)
    above, below = figure.subplots(2, 2)
    _draw_success(above[0], tables["choices"], methods)
    _draw_reliability(above[1], tables["reliability"])
    for axes, by, unit in ((below[0], "motion", "mm"), (below[1], "rotation", "deg")):
        own = [row for row in tables["coverage"] if row["by"] == by]
        _draw_coverage(axes, own, unit, f"fifth of predicted {by}")
    return figure


def _draw_success(axes: Axes, rows: Sequence[Row], methods: Mapping[str, str]) -> None:
    names = [name for name in methods if any(row["method"] == name for row in rows)][::-1]
    for k, size in enumerate(dict.fromkeys((row["mm"], row["deg"]) for row in rows)):
        own = {row["method"]: row for row in rows if (row["mm"], row["deg"]) == size}
        colour, mark = MARKS[k % len(MARKS)]
        axes.errorbar(
            [100.0 * own[name]["success"] for name in names],
            np.arange(len(names)) + 0.18 * (1 - k),
            xerr=[200.0 * own[name]["standard_error"] for name in names],
            fmt=mark, color=colour, markersize=3.5, linewidth=0.8,
            label=f"{size[0]:g} mm, {size[1]:g} deg",
        )  # fmt: skip
    axes.set_yticks(np.arange(len(names)), [_folded(methods[name]) for name in names])
    axes.set_xlabel("feasible goals met [%], 2 standard errors")
    axes.set(xlim=(0, 102), ylim=(-0.6, len(names) - 0.4))
    clean(axes)
    axes.legend(frameon=False, loc="upper left", handletextpad=0.2)


def _draw_reliability(axes: Axes, rows: Sequence[Row]) -> None:
    axes.plot((0, 100), (0, 100), color=palette.INK, linewidth=0.7, linestyle=(0, (4, 2)))
    for k, size in enumerate(dict.fromkeys((row["mm"], row["deg"]) for row in rows)):
        own = [r for r in rows if (r["mm"], r["deg"]) == size and r["goals"] >= MIN_GOALS]
        colour, mark = MARKS[k % len(MARKS)]
        axes.plot(
            [100.0 * row["stated"] for row in own], [100.0 * row["held"] for row in own],
            marker=mark, color=colour, markersize=3.5, linewidth=0.8,
            label=f"{size[0]:g} mm, {size[1]:g} deg",
        )  # fmt: skip
    axes.set(xlim=(0, 100), ylim=(0, 100), ylabel="goals met [%]")
    axes.set_xlabel("stated success probability [%]")
    clean(axes)
    axes.legend(frameon=False, loc="upper left", handletextpad=0.2)


def _draw_coverage(axes: Axes, rows: Sequence[Row], unit: str, label: str) -> None:
    axes.axhspan(*TARGET, color=palette.TRAIL, alpha=0.35, linewidth=0.0)
    axes.axhline(90.0, color=palette.INK, linewidth=0.7, linestyle=(0, (4, 2)))
    for k, name in enumerate(("x", "y", "angle")):
        colour, mark = MARKS[k]
        axes.plot(
            np.arange(len(rows)), [100.0 * row[f"{name}_held"] for row in rows],
            marker=mark, color=colour, markersize=3.5, linewidth=0.8, label=name,
        )  # fmt: skip
    axes.set_xticks(
        np.arange(len(rows)),
        [f"{row[f'from_{unit}']:.0f}-{row[f'to_{unit}']:.0f}" for row in rows],
    )
    axes.set(ylim=(60, 100), ylabel="within 90 % interval [%]", xlabel=f"{label} [{unit}]")
    clean(axes)
    axes.legend(frameon=False, loc="lower right", ncols=2, handletextpad=0.2)


def _folded(text: str) -> str:
    """Return a text on two lines."""
    words = text.split()
    half = (len(words) + 1) // 2
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])
