"""Charts of ensembles of outcomes over a scene, of many runs, and of Sobol indices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark
from fixel.drawing.top_view import closed_line, plain_view
from fixel.drawing.view import UNITS, evenly, unit_for
from fixel.errors import InvalidInput
from fixel.model import Goal, Scene, placed
from fixel.simulation import BatchResult
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.outcomes import Sensitivity
from fixel.uncertainty.prediction import Prediction
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = (
    palette.BODY, palette.FORCE, palette.TOUCHED, palette.CONE, palette.PUSHER, palette.TRAIL,
    palette.FIXEL, palette.INK,
)  # fmt: skip

OUTLINES: Final = 60  # maximum number of end poses drawn as outlines
DOTS: Final = 2000
BINS: Final = 40


class OutcomePoses(NamedTuple):
    """End poses of a body over a scene, by outcome."""

    scene: Scene
    drawn: FloatArray  # (n, 3) errors of the start pose [m, m, rad]
    end: FloatArray  # (n, 3) end poses [m, m, rad]
    nominal: FloatArray  # (3,) end pose without an error of the start
    outcome: IntArray  # (n,) outcome of each end pose, from 0
    share: Sequence[float]  # share of each outcome
    names: Sequence[str] = ()  # names of the outcomes; by default numbers


def ends_chart(ends: OutcomePoses, title: str = "") -> Chart:
    """Draw end poses of a body over its scene, with start errors, end positions and end angles."""
    names = ("x_m", "y_m", "theta_rad")
    return Chart(
        title=title,
        size=(chart.WIDE, 4.3),
        fill=lambda figure: _draw_ends(figure, ends),
        data=Table.from_columns(
            {f"start_error_{name}": ends.drawn[:, k] for k, name in enumerate(names)}
            | {f"end_{name}": ends.end[:, k] for k, name in enumerate(names)}
            | {"outcome": ends.outcome + 1}
        ),
    )


def _draw_ends(figure: Figure, ends: OutcomePoses) -> None:
    axes_of = figure.subplot_mosaic(
        [["scene", "starts"], ["scene", "ends"], ["scene", "angles"]], width_ratios=(1.9, 1.0)
    )
    _scene(axes_of["scene"], ends)
    every = max(1, len(ends.end) // DOTS)
    for name, cloud, label in (
        ("starts", ends.drawn, "start error"),
        ("ends", ends.end - ends.nominal, "end, from the nominal"),
    ):
        size = float(np.abs(cloud[:, :2]).max())
        unit = UNITS[0] if size < 1e-4 else UNITS[1] if size < 0.5 else UNITS[2]
        axes = axes_of[name]
        for k in range(len(ends.share)):
            own = cloud[::every][ends.outcome[::every] == k] * unit.factor
            axes.plot(own[:, 0], own[:, 1], ".", color=_colour(k), markersize=1.6)
        axes.set(xlabel=f"{label}, x [{unit.name}]", ylabel=f"y [{unit.name}]")
        _no_narrower(axes, float(np.ptp(cloud[:, :2], axis=0).max()) * unit.factor)
        chart.clean(axes)
        _few_numbers(axes)
    _angles(axes_of["angles"], ends)
    chart.legend_below(figure, [axes_of["scene"]], most=4)


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _scene(axes: Axes, ends: OutcomePoses) -> None:
    scene = ends.scene
    body = scene.bodies[0]
    corners = body.shape.outline
    unit = unit_for(float(np.ptp(placed(corners, body.pose), axis=0).max()))

    def outline_at(pose: FloatArray, outline: FloatArray = corners) -> FloatArray:
        return closed_line(placed(outline, pose), unit)

    for fixel in scene.fixels:
        axes.fill(*outline_at(fixel.pose, fixel.shape.outline), color=palette.FIXEL)
    for pusher in scene.pushers:
        outline = outline_at(pusher.pose, pusher.shape.outline)
        axes.fill(*outline, color=chart.tint(palette.PUSHER, 0.5), label="pusher, at the start")
    axes.plot(*outline_at(body.pose), "--", color=palette.INK, linewidth=0.8, label="start")
    chosen = evenly(len(ends.end), OUTLINES)
    for k in range(len(ends.share)):
        name = f"{ends.names[k] if ends.names else f'outcome {k + 1}'}: {ends.share[k]:.0%}"
        if len(ends.share) == 1 and not ends.names:
            name = "ends"
        # Draw at least one pose of a rare outcome.
        own = [j for j in chosen if ends.outcome[j] == k] or [int(np.argmax(ends.outcome == k))]
        for j in own:
            outline = outline_at(ends.end[j])
            axes.plot(*outline, color=_colour(k), linewidth=0.5, alpha=0.35)
        axes.plot([], [], color=_colour(k), linewidth=1.2, label=name)
    axes.plot(*outline_at(ends.nominal), color=palette.INK, linewidth=1.4, label="nominal")
    plain_view(axes, unit)


def _angles(axes: Axes, ends: OutcomePoses) -> None:
    angle = np.degrees(ends.end[:, 2] - ends.nominal[2])
    low, high = float(angle.min()), float(angle.max())
    if high - low < 1e-3:
        low, high = low - 5e-4, high + 5e-4
    edges = np.linspace(low, high, BINS + 1)
    groups = [angle[ends.outcome == k] for k in range(len(ends.share))]
    colours = [_colour(k) for k in range(len(groups))]
    axes.hist(groups, bins=edges.tolist(), color=colours, stacked=True)
    axes.axvline(0.0, color=palette.INK, linewidth=1.0)
    axes.set(xlabel=f"end angle, from {math.degrees(ends.nominal[2]):z.1f} [deg]", ylabel="starts")
    chart.clean(axes)
    _few_numbers(axes)


def _few_numbers(axes: Axes) -> None:
    """Reduce tick labels so that even ten characters each fit side by side in a small panel."""
    axes.locator_params(axis="x", nbins=3)
    axes.locator_params(axis="y", nbins=4)
    axes.tick_params(axis="x", pad=4.0)  # below the lowest number of the other axis


def _no_narrower(axes: Axes, size: float) -> None:
    """Widen limits to at least a hundredth of a size, so that rounding errors are not magnified."""
    for limits, set_limits in ((axes.get_xlim(), axes.set_xlim), (axes.get_ylim(), axes.set_ylim)):
        middle, half = 0.5 * sum(limits), 0.5 * (limits[1] - limits[0])
        if half < 0.005 * size:
            set_limits(middle - 0.005 * size, middle + 0.005 * size)


def sensitivity_chart(found: Sensitivity, title: str = "") -> Chart:
    """Draw end poses over the scene, coloured by outcome, with start errors and end angles."""
    own = found.prediction
    drawn = own.drawn[own.ended]
    ends = OutcomePoses(own.scene, drawn, own.ends, own.nominal[-1], found.outcome, found.share)
    return ends_chart(ends, title or f"Sensitivity: {found.flag}")


def prediction_chart(found: Prediction, *, goal: Goal | None = None) -> Chart:
    """Draw end poses over the scene, coloured by contact mode, or by whether they meet a goal."""
    if goal is None:
        fixels = [fixel.name for fixel in found.scene.fixels]
        modes = list(found.modes)
        own = found.mode[found.ended]
        outcome = np.array([modes.index(mode) for mode in own.tolist()])
        names = [_touched(fixels, mode) for mode in modes] if fixels else ["ends"]
    else:
        outcome = np.where(found.meets(goal), 0, 1)
        names = ["goal met", "goal not met"]
    share = np.bincount(outcome, minlength=len(names)) / len(outcome)
    some = np.flatnonzero(share > 0.0)
    ends = OutcomePoses(
        scene=found.scene,
        drawn=found.drawn[found.ended],
        end=found.ends,
        nominal=found.nominal[-1],
        outcome=np.searchsorted(some, outcome),
        share=share[some].tolist(),
        names=[names[k] for k in some],
    )
    return ends_chart(
        ends, "Prediction" if goal is None else f"P(goal) = {found.probability(goal)}"
    )


def _touched(fixels: Sequence[str], mode: str) -> str:
    touched = [name for name, digit in zip(fixels, mode, strict=True) if digit == "1"]
    return f"touches {', '.join(touched)}" if touched else "touches nothing"


def indices_chart(found: Sensitivity, title: str = "Sobol indices") -> Chart:
    """Draw the Sobol indices of a sensitivity, one panel per coordinate of the end.

    A sensitivity without indices raises `InvalidInput`.
    """
    own = found.indices
    if own is None:
        hint = "compute them with indices=True"
        raise InvalidInput(
            "kind", found="no indices", expected="a sensitivity with them", hint=hint
        )
    names = [factor.name for factor in own.factors]
    parts = {"first": own.first, "first_error": own.first_error, "total": own.total,
             "total_error": own.total_error}  # fmt: skip
    row: list[Mark] = []
    at = np.arange(len(names))
    for k, outcome in enumerate(own.outcomes):
        unit = displayed(own.units[k])
        top = max(1.0, float(np.max(own.total[k] + own.total_error[k])))
        row.append(
            chart.panel(
                chart.bars(at - 0.2, own.first[k], 0.36, xerr=own.first_error[k],
                           color=palette.BODY, label="first order: alone", error_kw=chart.WHISKER),
                chart.bars(at + 0.2, own.total[k], 0.36, xerr=own.total_error[k],
                           color=palette.PUSHER, label="total: with all others",
                           error_kw=chart.WHISKER),
                title=f"{outcome}: {unit.text(float(own.deviation[k]))} {unit.name}",
                rows=[] if row else [chart.shorten(name, 24) for name in names],
                xlabel="share of the variance",
                xlim=(min(0.0, float(np.min(own.first[k] - own.first_error[k]))), 1.02 * top),
            )
        )  # fmt: skip
    return Chart(
        title=title,
        size=(chart.WIDE, 0.95 + 0.24 * len(names)),
        fill=chart.panels([row], sharey=True),
        data=Table.from_columns(
            {
                "outcome": [name for name in own.outcomes for _ in names],
                "input": names * len(own.outcomes),
                **{name: values.ravel() for name, values in parts.items()},
            }
        ),
    )


def runs_chart(runs: BatchResult, *, body: str | None = None) -> Chart:
    """Draw histograms of the end poses of a body, by default the first, over many runs.

    Runs that stopped early are left out.
    """
    name = body or runs.names[0]
    ends = runs[runs.converged][name].final
    row: list[Mark] = []
    for label, values, unit in zip(("x", "y", "angle"), ends, ("m", "m", "rad"), strict=True):
        shown = displayed(unit)
        counts = chart.histogram(np.asarray(values) * shown.factor, bins="auto", color=palette.BODY)
        row.append(chart.panel(counts, xlabel=shown.on(label), ylabel="" if row else "runs"))
    return Chart(
        title=f"{name} at the end of {len(ends.x)} runs",
        size=(chart.WIDE, 2.0),
        fill=chart.panels([row]),
        data=Table.from_columns({"x_m": ends.x, "y_m": ends.y, "angle_rad": ends.theta}),
    )
