"""Charts of a posterior: corner plot of parameters, bands about a path, regions of its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, AbstractChart, clean, readable, sheet, tint
from fixel.model import placed
from fixel.table import Table, Value
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CELL: Final = 1.2  # [inch], side of a panel of a corner plot
DECADES: Final = 30.0  # minimum ratio of the ends of a logarithmic axis
LONG: Final = 5  # longer numbers below a corner plot are written upwards
MODES: Final = (palette.BODY, palette.FORCE, palette.TOUCHED, palette.CONE, palette.PUSHER)
BINS: Final = 30


class CornerAxis(NamedTuple):
    """Parameter of a corner plot, in its own unit."""

    label: str
    unit: str
    low: float  # bounds of the prior
    high: float
    truth: float | None = None  # true value, if known
    logarithmic: bool = False


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CornerChart(AbstractChart):
    """Corner plot: samples of parameters against one another, with modes in colours.

    Parameters
    ----------
    axes : sequence of CornerAxis
    samples : (k, n) float64
    mode : (k,) int
        Mode of each sample; 0 has the largest weight.
    weights : sequence of float
        Weights of the modes.
    title : str
    """

    axes: Sequence[CornerAxis]
    samples: FloatArray
    mode: np.ndarray
    weights: Sequence[float]
    title: str = ""

    def figure(self) -> Figure:
        n = len(self.axes)
        side = max(2.6, CELL * n + 0.5)
        figure = sheet(side, side + 0.2, self.title)
        panels = figure.subplots(n, n, squeeze=False)
        for row in range(n):
            for column in range(n):
                axes = panels[row, column]
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
        return np.asarray(readable(self.axes[k].unit).factor * self.samples[:, k])

    def _ends(self, k: int) -> tuple[float, float]:
        """Range of the samples and the truth, with a margin, within the prior."""
        axis = self.axes[k]
        known = [*self.samples[:, k], *([] if axis.truth is None else [axis.truth])]
        low, high = float(np.min(known)), float(np.max(known))
        if axis.logarithmic:
            wide = (low / 1.1, 1.1 * high)
        else:
            margin = max(0.05 * (high - low), 1e-6 * (axis.high - axis.low))
            wide = (low - margin, high + margin)
        factor = readable(axis.unit).factor
        ends = min(max(wide[0], axis.low), low), max(min(wide[1], axis.high), high)
        return factor * ends[0], factor * ends[1]

    def _logarithmic(self, k: int) -> bool:
        low, high = self._ends(k)
        return self.axes[k].logarithmic and high > DECADES * low

    def _alone(self, axes: Axes, k: int) -> None:
        low, high = self._ends(k)
        log = self._logarithmic(k)
        edges = np.geomspace(low, high, BINS + 1) if log else np.linspace(low, high, BINS + 1)
        values = self._values(k)
        parts = [values[self.mode == m] for m in range(len(self.weights))]
        colours = [MODES[m % len(MODES)] for m in range(len(parts))]
        axes.hist(parts, bins=list(edges), stacked=True, color=colours)
        axes.set_yticks([])
        self._truth(axes.axvline, k)

    def _pair(self, axes: Axes, x: int, y: int) -> None:
        across, up = self._values(x), self._values(y)
        for m in range(len(self.weights)):
            own = self.mode == m
            axes.plot(across[own], up[own], ".", markersize=1.6, alpha=0.35, rasterized=True,
                      markeredgewidth=0.0, color=MODES[m % len(MODES)])  # fmt: skip
        axes.set_ylim(*self._ends(y))
        self._truth(axes.axvline, x)
        self._truth(axes.axhline, y)

    def _truth(self, draw: Any, k: int) -> None:
        truth = self.axes[k].truth
        if truth is not None:
            value = readable(self.axes[k].unit).factor * truth
            draw(value, color=palette.INK, linewidth=0.7, linestyle=(0, (3, 2)))

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
        own = self.axes[k]
        return readable(own.unit).on(own.label).replace(" [", "\n[")

    def _legend(self, figure: Figure) -> None:
        from matplotlib.lines import Line2D

        entries: list[Any] = []
        for m, weight in enumerate(self.weights):
            name = f"mode {m + 1}: {100.0 * weight:.0f} %" if len(self.weights) > 1 else "samples"
            entries.append(Line2D([], [], marker="o", linestyle="none", markersize=4.0,
                                  color=MODES[m % len(MODES)], label=name))  # fmt: skip
        if any(axis.truth is not None for axis in self.axes):
            entries.append(Line2D([], [], color=palette.INK, linewidth=0.7,
                                  linestyle=(0, (3, 2)), label="truth"))  # fmt: skip
        # There is room above the diagonal.
        figure.legend(handles=entries, frameon=False, loc="upper right",
                      bbox_to_anchor=(0.98, 0.93))  # fmt: skip

    def table(self) -> Table:
        units = [f"{axis.label}_{axis.unit}" if axis.unit != "-" else axis.label
                 for axis in self.axes]  # fmt: skip
        rows: list[tuple[Value, ...]] = [
            (*map(float, sample), int(mode) + 1)
            for sample, mode in zip(self.samples, self.mode, strict=True)
        ]
        return Table((*units, "mode"), rows)


class PathBand(NamedTuple):
    """Band about a path at one level."""

    level: float
    low: FloatArray  # (n, 3)
    high: FloatArray  # (n, 3)


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
    measured, best : (n, 3) float64
    bands : sequence of PathBand
        Bands, the narrowest first.
    title : str
    """

    time: FloatArray
    measured: FloatArray
    best: FloatArray
    bands: Sequence[PathBand]
    title: str = ""

    def figure(self) -> Figure:
        figure = sheet(WIDE, 3.2, self.title)
        panels = figure.subplots(2, 3, sharex=True, height_ratios=(1.0, 1.0))
        for k, (label, factor) in enumerate(_ROWS):
            self._path(panels[0, k], k, factor, np.zeros(len(self.time)))
            self._path(panels[1, k], k, factor, self.best[:, k])
            panels[0, k].set_ylabel(label)
            panels[1, k].set_ylabel(f"{label}, less likeliest")
            panels[1, k].set_xlabel("time [s]")
        figure.align_ylabels()
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, frameon=False, ncols=len(labels),
                      loc="outside lower center")  # fmt: skip
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
        axes.plot(self.time, factor * (self.measured[:, k] - off), color=palette.INK,
                  linewidth=0.6, linestyle=(0, (2, 1.2)), label="measured")  # fmt: skip
        clean(axes)

    def table(self) -> Table:
        names = ("x_m", "y_m", "theta_rad")
        columns = ["time_s", *(f"measured_{n}" for n in names), *(f"likeliest_{n}" for n in names)]
        parts = [self.time[:, None], self.measured, self.best]
        for band in self.bands:
            for side, ends in (("low", band.low), ("high", band.high)):
                columns += [f"{side}_{100.0 * band.level:.0f}_{n}" for n in names]
                parts.append(ends)
        rows = [tuple(map(float, row)) for row in np.concatenate(parts, axis=1)]
        return Table(tuple(columns), list(rows))


class FinalRegion(NamedTuple):
    """Elliptic region of final positions and interval of final angles, at one level."""

    level: float
    centre: FloatArray  # (2,)
    radii: FloatArray  # (2,)
    turn: float  # angle of the first axis [rad]
    angles: tuple[float, float]  # [rad]


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
    regions : sequence of FinalRegion
        Regions, the smallest first.
    title : str
    """

    outline: FloatArray
    start: FloatArray
    measured: FloatArray
    draws: FloatArray
    regions: Sequence[FinalRegion]
    title: str = ""

    def figure(self) -> Figure:
        figure = sheet(WIDE, 2.9, self.title)
        whole, near, turned = figure.subplots(1, 3, width_ratios=(1.2, 1.0, 1.0))
        self._whole(whole)
        self._near(near)
        self._turned(turned)
        handles, labels = near.get_legend_handles_labels()
        more, names = whole.get_legend_handles_labels()
        legend = figure.legend(handles + more, labels + names, frameon=False, ncols=6,
                               loc="outside lower center")  # fmt: skip
        legend.get_lines()[0].set_markersize(6.0)  # a draw is a speck
        return figure

    def _whole(self, axes: Axes) -> None:
        def closed(pose: FloatArray) -> FloatArray:
            table = placed(self.outline, pose)
            return np.asarray(1e3 * np.vstack((table, table[:1])).T)

        axes.plot(*closed(self.start), color=palette.FIXEL, linewidth=0.8,
                  linestyle=(0, (3, 2)), label="start")  # fmt: skip
        for pose in self.draws[:60]:
            axes.plot(*closed(pose), color=palette.TRAIL, linewidth=0.4, alpha=0.35)
        axes.plot(*closed(self.measured), color=palette.INK, linewidth=0.8)
        axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        axes.margins(0.06)
        clean(axes)

    def _near(self, axes: Axes) -> None:
        turn = np.linspace(0.0, 2.0 * np.pi, 121)
        axes.plot(*(1e3 * self.draws[:, :2].T), ".", color=palette.TRAIL, markersize=2.0,
                  markeredgewidth=0.0, alpha=0.5, label="draws")  # fmt: skip
        for region, style in zip(self.regions, ("-", (0, (4, 2)), ":"), strict=False):
            c, s = np.cos(region.turn), np.sin(region.turn)
            a, b = region.radii[:, None] * np.array([np.cos(turn), np.sin(turn)])
            ring = region.centre[:, None] + np.array([c * a - s * b, s * a + c * b])
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
            for end in region.angles:
                axes.axvline(float(np.degrees(end)), color=palette.BODY, linewidth=0.9,
                             linestyle=style)  # fmt: skip
        middle = float(np.median(self.draws[:, 2]))
        shift = 2.0 * np.pi * np.round((middle - self.measured[2]) / (2.0 * np.pi))
        axes.axvline(float(np.degrees(self.measured[2] + shift)), color=palette.INK, linewidth=0.9)
        axes.set(xlabel="final theta [deg]", ylabel="draws")
        axes.locator_params(axis="x", nbins=5)
        clean(axes)

    def table(self) -> Table:
        rows: list[tuple[Value, ...]] = [("measured", *map(float, self.measured))]
        rows += [("draw", *map(float, pose)) for pose in self.draws]
        return Table(("what", "x_m", "y_m", "theta_rad"), rows)
