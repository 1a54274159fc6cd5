"""Charts of ensembles of outcomes over a scene, and of Sobol indices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    DisplayUnit,
    clean,
    display_unit,
    legend_below,
    plot_axes,
    sheet,
    shorten,
    tint,
)
from fixel.drawing.top_view import closed_line
from fixel.drawing.view import UNITS, unit_for
from fixel.errors import InvalidInput
from fixel.model import Goal, Scene, placed
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.indices import Indices
from fixel.uncertainty.outcomes import Sensitivity
from fixel.uncertainty.prediction import Prediction

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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class EnsembleChart(AbstractChart):
    """End poses of a body over the scene, with start errors, end positions and end angles.

    Parameters
    ----------
    title : str
    scene : Scene
    drawn : (n, 3) float64
        Errors of the start pose [m, m, rad].
    end : (n, 3) float64
        End poses [m, m, rad].
    nominal : (3,) float64
        End pose without an error of the start.
    outcome : (n,) int64
        Outcome of each end pose, from 0.
    share : sequence of float
        Share of each outcome.
    names : sequence of str
        Names of the outcomes; by default numbers.
    """

    title: str
    scene: Scene
    drawn: FloatArray
    end: FloatArray
    nominal: FloatArray
    outcome: IntArray
    share: Sequence[float]
    names: Sequence[str] = ()

    @classmethod
    def of(cls, found: Sensitivity, title: str = "") -> EnsembleChart:
        """Return the chart of a sensitivity."""
        own = found.prediction
        return cls(
            title=title,
            scene=own.scene,
            drawn=own.drawn[own.ended],
            end=own.ends,
            nominal=own.nominal[-1],
            outcome=found.outcome,
            share=found.share,
        )

    def figure(self) -> Figure:
        figure = sheet(WIDE, 4.3, self.title)
        panels = figure.subplot_mosaic(
            [["scene", "starts"], ["scene", "ends"], ["scene", "angles"]],
            width_ratios=(1.9, 1.0),
        )
        _scene(panels["scene"], self)
        every = max(1, len(self.end) // DOTS)
        for name, cloud, label in (
            ("starts", self.drawn, "start error"),
            ("ends", self.end - self.nominal, "end, from the nominal"),
        ):
            unit = _unit_of_errors(float(np.abs(cloud[:, :2]).max()))
            axes = panels[name]
            for k in range(len(self.share)):
                own = cloud[::every][self.outcome[::every] == k] * unit.factor
                axes.plot(own[:, 0], own[:, 1], ".", color=_colour(k), markersize=1.6)
            axes.set(xlabel=f"{label}, x [{unit.name}]", ylabel=f"y [{unit.name}]")
            _no_narrower(axes, float(np.ptp(cloud[:, :2], axis=0).max()) * unit.factor)
            clean(axes)
            _few_numbers(axes)
        _angles(panels["angles"], self)
        legend_below(figure, [panels["scene"]], most=4)
        return figure

    def table(self) -> Table:
        names = ("x_m", "y_m", "theta_rad")
        return Table.from_columns(
            {f"start_error_{name}": self.drawn[:, k] for k, name in enumerate(names)}
            | {f"end_{name}": self.end[:, k] for k, name in enumerate(names)}
            | {"outcome": self.outcome + 1}
        )


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _scene(axes: Axes, chart: EnsembleChart) -> None:
    scene = chart.scene
    body = scene.bodies[0]
    corners = body.shape.outline
    unit = unit_for(float(np.ptp(placed(corners, body.pose), axis=0).max()))

    def outline_at(pose: FloatArray, outline: FloatArray = corners) -> FloatArray:
        return closed_line(placed(outline, pose), unit)

    for fixel in scene.fixels:
        axes.fill(*outline_at(fixel.pose, fixel.shape.outline), color=palette.FIXEL)
    for pusher in scene.pushers:
        outline = outline_at(pusher.pose, pusher.shape.outline)
        axes.fill(*outline, color=tint(palette.PUSHER, 0.5), label="pusher, at the start")
    axes.plot(*outline_at(body.pose), "--", color=palette.INK, linewidth=0.8, label="start")
    chosen = np.unique(np.linspace(0, len(chart.end) - 1, OUTLINES).round().astype(int))
    for k in range(len(chart.share)):
        name = f"{chart.names[k] if chart.names else f'outcome {k + 1}'}: {chart.share[k]:.0%}"
        if len(chart.share) == 1 and not chart.names:
            name = "ends"
        # Draw at least one pose of a rare outcome.
        own = [j for j in chosen if chart.outcome[j] == k] or [int(np.argmax(chart.outcome == k))]
        for j in own:
            outline = outline_at(chart.end[j])
            axes.plot(*outline, color=_colour(k), linewidth=0.5, alpha=0.35)
        axes.plot([], [], color=_colour(k), linewidth=1.2, label=name)
    axes.plot(*outline_at(chart.nominal), color=palette.INK, linewidth=1.4, label="nominal")
    axes.set_aspect("equal", adjustable="datalim")  # a flat panel would have no room for labels
    axes.margins(0.05)
    axes.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]")
    axes.spines[["top", "right"]].set_visible(False)


def _angles(axes: Axes, chart: EnsembleChart) -> None:
    angle = np.degrees(chart.end[:, 2] - chart.nominal[2])
    low, high = float(angle.min()), float(angle.max())
    if high - low < 1e-3:
        low, high = low - 5e-4, high + 5e-4
    edges = np.linspace(low, high, BINS + 1)
    groups = [angle[chart.outcome == k] for k in range(len(chart.share))]
    colours = [_colour(k) for k in range(len(groups))]
    axes.hist(groups, bins=edges.tolist(), color=colours, stacked=True)
    axes.axvline(0.0, color=palette.INK, linewidth=1.0)
    axes.set(xlabel=f"end angle, from {math.degrees(chart.nominal[2]):z.1f} [deg]", ylabel="starts")
    clean(axes)
    _few_numbers(axes)


def _unit_of_errors(size: float) -> DisplayUnit:
    """Select the unit of errors up to a size [m]: below 0.1 mm micrometres."""
    return UNITS[0] if size < 1e-4 else UNITS[1] if size < 0.5 else UNITS[2]


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


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class IndicesChart(AbstractChart):
    """First-order and total Sobol indices, one panel per outcome."""

    title: str
    indices: Indices

    def figure(self) -> Figure:
        own = self.indices
        names = [factor.name for factor in own.factors]
        figure = sheet(WIDE, 0.95 + 0.24 * len(names), self.title)
        row = figure.subplots(1, len(own.outcomes), sharey=True, squeeze=False)[0]
        place = np.arange(len(names))
        for k, axes in enumerate(row):
            for shift, values, errors, colour, label in (
                (-0.2, own.first[k], own.first_error[k], palette.BODY, "first order: alone"),
                (0.2, own.total[k], own.total_error[k], palette.PUSHER, "total: with all others"),
            ):
                axes.barh(
                    place + shift, values, 0.36, xerr=errors, color=colour, label=label,
                    error_kw={"linewidth": 0.8, "ecolor": palette.INK},
                )  # fmt: skip
            unit = display_unit(own.units[k])
            text = unit.text(float(own.deviation[k]))
            axes.set_title(f"{own.outcomes[k]}: {text} {unit.name}", loc="left")
            axes.set_xlabel("share of the variance")
            top = max(1.0, float(np.max(own.total[k] + own.total_error[k])))
            low = min(0.0, float(np.min(own.first[k] - own.first_error[k])))
            axes.set_xlim(low, 1.02 * top)
            clean(axes)
        row[0].set_yticks(place, [shorten(name, 24) for name in names])
        row[0].invert_yaxis()
        legend_below(figure, row[:1])
        return figure

    def table(self) -> Table:
        own, n = self.indices, len(self.indices.outcomes)
        parts = {"first": own.first, "first_error": own.first_error, "total": own.total,
                 "total_error": own.total_error}  # fmt: skip
        return Table.from_columns(
            {
                "outcome": [name for name in own.outcomes for _ in own.factors],
                "input": [factor.name for factor in own.factors] * n,
                **{name: values.ravel() for name, values in parts.items()},
            }
        )


# --- plots of results ---------------------------------------------------------------------------


def draw_sensitivity(found: Sensitivity, *, ax: Axes | None = None) -> Any:
    """Draw end poses over the scene, coloured by outcome, with start errors and end angles."""
    return plot_axes(EnsembleChart.of(found, f"Sensitivity: {found.flag}").figure, ax)


def draw_indices(found: Sensitivity, *, ax: Axes | None = None) -> Any:
    """Draw the Sobol indices of a sensitivity, one panel per coordinate of the end."""
    if found.indices is None:
        hint = "compute them with indices=True"
        raise InvalidInput(
            "kind", found="no indices", expected="a sensitivity with them", hint=hint
        )
    return plot_axes(IndicesChart(title="Sobol indices", indices=found.indices).figure, ax)


def draw_ends(found: Prediction, *, goal: Goal | None = None, ax: Axes | None = None) -> Any:
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
    chart = EnsembleChart(
        title="Prediction" if goal is None else f"P(goal) = {found.probability(goal)}",
        scene=found.scene,
        drawn=found.drawn[found.ended],
        end=found.ends,
        nominal=found.nominal[-1],
        outcome=np.searchsorted(some, outcome),
        share=share[some].tolist(),
        names=[names[k] for k in some],
    )
    return plot_axes(chart.figure, ax)


def _touched(fixels: Sequence[str], mode: str) -> str:
    touched = [name for name, digit in zip(fixels, mode, strict=True) if digit == "1"]
    return f"touches {', '.join(touched)}" if touched else "touches nothing"
