"""Quality of tracking: poses, residuals and gaps against time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import save_figure
from fixel.vision.tracking.tracked import FilmTracks, PartTrack

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (palette.BODY, palette.PUSHER, palette.CONE, palette.TOUCHED)
HEIGHT = 5.2  # [inch]


def draw_track(
    tracked: FilmTracks, path: str | Path, effective: tuple[float, float] | None = None
) -> None:
    """Draw tracked poses and residuals against time, with gaps shaded.

    Parameters
    ----------
    tracked : FilmTracks
    path : str or Path
        File to write (`.pdf`, `.svg` or `.png`).
    effective : (float, float), optional
        First and last time of useful data, counted from the first frame [s].
    """
    save_figure(lambda: track_figure(tracked, effective), path)


def track_figure(tracked: FilmTracks, effective: tuple[float, float] | None = None) -> Figure:
    """Create the figure that `draw_track` saves."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.0 * palette.COLUMN, HEIGHT), layout="constrained")
    panels = figure.subplots(4, 1, sharex=True)
    micro = _is_small(tracked)
    unit, factor = ("µm", 1e6) if micro else ("mm", 1e3)
    zero = tracked.time[0]
    for part, colour in zip(tracked.parts.values(), COLOURS, strict=False):
        _part(panels, part, colour, zero, factor)
    for axes, label in zip(
        panels,
        (f"x [{unit}]", f"y [{unit}]", "θ [deg]", "residual [px]"),
        strict=True,
    ):
        axes.set_ylabel(label)
        axes.spines[["top", "right"]].set_visible(False)
        for instant in effective or ():
            axes.axvline(instant, color=palette.INK, linewidth=0.5, linestyle=(0, (3, 2)))
    panels[3].set_ylim(bottom=0.0)
    panels[3].set_xlabel("time [s]; dashed: effective start and end; shaded: no pose")
    panels[0].legend(loc="upper left", frameon=False, ncols=4)
    figure.align_ylabels(panels)
    return figure


def _part(panels: Any, part: PartTrack, colour: str, zero: float, factor: float) -> None:
    time = part.time - zero
    pose = np.where(part.good[:, None], part.pose, np.nan) * (factor, factor, np.degrees(1.0))
    for axes, column in zip(panels, pose.T, strict=False):
        axes.plot(time, column, color=colour, linewidth=0.9, label=part.name)
    out = part.seen & ~part.good
    for axes, column, scale in zip(
        panels, part.pose.T, (factor, factor, np.degrees(1.0)), strict=False
    ):
        axes.plot(time[out], scale * column[out], "x", color=palette.FORCE, markersize=3)
    panels[3].plot(time, part.residual, color=colour, linewidth=0.7)
    for first, last, _ in part.gaps:
        for axes in panels:
            axes.axvspan(first - zero, last - zero, color=colour, alpha=0.15, linewidth=0)


def _is_small(tracked: FilmTracks) -> bool:
    places = [part.pose[part.good, :2] for part in tracked.parts.values() if part.good.any()]
    return bool(places) and max(float(np.ptp(own, axis=0).max()) for own in places) < 5e-3
