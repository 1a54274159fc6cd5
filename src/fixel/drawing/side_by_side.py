"""Tracked and true paths of runs, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, AbstractChart, clean, sheet
from fixel.model import placed, pose_error
from fixel.table import Table, Value
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW: Final = 2.0  # [inch], height of a run
OUTLINES: Final = 4  # number of outlines of the object along its path
ROOM: Final = 5.0  # [mm], margin around all that is drawn


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TrackedRun:
    """True and tracked poses of one run, frame by frame.

    Attributes
    ----------
    name : str
    outline : (k, 2) float64
        Outline of the object, in its own frame [m].
    fixels : sequence of (k, 2) float64
        Outlines of the fixels [m].
    time : (n,) float64
        Times of the frames [s].
    true, tracked : (n, 3) float64
        Poses of the object [m, m, rad].
    """

    name: str
    outline: FloatArray
    fixels: Sequence[FloatArray]
    time: FloatArray
    true: FloatArray
    tracked: FloatArray

    @property
    def position_error(self) -> FloatArray:
        """Distance between tracked and true positions, (n,) [m]."""
        return pose_error(self.tracked, self.true)[0]

    @property
    def angle_error(self) -> FloatArray:
        """Angles from true to tracked poses, (n,) [rad]."""
        return pose_error(self.tracked, self.true)[1]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SideBySide(AbstractChart):
    """True and tracked paths and the distance between them, one row per run."""

    runs: tuple[TrackedRun, ...]

    def figure(self) -> Figure:
        figure = sheet(WIDE, ROW * len(self.runs))
        grid = figure.subplots(len(self.runs), 3, squeeze=False, width_ratios=(1.0, 1.0, 1.15))
        for axes, title in zip(grid[0], ("true", "tracked", "tracked less true"), strict=True):
            axes.set_title(title)
        for axes, run in zip(grid, self.runs, strict=True):
            _from_above(axes[0], run, run.true, palette.INK)
            _from_above(axes[1], run, run.tracked, palette.BODY)
            _apart(axes[2], run)
            axes[0].set_ylabel(f"{run.name}\ny [mm]")
        for axes in grid[-1, :2]:
            axes.set_xlabel("x [mm]")
        grid[-1, 2].set_xlabel("time [s]")
        return figure

    def table(self) -> Table:
        columns = ("run", "time_s", *(f"{who}_{k}" for who in ("true", "tracked") for k in _POSE))
        rows: list[tuple[Value, ...]] = [
            (run.name, time, *true, *tracked)
            for run in self.runs
            for time, true, tracked in zip(
                run.time.tolist(), run.true.tolist(), run.tracked.tolist(), strict=True
            )
        ]
        return Table(columns, rows)


_POSE: Final = ("x_m", "y_m", "angle_rad")


def _from_above(axes: Axes, run: TrackedRun, poses: FloatArray, colour: str) -> None:
    for fixel in run.fixels:
        axes.fill(*(1e3 * fixel.T), color=palette.FIXEL, linewidth=0.0)
    for k in np.linspace(0, len(poses) - 1, OUTLINES).astype(int):
        corners = 1e3 * placed(run.outline, poses[k])
        style: dict[str, Any] = {"color": colour, "linewidth": 0.9}
        axes.plot(*np.vstack((corners, corners[:1])).T, alpha=1.0 if k else 0.5, **style)
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
