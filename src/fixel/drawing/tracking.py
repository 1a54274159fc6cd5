"""Figures of tracked motion, of true paths next to tracked ones, and of a camera's accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, Chart, Style, clean, sheet
from fixel.drawing.top_view import closed_line
from fixel.model import placed, pose_error
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.vision.plane_errors import PlaneErrors
from fixel.vision.tracking.base import FilmTracks, PartTrack

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = (palette.BODY, palette.PUSHER, palette.CONE, palette.TOUCHED)
HEIGHT: Final = 5.2  # [inch]
ROW: Final = 2.0  # [inch], height of a run
OUTLINES: Final = 4  # number of outlines of the object along its path
ROOM: Final = 5.0  # [mm], margin around all that is drawn
LEVELS: Final = 9  # contours of errors


def track_figure(tracked: FilmTracks, effective: tuple[float, float] | None = None) -> Figure:
    """Draw tracked poses and residuals against time, with gaps shaded.

    Useful data are from the first to the last `effective` time, counted from the first frame [s].
    """
    figure = sheet(WIDE, HEIGHT)
    panels = figure.subplots(4, 1, sharex=True)
    places = [part.pose[part.good, :2] for part in tracked.parts.values() if part.good.any()]
    micro = bool(places) and max(float(np.ptp(own, axis=0).max()) for own in places) < 5e-3
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


def camera_error_chart(errors: PlaneErrors) -> Chart:
    """Draw errors of places on the plate in the camera's view, and the coverage by boards."""

    def fill(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_errors(figure, left, errors)
        _draw_seen(figure, right, errors)

    return Chart(
        size=(WIDE, 2.9),
        fill=fill,
        data=Table.from_columns(
            {
                **{name: errors.pixels[..., k].ravel() for k, name in enumerate(("u_px", "v_px"))},
                **{name: errors.places[..., k].ravel() for k, name in enumerate(("x_m", "y_m"))},
                "height_m": np.full(errors.camera.size, errors.height),
                "camera_95_m": errors.camera.ravel(),
                "with_noise_95_m": errors.whole.ravel(),
            }
        ),
    )


def _draw_errors(figure: Figure, axes: Axes, e: PlaneErrors) -> None:
    x, y = 1e3 * e.places[..., 0], 1e3 * e.places[..., 1]
    size = 1e3 * e.whole
    shades = axes.contourf(x, y, size, levels=_levels(size), cmap="Blues")
    edge = np.concatenate([e.places[0], e.places[:, -1], e.places[-1, ::-1], e.places[::-1, 0]])
    axes.plot(*(1e3 * edge).T, color=palette.INK, linewidth=0.6)
    worst = e.worst
    axes.plot(x[worst], y[worst], "o", color=palette.FORCE, markersize=4.0, clip_on=False)
    axes.annotate(
        f"{size[worst]:.2g} mm",
        (float(x[worst]), float(y[worst])),
        xytext=(0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())),
        textcoords="data",
        ha="center",
        color=palette.FORCE,
        arrowprops={"arrowstyle": "-", "color": palette.FORCE, "linewidth": 0.5},
    )
    axes.set_aspect("equal")
    axes.set(xlabel="x on the plate [mm]", ylabel="y on the plate [mm]")
    axes.set_title(f"95 % of position errors are below, {1e3 * e.height:g} mm above the plate",
                   loc="left")  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    _bar(figure, shades, axes, "error [mm]")


def _draw_seen(figure: Figure, axes: Axes, e: PlaneErrors) -> None:
    right, bottom = e.pixels[-1, -1] + 0.5
    axes.set_aspect("equal")
    axes.set(xlim=(-0.5, right), ylim=(bottom, -0.5), xlabel="u [px]", ylabel="v [px]")
    if not e.seen.size:
        axes.set_title("positions of the boards: unknown", loc="left")
        return
    shown = np.ma.masked_equal(e.seen, 0.0)
    cells = axes.imshow(shown, extent=(-0.5, right, bottom, -0.5), cmap="Greens", vmin=0.0)
    axes.set_title("positions of the boards; white: none", loc="left")
    _bar(figure, cells, axes, "corners")


def _levels(values: FloatArray) -> list[float]:
    """Round contour levels that span the values."""
    from matplotlib.ticker import MaxNLocator

    low, high = float(values.min()), float(values.max())
    if not high > low:
        low, high = 0.9 * low, 1.1 * high + 1e-9
    return [float(level) for level in MaxNLocator(LEVELS).tick_values(low, high)]


def _bar(figure: Figure, shades: Any, axes: Axes, label: str) -> None:
    bar = figure.colorbar(shades, ax=axes, location="bottom", shrink=0.8, aspect=30, pad=0.02)
    bar.set_label(label, labelpad=1.5)
    bar.outline.set_linewidth(0.4)
    bar.ax.tick_params(width=0.4, length=2.0, pad=1.5)
