"""Figure of a filter run: top view of the path, poses and parameters against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing import palette, top_view
from fixel.drawing.chart import tint
from fixel.filtering.recorded import FilterRun, during
from fixel.model import Experiment, Scene, Shape, Trajectory, placed, wrapped
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NINETY: Final = 1.645  # half width of the central 90 % of a normal distribution, in deviations
FLAT: Final = 0.55  # height of panels of parameters, as a share of that of poses
HIDDEN: Final = palette.FORCE

LABELS: Final = {
    "mu_support": "μ\nsupport",
    "mu_pusher": "μ\npusher",
    "mu_fixel": "μ\nfixel",
    "tripod_radius": "tripod\n[mm]",
}
FACTORS: Final = {"tripod_radius": 1e3}  # from SI to the unit of the label


def filter_figure(estimates: FilterRun) -> Figure:
    """Draw the estimates of a filter and the measurements of its experiment."""
    from matplotlib.patches import Patch

    experiment = estimates.experiment
    scene = experiment.scene
    assert scene is not None  # both are required by filters
    assert experiment.pusher is not None
    span = estimates.time[0], estimates.time[-1]
    measured, pusher = during(experiment.trajectory, span), during(experiment.pusher, span)
    corners = top_view.swept_points(scene.pushers[0].shape, pusher.pose)
    for track in (measured, estimates.trajectory):
        corners += top_view.swept_points(scene.bodies[0].shape, track.pose)
    names, n_fixel = estimates.prior.names, estimates.touch.shape[1]
    page = top_view.column_page(
        top_view.extent_of(corners, scene.fixels, scene.bodies[0].shape),
        ("x [mm]", "y [mm]", "θ [deg]", *(LABELS.get(name, name) for name in names)),
        [top_view.PANEL] * 3 + [FLAT * top_view.PANEL] * len(names),
        [f.name for f in scene.fixels][:n_fixel],
        2.0 * top_view.STRIP_ROW,
    )
    handles = _draw_view(page.view, scene, pusher.pose[-1], measured, estimates)
    _draw_poses(page.panels[:3], measured, estimates)
    _draw_parameters(page.panels[3:], estimates)
    _draw_touches(page.strip, experiment, estimates)
    _set_time(page.against_time, estimates)
    handles.append(Patch(facecolor=palette.TRAIL, alpha=0.4, label="90 %"))
    if n_fixel:
        handles.append(Patch(facecolor=palette.INK, label="fixel in contact"))
        handles.append(Patch(facecolor=palette.TOUCHED, label="contact, estimated"))
    return top_view.finish_page(page, handles, f"{experiment.key}, filtered", experiment)


def _draw_view(
    axes: Axes, scene: Scene, pusher: FloatArray, measured: Trajectory, estimates: FilterRun
) -> list[Artist]:
    handles = top_view.add_fixels(axes, scene)
    style = top_view.solid(tint(palette.PUSHER, 0.45), palette.PUSHER, 0.8, zorder=1.9)
    outlines = [placed(scene.pushers[0].shape.outline, pusher)]
    handles += top_view.add_outlines(axes, outlines, label="pusher, end", **style)
    what = "measured" if estimates.experiment.real else "recorded"
    handles += _outlines(axes, scene.bodies[0].shape, measured, estimates, what)
    way = measured.pose[:, :2].T * top_view.MM.factor
    (line,) = axes.plot(*way, color=palette.INK, linewidth=1.0, zorder=3.4,
                        label=f"{what}, trajectory")  # fmt: skip
    return [*handles, line, *_estimated_path(axes, estimates)]


def _outlines(
    axes: Axes, shape: Shape, measured: Trajectory, estimates: FilterRun, what: str
) -> list[Artist]:
    """Draw the object at start, end and the end of the occlusion, where errors are largest."""
    dotted = top_view.hollow(palette.FIXEL, linestyle=top_view.DOTTED, zorder=1.5)
    first = placed(shape.outline, measured.pose[0])
    handles = top_view.add_outlines(axes, [first], label="start", **dotted)
    instants = [estimates.time[-1]]
    if estimates.hidden.any():
        instants.append(estimates.time[estimates.hidden][-1])
    for track, colour, label in (
        (measured, palette.INK, what),
        (estimates.trajectory, palette.BODY, "estimated"),
    ):
        outlines = [placed(shape.outline, track.at(instant)) for instant in instants]
        full = top_view.hollow(colour, label=f"{label}, end", zorder=2.5)
        handles += top_view.add_outlines(axes, outlines[:1], **full)
        if len(outlines) > 1:
            dashed = top_view.hollow(
                colour, label=f"{label}, last hidden", linestyle=top_view.DASHED, zorder=2.4
            )
            handles += top_view.add_outlines(axes, outlines[1:], **dashed)
    return handles


def _estimated_path(axes: Axes, estimates: FilterRun) -> list[Artist]:
    way = estimates.pose[:, :2] * top_view.MM.factor
    (seen,) = axes.plot(*way.T, color=palette.BODY, linewidth=1.0, zorder=3.5,
                        label="estimated trajectory")  # fmt: skip
    hidden = estimates.hidden
    if not hidden.any():
        return [seen]
    masked = np.where(hidden[:, None], way, np.nan)
    (dark,) = axes.plot(*masked.T, color=HIDDEN, linewidth=1.6, zorder=3.6,
                        label="estimated while hidden")  # fmt: skip
    return [seen, dark]


def _draw_poses(panels: Sequence[Axes], measured: Trajectory, estimates: FilterRun) -> None:
    """Draw estimates with their 90 % bands, and measured poses."""
    deviation = np.sqrt(np.diagonal(estimates.covariance, axis1=1, axis2=2))
    angle = np.unwrap(measured.pose[:, 2])
    # Shift measured angles by whole turns, to be near the estimated ones.
    shift = estimates.pose[0, 2] - angle[0]
    angle = angle + shift - wrapped(shift)
    columns = (measured.pose[:, 0], measured.pose[:, 1], angle)
    factors = (top_view.MM.factor, top_view.MM.factor, 180.0 / np.pi)
    for k, (axes, column, factor) in enumerate(zip(panels, columns, factors, strict=True)):
        middle, half = estimates.pose[:, k], NINETY * deviation[:, k]
        _band(axes, estimates.time, factor * (middle - half), factor * (middle + half))
        axes.plot(measured.time, factor * column, color=palette.INK, linewidth=0.9)
        axes.plot(estimates.time, factor * middle, color=palette.BODY, linewidth=0.9)


def _draw_parameters(panels: Sequence[Axes], estimates: FilterRun) -> None:
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


def _draw_touches(axes: Axes | None, experiment: Experiment, estimates: FilterRun) -> None:
    """Draw a row per fixel: above its readings, below the estimated probability of contact."""
    if axes is None:
        return
    time = estimates.time
    channel = experiment.channel("tactile")
    for row in range(estimates.touch.shape[1]):
        if channel is not None and row < channel.values.shape[1]:
            felt = channel.values[:, row] > 0.5
            kept = (channel.time >= time[0] - 1e-6) & (channel.time <= time[-1] + 1e-6)
            spans = top_view.touch_spans(channel.time[kept], felt[kept])
            axes.broken_barh(spans, (row - 0.40, 0.36), facecolor=palette.INK, linewidth=0.0)
        base, height = row + 0.40, 0.36
        top = base - height * estimates.touch[:, row]
        axes.fill_between(time, base, top, color=palette.TOUCHED, linewidth=0.0)


def _set_time(every: Sequence[Axes], estimates: FilterRun) -> None:
    """Set the time axes of all panels, with a shade while the object is hidden."""
    top_view.time_axes(every, estimates.time)
    for k, axes in enumerate(every):
        if estimates.occlusion is not None:
            axes.axvspan(*estimates.occlusion, color=HIDDEN, alpha=0.12, linewidth=0.0, zorder=0.1)
        if k < 3:
            axes.locator_params(axis="y", nbins=4, steps=[1, 2, 5, 10])
            axes.margins(y=0.1)
        elif k < 3 + len(estimates.prior.names):
            axes.locator_params(axis="y", nbins=3)
