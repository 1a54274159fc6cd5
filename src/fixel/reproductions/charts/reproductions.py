"""Figures of reproductions: supports found and machined, paths of a trial, clusters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    PICTURE_ENDINGS,
    AbstractChart,
    draw_chart,
    refuse_ending,
    save_filled,
    tint,
)
from fixel.model import placed
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDE = 2.0 * palette.COLUMN + 0.2  # width of a figure over two columns [inch]
COLOURS = (palette.BODY, palette.TOUCHED, palette.CONE, palette.FORCE, palette.TRAIL)


class SupportPanel(NamedTuple):
    """Machined and found points (3, 2) of one support, in the frame of the block [m]."""

    name: str
    outline: FloatArray  # (n, 2)
    machined: FloatArray
    from_poses: FloatArray
    from_forces: FloatArray  # from poses and forces


class SupportPicture(NamedTuple):
    """Figure of several supports, side by side."""

    panels: Sequence[SupportPanel]


class PathCurve(NamedTuple):
    """Motion of an object, with its distance from the measured one."""

    label: str
    pose: FloatArray  # (n, 3)
    error: FloatArray  # (n,) [m]; empty for the measurement


class PathPicture(NamedTuple):
    """Figure of a trial, measured and simulated."""

    outline: FloatArray  # (n, 2) in the frame of the object [m]
    time: FloatArray  # (n,) [s]
    curves: Sequence[PathCurve]  # the measured one first
    fixels: FloatArray  # (n, 2) [m]
    fixel_radius: float
    actuator_outline: FloatArray
    actuator: FloatArray  # (n, 3)


class TriangleCluster(NamedTuple):
    """Cluster of support triangles that pushes cannot distinguish."""

    label: str
    points: FloatArray  # (k, 3, 2) [m]
    shares: FloatArray  # (k, 3) shares of the load


class ClusterPicture(NamedTuple):
    """Figure of clusters side by side, each with the true support."""

    outline: FloatArray
    truth: FloatArray  # (3, 2)
    clusters: Sequence[TriangleCluster]


Picture = SupportPicture | PathPicture | ClusterPicture | AbstractChart


def draw(picture: Picture, file: str | Path) -> None:
    """Draw a reproduction to a file.

    Parameters
    ----------
    picture : SupportPicture, PathPicture, ClusterPicture or AbstractChart
    file : str or Path
        File to write (`.pdf`, `.png` or `.svg`).
    """
    if isinstance(picture, AbstractChart):
        draw_chart(picture, file)
        return
    refuse_ending(file, PICTURE_ENDINGS, "picture")
    save_filled(lambda figure: _fill(figure, picture), file)


def _fill(figure: Figure, picture: SupportPicture | PathPicture | ClusterPicture) -> None:
    if isinstance(picture, SupportPicture):
        _supports(figure, picture)
    elif isinstance(picture, PathPicture):
        _paths(figure, picture)
    else:
        _clusters(figure, picture)


def _closed(outline: FloatArray, per_metre: float = 1e3) -> FloatArray:
    return np.asarray(np.vstack((outline, outline[:1])).T * per_metre)


def _clean(axes: Axes, unit: str = "mm") -> None:
    axes.set_aspect("equal")
    axes.margins(0.06)
    axes.set(xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    axes.spines[["top", "right"]].set_visible(False)


def _supports(figure: Figure, picture: SupportPicture) -> None:
    n = len(picture.panels)
    figure.set_size_inches(WIDE, WIDE / max(n, 2) + 0.25)
    row = figure.subplots(1, n, squeeze=False, sharey=True)[0]
    for axes, panel in zip(row, picture.panels, strict=True):
        axes.fill(*_closed(panel.outline), color=tint(palette.BODY, 0.12))
        axes.plot(*_closed(panel.outline), color=palette.BODY, linewidth=0.8)
        for points, colour, marker, label in (
            (panel.machined, palette.INK, "s", "machined"),
            (panel.from_poses, palette.PUSHER, "o", "from poses"),
            (panel.from_forces, palette.FORCE, "^", "from poses and forces"),
        ):
            axes.plot(*_closed(points), color=colour, linewidth=0.5, alpha=0.5)
            axes.plot(*(points.T * 1e3), marker, color=colour, markersize=4.0, linestyle="none",
                      markerfacecolor="none" if marker == "s" else colour, label=label)  # fmt: skip
        axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=6.0, label="centre of mass")
        axes.set_title(panel.name, loc="left")
        _clean(axes)
    for axes in row[1:]:
        axes.set_ylabel("")
    handles, labels = row[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=4, loc="outside lower center")


def _paths(figure: Figure, picture: PathPicture) -> None:
    figure.set_size_inches(WIDE, 3.3)
    top, errors = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    measured = picture.curves[0].pose
    top.fill(*_closed(placed(picture.outline, measured[0])), color=palette.FAINT, label="start")
    colours = (palette.INK, *COLOURS)
    for curve, colour in zip(picture.curves, colours, strict=False):
        width = 1.4 if colour == palette.INK else 1.0
        end = _closed(placed(picture.outline, curve.pose[-1]))
        top.plot(*end, color=colour, linewidth=width, label=curve.label)
        top.plot(*(curve.pose[:, :2].T * 1e3), color=colour, linewidth=width)
        if len(curve.error):
            errors.plot(picture.time, curve.error * 1e3, color=colour, linewidth=1.1)
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = picture.fixel_radius * 1e3 * np.array([np.cos(turn), np.sin(turn)])
    for number, centre in enumerate(picture.fixels * 1e3, 1):
        top.fill(*(ring + centre[:, None]), color=palette.FIXEL)
        top.annotate(f"fixel {number}", centre, (0.0, -12.0), ha="center",
                     textcoords="offset points")  # fmt: skip
    for pose, style in ((picture.actuator[0], (0, (3, 2))), (picture.actuator[-1], "-")):
        outline = _closed(placed(picture.actuator_outline, pose))
        top.plot(*outline, color=palette.PUSHER, linewidth=0.8, linestyle=style)
    _clean(top)
    errors.set(xlabel="time [s]", ylabel="distance from the measured pose [mm]", ylim=(0.0, None))
    errors.grid(color=palette.FAINT, linewidth=0.4)
    errors.spines[["top", "right"]].set_visible(False)
    handles, labels = top.get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")


def _clusters(figure: Figure, picture: ClusterPicture) -> None:
    n = max(len(picture.clusters), 1)
    columns = min(n, 5)
    rows = -(-n // columns)
    figure.set_size_inches(WIDE, 2.55 * rows + 0.2)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, cluster in zip(panels.ravel(), picture.clusters, strict=False):
        axes.fill(*_closed(picture.outline, 1e6), color=tint(palette.BODY, 0.10))
        axes.plot(*_closed(picture.outline, 1e6), color=palette.BODY, linewidth=0.8)
        axes.plot(*_closed(picture.truth, 1e6), color=palette.INK, linewidth=1.0,
                  linestyle=(0, (3, 2)), label="p1*, which made the data")  # fmt: skip
        for points, share in zip(cluster.points, cluster.shares, strict=True):
            axes.plot(*_closed(points, 1e6), color=palette.FORCE, linewidth=0.6, alpha=0.6)
            axes.scatter(*(points.T * 1e6), s=60.0 * share + 0.5, color=palette.FORCE, alpha=0.7,
                         linewidths=0.0, label="found, area by load")  # fmt: skip
        axes.plot(0.0, 0.0, "+", color=palette.INK, markersize=5.0, label="centre of mass")
        axes.set_title(cluster.label, loc="left")
        _clean(axes, "µm")
    for axes in panels.ravel()[n:]:
        axes.set_visible(False)
    for axes in panels[:, 1:].ravel():
        axes.set_ylabel("")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        unique.values(), unique.keys(), frameon=False, ncols=3, loc="outside lower center"
    )
