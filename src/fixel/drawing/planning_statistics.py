"""Charts of a plan's success probability, of its trials, and of the causes of its failures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    clean,
    display_unit,
    legend_below,
    log_scale,
    plot_axes,
    sheet,
    shorten,
    whole_numbers,
)
from fixel.errors import unknown_name
from fixel.planning.causes import Explanation, UnknownEffect
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import ALPHA, Trials
from fixel.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_BARS: Final = 12
MAX_PANELS: Final = 6
COLUMNS: Final = 3


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CausesChart(AbstractChart):
    """Share of failures that each unknown explains, and what measuring it is worth."""

    explanation: Explanation

    @property
    def effects(self) -> tuple[UnknownEffect, ...]:
        """Effects that are drawn, the largest share first."""
        return self.explanation.effects[:MAX_BARS]

    def figure(self) -> Figure:
        own, effects = self.explanation, self.effects
        title = f"Success in {100.0 * own.success:.1f} % of {own.n} scenarios"
        figure = sheet(WIDE, 0.9 + 0.24 * max(2, len(effects)), title)
        left, right = figure.subplots(1, 2, sharey=True)
        place = np.arange(len(effects))
        left.barh(place, [100.0 * one.share for one in effects], 0.6, color=palette.BODY)
        left.set(xlabel="explains of the failures [%]", xlim=(0.0, 100.0))
        worth = [one.worth for one in effects]
        error = [one.worth_error if one.worth > 0.0 else 0.0 for one in effects]
        look = {"linewidth": 0.8, "ecolor": palette.INK}
        right.barh(place, worth, 0.6, xerr=error, color=palette.TOUCHED, error_kw=look)
        right.set_xlabel("success gained by measuring it")
        largest = max([0.01, *(w + e for w, e in zip(worth, error, strict=True))])
        right.set_xlim(0.0, 1.05 * largest)
        left.set_yticks(place, [shorten(one.name, 24) for one in effects])
        left.invert_yaxis()
        clean(left)
        clean(right)
        return figure

    def table(self) -> Table:
        return self.explanation._data()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SuccessCurvesChart(AbstractChart):
    """Success against unknowns, with 95 % intervals, one panel per unknown."""

    explanation: Explanation
    effects: tuple[UnknownEffect, ...]

    def figure(self) -> Figure:
        n_rows = -(-len(self.effects) // COLUMNS)
        n_columns = min(COLUMNS, len(self.effects))
        figure = sheet(WIDE if n_columns > 1 else palette.COLUMN, 1.6 * n_rows + 0.3)
        panels = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False)
        for axes, own in zip(panels.flat, self.effects, strict=False):
            self._panel(axes, own)
        for axes in panels.flat[len(self.effects) :]:
            axes.set_visible(False)
        for axes in panels[:, 0]:
            axes.set_ylabel("success")
        legend_below(figure, panels.flat[:1])
        return figure

    def _panel(self, axes: Axes, own: UnknownEffect) -> None:
        unit = display_unit(own.unit)
        value = unit.factor * own.value
        rate = np.array([one.value for one in own.success])
        low = rate - np.array([one.low for one in own.success])
        high = np.array([one.high for one in own.success]) - rate
        axes.errorbar(value, rate, yerr=[low, high], fmt="o-", color=palette.BODY, markersize=2.5,
                      linewidth=1.0, elinewidth=0.7, label="with 95 % interval")  # fmt: skip
        axes.axhline(self.explanation.success, color=palette.INK, linewidth=0.8, linestyle="--",
                     label="in all scenarios")  # fmt: skip
        if own.region is not None:
            ends = axes.get_xlim()
            limits = (own.region.below, own.region.above)
            for limit, end in zip(limits, ends, strict=True):
                if limit is not None:
                    axes.axvspan(end, unit.factor * limit, color=palette.FORCE, alpha=0.12,
                                 linewidth=0.0, label="fails mostly here")  # fmt: skip
            axes.set_xlim(*ends)
        axes.set_xlabel(unit.on(shorten(own.name, 28)))
        axes.set_ylim(-0.03, 1.03)
        clean(axes)

    def table(self) -> Table:
        columns = ("unknown", "value", "success", "low", "high", "scenarios")
        rows = [
            (own.name, value, *one)
            for own in self.effects
            for value, one in zip(own.value, own.success, strict=True)
        ]
        return Table(columns, rows)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SuccessChart(AbstractChart):
    """Success rate of each parameter draw, ordered, with the mean and the stated probability."""

    success: SuccessProbability

    def figure(self) -> Figure:
        own = self.success
        figure = sheet(palette.COLUMN, 2.3)
        axes = figure.subplots()
        rates = np.sort(own.rates)
        share = 100.0 * np.arange(1, len(rates) + 1) / len(rates)
        axes.step(share, rates, where="mid", color=palette.BODY, linewidth=1.2,
                  label=f"parameter draws, {own.n_runs} runs each")  # fmt: skip
        axes.axhline(own.mean, color=palette.INK, linewidth=0.8, linestyle="--", label="mean")
        axes.axhspan(own.low, own.high, color=palette.INK, alpha=0.1, linewidth=0.0)
        axes.axhline(own.stated, color=palette.FORCE, linewidth=1.0, label="stated")
        axes.set(
            xlabel="share of the parameter draws [%]", ylabel="success rate", xlim=(0.0, 100.0)
        )
        axes.set_ylim(min(0.9, rates[0], own.stated) - 0.03, 1.02)
        clean(axes)
        legend_below(figure, [axes])
        return figure

    def table(self) -> Table:
        return self.success._data()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TrialsChart(AbstractChart):
    """Evidence against the stated success probability after each trial."""

    trials: Trials

    def figure(self) -> Figure:
        own = self.trials
        title = f"{own.successes} of {own.n} trials met the goal, stated {own.stated:.2f}"
        figure = sheet(palette.COLUMN, 2.1, title)
        axes = figure.subplots()
        evidence = np.concatenate([[1.0], own.evidence])
        axes.plot(evidence, color=palette.INK, linewidth=0.8)
        met = np.array([trial.met for trial in own.trials], dtype=bool)
        for which, colour, label in (
            (met, palette.TOUCHED, "goal met"),
            (~met, palette.FORCE, "failure"),
        ):
            rows = np.flatnonzero(which) + 1
            axes.plot(rows, evidence[rows], "o", color=colour, markersize=3.0, label=label)
        limit = 1.0 / ALPHA
        axes.axhline(limit, color=palette.FORCE, linewidth=0.8, linestyle="--", label="refuted")
        log_scale(axes, "y", np.append(np.maximum(evidence, 1e-3), limit))
        axes.set(xlabel="trial", ylabel="evidence against (e-value)")
        whole_numbers(axes)
        clean(axes)
        legend_below(figure, [axes])
        return figure

    def table(self) -> Table:
        return self.trials._data()


# --- plots of results ---------------------------------------------------------------------------


def draw_causes(found: Explanation, *, ax: Axes | None = None) -> Any:
    """Draw the share of failures that each unknown explains, and the worth of measuring it."""
    return plot_axes(CausesChart(explanation=found).figure, ax)


def draw_success_against(
    found: Explanation, *, unknown: str | None = None, ax: Axes | None = None
) -> Any:
    """Draw success against one unknown, by name, or against those that explain most."""
    effects = found.effects[:MAX_PANELS]
    if unknown is not None or not effects:
        effects = tuple(own for own in found.effects if own.name == unknown)
    if not effects:
        raise unknown_name("unknown", unknown, [own.name for own in found.effects])
    return plot_axes(SuccessCurvesChart(explanation=found, effects=effects).figure, ax)


def draw_success(found: SuccessProbability, *, ax: Axes | None = None) -> Any:
    """Draw the success rates of the parameter draws, in order."""
    return plot_axes(SuccessChart(success=found).figure, ax)


def draw_trials(found: Trials, *, ax: Axes | None = None) -> Any:
    """Draw the evidence against the stated success probability after each trial."""
    return plot_axes(TrialsChart(trials=found).figure, ax)
