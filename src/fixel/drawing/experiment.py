"""Figures of experiments: measured poses and contacts, and deviations of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette, top_view
from fixel.drawing.chart import Style
from fixel.drawing.view import Rectangle, evenly, ghosts
from fixel.errors import InvalidInput, counted
from fixel.model import Channel, Experiment, Shape, Trajectory, placed, pose_error

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = (palette.FIXEL, palette.BODY, palette.PUSHER, palette.TOUCHED, palette.FORCE)
MAX_PATHS: Final = 200
MAX_DRAWN: Final = 6  # experiments that are drawn with outlines
STEPS: Final = 2  # number of outlines between start and end in a comparison


def _new_axes(height: float) -> Axes:
    """Create axes of a figure with a height [inch], which Pyplot knows."""
    from matplotlib import pyplot

    return pyplot.subplots(figsize=(4.9, height), layout="constrained")[1]


def plot_path(experiment: Experiment, *, ax: Axes | None = None) -> Axes:
    """Draw the top view of an experiment; return its axes."""
    axes = ax or _new_axes(3.5)
    handles = top_view.add_fixels(axes, experiment.scene, experiment.contact_mode)
    handles += _draw_pusher(axes, experiment) + _draw_object(axes, experiment)
    top_view.frame_axes(axes, _extent(experiment, experiment.trajectory))
    axes.set_title(experiment.key)
    return axes


def plot_paths(experiments: Sequence[Experiment], *, ax: Axes | None = None) -> Axes:
    """Draw the measured paths of several experiments, `MAX_PATHS` at most; return the axes."""
    axes = ax or _new_axes(4.9)
    chosen = evenly(len(experiments), MAX_PATHS)
    dot: Style = {"marker": "o", "markersize": 2.5, "linestyle": "none", "color": palette.BODY}
    for k in chosen.tolist() if len(experiments) else ():
        experiment = experiments[k]
        shape, pose = _shape(experiment), experiment.trajectory.pose
        _path(axes, experiment.trajectory, "", color=palette.BODY, linewidth=0.6, alpha=0.6)
        for row, fill in ((0, "white"), (-1, palette.BODY)):
            axes.plot(
                *(pose[row, :2] * top_view.MM.factor), markerfacecolor=fill, zorder=3.6, **dot
            )
            if shape is not None and len(experiments) <= MAX_DRAWN:
                outline = placed(shape.outline, pose[row])
                thin = top_view.hollow(palette.BODY, 0.4, linestyle="-" if row else top_view.DASHED)
                top_view.add_outlines(axes, [outline], **thin)
                axes.update_datalim(outline * top_view.MM.factor)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"x [{top_view.MM.name}]")
    axes.set_ylabel(f"y [{top_view.MM.name}]")
    n, shown = len(experiments), len(chosen)
    axes.set_title(counted(n, "experiment") + (f", {shown} of them drawn" if shown < n else ""))
    return axes


def plot_errors(comparison: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the share of the experiments whose error is below a value, for each model."""
    axes = ax or _new_axes(3.5)
    lines = dict.fromkeys((row.model, row.use) for row in comparison.rows)
    models = list(comparison.models)
    for model, use in lines:
        rows = [row for row in comparison.of(model) if row.use == use]
        errors = np.sort([row.error_mm for row in rows if row.error_mm is not None])
        share = 100.0 * np.arange(1, len(errors) + 1) / max(1, len(rows))
        axes.step(
            np.concatenate(([0.0], errors)),
            np.concatenate(([0.0], share)),
            where="post",
            label=f"{model}{f', {use}' if use else ''} ({len(rows)})",
            color=COLOURS[models.index(model) % len(COLOURS)],
            linestyle="--" if use == "fitted" else "-",
        )
    axes.set_xlim(left=0.0)
    axes.set_ylim(0.0, 101.0)
    axes.set_xlabel("error [mm]")
    axes.set_ylabel("experiments below [%]")
    axes.legend(loc="lower right")
    return axes


def motion_figure(
    comparison: Any, *, experiment: str | None = None, model: str | None = None
) -> Figure:
    """Draw measured and simulated motion of one experiment, and the errors against time.

    By default it is the first experiment, and the last model. The plot has axes of its own.
    """
    rows = comparison.of(model or comparison.models[-1])
    chosen = [row for row in rows if experiment in (None, row.run.experiment.key)]
    if not chosen:
        raise InvalidInput(
            "experiment" if rows else "model",
            found=repr(experiment if rows else model),
            expected="a compared experiment",
        )
    run = chosen[0].run
    return comparison_figure(run.experiment, run.simulated, run.contacts)


def experiment_figure(experiment: Experiment) -> Figure:
    """Draw an experiment: top view of the plate, poses against time, contacts of the fixels.

    Of an experiment without a scene, only its path is drawn.
    """
    track, felt = experiment.trajectory, top_view.readings(experiment.channel("tactile"))
    labels = ("x [mm]", "y [mm]", "θ [deg]")
    page = top_view.column_page(
        _extent(experiment, track), labels, [top_view.PANEL] * 3, tuple(felt)
    )
    handles = top_view.add_fixels(page.view, experiment.scene, experiment.contact_mode)
    handles += _draw_pusher(page.view, experiment) + _draw_object(page.view, experiment)
    columns = (*(track.pose[:, :2].T * top_view.MM.factor), np.degrees(np.unwrap(track.pose[:, 2])))
    for axes, values in zip(page.panels, columns, strict=True):
        axes.plot(track.time, values, color=palette.BODY, linewidth=1.0, **_joined(track))
    _draw_touches(page.strip, felt, palette.TOUCHED)
    _set_time(page, experiment)
    return top_view.finish_page(page, handles, experiment.key, experiment)


def comparison_figure(
    experiment: Experiment, simulated: Trajectory, contacts: Channel | None = None
) -> Figure:
    """Draw a simulation over its experiment, and its errors against time.

    Simulated poses are on the experiment's clock, and contacts like its channel `tactile`. A
    simulation that does not overlap in time raises `InvalidInput`.
    """
    compared = _common_time(experiment, simulated)
    felt, touched = top_view.readings(experiment.channel("tactile")), top_view.readings(contacts)
    labels = ("position\nerror [mm]", "angle\nerror [deg]")
    box = _extent(experiment, experiment.trajectory, simulated)
    page = top_view.column_page(box, labels, [top_view.PANEL] * 2, tuple(felt or touched))
    handles = top_view.add_fixels(page.view, experiment.scene, experiment.contact_mode)
    handles += _draw_pusher(page.view, experiment)
    handles += _draw_both(page.view, experiment, simulated)
    _draw_errors(page.panels, compared, simulated)
    _draw_touches(page.strip, felt, palette.INK, (-0.35, 0.35) if not touched else (0.05, 0.42))
    _draw_touches(page.strip, touched, palette.BODY, (-0.42, -0.05))
    _set_time(page, experiment)
    return top_view.finish_page(page, handles, experiment.key, experiment)


def _common_time(experiment: Experiment, simulated: Trajectory) -> Trajectory:
    """Measured poses during the simulation; raise `InvalidInput` if there are none."""
    time = experiment.trajectory.time
    # Both clocks are multiples of a frame, but rounded differently.
    both = (time >= simulated.time[0] - 1e-9) & (time <= simulated.time[-1] + 1e-9)
    if not both.any():
        found = f"{simulated.time[0]:g} to {simulated.time[-1]:g} s"
        expected = f"a part of the measured time, {time[0]:g} to {time[-1]:g} s"
        raise InvalidInput("simulated.time", found=found, expected=expected)
    return Trajectory(time=time[both], pose=experiment.trajectory.pose[both])


def _shape(experiment: Experiment) -> Shape | None:
    if experiment.scene is None:
        return None
    return next(b.shape for b in experiment.scene.bodies if b.name == experiment.object_name)


def _pusher_shape(experiment: Experiment) -> Shape | None:
    scene = experiment.scene
    return scene.pushers[0].shape if scene is not None and scene.pushers else None


def _extent(experiment: Experiment, *tracks: Trajectory) -> Rectangle:
    corners = [
        points
        for track in tracks
        for points in top_view.swept_points(_shape(experiment), track.pose)
    ]
    if experiment.pusher is not None:
        corners += top_view.swept_points(_pusher_shape(experiment), experiment.pusher.pose)
    fixels = () if experiment.scene is None else experiment.scene.fixels
    return top_view.extent_of(corners, fixels, _shape(experiment))


def _draw_pusher(axes: Axes, experiment: Experiment) -> list[Artist]:
    track, shape = experiment.pusher, _pusher_shape(experiment)
    if track is None:
        return []
    colour = palette.PUSHER
    handles = [] if shape is None else top_view.add_start_and_end(
        axes, "pusher", shape, track.pose, colour, 0.45
    )  # fmt: skip
    return [*handles, _path(axes, track, "pusher", color=colour, linewidth=0.9, zorder=3.2)]


def _draw_object(axes: Axes, experiment: Experiment) -> list[Artist]:
    """Draw the measured object: outlines at start and end, ghosts between them, and the path."""
    track, shape, name = experiment.trajectory, _shape(experiment), experiment.object_name
    handles: list[Artist] = []
    if shape is not None:
        handles = top_view.add_start_and_end(axes, name, shape, track.pose, palette.BODY, 0.30)
        # With only a few poses the motion between them is unknown.
        if len(track.time) > top_view.FEW_POSES:
            unwound = np.column_stack((track.pose[:, :2], np.unwrap(track.pose[:, 2])))
            outlines = [placed(shape.outline, pose) for pose in ghosts(unwound, shape, 4)]
            top_view.add_outlines(
                axes, outlines, **top_view.hollow(palette.BODY, 0.5, alpha=0.35, zorder=1.2)
            )
    handles.append(_path(axes, track, name, color=palette.BODY, linewidth=1.0, zorder=3.5))
    if shape is None:
        for row, fill, label in ((0, "white", "start"), (-1, palette.BODY, "end")):
            dot: Style = {"marker": "o", "markersize": 4.0, "linestyle": "none"}
            dot |= {"color": palette.BODY, "markerfacecolor": fill, "zorder": 3.6}
            place = track.pose[row : row + 1 or None, :2].T * top_view.MM.factor
            handles += axes.plot(*place, label=f"{name}, {label}", **dot)
    return handles


def _draw_both(axes: Axes, experiment: Experiment, simulated: Trajectory) -> list[Artist]:
    """Draw measured and simulated outlines at the same times, and both paths."""
    from matplotlib.colors import to_rgb

    shape, track = _shape(experiment), experiment.trajectory
    what = "measured" if experiment.real else "recorded"
    both = ((track, palette.INK, what), (simulated, palette.BODY, "simulated"))
    # Compare at a common end: measurements after the simulation's end are not its error.
    end = min(track.time[-1], simulated.time[-1])
    start = max(track.time[0], simulated.time[0])
    handles: list[Artist] = []
    if shape is not None:
        steps = STEPS if len(track.time) > top_view.FEW_POSES else 0
        between = np.linspace(start, end, steps + 2)[1:-1]
        for source, colour, label in both:
            outlines = [placed(shape.outline, pose) for pose in source.at(between)]
            top_view.add_outlines(
                axes, outlines, **top_view.hollow(colour, 0.5, alpha=0.4, zorder=1.3)
            )
            last = placed(shape.outline, source.at(end))
            full = top_view.solid((*to_rgb(colour), 0.12), colour, 1.0, zorder=2.5)
            handles += top_view.add_outlines(axes, [last], label=f"{label}, end", **full)
        first = placed(shape.outline, track.at(start))
        dashed = top_view.hollow(palette.FIXEL, 0.7, linestyle=top_view.DASHED, zorder=1.5)
        handles += top_view.add_outlines(axes, [first], label="start", **dashed)
    return handles + [
        _path(axes, source, label, color=colour, linewidth=1.0, zorder=3.5)
        for source, colour, label in both
    ]


def _joined(track: Trajectory) -> Style:
    """Style of a path: a line, or dots if there are only a few poses."""
    if len(track.time) > top_view.FEW_POSES:
        return {"linestyle": "-"}
    return {"linestyle": "none", "marker": "o", "markersize": 3.0}


def _path(axes: Axes, track: Trajectory, name: str, **style: Any) -> Artist:
    label = f"{name}, {'path' if len(track.time) > top_view.FEW_POSES else 'poses'}"
    place = track.pose[:, :2].T * top_view.MM.factor
    (line,) = axes.plot(*place, label=label, **style, **_joined(track))
    return line


def _draw_errors(panels: Sequence[Axes], measured: Trajectory, simulated: Trajectory) -> None:
    position, angle = pose_error(simulated.at(measured.time), measured.pose)
    style: Style = {"color": palette.BODY, "linewidth": 1.0, **_joined(measured)}
    panels[0].plot(measured.time, position * top_view.MM.factor, **style)
    panels[0].set_ylim(bottom=0.0)
    panels[1].plot(measured.time, np.degrees(angle), **style)
    panels[1].axhline(0.0, color=palette.FIXEL, linewidth=0.4, zorder=0.5)


def _draw_touches(
    strip: Axes | None,
    felt: dict[str, list[tuple[float, float]]],
    colour: str,
    band: tuple[float, float] = (-0.35, 0.35),
) -> None:
    """Fill the row of each fixel while it was touched; `band` is the part of the row [-]."""
    for row, spans in enumerate(felt.values() if strip is not None else ()):
        strip.broken_barh(  # type: ignore[union-attr]
            spans, (row + band[0], band[1] - band[0]), facecolor=colour, linewidth=0.0
        )


def _set_time(page: top_view.ColumnPage, experiment: Experiment) -> None:
    """Set the time axes of all panels, and shade what is outside the useful data."""
    left, right = top_view.time_axes(page.against_time, experiment.trajectory.time)
    margin = experiment.trajectory.time[0] - left
    first, last = experiment.effective or (left, right)
    for start, end in ((left, first), (last, right)):
        # A shade no wider than the margin would hide no data.
        if end - start > 1.5 * margin:
            for axes in page.against_time:
                axes.axvspan(start, end, color=palette.FAINT, alpha=0.5, linewidth=0, zorder=0.1)
    for axes in page.panels:
        axes.locator_params(axis="y", nbins=4, steps=[1, 2, 5, 10])
        axes.margins(y=0.12)
