"""Figures of experiments: measured poses and contacts, and deviations of a simulation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.banner import BANNER, add_simulated_band, cut_short
from fixel.drawing.picture import frame_axes, save_made, tint
from fixel.drawing.view import UNITS, Rectangle, ghosts
from fixel.errors import InvalidInput
from fixel.model import Channel, Experiment, Fixel, Shape, Trajectory, placed, pose_error
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM: Final = UNITS[1]

# Margins and sizes of the figure [inch].
LEFT, RIGHT, TOP, BOTTOM = 0.60, 0.12, 0.24, 0.36
TALLEST, LOWEST = 3.4, 1.1
VIEW_LABELS, PANEL, GAP, STRIP_ROW = 0.38, 0.62, 0.11, 0.13
LEGEND_ROW = 0.128
LETTER = 0.046  # mean width of a letter of a fixel's name

MARGIN = 0.05  # share of the larger side, around all that is drawn
MIN_SIDE = 5e-3  # [m], minimum side of a view, so that noise does not look like motion
MAX_OUTLINES = 60  # maximum number of outlines from which the extent is computed
FEW_POSES = 3  # up to this number of poses, draw dots: the motion between them is unknown
DOTTED: Final = (0, (1, 1))
MAX_NAMES = 12  # maximum number of fixels with names
STEPS = 2  # number of outlines between start and end in a comparison

DASHED: Final = (0, (3, 2))


def draw_experiment(experiment: Experiment, path: str | Path) -> None:
    """Draw an experiment: top view of the plate, poses against time, contacts of the fixels.

    Parameters
    ----------
    experiment : Experiment
        Experiment; without a scene, only its path is drawn.
    path : str or Path
        File to write (`.pdf`, `.svg` or `.png`).

    Raises
    ------
    InvalidInput
        The file name has another ending.
    """
    save_made(lambda: experiment_figure(experiment), path)


def draw_comparison(
    experiment: Experiment,
    simulated: Trajectory,
    path: str | Path,
    contacts: Channel | None = None,
) -> None:
    """Draw a simulation over its experiment, and its errors against time.

    Parameters
    ----------
    experiment : Experiment
    simulated : Trajectory
        Simulated poses of the object, on the experiment's clock.
    path : str or Path
        File to write (`.pdf`, `.svg` or `.png`).
    contacts : Channel, optional
        Simulated contacts of the fixels, like the channel `tactile` of an experiment.

    Raises
    ------
    InvalidInput
        The file name has another ending, or the simulation does not overlap in time.
    """
    save_made(lambda: comparison_figure(experiment, simulated, contacts), path)


def experiment_figure(experiment: Experiment) -> Figure:
    """Create the figure that `draw_experiment` saves."""
    sheet = _sheet(["x [mm]", "y [mm]", "θ [deg]"], _readings(experiment))
    box = _extent(experiment, [experiment.trajectory])
    handles = _plate(sheet.view, experiment) + _object(sheet.view, experiment)
    _poses(sheet.panels, experiment)
    _strip(sheet, _readings(experiment), palette.TOUCHED)
    _time_axes(sheet, experiment)
    return _laid_out(sheet, experiment, box, handles)


def comparison_figure(
    experiment: Experiment, simulated: Trajectory, contacts: Channel | None = None
) -> Figure:
    """Create the figure that `draw_comparison` saves."""
    compared = _together(experiment, simulated)
    readings = _readings(experiment) or (() if contacts is None else _runs(contacts))
    sheet = _sheet(["position\nerror [mm]", "angle\nerror [deg]"], readings)
    box = _extent(experiment, [experiment.trajectory, simulated])
    handles = _plate(sheet.view, experiment)
    handles += _overlay(sheet.view, experiment, simulated)
    _errors(sheet.panels, compared, simulated)
    if contacts is None:
        _strip(sheet, readings, palette.INK)
    else:
        _strip(sheet, _readings(experiment), palette.INK, (0.05, 0.42))
        _strip(sheet, _runs(contacts), palette.BODY, (-0.42, -0.05))
    _time_axes(sheet, experiment)
    return _laid_out(sheet, experiment, box, handles)


def _together(experiment: Experiment, simulated: Trajectory) -> Trajectory:
    """Measured poses during the simulation; raise `InvalidInput` if there are none."""
    time = experiment.trajectory.time
    # Both clocks are multiples of a frame, but rounded differently.
    both = (time >= simulated.time[0] - 1e-9) & (time <= simulated.time[-1] + 1e-9)
    if not both.any():
        raise InvalidInput(
            "simulated.time",
            found=f"{simulated.time[0]:g} to {simulated.time[-1]:g} s",
            expected=f"some of what was measured, {time[0]:g} to {time[-1]:g} s",
        )
    return Trajectory(time=time[both], pose=experiment.trajectory.pose[both])


# --- top view ---------------------------------------------------------------------------------


def _shape(experiment: Experiment) -> Shape | None:
    if experiment.scene is None:
        return None
    return next(b.shape for b in experiment.scene.bodies if b.name == experiment.object_name)


def _pusher_shape(experiment: Experiment) -> Shape | None:
    scene = experiment.scene
    return scene.pushers[0].shape if scene is not None and scene.pushers else None


def _fixels(experiment: Experiment) -> tuple[Fixel, ...]:
    return experiment.scene.fixels if experiment.scene is not None else ()


def _swept(shape: Shape | None, track: Trajectory) -> list[FloatArray]:
    """Points that a track covers [m]: outlines, or positions if the shape is unknown."""
    some = np.unique(np.linspace(0, len(track.pose) - 1, MAX_OUTLINES).round().astype(int))
    if shape is None:
        return [track.pose[:, :2]]
    return [placed(shape.outline, pose) for pose in track.pose[some]]


def _extent(experiment: Experiment, tracks: Iterable[Trajectory]) -> Rectangle:
    """Extent of the top view, with names of fixels [m]."""
    corners = [placed(f.shape.outline, f.pose) for f in _fixels(experiment)]
    for track in tracks:
        corners += _swept(_shape(experiment), track)
    if experiment.pusher is not None:
        corners += _swept(_pusher_shape(experiment), experiment.pusher)
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    short = np.maximum(MIN_SIDE - (high - low), 0.0) / 2.0
    (left, bottom), (right, top) = (low - short).tolist(), (high + short).tolist()
    return _with_names(experiment, Rectangle((left, right), (bottom, top)).widened(MARGIN))


def _with_names(experiment: Experiment, box: Rectangle) -> Rectangle:
    """Widen a rectangle on the right for the names of fixels."""
    right = box.x[1]
    per_inch = (box.x[1] - box.x[0]) / (palette.COLUMN - LEFT - RIGHT)
    for fixel in _fixels(experiment)[:MAX_NAMES]:
        reach = fixel.shape.radius + (LETTER * len(fixel.name) + 0.1) * per_inch
        right = max(right, float(fixel.pose[0]) + reach)
    return Rectangle((box.x[0], right), box.y)


def _plate(axes: Axes, experiment: Experiment) -> list[Artist]:
    return _draw_fixels(axes, experiment) + _draw_pusher(axes, experiment)


def _draw_fixels(axes: Axes, experiment: Experiment) -> list[Artist]:
    """Draw fixels with their names; those touched at the end have another colour."""
    fixels = _fixels(experiment)
    # There may be a contact mode without fixels (no scene), or fixels without a contact mode.
    touched = [digit == "1" for digit in experiment.contact_mode.ljust(len(fixels), "0")]
    handles: list[Artist] = []
    for colour, label, wanted in (
        (palette.FIXEL, "fixel", False),
        (palette.TOUCHED, "fixel touched at the end", True),
    ):
        some = [f for f, touch in zip(fixels, touched, strict=False) if touch == wanted]
        if some:
            style = {"facecolor": colour, "edgecolor": palette.INK, "linewidth": 0.5}
            outlines = [placed(f.shape.outline, f.pose) for f in some]
            handles.append(_patches(axes, outlines, label, zorder=4, **style))
    for fixel in fixels[:MAX_NAMES]:
        edge = placed(fixel.shape.outline, fixel.pose).max(axis=0) * MM.per_metre
        _name(axes, fixel.name, (float(edge[0]), float(fixel.pose[1]) * MM.per_metre))
    return handles


def _name(axes: Axes, name: str, place: tuple[float, float]) -> None:
    import matplotlib.patheffects as effects

    # A white rim makes letters readable over outlines.
    axes.annotate(
        name,
        place,
        (2.5, 0.0),
        textcoords="offset points",
        va="center",
        fontsize=palette.FONT_SIZE - 1.5,
        color=palette.INK,
        zorder=8,
        annotation_clip=True,
        path_effects=[effects.withStroke(linewidth=1.5, foreground="white")],
    )


def _draw_pusher(axes: Axes, experiment: Experiment) -> list[Artist]:
    track, shape = experiment.pusher, _pusher_shape(experiment)
    if track is None:
        return []
    handles: list[Artist] = []
    if shape is not None:
        first, last = (placed(shape.outline, track.pose[k]) for k in (0, -1))
        colour = palette.PUSHER
        hollow = {"facecolor": "none", "edgecolor": colour, "linewidth": 0.8, "linestyle": DASHED}
        full = {"facecolor": tint(colour, 0.45), "edgecolor": colour, "linewidth": 0.8}
        handles.append(_patches(axes, [first], "pusher, start", zorder=1.4, **hollow))
        handles.append(_patches(axes, [last], "pusher, end", zorder=1.9, **full))
    style = {"color": palette.PUSHER, "linewidth": 0.9, **_joined(track)}
    handles.append(_path(axes, track, "pusher, path", zorder=3.2, **style))
    return handles


def _object(axes: Axes, experiment: Experiment) -> list[Artist]:
    """Draw the measured object: outlines at start and end, ghosts between them, and the path."""
    track, shape = experiment.trajectory, _shape(experiment)
    handles: list[Artist] = []
    line = {"edgecolor": palette.BODY, "linewidth": 0.8}
    who = experiment.object_name
    if shape is not None:
        first, last = (placed(shape.outline, track.pose[k]) for k in (0, -1))
        full = {"facecolor": tint(palette.BODY, 0.30), **line}
        handles.append(
            _patches(
                axes, [first], f"{who}, start", zorder=2.7, facecolor="none", linestyle=DASHED,
                **line,
            )
        )  # fmt: skip
        handles.append(_patches(axes, [last], f"{who}, end", zorder=2.5, **full))
        _draw_ghosts(axes, track, shape)
    style = {"color": palette.BODY, "linewidth": 1.0, **_joined(track)}
    handles.append(_path(axes, track, f"{who}, path", zorder=3.5, **style))
    if shape is None:
        handles += _ends(axes, track, who)
    return handles


def _ends(axes: Axes, track: Trajectory, who: str) -> list[Artist]:
    """Draw dots at start and end of a path without outlines."""
    handles: list[Artist] = []
    for row, fill, label in ((0, "white", "start"), (-1, palette.BODY, "end")):
        handles += axes.plot(
            *(track.pose[row : row + 1 or None, :2].T * MM.per_metre),
            marker="o",
            markersize=4.0,
            linestyle="none",
            color=palette.BODY,
            markerfacecolor=fill,
            label=f"{who}, {label}",
            zorder=3.6,
        )
    return handles


def _draw_ghosts(axes: Axes, track: Trajectory, shape: Shape) -> None:
    # With only a few poses the motion between them is unknown.
    if len(track.time) > FEW_POSES:
        unwound = np.column_stack((track.pose[:, :2], np.unwrap(track.pose[:, 2])))
        between = ghosts(unwound, shape, 4)
        outlines = [placed(shape.outline, pose) for pose in between]
        style: dict[str, Any] = {"edgecolor": palette.BODY, "linewidth": 0.5, "alpha": 0.35}
        _patches(axes, outlines, "", zorder=1.2, facecolor="none", **style)


def _overlay(axes: Axes, experiment: Experiment, simulated: Trajectory) -> list[Artist]:
    """Draw measured and simulated outlines at the same times, and both paths."""
    shape, track = _shape(experiment), experiment.trajectory
    # Compare at a common end: measurements after the simulation's end are not its error.
    end = min(track.time[-1], simulated.time[-1])
    start = max(track.time[0], simulated.time[0])
    handles: list[Artist] = []
    if shape is not None:
        steps = STEPS if len(track.time) > FEW_POSES else 0
        between = np.linspace(start, end, steps + 2)[1:-1]
        for source, colour, what in _both(experiment, simulated):
            outlines = [placed(shape.outline, pose) for pose in source.at(between)]
            thin = {"facecolor": "none", "edgecolor": colour, "linewidth": 0.5, "alpha": 0.4}
            _patches(axes, outlines, "", zorder=1.3, **thin)
            last = placed(shape.outline, source.at(end))
            full = {"facecolor": (*_rgb(colour), 0.12), "edgecolor": colour, "linewidth": 1.0}
            handles.append(_patches(axes, [last], f"{what}, end", zorder=2.5, **full))
        first = placed(shape.outline, track.at(start))
        dashed = {"facecolor": "none", "edgecolor": palette.FIXEL, "linewidth": 0.7}
        handles.append(_patches(axes, [first], "start", zorder=1.5, linestyle=DASHED, **dashed))
    for source, colour, what in _both(experiment, simulated):
        style = {"color": colour, "linewidth": 1.0, **_joined(source)}
        handles.append(_path(axes, source, f"{what}, path", zorder=3.5, **style))
    return handles


def _both(experiment: Experiment, simulated: Trajectory) -> list[tuple[Trajectory, str, str]]:
    what = "measured" if experiment.real else "recorded"
    return [(experiment.trajectory, palette.INK, what), (simulated, palette.BODY, "simulated")]


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def _joined(track: Trajectory) -> dict[str, Any]:
    """Style of a path: a line, or dots if there are only a few poses."""
    if len(track.time) > FEW_POSES:
        return {"linestyle": "-"}
    return {"linestyle": "none", "marker": "o", "markersize": 3.0}


def _path(axes: Axes, track: Trajectory, label: str, **style: Any) -> Artist:
    if len(track.time) <= FEW_POSES:
        label = label.replace(", path", ", poses")
    (line,) = axes.plot(*(track.pose[:, :2].T * MM.per_metre), label=label, **style)
    return line


def _patches(axes: Axes, outlines: Sequence[FloatArray], label: str, **style: Any) -> Artist:
    """Draw filled outlines [m]; return their entry for a legend."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    scaled = [outline * MM.per_metre for outline in outlines]
    axes.add_collection(PolyCollection(scaled, **style), autolim=False)
    return Patch(label=label, **style)


# --- panels against time ----------------------------------------------------------------------


class _TouchSpan(NamedTuple):
    """Intervals in which a fixel was touched: (start, length) [s]."""

    name: str
    spans: list[tuple[float, float]]


def _readings(experiment: Experiment) -> tuple[_TouchSpan, ...]:
    channel = experiment.channel("tactile")
    return () if channel is None else _runs(channel)


def _runs(channel: Channel) -> tuple[_TouchSpan, ...]:
    return tuple(
        _TouchSpan(
            column.removesuffix("_bool").replace("_", "-"), _spans(channel.time, values > 0.5)
        )
        for column, values in zip(channel.columns, channel.values.T, strict=True)
        if column.endswith("_bool")
    )


def _spans(time: FloatArray, on: Any) -> list[tuple[float, float]]:
    """Intervals (start, length) of consecutive readings that are on [s]."""
    if len(time) < 2:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
    # A reading lasts until the next one; the last has the median duration.
    ends = np.append(time, time[-1] + float(np.median(np.diff(time))))
    return [(float(ends[a]), float(ends[b] - ends[a])) for a, b in edges.reshape(-1, 2)]


def _poses(panels: Sequence[Axes], experiment: Experiment) -> None:
    track = experiment.trajectory
    columns = (*(track.pose[:, :2].T * MM.per_metre), np.degrees(np.unwrap(track.pose[:, 2])))
    for axes, values in zip(panels, columns, strict=True):
        axes.plot(track.time, values, color=palette.BODY, linewidth=1.0, **_joined(track))


def _errors(panels: Sequence[Axes], measured: Trajectory, simulated: Trajectory) -> None:
    position, angle = pose_error(simulated.at(measured.time), measured.pose)
    style = {"color": palette.BODY, **_joined(measured)}
    panels[0].plot(measured.time, position * MM.per_metre, linewidth=1.0, **style)
    panels[0].set_ylim(bottom=0.0)
    panels[1].plot(measured.time, np.degrees(angle), linewidth=1.0, **style)
    panels[1].axhline(0.0, color=palette.FIXEL, linewidth=0.4, zorder=0.5)


def _strip(
    sheet: _ExperimentSheet,
    runs: Sequence[_TouchSpan],
    colour: str,
    band: tuple[float, float] = (-0.35, 0.35),
) -> None:
    """Draw a row for each fixel, filled while it was touched; `band` is the part of the row [-]."""
    if sheet.strip is None:
        return
    for row, run in enumerate(runs):
        place = (row + band[0], band[1] - band[0])
        sheet.strip.broken_barh(run.spans, place, facecolor=colour, linewidth=0.0)


def _time_axes(sheet: _ExperimentSheet, experiment: Experiment) -> None:
    """Set the time axes of all panels: limits, grids, and a shade outside the useful data."""
    time = experiment.trajectory.time
    margin = 0.02 * float(time[-1] - time[0]) or 0.5
    limits = (float(time[0]) - margin, float(time[-1]) + margin)
    every = [*sheet.panels] + ([sheet.strip] if sheet.strip is not None else [])
    for axes in every:
        axes.set_xlim(limits)
        axes.grid(color=palette.FAINT, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(pad=1.5, labelbottom=axes is every[-1])
        if experiment.effective is not None:
            first, last = experiment.effective
            for start, end in ((limits[0], first), (last, limits[1])):
                # A shade no wider than the margin would hide no data.
                if end - start > 1.5 * margin:
                    axes.axvspan(
                        start, end, color=palette.FAINT, alpha=0.5, linewidth=0.0, zorder=0.1
                    )
    for axes in sheet.panels:
        axes.locator_params(axis="y", nbins=4, steps=[1, 2, 5, 10])
        axes.margins(y=0.12)
    every[-1].set_xlabel("time [s]", labelpad=1.5)


# --- layout -----------------------------------------------------------------------------------


class _ExperimentSheet(NamedTuple):
    """Axes of a figure of one column, from top to bottom."""

    figure: Figure
    view: Axes
    panels: list[Axes]
    strip: Axes | None
    n_run: int


def _sheet(labels: Sequence[str], runs: Sequence[_TouchSpan]) -> _ExperimentSheet:
    from matplotlib.figure import Figure

    figure = Figure()
    whole = (0.0, 0.0, 1.0, 1.0)
    view = figure.add_axes(whole, label="view")
    panels = [figure.add_axes(whole, label=label) for label in labels]
    for axes, label in zip(panels, labels, strict=True):
        axes.set_ylabel(label, labelpad=2.0)
    strip = figure.add_axes(whole, label="tactile") if runs else None
    if strip is not None:
        strip.set_yticks(range(len(runs)), [run.name for run in runs])
        strip.set_ylim(len(runs) - 0.5, -0.5)
        strip.tick_params(axis="y", labelsize=palette.FONT_SIZE - 1.5, length=0.0)
    return _ExperimentSheet(figure, view, panels, strip, len(runs))


def _laid_out(
    sheet: _ExperimentSheet, experiment: Experiment, box: Rectangle, handles: Sequence[Artist]
) -> Figure:
    """Place the axes in inches, so that nothing overlaps or is cut off."""
    width = palette.COLUMN - LEFT - RIGHT
    height = width * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    height = min(TALLEST, max(LOWEST, height))
    frame_axes(sheet.view, box.with_aspect(height / width), MM)
    rows = -(-len(handles) // _columns(handles))
    top = TOP + (0.0 if experiment.real else BANNER)
    legend = LEGEND_ROW * rows + 0.08
    strip = STRIP_ROW * sheet.n_run + GAP if sheet.strip is not None else 0.0
    panels = len(sheet.panels) * (PANEL + GAP) - GAP
    total = top + height + VIEW_LABELS + legend + panels + strip + BOTTOM
    sheet.figure.set_size_inches(palette.COLUMN, total)

    def place(axes: Axes, from_top: float, tall: float) -> None:
        bottom = (total - from_top - tall) / total
        axes.set_position((LEFT / palette.COLUMN, bottom, width / palette.COLUMN, tall / total))

    place(sheet.view, top, height)
    below = top + height + VIEW_LABELS
    _legend(sheet.figure, handles, 1.0 - below / total)
    below += legend
    for axes in sheet.panels:
        place(axes, below, PANEL)
        below += PANEL + GAP
    if sheet.strip is not None:
        place(sheet.strip, below, STRIP_ROW * sheet.n_run)
    sheet.figure.align_ylabels(sheet.panels)
    _heading(sheet, experiment, total)
    return sheet.figure


def _columns(handles: Sequence[Artist]) -> int:
    return 3 if max(len(str(handle.get_label())) for handle in handles) < 18 else 2


def _legend(figure: Figure, handles: Sequence[Artist], top: float) -> None:
    figure.legend(
        handles=list(handles),
        loc="upper center",
        bbox_to_anchor=(0.5, top),
        ncols=_columns(handles),
        frameon=False,
        borderpad=0.0,
        borderaxespad=0.0,
        labelspacing=0.3,
        handlelength=1.7,
        columnspacing=1.2,
        handletextpad=0.5,
    )


def _heading(sheet: _ExperimentSheet, experiment: Experiment, total: float) -> None:
    """Draw the name of the experiment, and a banner if it is simulated."""
    sheet.view.set_title(cut_short(experiment.key, 52), loc="left", pad=3.5)
    if experiment.real:
        return
    add_simulated_band(sheet.figure, experiment.simulated_by, BANNER / total)
