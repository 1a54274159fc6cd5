"""Charts of a posterior: corner plot of parameters, bands about a path, regions of its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import (
    WIDE,
    AbstractChart,
    Style,
    clean,
    display_unit,
    legend_below,
    plot_axes,
    sheet,
    tint,
)
from fixel.drawing.top_view import closed_line
from fixel.model import placed
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.bands import LEVELS, Band, CoverageCurve, EndBounds
from fixel.uncertainty.discrepancy import LABEL
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prediction import Prediction

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CELL: Final = 1.2  # [inch], side of a panel of a corner plot
DECADES: Final = 30.0  # minimum ratio of the ends of a logarithmic axis
LONG: Final = 5  # longer numbers below a corner plot are written upwards
MODES: Final = (palette.BODY, palette.FORCE, palette.TOUCHED, palette.CONE, palette.PUSHER)
BINS: Final = 30


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CornerChart(AbstractChart):
    """Corner plot: samples of parameters against one another, with modes in colours."""

    posterior: Posterior
    title: str = ""

    @property
    def modes(self) -> IntArray:
        """Mode of each sample, (k,); mode 0 has the largest weight."""
        mode = np.zeros(len(self.posterior.points), np.int64)
        for k, part in enumerate(self.posterior.modes):
            mode[part.members] = k
        return mode

    def figure(self) -> Figure:
        n = len(self.posterior.labels)
        side = max(2.6, CELL * n + 0.5)
        figure = sheet(side, side + 0.2, self.title)
        panels = figure.subplots(n, n, squeeze=False)
        for (row, column), axes in np.ndenumerate(panels):
            if column > row:
                axes.set_visible(False)
            elif column == row:
                self._alone(axes, row)
            else:
                self._pair(axes, column, row)
            self._edges(axes, row, column, n)
        figure.align_labels()
        self._legend(figure)
        return figure

    def _values(self, k: int) -> FloatArray:
        factor = display_unit(self.posterior.units[k]).factor
        return np.asarray(factor * self.posterior.points[:, k])

    def _ends(self, k: int) -> tuple[float, float]:
        """Range of the samples, with a margin, within the prior."""
        own = self.posterior
        low, high = float(own.points[:, k].min()), float(own.points[:, k].max())
        if own.labels[k] == LABEL:
            wide = (low / 1.1, 1.1 * high)
        else:
            margin = max(0.05 * (high - low), 1e-6 * (own.high[k] - own.low[k]))
            wide = (low - margin, high + margin)
        factor = display_unit(own.units[k]).factor
        ends = min(max(wide[0], own.low[k]), low), max(min(wide[1], own.high[k]), high)
        return factor * ends[0], factor * ends[1]

    def _logarithmic(self, k: int) -> bool:
        low, high = self._ends(k)
        return self.posterior.labels[k] == LABEL and high > DECADES * low

    def _alone(self, axes: Axes, k: int) -> None:
        low, high = self._ends(k)
        log = self._logarithmic(k)
        edges = np.geomspace(low, high, BINS + 1) if log else np.linspace(low, high, BINS + 1)
        values, modes = self._values(k), self.modes
        parts = [values[modes == m] for m in range(len(self.posterior.modes))]
        axes.hist(parts, bins=list(edges), stacked=True, color=_colours(len(parts)))
        axes.set_yticks([])

    def _pair(self, axes: Axes, x: int, y: int) -> None:
        across, up, modes = self._values(x), self._values(y), self.modes
        for m, colour in enumerate(_colours(len(self.posterior.modes))):
            own = modes == m
            axes.plot(across[own], up[own], ".", markersize=1.6, alpha=0.35, rasterized=True,
                      markeredgewidth=0.0, color=colour)  # fmt: skip
        axes.set_ylim(*self._ends(y))

    def _edges(self, axes: Axes, row: int, column: int, n: int) -> None:
        axes.set_xlim(*self._ends(column))
        self._number(axes, "x", column)
        if row != column:
            self._number(axes, "y", row)
        axes.tick_params(pad=1.0, labelsize=palette.FONT_SIZE - 1.5, which="both")
        axes.spines[["top", "right"]].set_visible(False)
        if row == n - 1:
            axes.set_xlabel(self._label(column), fontsize=palette.FONT_SIZE - 0.5)
        else:
            axes.tick_params(labelbottom=False, which="both")
        if column == 0 and row > 0:
            axes.set_ylabel(self._label(row), fontsize=palette.FONT_SIZE - 0.5)
        elif column > 0:
            axes.tick_params(labelleft=False, which="both")

    def _number(self, axes: Axes, which: Literal["x", "y"], k: int) -> None:
        """Set few ticks on an axis, with labels written upwards if they are too long."""
        from matplotlib.ticker import MaxNLocator, NullFormatter

        axis = getattr(axes, f"{which}axis")
        if self._logarithmic(k):
            getattr(axes, f"set_{which}scale")("log")
            axis.set_minor_formatter(NullFormatter())
            return
        axis.set_major_locator(MaxNLocator(2, steps=(1, 2, 5, 10)))
        axes.ticklabel_format(axis=which, useOffset=False)
        texts = axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
        if which == "x" and max(map(len, texts), default=0) > LONG:
            axes.tick_params(axis="x", labelrotation=90.0)

    def _label(self, k: int) -> str:
        own = self.posterior
        return display_unit(own.units[k]).on(label_text(own.labels[k])).replace(" [", "\n[")

    def _legend(self, figure: Figure) -> None:
        from matplotlib.lines import Line2D

        modes = self.posterior.modes
        texts = [f"mode {m}: {100.0 * mode.weight:.0f} %" for m, mode in enumerate(modes, 1)]
        dot: Style = {"marker": "o", "linestyle": "none", "markersize": 4.0}
        entries = [
            Line2D([], [], color=colour, label=text if len(modes) > 1 else "samples", **dot)
            for text, colour in zip(texts, _colours(len(modes)), strict=True)
        ]
        # There is room above the diagonal.
        figure.legend(handles=entries, frameon=False, loc="upper right",
                      bbox_to_anchor=(0.98, 0.93))  # fmt: skip

    def table(self) -> Table:
        own = self.posterior
        labels = [label_text(label) for label in own.labels]
        names = [x if u == "-" else f"{x}_{u}" for x, u in zip(labels, own.units, strict=True)]
        columns = dict(zip(names, own.points.T, strict=True))
        return Table.from_columns({**columns, "mode": self.modes + 1})


def label_text(label: str) -> str:
    """Label of a parameter for people."""
    return "model error" if label == LABEL else label


def _colours(n: int) -> list[str]:
    return [MODES[m % len(MODES)] for m in range(n)]


_ROWS: Final = (("x [mm]", 1e3), ("y [mm]", 1e3), ("theta [deg]", 180.0 / np.pi))


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BandsChart(AbstractChart):
    """x, y and theta against time: measured, likeliest and bands. Below each, the difference from
    the likeliest, which makes narrow bands visible.

    Parameters
    ----------
    time : (n,) float64
        Times [s].
    best : (n, 3) float64
    measured : (n, 3) float64, optional
    bands : sequence of Band
        Bands, the narrowest first.
    title : str
    """

    time: FloatArray
    best: FloatArray
    bands: Sequence[Band]
    measured: FloatArray | None = None
    title: str = ""

    def figure(self) -> Figure:
        figure = sheet(WIDE, 3.2, self.title)
        panels = figure.subplots(2, 3, sharex=True, height_ratios=(1.0, 1.0))
        for k, (label, factor) in enumerate(_ROWS):
            self._path(panels[0, k], k, factor, np.zeros(len(self.time)))
            self._path(panels[1, k], k, factor, self.best[:, k])
            panels[0, k].set_ylabel(label)
            panels[1, k].set_ylabel(f"{label} - most likely")
            panels[1, k].set_xlabel("time [s]")
        figure.align_ylabels()
        legend_below(figure, panels[0, :1])
        return figure

    def _path(self, axes: Axes, k: int, factor: float, off: FloatArray) -> None:
        for band, strength in zip(reversed(self.bands), (0.30, 0.55, 0.8), strict=False):
            axes.fill_between(
                self.time,
                factor * (band.low[:, k] - off),
                factor * (band.high[:, k] - off),
                color=tint(palette.TRAIL, strength),
                linewidth=0.0,
                label=f"{100.0 * band.level:.0f} %",
            )
        axes.plot(self.time, factor * (self.best[:, k] - off), color=palette.BODY, linewidth=0.9,
                  label="likeliest")  # fmt: skip
        if self.measured is not None:
            axes.plot(self.time, factor * (self.measured[:, k] - off), color=palette.INK,
                      linewidth=0.6, linestyle=(0, (2, 1.2)), label="measured")  # fmt: skip
        clean(axes)

    def table(self) -> Table:
        parts = {} if self.measured is None else {"measured": self.measured}
        parts["likeliest"] = self.best
        for band in self.bands:
            level = f"{100.0 * band.level:.0f}"
            parts |= {f"low_{level}": band.low, f"high_{level}": band.high}
        columns = {
            f"{name}_{axis}": poses[:, k]
            for name, poses in parts.items()
            for k, axis in enumerate(("x_m", "y_m", "theta_rad"))
        }
        return Table.from_columns({"time_s": self.time, **columns})


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FinalPoseChart(AbstractChart):
    """Final pose of a push: outlines drawn from the posterior, positions and angles in detail.

    Parameters
    ----------
    outline : (m, 2) float64
        Outline of the object, in its frame.
    start, measured : (3,) float64
        First and last measured pose.
    draws : (k, 3) float64
    regions : sequence of EndBounds
        Bounds, the smallest first.
    title : str
    """

    outline: FloatArray
    start: FloatArray
    measured: FloatArray
    draws: FloatArray
    regions: Sequence[EndBounds]
    title: str = ""

    def figure(self) -> Figure:
        figure = sheet(WIDE, 2.9, self.title)
        whole, near, turned = figure.subplots(1, 3, width_ratios=(1.2, 1.0, 1.0))
        self._whole(whole)
        self._near(near)
        self._turned(turned)
        legend_below(figure, (near, whole), 6)
        figure.legends[0].get_lines()[0].set_markersize(6.0)  # a draw is a speck
        return figure

    def _whole(self, axes: Axes) -> None:
        def outline(pose: FloatArray) -> FloatArray:
            return closed_line(placed(self.outline, pose))

        axes.plot(*outline(self.start), color=palette.FIXEL, linewidth=0.8,
                  linestyle=(0, (3, 2)), label="start")  # fmt: skip
        for pose in self.draws[:60]:
            axes.plot(*outline(pose), color=palette.TRAIL, linewidth=0.4, alpha=0.35)
        axes.plot(*outline(self.measured), color=palette.INK, linewidth=0.8)
        axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        axes.margins(0.06)
        clean(axes)

    def _near(self, axes: Axes) -> None:
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        axes.plot(*(1e3 * self.draws[:, :2].T), ".", color=palette.TRAIL, markersize=2.0,
                  markeredgewidth=0.0, alpha=0.5, label="draws")  # fmt: skip
        for region, style in zip(self.regions, ("-", (0, (4, 2)), ":"), strict=False):
            own = region.position
            c, s = np.cos(own.angle), np.sin(own.angle)
            a, b = own.radii[:, None] * np.array([np.cos(turn), np.sin(turn)])
            ring = own.centre[:, None] + np.array([c * a - s * b, s * a + c * b])
            axes.plot(*(1e3 * ring), color=palette.BODY, linewidth=0.9, linestyle=style,
                      label=f"{100.0 * region.level:.0f} %")  # fmt: skip
        axes.plot(*(1e3 * self.measured[:2]), "x", color=palette.INK, markersize=5.0,
                  label="measured")  # fmt: skip
        axes.set(xlabel="final x [mm]", ylabel="final y [mm]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=4)
        clean(axes)

    def _turned(self, axes: Axes) -> None:
        axes.hist(np.degrees(self.draws[:, 2]), bins=30, color=tint(palette.TRAIL, 0.7))
        for region, style in zip(self.regions, ("-", (0, (4, 2)), ":"), strict=False):
            for end in region.angle:
                axes.axvline(float(np.degrees(end)), color=palette.BODY, linewidth=0.9,
                             linestyle=style)  # fmt: skip
        middle = float(np.median(self.draws[:, 2]))
        shift = 2.0 * np.pi * np.round((middle - self.measured[2]) / (2.0 * np.pi))
        axes.axvline(float(np.degrees(self.measured[2] + shift)), color=palette.INK, linewidth=0.9)
        axes.set(xlabel="final theta [deg]", ylabel="draws")
        axes.locator_params(axis="x", nbins=5)
        clean(axes)

    def table(self) -> Table:
        poses = np.vstack((self.measured, self.draws))
        columns = dict(zip(("x_m", "y_m", "theta_rad"), poses.T, strict=True))
        return Table.from_columns({"what": ["measured"] + ["draw"] * len(self.draws), **columns})


class CoverageChart(AbstractChart):
    """Observed coverage of bounds against their stated probability, one panel per kind of bound.

    Parameters
    ----------
    curves : mapping of str to CoverageCurve
        Curves by the title of their panel.
    title : str
    groups : mapping of str to sequence of (n,) float64
        Shares observed in single groups, by panel.
    """

    def __init__(
        self,
        curves: Mapping[str, CoverageCurve],
        title: str = "",
        groups: Mapping[str, Sequence[FloatArray]] | None = None,
    ) -> None:
        self._curves, self._title, self._groups = dict(curves), title, dict(groups or {})

    def figure(self) -> Figure:
        n = len(self._curves)
        figure = sheet(0.1 + 2.6 * n, 2.9, self._title)
        row = figure.subplots(1, n, squeeze=False, sharey=True)[0]
        for axes, (name, curve) in zip(row, self._curves.items(), strict=True):
            _draw_coverage(axes, curve, self._groups.get(name, ()))
            title = f"{name}, {curve.outcomes} outcomes"
            axes.set_title(title, fontsize=palette.FONT_SIZE)
        row[0].set_ylabel("outcomes within bounds [%]")
        legend_below(figure, row[:1], 2)
        return figure

    def table(self) -> Table:
        names = ("bounds", "level", "held", "true_levels_from", "true_levels_to", "outcomes")
        rows = [
            (name, *row, curve.outcomes)
            for name, curve in self._curves.items()
            for row in zip(curve.levels, curve.held, curve.low, curve.high, strict=True)
        ]
        return Table(names, rows)


def _draw_coverage(axes: Axes, curve: CoverageCurve, groups: Sequence[FloatArray]) -> None:
    levels = 100.0 * curve.levels
    axes.plot((0, 100), (0, 100), color=palette.INK, linewidth=0.7, linestyle=(0, (4, 2)),
              label="exact coverage")  # fmt: skip
    axes.fill_between(levels, 100.0 * curve.low, 100.0 * curve.high, color=palette.TRAIL,
                      alpha=0.35, linewidth=0.0, label="95 % range of exact coverage")  # fmt: skip
    for k, own in enumerate(groups):
        axes.plot(levels, 100.0 * own, color=palette.FIXEL, linewidth=0.5, alpha=0.6,
                  label="single groups" if k == 0 else None)  # fmt: skip
    axes.plot(levels, 100.0 * curve.held, color=palette.FORCE, linewidth=1.2, marker="o",
              markersize=2.5, label="held")  # fmt: skip
    axes.set(xlim=(0, 100), ylim=(0, 100), xlabel="stated level [%]")
    axes.set_aspect("equal")
    clean(axes)


# --- plots of results ---------------------------------------------------------------------------


def draw_bands(found: Prediction, *, ax: Axes | None = None) -> Any:
    """Draw the nominal path of a prediction with bands of 50 and 90 %."""
    bands = [found.bands(level) for level in LEVELS]
    return plot_axes(BandsChart(time=found.time, best=found.nominal, bands=bands).figure, ax)


def draw_posterior(found: Posterior, *, ax: Axes | None = None) -> Any:
    """Draw samples of the parameters against one another, with modes in colours."""
    return plot_axes(CornerChart(posterior=found).figure, ax)
