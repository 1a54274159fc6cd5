"""Figures of tracked motion: its quality against time, and true paths next to tracked ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, Chart, Style, clean, save_figure, sheet
from fixel.drawing.top_view import closed_line
from fixel.model import placed, pose_error
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.vision.tracking.tracked import FilmTracks, PartTrack

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = (palette.BODY, palette.PUSHER, palette.CONE, palette.TOUCHED)
HEIGHT: Final = 5.2  # [inch]
ROW: Final = 2.0  # [inch], height of a run
OUTLINES: Final = 4  # number of outlines of the object along its path
ROOM: Final = 5.0  # [mm], margin around all that is drawn


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
    figure = sheet(WIDE, HEIGHT)
    panels = figure.subplots(4, 1, sharex=True)
    micro = _is_small(tracked)
    unit, factor = ("µm", 1e6) if micro else ("mm", 1e3)
    zero = tracked.time[0]
    for part, colour in zip(tracked.parts.values(), COLOURS, strict=False):
        _part(panels, part, colour, zero, factor)
    labels = (f"x [{unit}]", f"y [{unit}]", "θ [deg]", "residual [px]")
    for axes, label in zip(panels, labels, strict=True):
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
    time, out = part.time - zero, part.seen & ~part.good
    pose = part.pose * (factor, factor, np.degrees(1.0))
    for axes, column in zip(panels, pose.T, strict=False):
        shown = np.where(part.good, column, np.nan)
        axes.plot(time, shown, color=colour, linewidth=0.9, label=part.name)
        axes.plot(time[out], column[out], "x", color=palette.FORCE, markersize=3)
    panels[3].plot(time, part.residual, color=colour, linewidth=0.7)
    for first, last, _ in part.gaps:
        for axes in panels:
            axes.axvspan(first - zero, last - zero, color=colour, alpha=0.15, linewidth=0)


def _is_small(tracked: FilmTracks) -> bool:
    places = [part.pose[part.good, :2] for part in tracked.parts.values() if part.good.any()]
    return bool(places) and max(float(np.ptp(own, axis=0).max()) for own in places) < 5e-3


class TrackedRun(NamedTuple):
    """True and tracked poses of one run, frame by frame."""

    name: str
    outline: FloatArray  # (k, 2) outline of the object, in its own frame [m]
    fixels: Sequence[FloatArray]  # outlines of the fixels [m]
    time: FloatArray  # (n,) times of the frames [s]
    true: FloatArray  # (n, 3) poses of the object [m, m, rad]
    tracked: FloatArray  # (n, 3) poses of the object [m, m, rad]

    @property
    def position_error(self) -> FloatArray:
        """Distance between tracked and true positions, (n,) [m]."""
        return pose_error(self.tracked, self.true)[0]

    @property
    def angle_error(self) -> FloatArray:
        """Angles from true to tracked poses, (n,) [rad]."""
        return pose_error(self.tracked, self.true)[1]


def side_by_side(runs: Sequence[TrackedRun]) -> Chart:
    """Draw true and tracked paths and the distance between them, one row per run."""

    def fill(figure: Figure) -> None:
        grid = figure.subplots(len(runs), 3, squeeze=False, width_ratios=(1.0, 1.0, 1.15))
        for axes, title in zip(grid[0], ("true", "tracked", "tracked - true"), strict=True):
            axes.set_title(title)
        for axes, run in zip(grid, runs, strict=True):
            _from_above(axes[0], run, run.true, palette.INK)
            _from_above(axes[1], run, run.tracked, palette.BODY)
            _apart(axes[2], run)
            axes[0].set_ylabel(f"{run.name}\ny [mm]")
        for axes, label in zip(grid[-1], ("x [mm]", "x [mm]", "time [s]"), strict=True):
            axes.set_xlabel(label)

    columns: dict[str, Any] = {"run": [run.name for run in runs for _ in run.time],
                               "time_s": np.concatenate([run.time for run in runs])}  # fmt: skip
    for name in ("true", "tracked"):
        poses = np.concatenate([getattr(run, name) for run in runs])
        columns |= {f"{name}_{k}": poses[:, j] for j, k in enumerate(("x_m", "y_m", "angle_rad"))}
    return Chart(size=(WIDE, ROW * len(runs)), fill=fill, data=Table.from_columns(columns))


def _from_above(axes: Axes, run: TrackedRun, poses: FloatArray, colour: str) -> None:
    for fixel in run.fixels:
        axes.fill(*(1e3 * fixel.T), color=palette.FIXEL, linewidth=0.0)
    for k in np.linspace(0, len(poses) - 1, OUTLINES).astype(int):
        line: Style = {"color": colour, "linewidth": 0.9, "alpha": 1.0 if k else 0.5}
        axes.plot(*closed_line(placed(run.outline, poses[k])), **line)
    axes.plot(*(1e3 * poses[:, :2].T), color=palette.FORCE, linewidth=1.0)
    everything = np.vstack([placed(run.outline, pose) for pose in run.true] + [*run.fixels])
    low, high = 1e3 * everything.min(0) - ROOM, 1e3 * everything.max(0) + ROOM
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    clean(axes)


def _apart(axes: Axes, run: TrackedRun) -> None:
    axes.plot(run.time, 1e3 * run.position_error, color=palette.BODY, linewidth=0.8, label="mm")
    degrees = np.degrees(np.abs(run.angle_error))
    axes.plot(run.time, degrees, color=palette.PUSHER, linewidth=0.8, label="deg")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, ncols=2, loc="upper right")
    clean(axes)
