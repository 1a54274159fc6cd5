"""Request, base, result and figures of replays: selection of records, parts to simulate, rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fixel import model
from fixel.datasets.mit_push import MitPushes
from fixel.datasets.mit_push_records import TIP
from fixel.drawing import palette
from fixel.drawing.chart import clean, sheet
from fixel.drawing.top_view import MM, closed_line, plain_view
from fixel.errors import InvalidInput, check_name, unknown_name
from fixel.typing import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Place of the pusher of a template, clear of the object [m].
CLEAR_DISTANCE = 1.0


Row = dict[str, Any]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRequest:
    """Request of a replay: records, values and method."""

    # Values of columns, all of which a record must have.
    select: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    limit: int | None = None  # maximum number of records, spread evenly over those selected
    # Values that replace the nominal ones.
    settings: Mapping[str, float] = field(default_factory=dict)
    motion: str | None = None  # name of a motion model; by default that of the dataset
    everything: bool = False  # whether to include records that the quality filter would exclude
    window: float = 2.0  # length of the windows of long runs [s]; 0 for whole runs


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """Result of replaying recorded pushes."""

    dataset: str
    pushes: list[Row]  # plain numbers for each push, window or run; units are in the names
    groups: list[Row]  # aggregates; the last one includes all records, if there are several
    left_out: dict[str, int]  # number of records that were not replayed, by reason
    not_solved: int  # number of simulations that did not finish; aggregates exclude them
    settings: Row  # values and methods, sufficient to repeat the replay
    notes: list[str]  # remarks on the treatment of the data, in sentences
    figure: Callable[[], Figure] = field(repr=False)  # draws the replay
    # Wall times of the parts [s]; `per_second` counts the simulation alone.
    timing: Row = field(default_factory=dict)

    def summary(self) -> Row:
        """Return the output of `fixel replay --json`."""
        names = ("dataset", "settings", "left_out", "not_solved", "groups", "notes", "timing")
        return {name: getattr(self, name) for name in (*names, "pushes")}


class AbstractReplay(ABC):
    """Base class of replays, which read a dataset and simulate the requested records."""

    # Parts that are simulated at once: name, number of records, and what `simulate` takes.
    parts: list[tuple[str, int, Any]]

    @abstractmethod
    def __init__(self, folder: Path, request: ReplayRequest) -> None:
        """Read the dataset and select its parts."""

    @abstractmethod
    def simulate(self, item: Any) -> Any:
        """Simulate one part."""

    @abstractmethod
    def result(self, outcomes: list[Any]) -> Replay:
        """Compare the outcomes of all parts with the measurements."""


def template(
    body: model.Body, tip: model.Disk, settings: dict[str, float], speed: float, duration: float
) -> model.Scene:
    """Build a scene whose starts and paths vary: a tip clear of a body with even pressure.

    Measured starts may overlap, due to noise of the tracker; the first step separates them.
    """
    n_points = settings["support_points"]
    if n_points != int(n_points):
        raise InvalidInput("settings support_points", found=n_points, expected="a whole number")
    support = model.UniformPressure(friction=settings["mu_support"], n_points=int(n_points))
    return model.Scene(
        bodies=(replace(body, name="object", pose=np.zeros(3), support=support),),
        pushers=(
            model.Pusher(
                name="pusher",
                shape=tip,
                pose=np.array([CLEAR_DISTANCE, 0.0, 0.0]),
                drive=model.LineDrive(direction=np.array([1.0, 0.0]), speed=speed),
                friction=settings["mu_pusher"],
            ),
        ),
        duration=duration,
    )


# --- selection and settings ----------------------------------------------------------------------


def columns_and_values(pairs: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Parse `["shape=rect1", "shape=hex"]` to a mapping from column to requested values."""
    wanted: dict[str, tuple[str, ...]] = {}
    for pair in pairs:
        name, _, value = (part.strip() for part in pair.partition("="))
        if not (name and value):
            expected = "COLUMN=VALUE, as in shape=rect1"
            raise InvalidInput("select", found=repr(pair), expected=expected)
        wanted[name] = (*wanted.get(name, ()), value)
    return wanted


def matching(
    columns: Mapping[str, Sequence[object]], wanted: Mapping[str, tuple[str, ...]], n: int
) -> NDArray[np.bool_]:
    """Mask (n,) of the matching records; raise if a column or a value occurs in none of them."""
    fits = np.ones(n, dtype=bool)
    for name, values in wanted.items():
        check_name("select", name, columns)
        cells = [str(cell) for cell in columns[name]]
        for value in values:
            if not any(_same(cell, value) for cell in set(cells)):
                raise unknown_name(f"select {name}", value, sorted(set(cells)))
        chosen = {cell for cell in set(cells) if any(_same(cell, value) for value in values)}
        fits &= np.array([cell in chosen for cell in cells], dtype=bool)
    if not fits.any():
        found = ", ".join(f"{name}={'|'.join(values)}" for name, values in wanted.items())
        expected = "values that occur together in at least one record"
        raise InvalidInput("select", found=found, expected=expected)
    return fits


def only_doubtful(what: str) -> InvalidInput:
    """Return the error for a selection in which all pushes or windows are doubtful."""
    found = f"only {what} of doubtful quality"
    return InvalidInput("select", found=found, expected="others", hint="try everything=True")


def spread(n: int, limit: int | None) -> NDArray[np.intp]:
    """Select at most `limit` of `n` records, evenly spread, in order."""
    if limit is None or limit >= n:
        return np.arange(n)
    return np.arange(limit) * n // limit


def settings_from(nominal: Mapping[str, float], given: Mapping[str, float]) -> dict[str, float]:
    """Replace nominal values by given ones; raise for unknown names."""
    for name in given:
        check_name("settings", name, nominal)
    return {**nominal, **given}


def _same(cell: str, value: str) -> bool:
    try:
        return cell == value or float(cell) == float(value)
    except ValueError:
        return False


def errors_in_mm_and_deg(
    predicted: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances of the frames' origins [mm] and absolute angles between them [deg]."""
    position, angle = model.pose_error(predicted, measured)
    missing = np.isnan(predicted).any(axis=1)
    return (
        np.where(missing, np.nan, position * 1e3),
        np.where(missing, np.nan, np.degrees(np.abs(angle))),
    )


def mean_and_median(values: ArrayLike) -> Row:
    """Mean and median of the finite numbers; None if there are none."""
    numbers = np.asarray(values, dtype=np.float64)
    numbers = numbers[np.isfinite(numbers)]
    if not numbers.size:
        return {"mean": None, "median": None}
    return {"mean": float(numbers.mean()), "median": float(np.median(numbers))}


def rms(values: ArrayLike) -> float:
    """Root mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


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


def ring(centre: FloatArray, radius: float) -> FloatArray:
    """Coordinates (2, n) of a circle [mm] of a radius [m]."""
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    return np.asarray(radius * 1e3 * np.array([np.cos(turn), np.sin(turn)]) + centre[:, None])


def hide_spines(axes: Axes) -> None:
    """Hide the upper and right spines."""
    axes.spines[["top", "right"]].set_visible(False)


def label_fixels(axes: Axes, fixels: Sequence[model.Fixel], below: float) -> None:
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

    Predicted `ends` (n, 3) and errors of position [mm] and angle [deg] are those of each model.
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
    clean(axes)


def _push(
    axes: Axes, data: MitPushes, push: int, ends: Mapping[str, FloatArray], error_mm: float
) -> None:
    """Draw the top view of one push, with its simulated ends."""
    outline, start = data.bodies[str(data.shape[push])].shape.outline, data.start[push]

    def outline_at(pose: FloatArray) -> FloatArray:
        return closed_line(model.placed(outline, pose) - start[:2])

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
    experiment: model.Experiment, curves: Mapping[str, model.Trajectory], actuator: FloatArray
) -> Figure:
    """Draw the motions of the object in one trial, the measured one first, and the actuator's.

    `actuator` (n, 3) has its measured poses [m, m, rad].
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
        clean(own)
    axes[-1].set_xlabel("time since the actuator started [s]")
    axes[0].set_title(f"experiment {experiment.name}")
    left.legend(frameon=False, loc="outside lower center", ncols=2)
    return figure


def _above(
    axes: Axes,
    experiment: model.Experiment,
    curves: Mapping[str, model.Trajectory],
    actuator: FloatArray,
) -> None:
    """Draw outlines at start and end, paths of the object's frame, fixels and actuator."""
    scene = experiment.scene
    assert scene is not None
    outline = scene.bodies[0].shape.outline
    start = next(iter(curves.values())).pose[0]
    axes.fill(
        *closed_line(model.placed(outline, start)), color=palette.FAINT, label="object, start"
    )
    for name, curve in curves.items():
        axes.plot(
            *closed_line(model.placed(outline, curve.pose[-1])), linewidth=1.2, **style_of(name)
        )
        axes.plot(*(curve.pose[:, :2].T * 1e3), linewidth=0.6, color=STYLES[name][1])
    label_fixels(axes, scene.fixels, -11.0)
    for pose, shade in ((actuator[0], palette.FAINT), (actuator[-1], palette.FIXEL)):
        corners = closed_line(model.placed(scene.pushers[0].shape.outline, pose))
        axes.plot(*corners, color=shade, linewidth=1.0)
    axes.plot([], [], color=palette.INK, linewidth=0.6, label="path of the object's frame")
    axes.plot([], [], color=palette.FIXEL, linewidth=1.0, label="actuator, start and end")
    plain_view(axes, MM, margin=0.08)
