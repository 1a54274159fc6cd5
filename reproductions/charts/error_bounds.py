"""Charts of error bounds: their coverage by group, and how tight they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, log_scale, positive, sheet
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = dict[str, Any]

BAND: Final = (0.88, 0.92)
MIN_LEVEL: Final = 0.85
NAMES: Final = {
    "position": ("position", palette.BODY, "o"),
    "angle": ("angle", palette.PUSHER, "s"),
    "both": ("both, 35 mm/rad", palette.TOUCHED, "D"),
}


def new_sides_figure(groups: Sequence[Row], level: float) -> Figure:
    """Draw the coverage by group of error bounds for left-out sides and speeds.

    Parameters
    ----------
    groups : sequence of mapping
        `error`, `left_out`, `group`, `blind_coverage` and `bound_coverage` of each group; the last
        two are missing if no push has a bound.
    level : float
    """
    kinds = list(dict.fromkeys((row["left_out"], row["error"]) for row in groups))
    figure = sheet(WIDE, 2.9 * max((len(kinds) + 1) // 2, 1))
    panels = figure.subplots(max((len(kinds) + 1) // 2, 1), 2, squeeze=False).ravel()
    for axes, kind in zip(panels.tolist(), kinds, strict=False):
        rows = [row for row in groups if (row["left_out"], row["error"]) == kind]
        place = np.arange(len(rows))[::-1]
        axes.axvline(level, color=palette.INK, linewidth=0.8, linestyle=(0, (4, 2)))
        for name, colour, fill, label in (
            ("bound_coverage", palette.TOUCHED, palette.TOUCHED, "for a new contact"),
            ("blind_coverage", palette.FIXEL, "none", "blind to the contact"),
        ):
            share = [row.get(name, np.nan) for row in rows]
            axes.plot(share, place, "o", color=colour, markersize=3.5, markerfacecolor=fill,
                      label=label)  # fmt: skip
        axes.set_yticks(place, [row["group"] for row in rows])
        axes.set_xlabel(f"{kind[1]}, new {kind[0]}: share within the bound")
        clean(axes)
        axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.4, 1.0),
                    handletextpad=0.2, columnspacing=1.0)  # fmt: skip
    for axes in panels[len(kinds) :].tolist():
        axes.set_axis_off()
    return figure


def learned_sides_figure(groups: Sequence[Row], limits: Mapping[str, float]) -> Figure:
    """Draw by group how a process on residuals changes the errors on sides never pushed.

    Parameters
    ----------
    groups : sequence of mapping
        `left_out`, `group`, and `change_<unit>` for each unit of the limits.
    limits : mapping of unit to float
        Change that counts as noise.
    """
    figure = sheet(WIDE, 3.2)
    marks = zip(("side", "quarter"), (palette.BODY, palette.FIXEL), ("o", "D"), strict=True)
    panels = figure.subplots(1, len(limits), sharey=True)
    for kind, colour, marker in marks:
        rows = [row for row in groups if row["left_out"] == kind]
        place = np.arange(len(rows))[::-1]
        for axes, unit in zip(panels.tolist(), limits, strict=True):
            axes.plot([row[f"change_{unit}"] for row in rows], place, marker, color=colour,
                      markersize=3.5, markerfacecolor="none", label=f"new {kind}")  # fmt: skip
            axes.set_yticks(place, [row["group"] for row in rows])
    for axes, (unit, limit) in zip(panels.tolist(), limits.items(), strict=True):
        axes.axvline(0.0, color=palette.INK, linewidth=0.8)
        axes.axvline(limit, color=palette.INK, linewidth=0.8, linestyle=(0, (4, 2)),
                     label="largest loss that counts as noise")  # fmt: skip
        axes.set_xlabel(f"error with the process minus that of physics [{unit}]")
        axes.locator_params(axis="x", nbins=5)
        clean(axes)
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, ncols=3,
                  loc="outside upper center")  # fmt: skip
    return figure


def error_bounds_figure(
    groups: Sequence[Row],
    curve: Sequence[Row],
    error: FloatArray,
    bound: FloatArray,
    constant: float,
    level: float,
) -> Figure:
    """Draw error bounds: coverage by group, scatter against errors, histogram, and reliability.

    Parameters
    ----------
    groups : sequence of mapping
        `group`, `coverage`, `coverage_sd_of_counts` and `coverage_constant` of each group.
    curve : sequence of mapping
        `error`, `level` and `coverage` of each point.
    error, bound : (n,) float64
        Error and bound of each counted push [mm].
    constant : float
        Constant bound, without features [mm].
    level : float
    """
    figure = sheet(WIDE, 5.4)
    panels = figure.subplots(2, 2)
    _groups(panels[0, 0], groups, level)
    _scatter(panels[0, 1], error, bound, constant)
    _histogram(panels[1, 0], bound, constant)
    _reliability(panels[1, 1], curve)
    return figure


def _groups(axes: Axes, groups: Sequence[Row], level: float) -> None:
    place = np.arange(len(groups))[::-1]
    axes.axvspan(*BAND, color=palette.FAINT, alpha=0.6, linewidth=0.0)
    axes.axvline(MIN_LEVEL, color=palette.FORCE, linewidth=0.8, linestyle=(0, (4, 2)))
    share = [row["coverage"] for row in groups]
    spread = [row["coverage_sd_of_counts"] for row in groups]
    constant = [row["coverage_constant"] for row in groups]
    axes.errorbar(share, place, xerr=spread, fmt="D", color=palette.TOUCHED, markersize=3.5,
                  linewidth=0.8, label="stated (bar: sd of counts)")  # fmt: skip
    axes.plot(constant, place, "o", color=palette.FIXEL, markersize=3.5,
              markerfacecolor="none", label="constant bound")  # fmt: skip
    axes.set_yticks(place, [row["group"] for row in groups])
    axes.set_xlabel(f"share of pushes within their {100 * level:g} % bound")
    axes.set_ylim(-0.7, len(groups) - 0.3)
    clean(axes)
    axes.legend(frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.4, 1.0),
                handletextpad=0.2, columnspacing=1.0)  # fmt: skip


def _scatter(axes: Axes, error: FloatArray, bound: FloatArray, constant: float) -> None:
    held = error <= bound
    for which, colour, label in (
        (held, palette.BODY, "within the bound"),
        (~held, palette.FORCE, "beyond"),
    ):
        axes.plot(bound[which], positive(error)[which], ".", color=colour,
                  markersize=2.0, alpha=0.5, markeredgewidth=0.0, label=label)  # fmt: skip
    both = np.array([bound.min(), bound.max()])
    axes.plot(both, both, color=palette.INK, linewidth=0.8)
    axes.axhline(constant, color=palette.FIXEL, linewidth=0.8, linestyle=(0, (4, 2)),
                 label="constant bound")  # fmt: skip
    log_scale(axes, "x", bound)
    log_scale(axes, "y", np.quantile(error, [0.005, 1.0]))
    axes.set(xlabel="bound [mm]", ylabel="error, held out [mm]")
    clean(axes)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0),
                handletextpad=0.2, columnspacing=1.0, markerscale=3.0)  # fmt: skip


def _histogram(axes: Axes, bound: FloatArray, constant: float) -> None:
    top = float(np.quantile(bound, 0.995))
    edges = np.linspace(0.0, max(top, 1.1 * constant), 45)
    axes.hist(bound, edges.tolist(), color=palette.BODY, alpha=0.8, label="bounds")
    axes.axvline(float(bound.mean()), color=palette.INK, linewidth=1.0, label="their mean")
    axes.axvline(constant, color=palette.FIXEL, linewidth=1.0, linestyle=(0, (4, 2)),
                 label="constant bound")  # fmt: skip
    axes.set(xlabel="bound [mm]", ylabel="pushes")
    clean(axes)
    axes.legend(frameon=False)


def _reliability(axes: Axes, curve: Sequence[Row]) -> None:
    axes.plot([0.45, 1.0], [0.45, 1.0], color=palette.INK, linewidth=0.8)
    for what, (label, colour, marker) in NAMES.items():
        own = [row for row in curve if row["error"] == what]
        x, y = [row["level"] for row in own], [row["coverage"] for row in own]
        axes.plot(x, y, marker, linestyle="-", linewidth=0.8, color=colour, markersize=3.0,
                  label=label)  # fmt: skip
    axes.set(xlabel="stated probability", ylabel="share of pushes within", xlim=(0.45, 1.0),
             ylim=(0.45, 1.0))  # fmt: skip
    axes.set_aspect("equal", adjustable="box")
    clean(axes)
    axes.legend(frameon=False, loc="lower right")


def rates_figure(rows: Sequence[Row], paper: float, paper_angle: tuple[float, float]) -> Figure:
    """Draw position errors as shares of the motion, and angle errors, next to those of a paper.

    Parameters
    ----------
    rows : sequence of mapping
        `dataset`, `simulator`, `rms_over_motion`, `median_over_motion`, `angle_deg_rms` and
        `angle_deg_median`.
    paper : float
        RMS position error over motion in the paper [-].
    paper_angle : (float, float)
        Range of angle errors in the paper [deg].
    """
    figure = sheet(WIDE, 1.1 + 0.28 * len(rows))
    left, right = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(rows))[::-1]
    for axes, rms, median, factor in (
        (left, "rms_over_motion", "median_over_motion", 100.0),
        (right, "angle_deg_rms", "angle_deg_median", 1.0),
    ):
        axes.plot([factor * row[rms] for row in rows], place, "D", color=palette.BODY,
                  markersize=4.0, label="RMS")  # fmt: skip
        axes.plot([factor * row[median] for row in rows], place, "o", markersize=4.0,
                  color=palette.TRAIL, markerfacecolor="none", label="median")  # fmt: skip
        axes.set_xlim(left=0.0)
        clean(axes)
    left.axvline(100.0 * paper, color=palette.FORCE, linewidth=1.0, linestyle=(0, (4, 2)),
                 label="paper")  # fmt: skip
    right.axvspan(*paper_angle, color=palette.FORCE, alpha=0.2, linewidth=0.0)
    left.set_yticks(place, [_two_lines(row) for row in rows])
    left.set_ylim(-0.6, len(rows) - 0.4)
    left.set_xlabel("position error over motion of the object [%]")
    right.set_xlabel("angle error [deg]")
    figure.legend(*left.get_legend_handles_labels(), frameon=False, ncols=3,
                  loc="outside lower center")  # fmt: skip
    return figure


def _two_lines(row: Row) -> str:
    return f"{row['dataset']}\n{row['simulator'].partition(' (')[0]}"
