"""Figures of replays: measured and simulated pushes side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import save_filled
from fixel.errors import InvalidInput
from fixel.model import placed
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENDINGS = (".pdf", ".png", ".svg")

# Label, colour and line style of each model; measurements are black.
LABELS = {
    "fixel": "fixel",
    "poly4": "published, poly4",
    "quad": "published, quadratic",
    "measured": "measured",
    "laboratory": "laboratory's simulation",
}
COLOURS = {
    "fixel": palette.BODY,
    "poly4": palette.PUSHER,
    "quad": palette.CONE,
    "measured": palette.INK,
    "laboratory": palette.PUSHER,
}
DASHES = {
    "fixel": "-",
    "poly4": (0, (4, 1.5)),
    "quad": (0, (1, 1)),
    "measured": "-",
    "laboratory": (0, (4, 1.5)),
}  # fmt: skip

WIDE = 2.0 * palette.COLUMN + 0.2  # width of a figure over two columns [inch]

# Share of the pushes within the axes of the error curves.
SHOWN = 0.97


class PushExample(NamedTuple):
    """Top view of one push; poses [m, m, rad]."""

    name: str
    outline: FloatArray  # (n, 2) in the frame of the object [m]
    start: FloatArray  # (3,)
    measured: FloatArray  # (3,) end pose
    predicted: Mapping[str, FloatArray]  # model -> (3,) end pose
    tip_start: FloatArray  # (2,)
    tip_end: FloatArray  # (2,)
    tip_radius: float
    error_mm: float


class PushPicture(NamedTuple):
    """Errors of all pushes, and top views of a few."""

    position: Mapping[str, FloatArray]  # model -> (n,) [mm]
    angle: Mapping[str, FloatArray]  # model -> (n,) [deg]
    examples: Sequence[PushExample]


class TrialCurve(NamedTuple):
    """Poses of the object against time, measured or of one model."""

    name: str
    time: FloatArray  # (n,) [s]
    pose: FloatArray  # (n, 3)


class TrialPicture(NamedTuple):
    """Curves and geometry of one grasp acquisition trial."""

    name: str
    outline: FloatArray
    curves: Sequence[TrialCurve]
    fixels: FloatArray  # (n, 2) [m]
    fixel_radius: float
    actuator_outline: FloatArray
    actuator_angle: float
    actuator: FloatArray  # (n, 2) [m]


class WindowCurve(NamedTuple):
    """Poses and errors in one window of a long run."""

    run: str
    time: FloatArray  # (n,) on the clock of the run [s]
    measured: FloatArray  # (n, 3)
    simulated: FloatArray  # (n, 3)
    position: FloatArray  # (n,) [m]
    angle: FloatArray  # (n,) [rad]


class WindowPicture(NamedTuple):
    """Figure of windows of long runs."""

    windows: Sequence[WindowCurve]


Picture = PushPicture | TrialPicture | WindowPicture


def draw(picture: Picture, file: str | Path) -> None:
    """Draw a replay to a file.

    Parameters
    ----------
    picture : PushPicture, TrialPicture or WindowPicture
    file : str or Path
        File to write (`.png`, `.svg` or `.pdf`).
    """
    path = Path(file)
    refuse_file(path)
    save_filled(lambda figure: _fill(figure, picture), path)


def _fill(figure: Figure, picture: Picture) -> None:
    if isinstance(picture, PushPicture):
        _pushes(figure, picture)
    elif isinstance(picture, TrialPicture):
        _trial(figure, picture)
    else:
        _windows(figure, picture)


def refuse_file(path: Path) -> None:
    """Raise `InvalidInput` for a file with another ending, or in a folder that does not exist."""
    if path.suffix.lower() not in ENDINGS:
        raise InvalidInput("--plot", found=path.name, expected="a file .png, .svg or .pdf")
    if not path.parent.is_dir():
        raise InvalidInput("--plot", found=f"no folder {path.parent}", expected="one that exists")


def _style(name: str) -> dict[str, Any]:
    return {"color": COLOURS[name], "linestyle": DASHES[name], "label": LABELS[name]}


def _clean(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)


def _pushes(figure: Figure, picture: PushPicture) -> None:
    n = max(len(picture.examples), 1)
    figure.set_size_inches(WIDE, 4.7)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.15))
    above, below = parts
    left, right = above.subplots(1, 2)
    _error_curves(left, picture.position, "position error at the end [mm]")
    _error_curves(right, picture.angle, "angle error at the end [deg]")
    left.set_ylabel("share of pushes below")
    right.legend(frameon=False, loc="lower right")
    for axes, example in zip(
        below.subplots(1, n, squeeze=False)[0], picture.examples, strict=False
    ):
        _push(axes, example)
    if picture.examples:
        below.axes[0].set_ylabel("y from the start [mm]")
        # One legend for all panels, from the one with most entries.
        full = max(below.axes, key=lambda axes: len(axes.get_legend_handles_labels()[0]))
        handles, labels = full.get_legend_handles_labels()
        below.legend(handles, labels, frameon=False, ncols=5, loc="outside lower center")


def _error_curves(axes: Axes, errors: Mapping[str, FloatArray], label: str) -> None:
    """Draw empirical distributions of errors; a dot marks the median."""
    far = 1.0
    for name, values in errors.items():
        ordered = np.sort(values[np.isfinite(values)])
        if not len(ordered):
            continue
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        median = float(np.median(ordered))
        style = _style(name)
        style["label"] += f" (n = {len(ordered)})"
        axes.step(ordered, share, where="post", linewidth=1.2, **style)
        axes.plot([median], [0.5], "o", markersize=3.0, color=COLOURS[name])
        far = max(far, float(np.quantile(ordered, SHOWN)))
    axes.set(xlabel=label, xlim=(0.0, far), ylim=(0.0, 1.0))
    axes.grid(color=palette.FAINT, linewidth=0.4)
    _clean(axes)


def _push(axes: Axes, example: PushExample) -> None:
    def closed(pose: FloatArray) -> FloatArray:
        corners = placed(example.outline, pose) - example.start[:2]
        return np.asarray(np.vstack((corners, corners[:1])).T * 1e3)

    axes.fill(*closed(example.start), color=palette.FAINT, label="start, measured")
    axes.plot(*closed(example.measured), color=palette.INK, linewidth=1.4, label="end, measured")
    for name, pose in example.predicted.items():
        style = _style(name)
        style["label"] = "end, " + style["label"]
        axes.plot(*closed(pose), linewidth=1.0, **style)
    first, last = ((p - example.start[:2]) * 1e3 for p in (example.tip_start, example.tip_end))
    axes.annotate(
        "",
        tuple(last),
        tuple(first),
        arrowprops={"arrowstyle": "->", "color": palette.FIXEL, "linewidth": 0.8},
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = example.tip_radius * 1e3 * np.array([np.cos(turn), np.sin(turn)])
    for centre in (first, last):
        axes.plot(*(ring + centre[:, None]), color=palette.FIXEL, linewidth=0.8)
    axes.plot([], [], color=palette.FIXEL, linewidth=0.8, label="tip and stroke")
    axes.set_aspect("equal")
    axes.set(title=f"{example.name.replace('_', ' ')}\noff by {example.error_mm:.1f} mm")
    axes.set_xlabel("x from the start [mm]")
    _clean(axes)


def _trial(figure: Figure, picture: TrialPicture) -> None:
    figure.set_size_inches(WIDE, 3.6)
    parts: Any = figure.subfigures(1, 2, width_ratios=(0.85, 1.0))
    left, right = parts
    _above(left.subplots(), picture)
    axes = right.subplots(3, 1, sharex=True)
    labels = ("x [mm]", "y [mm]", "angle [deg]")
    for k, (own, label) in enumerate(zip(axes, labels, strict=True)):
        for curve in picture.curves:
            values = curve.pose[:, k] * 1e3 if k < 2 else np.degrees(np.unwrap(curve.pose[:, 2]))
            own.plot(curve.time, values, linewidth=1.2, **_style(curve.name))
        own.set_ylabel(label)
        own.grid(color=palette.FAINT, linewidth=0.4)
        _clean(own)
    axes[-1].set_xlabel("time since the actuator started [s]")
    axes[0].set_title(picture.name)
    left.legend(frameon=False, loc="outside lower center", ncols=2)


def _above(axes: Axes, picture: TrialPicture) -> None:
    """Draw outlines at start and end, paths of the object's frame, fixels and actuator."""

    def closed(outline: FloatArray, pose: FloatArray) -> FloatArray:
        corners = placed(outline, pose)
        return np.asarray(np.vstack((corners, corners[:1])).T * 1e3)

    start = picture.curves[0].pose[0]
    axes.fill(*closed(picture.outline, start), color=palette.FAINT, label="object, start")
    for curve in picture.curves:
        axes.plot(*closed(picture.outline, curve.pose[-1]), linewidth=1.2, **_style(curve.name))
        axes.plot(*(curve.pose[:, :2].T * 1e3), linewidth=0.6, color=COLOURS[curve.name])
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = picture.fixel_radius * 1e3 * np.array([np.cos(turn), np.sin(turn)])
    for number, centre in enumerate(picture.fixels * 1e3):
        axes.fill(*(ring + centre[:, None]), color=palette.FIXEL)
        axes.annotate(f"fixel {number + 1}", centre, (0.0, -11.0), ha="center",
                      textcoords="offset points")  # fmt: skip
    for place, shade in (
        (picture.actuator[0], palette.FAINT),
        (picture.actuator[-1], palette.FIXEL),
    ):
        outline = closed(picture.actuator_outline, np.append(place, picture.actuator_angle))
        axes.plot(*outline, color=shade, linewidth=1.0)
    axes.plot([], [], color=palette.INK, linewidth=0.6, label="path of the object's frame")
    axes.plot([], [], color=palette.FIXEL, linewidth=1.0, label="actuator, start and end")
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
    _clean(axes)


def _windows(figure: Figure, picture: WindowPicture) -> None:
    names = list(dict.fromkeys(window.run for window in picture.windows))
    figure.set_size_inches(WIDE, 1.25 * max(len(names), 1) + 0.5)
    panels = figure.subplots(max(len(names), 1), 3, squeeze=False, width_ratios=(1.3, 1.0, 1.0))
    for row, name in zip(panels, names, strict=False):
        own = [window for window in picture.windows if window.run == name]
        for window in own:
            origin = own[0].measured[0, :2]
            row[0].plot(*((window.measured[:, :2] - origin).T * 1e3), linewidth=1.6,
                        **_style("measured"))  # fmt: skip
            row[0].plot(*((window.simulated[:, :2] - origin).T * 1e3), linewidth=1.0,
                        **_style("fixel"))  # fmt: skip
            row[1].plot(window.time, window.position * 1e3, color=palette.BODY, linewidth=1.0)
            row[2].plot(window.time, np.degrees(window.angle), color=palette.BODY, linewidth=1.0)
        row[0].set_title(_short(name), loc="left")
        row[0].set_ylabel("y [mm]")
        row[1].set_ylabel("error [mm]")
        row[2].set_ylabel("error [deg]")
        for axes in row:
            axes.grid(color=palette.FAINT, linewidth=0.4)
            _clean(axes)
    panels[-1, 0].set_xlabel("x from the start of the run [mm]")
    panels[-1, 1].set_xlabel("time [s]")
    panels[-1, 2].set_xlabel("time [s]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], frameon=False, ncols=2, loc="outside upper right")


def _short(name: str) -> str:
    """Name of a file without the parts that all names share."""
    return name.removeprefix("cpush_").removeprefix("StraightLine_2016_10_23_").replace("_", " ")
