"""Figures of replays: measured and simulated pushes side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.datasets.mit_push import MitPushes
from fixel.datasets.mit_push_records import TIP
from fixel.drawing import palette
from fixel.drawing.chart import sheet
from fixel.model import Experiment, Fixel, Trajectory, placed
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DASHED, _DOTTED = (0, (4, 1.5)), (0, (1, 1))

# Label, colour and line style of each model; measurements are black.
STYLES = {
    "fixel": ("fixel", palette.BODY, "-"),
    "poly4": ("published, poly4", palette.PUSHER, _DASHED),
    "quad": ("published, quadratic", palette.CONE, _DOTTED),
    "measured": ("measured", palette.INK, "-"),
    "laboratory": ("laboratory's simulation", palette.PUSHER, _DASHED),
}


WIDE: Final = 2.0 * palette.COLUMN + 0.2  # width of a figure over two columns [inch]
SHOWN: Final = 0.97  # share of the errors within the axes of their distributions


def closed(outline: FloatArray, per_metre: float = 1e3) -> FloatArray:
    """Coordinates (2, n + 1) of a closed outline, for plotting."""
    return np.asarray(np.vstack((outline, outline[:1])).T * per_metre)


def ring(centre: FloatArray, radius: float) -> FloatArray:
    """Coordinates (2, n) of a circle [mm] of a radius [m]."""
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    return np.asarray(radius * 1e3 * np.array([np.cos(turn), np.sin(turn)]) + centre[:, None])


def hide_spines(axes: Axes) -> None:
    """Hide the upper and right spines."""
    axes.spines[["top", "right"]].set_visible(False)


def label_fixels(axes: Axes, fixels: Sequence[Fixel], below: float) -> None:
    """Draw round fixels, with their numbers some points below."""
    for number, fixel in enumerate(fixels, 1):
        centre = fixel.pose[:2] * 1e3
        axes.fill(*ring(centre, fixel.shape.radius), color=palette.FIXEL)
        axes.annotate(f"fixel {number}", tuple(centre), (0.0, below), ha="center",
                      textcoords="offset points")  # fmt: skip


def style_of(name: str) -> dict[str, Any]:
    """Return label, colour and line style of a model."""
    return dict(zip(("label", "color", "linestyle"), STYLES[name], strict=True))


def pushes_figure(
    data: MitPushes,
    chosen: IntArray,
    examples: Sequence[int],
    ends: Mapping[str, FloatArray],
    errors: Mapping[str, tuple[FloatArray, FloatArray]],
) -> Figure:
    """Draw the errors of the chosen pushes, and top views of a few rows.

    Parameters
    ----------
    ends : mapping from model to (n, 3) float64
        Predicted end poses.
    errors : mapping from model to pair of (n,) float64
        Errors of position [mm] and angle [deg].
    """
    figure = sheet(WIDE, 4.7)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    above, below = parts
    left, right = above.subplots(1, 2)
    for k, (axes, what) in enumerate(
        ((left, "position error at the end [mm]"), (right, "angle error at the end [deg]"))
    ):
        _error_curves(axes, {name: pair[k][chosen] for name, pair in errors.items()}, what)
    left.set_ylabel("share of pushes below")
    right.legend(frameon=False, loc="lower right")
    row = below.subplots(1, max(len(examples), 1), squeeze=False)[0]
    for axes, push in zip(row, examples, strict=False):
        shown = {name: ends[name][push] for name in ("fixel", "poly4") if name in ends}
        _push(axes, data, push, shown, float(errors["fixel"][0][push]))
    if examples:
        below.axes[0].set_ylabel("y from the start [mm]")
        # One legend for all panels, from the one with most entries.
        full = max(below.axes, key=lambda axes: len(axes.get_legend_handles_labels()[0]))
        handles, labels = full.get_legend_handles_labels()
        below.legend(handles, labels, frameon=False, ncols=5, loc="outside lower center")
    return figure


def _error_curves(axes: Axes, errors: Mapping[str, FloatArray], label: str) -> None:
    """Draw empirical distributions of errors; a dot marks the median."""
    far = 1.0
    for name, values in errors.items():
        ordered = np.sort(values[np.isfinite(values)])
        if not len(ordered):
            continue
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        median = float(np.median(ordered))
        style = style_of(name)
        style["label"] += f" (n = {len(ordered)})"
        axes.step(ordered, share, where="post", linewidth=1.2, **style)
        axes.plot([median], [0.5], "o", markersize=3.0, color=STYLES[name][1])
        far = max(far, float(np.quantile(ordered, SHOWN)))
    axes.set(xlabel=label, xlim=(0.0, far), ylim=(0.0, 1.0))
    axes.grid(color=palette.FAINT, linewidth=0.4)
    hide_spines(axes)


def _push(
    axes: Axes, data: MitPushes, push: int, ends: Mapping[str, FloatArray], error_mm: float
) -> None:
    """Draw the top view of one push, with its simulated ends."""
    outline, start = data.bodies[str(data.shape[push])].shape.outline, data.start[push]

    def outline_at(pose: FloatArray) -> FloatArray:
        return closed(placed(outline, pose) - start[:2])

    axes.fill(*outline_at(start), color=palette.FAINT, label="start, measured")
    axes.plot(*outline_at(data.end[push]), color=palette.INK, linewidth=1.4, label="end, measured")
    for name, pose in ends.items():
        if np.isfinite(pose).all():
            style = style_of(name)
            style["label"] = "end, " + style["label"]
            axes.plot(*outline_at(pose), linewidth=1.0, **style)
    tips = (data.tip_start[push], data.tip_end[push])
    first, last = ((place - start[:2]) * 1e3 for place in tips)
    axes.annotate(
        "",
        tuple(last),
        tuple(first),
        arrowprops={"arrowstyle": "->", "color": palette.FIXEL, "linewidth": 0.8},
    )
    for centre in (first, last):
        axes.plot(*ring(centre, TIP.radius), color=palette.FIXEL, linewidth=0.8)
    axes.plot([], [], color=palette.FIXEL, linewidth=0.8, label="tip and stroke")
    name = str(data.names[push]).replace("_", " ")
    axes.set_aspect("equal")
    axes.set(title=f"{name}\noff by {error_mm:.1f} mm")
    axes.set_xlabel("x from the start [mm]")
    hide_spines(axes)


def trial_figure(
    experiment: Experiment, curves: Mapping[str, Trajectory], actuator: FloatArray
) -> Figure:
    """Draw the motions of the object in one trial, the measured one first.

    Parameters
    ----------
    actuator : (n, 3) float64
        Measured poses of the actuator [m, m, rad].
    """
    figure = sheet(WIDE, 3.6)
    parts: Any = figure.subfigures(1, 2, width_ratios=(0.85, 1.0))
    left, right = parts
    _above(left.subplots(), experiment, curves, actuator)
    axes = right.subplots(3, 1, sharex=True)
    labels = ("x [mm]", "y [mm]", "angle [deg]")
    for k, (own, label) in enumerate(zip(axes, labels, strict=True)):
        for name, curve in curves.items():
            values = curve.pose[:, k] * 1e3 if k < 2 else np.degrees(np.unwrap(curve.pose[:, 2]))
            own.plot(curve.time, values, linewidth=1.2, **style_of(name))
        own.set_ylabel(label)
        own.grid(color=palette.FAINT, linewidth=0.4)
        hide_spines(own)
    axes[-1].set_xlabel("time since the actuator started [s]")
    axes[0].set_title(f"experiment {experiment.name}")
    left.legend(frameon=False, loc="outside lower center", ncols=2)
    return figure


def _above(
    axes: Axes, experiment: Experiment, curves: Mapping[str, Trajectory], actuator: FloatArray
) -> None:
    """Draw outlines at start and end, paths of the object's frame, fixels and actuator."""
    scene = experiment.scene
    assert scene is not None
    outline = scene.bodies[0].shape.outline
    start = next(iter(curves.values())).pose[0]
    axes.fill(*closed(placed(outline, start)), color=palette.FAINT, label="object, start")
    for name, curve in curves.items():
        axes.plot(*closed(placed(outline, curve.pose[-1])), linewidth=1.2, **style_of(name))
        axes.plot(*(curve.pose[:, :2].T * 1e3), linewidth=0.6, color=STYLES[name][1])
    label_fixels(axes, scene.fixels, -11.0)
    for pose, shade in ((actuator[0], palette.FAINT), (actuator[-1], palette.FIXEL)):
        corners = closed(placed(scene.pushers[0].shape.outline, pose))
        axes.plot(*corners, color=shade, linewidth=1.0)
    axes.plot([], [], color=palette.INK, linewidth=0.6, label="path of the object's frame")
    axes.plot([], [], color=palette.FIXEL, linewidth=1.0, label="actuator, start and end")
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    hide_spines(axes)
