"""Charts of a posterior: corner plot of parameters, bands about a path, regions of its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark, Style
from fixel.drawing.top_view import closed_line
from fixel.model import placed, rotated
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import LABEL
from fixel.uncertainty.posterior import Posterior
from fixel.uncertainty.prediction import LEVELS, Band, CoverageCurve, EndBounds, Prediction
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CELL: Final = 1.2  # [inch], side of a panel of a corner plot
DECADES: Final = 30.0  # minimum ratio of the ends of a logarithmic axis
LONG: Final = 5  # longer numbers below a corner plot are written upwards
MODES: Final = (palette.BODY, palette.FORCE, palette.TOUCHED, palette.CONE, palette.PUSHER)
BINS: Final = 30
POSE: Final = ("x_m", "y_m", "theta_rad")
LABELS: Final = (("x [mm]", 1e3), ("y [mm]", 1e3), ("theta [deg]", 180.0 / np.pi))
LINES: Final = ("-", chart.DASHED, ":")  # of regions, the smallest first


def corner_chart(posterior: Posterior, title: str = "") -> Chart:
    """Draw samples of the parameters against one another, with modes in colours."""
    corner = _Corner(posterior)
    n = len(posterior.labels)
    side = max(2.6, CELL * n + 0.5)
    labels = [label_text(label) for label in posterior.labels]
    names = [x if u == "-" else f"{x}_{u}" for x, u in zip(labels, posterior.units, strict=True)]
    columns = dict(zip(names, posterior.points.T, strict=True))
    return Chart(
        title=title,
        size=(side, side + 0.2),
        fill=corner.fill,
        data=Table.from_columns({**columns, "mode": corner.modes + 1}),
    )


class _Corner:
    """Panels of a corner plot."""

    def __init__(self, posterior: Posterior) -> None:
        self.posterior = posterior
        self.modes = np.zeros(len(posterior.points), np.int64)
        for k, part in enumerate(posterior.modes):
            self.modes[part.members] = k
        self.colours = [MODES[m % len(MODES)] for m in range(len(posterior.modes))]

    def fill(self, figure: Figure) -> None:
        n = len(self.posterior.labels)
        for (row, column), axes in np.ndenumerate(figure.subplots(n, n, squeeze=False)):
            if column > row:
                axes.set_visible(False)
            elif column == row:
                self._alone(axes, row)
            else:
                self._pair(axes, column, row)
            self._edges(axes, row, column, n)
        figure.align_labels()
        self._legend(figure)

    def _values(self, k: int) -> FloatArray:
        factor = displayed(self.posterior.units[k]).factor
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
        factor = displayed(own.units[k]).factor
        ends = min(max(wide[0], own.low[k]), low), max(min(wide[1], own.high[k]), high)
        return factor * ends[0], factor * ends[1]

    def _logarithmic(self, k: int) -> bool:
        low, high = self._ends(k)
        return self.posterior.labels[k] == LABEL and high > DECADES * low

    def _alone(self, axes: Axes, k: int) -> None:
        low, high = self._ends(k)
        log = self._logarithmic(k)
        edges = np.geomspace(low, high, BINS + 1) if log else np.linspace(low, high, BINS + 1)
        values = self._values(k)
        parts = [values[self.modes == m] for m in range(len(self.colours))]
        axes.hist(parts, bins=list(edges), stacked=True, color=self.colours)
        axes.set_yticks([])

    def _pair(self, axes: Axes, x: int, y: int) -> None:
        across, up = self._values(x), self._values(y)
        for m, colour in enumerate(self.colours):
            own = self.modes == m
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
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
            return
        axis.set_major_locator(MaxNLocator(2, steps=(1, 2, 5, 10)))
        axes.ticklabel_format(axis=which, useOffset=False)
        texts = axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
        if which == "x" and max(map(len, texts), default=0) > LONG:
            axes.tick_params(axis="x", labelrotation=90.0)

    def _label(self, k: int) -> str:
        own = self.posterior
        return displayed(own.units[k]).on(label_text(own.labels[k])).replace(" [", "\n[")

    def _legend(self, figure: Figure) -> None:
        from matplotlib.lines import Line2D

        modes = self.posterior.modes
        texts = [f"mode {m}: {100.0 * mode.weight:.0f} %" for m, mode in enumerate(modes, 1)]
        dot: Style = {"marker": "o", "linestyle": "none", "markersize": 4.0}
        entries = [
            Line2D([], [], color=colour, label=text if len(modes) > 1 else "samples", **dot)
            for text, colour in zip(texts, self.colours, strict=True)
        ]
        # There is room above the diagonal.
        figure.legend(handles=entries, frameon=False, loc="upper right",
                      bbox_to_anchor=(0.98, 0.93))  # fmt: skip


def label_text(label: str) -> str:
    """Label of a parameter for people."""
    return "model error" if label == LABEL else label


def bands_chart(
    time: FloatArray,
    best: FloatArray,
    bands: Sequence[Band],
    measured: FloatArray | None = None,
    title: str = "",
) -> Chart:
    """Draw x, y and theta against time: measured, likeliest and bands.

    Below each is the difference from the likeliest, which makes narrow bands visible. Poses are
    (n, 3) at times (n,) [s]; the narrowest band is first.
    """

    def path(k: int, off: FloatArray, **labels: Any) -> Mark:
        factor = LABELS[k][1]
        marks = [
            chart.band(time, factor * (own.low[:, k] - off), factor * (own.high[:, k] - off),
                       color=chart.tint(palette.TRAIL, strength), linewidth=0.0,
                       label=f"{100.0 * own.level:.0f} %")
            for own, strength in zip(reversed(bands), (0.30, 0.55, 0.8), strict=False)
        ]  # fmt: skip
        likeliest: Style = {"color": palette.BODY, "linewidth": 0.9, "label": "likeliest"}
        marks.append(chart.line(time, factor * (best[:, k] - off), **likeliest))
        if measured is not None:
            dashed: Style = {"color": palette.INK, "linewidth": 0.6, "linestyle": (0, (2, 1.2))}
            own = factor * (measured[:, k] - off)
            marks.append(chart.line(time, own, label="measured", **dashed))
        return chart.panel(*marks, **labels)

    zero = np.zeros(len(time))
    rows = [
        [path(k, zero, ylabel=label) for k, (label, _) in enumerate(LABELS)],
        [
            path(k, best[:, k], ylabel=f"{label} - most likely", xlabel="time [s]")
            for k, (label, _) in enumerate(LABELS)
        ],
    ]
    parts = {} if measured is None else {"measured": measured}
    parts["likeliest"] = best
    for own in bands:
        level = f"{100.0 * own.level:.0f}"
        parts |= {f"low_{level}": own.low, f"high_{level}": own.high}
    columns = {
        f"{name}_{axis}": poses[:, k]
        for name, poses in parts.items()
        for k, axis in enumerate(POSE)
    }
    return Chart(
        title=title,
        size=(chart.WIDE, 3.2),
        fill=chart.panels(rows, sharex=True),
        data=Table.from_columns({"time_s": time, **columns}),
    )


def final_pose_chart(
    outline: FloatArray,
    start: FloatArray,
    measured: FloatArray,
    draws: FloatArray,
    regions: Sequence[EndBounds],
    title: str = "",
) -> Chart:
    """Draw the final pose of a push: outlines drawn from the posterior, positions and angles.

    The outline (m, 2) is in the frame of the object. Poses (3,) are the first and the last measured
    one, and draws (k, 3) of the last one. The smallest bounds are first.
    """
    poses = dict(zip(POSE, np.vstack((measured, draws)).T, strict=True))

    def fill(figure: Figure) -> None:
        whole, near, turned = figure.subplots(1, 3, width_ratios=(1.2, 1.0, 1.0))
        _outlines(outline, start, measured, draws)(whole)
        _positions(measured, draws, regions)(near)
        _angles(measured, draws, regions)(turned)
        near.set_aspect("equal", adjustable="datalim")
        near.locator_params(nbins=4)
        turned.locator_params(axis="x", nbins=5)
        chart.legend_below(figure, (near, whole), 6)
        figure.legends[0].get_lines()[0].set_markersize(6.0)  # a draw is a speck

    return Chart(
        title=title,
        size=(chart.WIDE, 2.9),
        fill=fill,
        data=Table.from_columns({"what": ["measured"] + ["draw"] * len(draws), **poses}),
    )


def _outlines(
    outline: FloatArray, start: FloatArray, measured: FloatArray, draws: FloatArray
) -> Mark:
    def at(pose: FloatArray, **style: Any) -> Mark:
        return chart.line(*closed_line(placed(outline, pose)), **style)

    return chart.panel(
        at(start, color=palette.FIXEL, linewidth=0.8, linestyle=chart.DASHED, label="start"),
        *(at(pose, color=palette.TRAIL, linewidth=0.4, alpha=0.35) for pose in draws[:60]),
        at(measured, color=palette.INK, linewidth=0.8),
        lambda axes: axes.margins(0.06),
        aspect="equal",
        xlabel="x [mm]",
        ylabel="y [mm]",
    )


def _positions(measured: FloatArray, draws: FloatArray, regions: Sequence[EndBounds]) -> Mark:
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    circle = np.column_stack((np.cos(turn), np.sin(turn)))
    rings = []
    for region, style in zip(regions, LINES, strict=False):
        own = region.position
        ring = own.centre + rotated(own.radii * circle, np.asarray(own.angle))
        rings.append(chart.line(*(1e3 * ring.T), color=palette.BODY, linewidth=0.9, linestyle=style,
                                label=f"{100.0 * region.level:.0f} %"))  # fmt: skip
    return chart.panel(
        chart.line(*(1e3 * draws[:, :2].T), ".", color=palette.TRAIL, markersize=2.0,
                   markeredgewidth=0.0, alpha=0.5, label="draws"),
        *rings,
        chart.line(*(1e3 * measured[:2]), "x", color=palette.INK, markersize=5.0, label="measured"),
        xlabel="final x [mm]",
        ylabel="final y [mm]",
    )  # fmt: skip


def _angles(measured: FloatArray, draws: FloatArray, regions: Sequence[EndBounds]) -> Mark:
    ends = [
        chart.vline(float(np.degrees(end)), color=palette.BODY, linewidth=0.9, linestyle=style)
        for region, style in zip(regions, LINES, strict=False)
        for end in region.angle
    ]
    middle = float(np.median(draws[:, 2]))
    shift = 2.0 * np.pi * np.round((middle - measured[2]) / (2.0 * np.pi))
    return chart.panel(
        chart.histogram(np.degrees(draws[:, 2]), bins=BINS, color=chart.tint(palette.TRAIL, 0.7)),
        *ends,
        chart.vline(float(np.degrees(measured[2] + shift)), color=palette.INK, linewidth=0.9),
        xlabel="final theta [deg]",
        ylabel="draws",
    )


def coverage_chart(
    curves: Mapping[str, CoverageCurve],
    title: str = "",
    groups: Mapping[str, Sequence[FloatArray]] | None = None,
) -> Chart:
    """Draw the observed coverage of bounds against their stated probability, by kind of bound.

    Curves, and shares (n,) observed in single groups, are by the title of their panel.
    """
    row = [
        _coverage(f"{name}, {curve.outcomes} outcomes", curve, (groups or {}).get(name, ()))
        for name, curve in curves.items()
    ]
    head = ("bounds", "level", "held", "true_levels_from", "true_levels_to", "outcomes")
    rows = [
        (name, *one, curve.outcomes)
        for name, curve in curves.items()
        for one in zip(curve.levels, curve.held, curve.low, curve.high, strict=True)
    ]
    return Chart(
        title=title,
        size=(0.1 + 2.6 * len(row), 2.9),
        fill=chart.panels([row], 2, sharey=True),
        data=Table(head, rows),
    )


def _coverage(title: str, curve: CoverageCurve, groups: Sequence[FloatArray]) -> Mark:
    levels = 100.0 * curve.levels
    single = [
        chart.line(levels, 100.0 * own, color=palette.FIXEL, linewidth=0.5, alpha=0.6,
                   label=None if k else "single groups")
        for k, own in enumerate(groups)
    ]  # fmt: skip
    return chart.panel(
        chart.line((0, 100), (0, 100), color=palette.INK, linewidth=0.7, linestyle=chart.DASHED,
                   label="exact coverage"),
        chart.band(levels, 100.0 * curve.low, 100.0 * curve.high, color=palette.TRAIL,
                   alpha=0.35, linewidth=0.0, label="95 % range of exact coverage"),
        *single,
        chart.line(levels, 100.0 * curve.held, color=palette.FORCE, linewidth=1.2, marker="o",
                   markersize=2.5, label="held"),
        title=title,
        xlim=(0, 100),
        ylim=(0, 100),
        aspect="equal",
        xlabel="stated level [%]",
        ylabel="outcomes within bounds [%]",
    )  # fmt: skip


def prediction_bands_chart(found: Prediction) -> Chart:
    """Draw the nominal path of a prediction with bands of 50 and 90 %."""
    return bands_chart(found.time, found.nominal, [found.bands(level) for level in LEVELS])
