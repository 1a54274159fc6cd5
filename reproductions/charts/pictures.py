"""Figures of reproductions and benchmarks, each drawn in an empty figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import sheet, tint
from fixel.drawing.top_view import closed_line
from fixel.drawing.view import UNITS
from fixel.model import Scene, placed
from fixel.replay.base import SHOWN, WIDE, hide_spines, label_fixels
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fixel.replay.base import Row
    from reproductions.result import HeldOutScores

MICRONS: Final = UNITS[0]
COLOURS: Final = (palette.BODY, palette.TOUCHED, palette.CONE, palette.FORCE, palette.TRAIL)

# Colour and marker of each model of a benchmark.
MODELS: Final = {
    "published": (palette.PUSHER, "s"),
    "uncalibrated": (palette.FIXEL, "o"),
    "calibrated": (palette.BODY, "D"),
}
# Colour of the calibrated curve of each protocol.
SHADES: Final = (palette.BODY, palette.TOUCHED, palette.CONE, palette.TRAIL, palette.FORCE)
# Share marked by a thin line in the distributions: the median.
HALF: Final = 0.5


def _top_view(axes: Axes, unit: str = "mm") -> None:
    axes.set_aspect("equal")
    axes.margins(0.06)
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    hide_spines(axes)


def supports_figure(outline: FloatArray, supports: Mapping[str, Sequence[FloatArray]]) -> Figure:
    """Draw supports side by side in the outline (n, 2) of the block [m].

    Parameters
    ----------
    supports : mapping from name to three (3, 2) float64
        Machined points, and those found from poses, and from poses and forces [m].
    """
    n = len(supports)
    figure = sheet(WIDE, WIDE / max(n, 2) + 0.25)
    row = figure.subplots(1, n, squeeze=False, sharey=True)[0]
    for axes, (name, found) in zip(row, supports.items(), strict=True):
        axes.fill(*closed_line(outline), color=tint(palette.BODY, 0.12))
        axes.plot(*closed_line(outline), color=palette.BODY, linewidth=0.8)
        for points, (colour, marker, label) in zip(
            found,
            (
                (palette.INK, "s", "machined"),
                (palette.PUSHER, "o", "from poses"),
                (palette.FORCE, "^", "from poses and forces"),
            ),
            strict=True,
        ):
            axes.plot(*closed_line(points), color=colour, linewidth=0.5, alpha=0.5)
            axes.plot(*(points.T * 1e3), marker, color=colour, markersize=4.0, linestyle="none",
                      markerfacecolor="none" if marker == "s" else colour, label=label)  # fmt: skip
        axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=6.0, label="centre of mass")
        axes.set_title(name, loc="left")
        _top_view(axes)
    for axes in row[1:]:
        axes.set_ylabel("")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=4, loc="outside lower center")
    return figure


def paths_figure(
    scene: Scene,
    time: FloatArray,
    measured: FloatArray,
    curves: Mapping[str, FloatArray],
    actuator: FloatArray,
) -> Figure:
    """Draw a trial from above, measured and simulated, and the distances from the measured poses.

    Parameters
    ----------
    time : (n,) float64
        Times of the poses [s].
    measured : (n, 3) float64
        Measured poses of the object [m, m, rad].
    curves : mapping from label to (n, 3) float64
        Simulated poses.
    actuator : (2, 3) float64
        First and last pose of the actuator.
    """
    figure = sheet(WIDE, 3.3)
    top, errors = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    outline = scene.bodies[0].shape.outline
    top.fill(*closed_line(placed(outline, measured[0])), color=palette.FAINT, label="start")
    colours = (palette.INK, *COLOURS)
    for (label, pose), colour in zip(
        {"measured": measured, **curves}.items(), colours, strict=False
    ):
        width = 1.4 if colour == palette.INK else 1.0
        top.plot(
            *closed_line(placed(outline, pose[-1])), color=colour, linewidth=width, label=label
        )
        top.plot(*(pose[:, :2].T * 1e3), color=colour, linewidth=width)
        if pose is not measured:
            error = np.hypot(*(pose - measured)[:, :2].T)
            errors.plot(time, error * 1e3, color=colour, linewidth=1.1)
    label_fixels(top, scene.fixels, -12.0)
    for pose, style in zip(actuator, ((0, (3, 2)), "-"), strict=True):
        corners = closed_line(placed(scene.pushers[0].shape.outline, pose))
        top.plot(*corners, color=palette.PUSHER, linewidth=0.8, linestyle=style)
    _top_view(top)
    errors.set(xlabel="time [s]", ylabel="distance from the measured pose [mm]", ylim=(0.0, None))
    errors.grid(color=palette.FAINT, linewidth=0.4)
    hide_spines(errors)
    handles, labels = top.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")
    return figure


def clusters_figure(
    outline: FloatArray, truth: FloatArray, clusters: Mapping[str, tuple[FloatArray, FloatArray]]
) -> Figure:
    """Draw clusters of support triangles side by side, each with the true support (3, 2) [m].

    Parameters
    ----------
    clusters : mapping from label to pair of arrays
        Points (k, 3, 2) of the triangles [m], and shares (k, 3) of the load.
    """
    n = max(len(clusters), 1)
    columns = min(n, 5)
    rows = -(-n // columns)
    figure = sheet(WIDE, 2.55 * rows + 0.2)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (title, found) in zip(panels.ravel(), clusters.items(), strict=False):
        axes.fill(*closed_line(outline, MICRONS), color=tint(palette.BODY, 0.10))
        axes.plot(*closed_line(outline, MICRONS), color=palette.BODY, linewidth=0.8)
        axes.plot(*closed_line(truth, MICRONS), color=palette.INK, linewidth=1.0,
                  linestyle=(0, (3, 2)), label="p1*, which made the data")  # fmt: skip
        for points, share in zip(*found, strict=True):
            axes.plot(*closed_line(points, MICRONS), color=palette.FORCE, linewidth=0.6, alpha=0.6)
            axes.scatter(*(points.T * 1e6), s=60.0 * share + 0.5, color=palette.FORCE, alpha=0.7,
                         linewidths=0.0, label="found, area by load")  # fmt: skip
        axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=5.0, label="centre of mass")
        axes.set_title(title, loc="left")
        _top_view(axes, "µm")
    for axes in panels.ravel()[n:]:
        axes.set_visible(False)
    for axes in panels[:, 1:].ravel():
        axes.set_ylabel("")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        unique.values(), unique.keys(), frameon=False, ncols=3, loc="outside lower center"
    )
    return figure


def benchmark_figure(scored: Sequence[HeldOutScores], rows: Sequence[Row]) -> Figure:
    """Draw held-out errors by group for the first protocol, and distributions for all.

    Parameters
    ----------
    scored : sequence of HeldOutScores
        Scores, one per protocol.
    rows : sequence of dict
        Aggregates of the benchmark.
    """
    protocol = scored[0].protocol if scored else ""
    fine = [row for row in rows if row["protocol"] == protocol and row["shape"] != "all"]
    figure = sheet(WIDE, 2.8 + 0.14 * max(len(fine), 1))
    axes = figure.subplot_mosaic([["groups", "position"], ["groups", "angle"]])
    if scored:
        _groups(axes["groups"], protocol, fine, list(scored[0].position))
    _curves(axes["position"], scored, "position", "position error, held out [mm]")
    _curves(axes["angle"], scored, "angle", "angle error, held out [deg]")
    handles, labels = axes["position"].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower right", ncols=4)
    return figure


def _groups(axes: Axes, protocol: str, rows: Sequence[Row], models: Sequence[str]) -> None:
    """Draw mean errors of the groups, each with a line from the worst model to the best."""
    place = np.arange(len(rows))[::-1]
    shown = [model for model in MODELS if model in models]
    table = np.array(
        [[row[model]["position_mm"]["mean"] for row in rows] for model in shown], np.float64
    )
    axes.hlines(place, table.min(axis=0), table.max(axis=0), color=palette.FAINT, linewidth=1.5)
    for model, mean in zip(shown, table, strict=True):
        colour, marker = MODELS[model]
        axes.plot(mean, place, marker, color=colour, markersize=4.0, label=model)
    axes.set_yticks(place, [f"{row['surface']} {row['shape']}" for row in rows])
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"mean position error, held out, protocol {protocol} [mm]")
    axes.grid(axis="x", color=palette.FAINT, linewidth=0.4)
    axes.legend(
        frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), handletextpad=0.1
    )
    hide_spines(axes)


def _curves(axes: Axes, scored: Sequence[HeldOutScores], what: str, label: str) -> None:
    """Draw cumulative errors: reference models once, then the calibrated one of every protocol."""
    far = 1.0
    first = True
    for own, shade in zip(scored, SHADES, strict=False):
        errors: Mapping[str, FloatArray] = getattr(own, what)
        for model in MODELS if first else ("calibrated",):
            if model not in errors:
                continue
            ordered = np.sort(errors[model][np.isfinite(errors[model])])
            if not len(ordered):
                continue
            calibrated = model == "calibrated"
            axes.step(
                ordered,
                np.arange(1, len(ordered) + 1) / len(ordered),
                where="post",
                linewidth=1.2 if calibrated else 1.0,
                linestyle="-" if calibrated else (0, (4, 1.5)),
                color=shade if calibrated else MODELS[model][0],
                label=own.protocol if calibrated else model,
            )
            far = max(far, float(np.quantile(ordered, SHOWN)))
        first = False
    axes.axhline(HALF, color=palette.FAINT, linewidth=0.8, zorder=0.0)
    axes.set(xlabel=label, ylabel="share of pushes below", xlim=(0.0, far), ylim=(0.0, 1.0))
    axes.grid(color=palette.FAINT, linewidth=0.4)
    hide_spines(axes)
