"""Figure of a filter run: top view of the path, poses and parameters against time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.banner import BANNER, add_simulated_band, cut_short
from fixel.drawing.experiment import (
    BOTTOM,
    DASHED,
    DOTTED,
    GAP,
    LEFT,
    LEGEND_ROW,
    LOWEST,
    MM,
    PANEL,
    RIGHT,
    STRIP_ROW,
    TALLEST,
    TOP,
    VIEW_LABELS,
)
from fixel.drawing.picture import frame_axes, save_made, tint
from fixel.drawing.view import Rectangle
from fixel.filtering.recorded import FilterEstimates
from fixel.model import Experiment, Scene, Shape, Trajectory, placed, wrapped
from fixel.typing import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NINETY: Final = 1.645  # half width of the central 90 % of a normal distribution, in deviations
MAX_OUTLINES: Final = 60  # maximum number of outlines from which the extent is computed
MARGIN: Final = 0.05  # share of the larger side
FLAT: Final = 0.55  # height of panels of parameters, as a share of that of poses
HIDDEN: Final = palette.FORCE

LABELS: Final = {
    "mu_support": "μ\nsupport",
    "mu_pusher": "μ\npusher",
    "mu_fixel": "μ\nfixel",
    "tripod_radius": "tripod\n[mm]",
}
FACTORS: Final = {"tripod_radius": 1e3}  # from SI to the unit of the label


def draw_filter(experiment: Experiment, estimates: FilterEstimates, path: str | Path) -> None:
    """Draw the estimates of a filter and the measurements of an experiment.

    Parameters
    ----------
    experiment : Experiment
        Experiment that was filtered.
    estimates : FilterEstimates
    path : str or Path
        File to write (`.pdf`, `.svg` or `.png`).

    Raises
    ------
    InvalidInput
        The file name has another ending.
    """
    save_made(lambda: filter_figure(experiment, estimates), path)


def filter_figure(experiment: Experiment, estimates: FilterEstimates) -> Figure:
    """Create the figure that `draw_filter` saves."""
    sheet = _sheet(experiment, estimates)
    handles = _view(sheet.view, experiment, estimates)
    _poses(sheet.poses, experiment, estimates)
    _parameters(sheet.parameters, estimates)
    _touches(sheet.strip, experiment, estimates)
    _time_axes(sheet, estimates)
    return _laid_out(sheet, experiment, _extent(experiment, estimates), handles)


class _FilterSheet(NamedTuple):
    """Axes of a figure of one column, from top to bottom."""

    figure: Figure
    view: Axes
    poses: list[Axes]
    parameters: list[Axes]
    strip: Axes | None
    n_fixel: int

    @property
    def against_time(self) -> list[Axes]:
        return [*self.poses, *self.parameters, *([] if self.strip is None else [self.strip])]


def _sheet(experiment: Experiment, estimates: FilterEstimates) -> _FilterSheet:
    from matplotlib.figure import Figure

    figure = Figure()

    def axes(label: str) -> Axes:
        made = figure.add_axes((0.0, 0.0, 1.0, 1.0), label=label)
        made.set_ylabel(label, labelpad=2.0)
        return made

    view = figure.add_axes((0.0, 0.0, 1.0, 1.0), label="view")
    poses = [axes(label) for label in ("x [mm]", "y [mm]", "θ [deg]")]
    parameters = [axes(LABELS.get(name, name)) for name in estimates.prior.names]
    n_fixel = estimates.touch.shape[1]
    strip = None
    if n_fixel:
        strip = figure.add_axes((0.0, 0.0, 1.0, 1.0), label="tactile")
        strip.set_yticks(range(n_fixel), [f.name for f in _scene(experiment).fixels])
        strip.set_ylim(n_fixel - 0.5, -0.5)
        strip.tick_params(axis="y", labelsize=palette.FONT_SIZE - 1.5, length=0.0)
    return _FilterSheet(figure, view, poses, parameters, strip, n_fixel)


def _scene(experiment: Experiment) -> Scene:
    assert experiment.scene is not None  # required by filters
    return experiment.scene


# --- top view ---------------------------------------------------------------------------------


def _extent(experiment: Experiment, estimates: FilterEstimates) -> Rectangle:
    """Extent of the top view [m]."""
    scene = _scene(experiment)
    corners = [placed(f.shape.outline, f.pose) for f in scene.fixels]
    for shape, track in (
        (scene.bodies[0].shape, _measured(experiment, estimates)),
        (scene.bodies[0].shape, estimates.trajectory),
        (scene.pushers[0].shape, _pusher(experiment, estimates)),
    ):
        some = np.unique(np.linspace(0, len(track.pose) - 1, MAX_OUTLINES).round().astype(int))
        corners += [placed(shape.outline, pose) for pose in track.pose[some]]
    points = np.concatenate(corners)
    (left, bottom), (right, top) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Rectangle((left, right), (bottom, top)).widened(MARGIN)


def _measured(experiment: Experiment, estimates: FilterEstimates) -> Trajectory:
    """Measured trajectory during the filter run."""
    return _cut(experiment.trajectory, estimates)


def _pusher(experiment: Experiment, estimates: FilterEstimates) -> Trajectory:
    assert experiment.pusher is not None
    return _cut(experiment.pusher, estimates)


def _cut(track: Trajectory, estimates: FilterEstimates) -> Trajectory:
    first, last = estimates.time[0], estimates.time[-1]
    kept = (track.time >= first - 1e-6) & (track.time <= last + 1e-6)
    return Trajectory(time=track.time[kept], pose=track.pose[kept])


def _view(axes: Axes, experiment: Experiment, estimates: FilterEstimates) -> list[Artist]:
    scene, measured = _scene(experiment), _measured(experiment, estimates)
    shape, pusher = scene.bodies[0].shape, _pusher(experiment, estimates)
    handles: list[Artist] = []
    if scene.fixels:
        style = {"facecolor": palette.FIXEL, "edgecolor": palette.INK, "linewidth": 0.5}
        outlines = [placed(f.shape.outline, f.pose) for f in scene.fixels]
        handles.append(_patches(axes, outlines, "fixel", zorder=4, **style))
    colour = palette.PUSHER
    style = {"facecolor": tint(colour, 0.45), "edgecolor": colour, "linewidth": 0.8}
    head = scene.pushers[0].shape
    outlines = [placed(head.outline, pusher.pose[-1])]
    handles.append(_patches(axes, outlines, "pusher, end", zorder=1.9, **style))
    what = "measured" if experiment.real else "recorded"
    handles += _outlines(axes, shape, measured, estimates, what)
    (line,) = axes.plot(
        *(measured.pose[:, :2].T * MM.per_metre),
        color=palette.INK,
        linewidth=1.0,
        label=f"{what}, path",
        zorder=3.4,
    )
    return [*handles, line, *_estimated_path(axes, estimates)]


def _outlines(
    axes: Axes, shape: Shape, measured: Trajectory, estimates: FilterEstimates, what: str
) -> list[Artist]:
    """Draw the object at start, end and the end of the occlusion, where errors are largest."""
    dotted = {"facecolor": "none", "edgecolor": palette.FIXEL, "linewidth": 0.8}
    first = placed(shape.outline, measured.pose[0])
    handles = [_patches(axes, [first], "start", zorder=1.5, linestyle=DOTTED, **dotted)]
    instants = [estimates.time[-1]]
    if estimates.hidden.any():
        instants.append(estimates.time[estimates.hidden][-1])
    for track, colour, label in (
        (measured, palette.INK, what),
        (estimates.trajectory, palette.BODY, "estimated"),
    ):
        thin = {"facecolor": "none", "edgecolor": colour, "linewidth": 0.8}
        outlines = [placed(shape.outline, track.at(instant)) for instant in instants]
        handles.append(_patches(axes, outlines[:1], f"{label}, end", zorder=2.5, **thin))
        if len(outlines) > 1:
            name = f"{label}, last hidden"
            handles.append(_patches(axes, outlines[1:], name, 2.4, linestyle=DASHED, **thin))
    return handles


def _estimated_path(axes: Axes, estimates: FilterEstimates) -> list[Artist]:
    way = estimates.pose[:, :2] * MM.per_metre
    (seen,) = axes.plot(
        *way.T, color=palette.BODY, linewidth=1.0, label="estimated, path", zorder=3.5
    )
    hidden = estimates.hidden
    if not hidden.any():
        return [seen]
    masked = np.where(hidden[:, None], way, np.nan)
    (dark,) = axes.plot(
        *masked.T, color=HIDDEN, linewidth=1.6, label="estimated while hidden", zorder=3.6
    )
    return [seen, dark]


def _patches(
    axes: Axes, outlines: Sequence[FloatArray], label: str, zorder: float, **style: Any
) -> Artist:
    """Draw outlines [m]; return their entry for a legend."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    scaled = [outline * MM.per_metre for outline in outlines]
    axes.add_collection(PolyCollection(scaled, zorder=zorder, **style), autolim=False)
    return Patch(label=label, **style)


# --- against time -----------------------------------------------------------------------------


def _poses(panels: Sequence[Axes], experiment: Experiment, estimates: FilterEstimates) -> None:
    """Draw estimates with their 90 % bands, and measured poses."""
    measured = _measured(experiment, estimates)
    deviation = np.sqrt(np.diagonal(estimates.covariance, axis1=1, axis2=2))
    angle = np.unwrap(measured.pose[:, 2])
    # Shift measured angles by whole turns, to be near the estimated ones.
    shift = estimates.pose[0, 2] - angle[0]
    angle = angle + shift - wrapped(shift)
    columns = (measured.pose[:, 0], measured.pose[:, 1], angle)
    factors = (MM.per_metre, MM.per_metre, 180.0 / np.pi)
    for k, (axes, column, factor) in enumerate(zip(panels, columns, factors, strict=True)):
        middle, half = estimates.pose[:, k], NINETY * deviation[:, k]
        _band(axes, estimates.time, factor * (middle - half), factor * (middle + half))
        axes.plot(measured.time, factor * column, color=palette.INK, linewidth=0.9)
        axes.plot(estimates.time, factor * middle, color=palette.BODY, linewidth=0.9)


def _parameters(panels: Sequence[Axes], estimates: FilterEstimates) -> None:
    """Draw medians with 5 % to 95 % bands, within the bounds of the prior."""
    prior = estimates.prior
    for k, (axes, name) in enumerate(zip(panels, prior.names, strict=True)):
        factor = FACTORS.get(name, 1.0)
        low, middle, high = factor * estimates.quantiles[:, k].T
        _band(axes, estimates.time, low, high)
        axes.plot(estimates.time, middle, color=palette.BODY, linewidth=0.9)
        least, most = factor * prior.low[k], factor * prior.high[k]
        margin = 0.06 * (most - least) or 0.05 * abs(most) or 1.0
        axes.set_ylim(least - margin, most + margin)


def _band(axes: Axes, time: FloatArray, low: FloatArray, high: FloatArray) -> None:
    axes.fill_between(time, low, high, color=palette.TRAIL, alpha=0.4, linewidth=0.0, zorder=1.2)


def _touches(axes: Axes | None, experiment: Experiment, estimates: FilterEstimates) -> None:
    """Draw a row per fixel: above its readings, below the estimated probability of contact."""
    if axes is None:
        return
    time = estimates.time
    channel = experiment.channel("tactile")
    for row in range(estimates.touch.shape[1]):
        if channel is not None and row < channel.values.shape[1]:
            felt = channel.values[:, row] > 0.5
            kept = (channel.time >= time[0] - 1e-6) & (channel.time <= time[-1] + 1e-6)
            spans = _spans(channel.time[kept], felt[kept])
            axes.broken_barh(spans, (row - 0.40, 0.36), facecolor=palette.INK, linewidth=0.0)
        base, height = row + 0.40, 0.36
        axes.fill_between(
            time,
            np.full(len(time), base),
            base - height * estimates.touch[:, row],
            color=palette.TOUCHED,
            linewidth=0.0,
        )


def _spans(time: FloatArray, on: BoolArray) -> list[tuple[float, float]]:
    """Intervals (start, length) of consecutive readings that are on [s]."""
    if len(time) < 2:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
    ends = np.append(time, time[-1] + float(np.median(np.diff(time))))
    return [(float(ends[a]), float(ends[b] - ends[a])) for a, b in edges.reshape(-1, 2)]


def _time_axes(sheet: _FilterSheet, estimates: FilterEstimates) -> None:
    """Set the time axes of all panels: limits, grids, and a shade while the object is hidden."""
    time, every = estimates.time, sheet.against_time
    margin = 0.02 * float(time[-1] - time[0])
    for axes in every:
        axes.set_xlim(float(time[0]) - margin, float(time[-1]) + margin)
        axes.grid(color=palette.FAINT, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(pad=1.5, labelbottom=axes is every[-1])
        if estimates.occlusion is not None:
            axes.axvspan(*estimates.occlusion, color=HIDDEN, alpha=0.12, linewidth=0.0, zorder=0.1)
    for axes in sheet.poses:
        axes.locator_params(axis="y", nbins=4, steps=[1, 2, 5, 10])
        axes.margins(y=0.1)
    for axes in sheet.parameters:
        axes.locator_params(axis="y", nbins=3)
    every[-1].set_xlabel("time [s]", labelpad=1.5)


# --- layout -----------------------------------------------------------------------------------


def _laid_out(
    sheet: _FilterSheet, experiment: Experiment, box: Rectangle, handles: list[Artist]
) -> Figure:
    """Place the axes in inches, so that nothing overlaps or is cut off."""
    from matplotlib.patches import Patch

    width = palette.COLUMN - LEFT - RIGHT
    height = width * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    height = min(TALLEST, max(LOWEST, height))
    frame_axes(sheet.view, box.with_aspect(height / width), MM)
    handles = [*handles, Patch(facecolor=palette.TRAIL, alpha=0.4, label="90 %")]
    if sheet.n_fixel:
        handles.append(Patch(facecolor=palette.INK, label="fixel feels contact"))
        handles.append(Patch(facecolor=palette.TOUCHED, label="contact, estimated"))
    legend = LEGEND_ROW * -(-len(handles) // 2) + 0.08
    tall = [PANEL] * len(sheet.poses) + [FLAT * PANEL] * len(sheet.parameters)
    tall += [] if sheet.strip is None else [2.0 * STRIP_ROW * sheet.n_fixel]
    top = TOP + (0.0 if experiment.real else BANNER)
    total = top + height + VIEW_LABELS + legend + sum(tall) + GAP * (len(tall) - 1) + BOTTOM
    sheet.figure.set_size_inches(palette.COLUMN, total)

    def place(axes: Axes, from_top: float, high: float) -> None:
        bottom = (total - from_top - high) / total
        axes.set_position((LEFT / palette.COLUMN, bottom, width / palette.COLUMN, high / total))

    place(sheet.view, top, height)
    below = top + height + VIEW_LABELS
    _legend(sheet.figure, handles, 1.0 - below / total)
    below += legend
    for axes, high in zip(sheet.against_time, tall, strict=True):
        place(axes, below, high)
        below += high + GAP
    sheet.figure.align_ylabels([*sheet.poses, *sheet.parameters])
    _heading(sheet, experiment, total)
    return sheet.figure


def _legend(figure: Figure, handles: Sequence[Artist], top: float) -> None:
    figure.legend(
        handles=list(handles),
        loc="upper center",
        bbox_to_anchor=(0.5, top),
        ncols=2,
        frameon=False,
        borderpad=0.0,
        borderaxespad=0.0,
        labelspacing=0.3,
        handlelength=1.7,
        columnspacing=1.2,
        handletextpad=0.5,
    )


def _heading(sheet: _FilterSheet, experiment: Experiment, total: float) -> None:
    """Draw the name of the experiment, and a banner if it is simulated."""
    sheet.view.set_title(cut_short(f"{experiment.key}, filtered", 52), loc="left", pad=3.5)
    if experiment.real:
        return
    add_simulated_band(sheet.figure, experiment.simulated_by, BANNER / total)
