"""One experiment with two sets of parameters: top view of the plate, and poses against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, Chart, Style, clean, shorten, tint
from fixel.drawing.top_view import FEW_POSES, MAX_OUTLINES, MM, closed_line, frame_axes
from fixel.drawing.view import Rectangle, evenly
from fixel.model import Trajectory, placed
from fixel.model.trajectory import wrapped
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import unit_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DASHED: Final = (0, (4, 1.6))
VIEW: Final = 2.75  # [inch], width of the top view
MIN_RANGE: Final = 0.02  # minimum range of a panel [mm or deg]


class Track(NamedTuple):
    """Poses of the object against time, with their error."""

    time: FloatArray  # (n,) [s]
    pose: FloatArray  # (n, 3) [m, m, rad]
    error: float | None = None  # difference from the measured track, in the chart's unit


class OverlayMotions(NamedTuple):
    """Measured and simulated poses of one experiment, before and after a calibration."""

    outline: FloatArray  # (k, 2) outline of the object, in its own frame [m]
    measured: Track
    before: Track  # shorter where the simulation stopped early
    after: Track
    real: bool  # whether the poses were measured; otherwise they are labelled recorded
    fixels: Sequence[FloatArray]  # outlines of the fixels [m]
    # Outlines of the pusher at start and end [m]; empty without a pusher.
    pusher: Sequence[FloatArray]
    unit: str  # unit of the errors

    @property
    def tracks(self) -> tuple[tuple[str, Track, Style], ...]:
        """Tracks to draw, with names and line styles."""
        return (
            ("measured" if self.real else "recorded", self.measured, _MEASURED),
            ("before", self.before, _BEFORE),
            ("after", self.after, _AFTER),
        )


def overlay_chart(title: str, own: OverlayMotions) -> Chart:
    """Draw measured and simulated poses: top view of the plate, and poses against time.

    Source: RPI thesis, figures 5.2 and 5.3.
    """
    rows = [
        (name, time, *pose)
        for name, track, _ in own.tracks
        for time, pose in zip(track.time, track.pose, strict=True)
    ]
    return Chart(
        title=shorten(title, 100),
        size=(WIDE, 3.3),
        fill=lambda figure: _draw(figure, own),
        data=Table(("curve", "time_s", "x_m", "y_m", "theta_rad"), rows),
    )


def _draw(figure: Figure, chart: OverlayMotions) -> None:
    axes_of = figure.subplot_mosaic(
        [["view", "x", "dx"], ["view", "y", "dy"], ["legend", "theta", "dtheta"]],
        width_ratios=(VIEW, 1.6, 1.6),
    )
    _draw_view(axes_of["view"], chart)
    for prefix, draw in (("", _draw_poses), ("d", _draw_differences)):
        column = [axes_of[prefix + name] for name in ("x", "y", "theta")]
        draw(column, chart)
        _time_axes(column, chart.measured)
        figure.align_ylabels(column)
    axes_of["legend"].axis("off")
    axes_of["legend"].legend(
        *axes_of["view"].get_legend_handles_labels(), loc="center", ncols=2, frameon=False,
        labelspacing=0.35, columnspacing=1.2, handlelength=2.2,
    )  # fmt: skip


# Wide and pale, so that it is visible below a simulation that matches it.
_MEASURED: Final[Style] = {"color": "#9A9A9A", "linewidth": 2.4}
_BEFORE: Final[Style] = {"color": palette.CONE, "linewidth": 1.1, "linestyle": DASHED}
_AFTER: Final[Style] = {"color": palette.BODY, "linewidth": 1.1}


def _draw_view(axes: Axes, chart: OverlayMotions) -> None:
    corners = [*chart.fixels, *chart.pusher]
    for _, track, _ in chart.tracks:
        some = track.pose[evenly(len(track.pose), MAX_OUTLINES)]
        corners += [placed(chart.outline, pose) for pose in some]
    frame_axes(axes, Rectangle.around(np.concatenate(corners)).widened(0.04))
    start: Style = {"facecolor": tint(palette.FIXEL, 0.2), "edgecolor": palette.FIXEL}
    first = placed(chart.outline, chart.measured.pose[0])
    axes.fill(*closed_line(first), label="object, start", linewidth=0.6, linestyle=DASHED, **start)
    for name, track, style in chart.tracks:
        last = placed(chart.outline, track.pose[-1])
        label = f"{name}, end"
        if track.error is not None:
            label += f" ({track.error:.3g} {unit_text(chart.unit)})"
        axes.plot(*closed_line(last), label=label, zorder=4, **style)
        if len(track.time) > FEW_POSES:
            thin = style | {"linewidth": 0.6 * style["linewidth"]}
            axes.plot(*(track.pose[:, :2].T * MM.factor), zorder=3, **thin)
    for k, outline in enumerate(chart.fixels):
        axes.fill(*closed_line(outline), color=palette.INK, zorder=5, linewidth=0.0,
                  label="" if k else "fixel")  # fmt: skip
    for outline, line, label in zip(chart.pusher, (DASHED, "-"), ("start", "end"), strict=False):
        axes.plot(*closed_line(outline), color=palette.PUSHER, linewidth=1.0, linestyle=line,
                  label=f"pusher, {label}", zorder=2)  # fmt: skip


def _draw_poses(panels: Sequence[Axes], chart: OverlayMotions) -> None:
    for _, track, style in chart.tracks:
        turned = np.degrees(np.unwrap(track.pose[:, 2]))
        for axes, values in zip(panels, (*track.pose[:, :2].T * MM.factor, turned), strict=True):
            axes.plot(track.time, values, **style | _dots(track))
    for axes, label in zip(panels, ("x [mm]", "y [mm]", "θ [deg]"), strict=True):
        axes.set_ylabel(label, labelpad=1.0)


def _draw_differences(panels: Sequence[Axes], chart: OverlayMotions) -> None:
    """Draw the deviations of both simulations from the measured poses."""
    for _, track, style in chart.tracks[1:]:
        time, difference = _difference(track, chart.measured)
        if len(time):
            for axes, values in zip(panels, difference.T, strict=True):
                axes.plot(time, values, **style | _dots(chart.measured))
    for axes, label in zip(panels, ("Δx [mm]", "Δy [mm]", "Δθ [deg]"), strict=True):
        axes.axhline(0.0, color=palette.INK, linewidth=0.5, zorder=1)
        axes.set_ylabel(label, labelpad=1.0)
    panels[0].set_title(
        f"simulated - {chart.tracks[0][0]}", loc="right", fontsize=palette.FONT_SIZE, pad=3.0
    )


def _difference(track: Track, measured: Track) -> tuple[FloatArray, FloatArray]:
    """Deviations (n, 3) of a simulation from measured poses [mm, mm, deg], at their times."""
    reached = measured.time <= track.time[-1] + 1e-9
    time, pose = measured.time[reached], measured.pose[reached]
    off = Trajectory(time=track.time, pose=track.pose).at(time) - pose
    return time, np.column_stack((MM.factor * off[:, :2], np.degrees(wrapped(off[:, 2]))))


def _dots(track: Track) -> Style:
    """Style with dots instead of a line, for tracks with only a few poses."""
    few = len(track.time) <= FEW_POSES
    return {"linestyle": "none", "marker": "o", "markersize": 3.5} if few else {}


def _time_axes(panels: Sequence[Axes], measured: Track) -> None:
    end = float(measured.time[-1])
    for axes in panels:
        clean(axes)
        axes.set_xlim(-0.02 * end, 1.02 * end)
        axes.margins(y=0.10)
        low, high = axes.get_ylim()
        if high - low < MIN_RANGE:  # do not magnify rounding errors
            axes.set_ylim(0.5 * (low + high - MIN_RANGE), 0.5 * (low + high + MIN_RANGE))
        axes.locator_params(axis="y", nbins=4, steps=[1, 2, 5, 10])
        axes.tick_params(labelbottom=axes is panels[-1])
    panels[-1].set_xlabel("time [s]", labelpad=1.5)
