"""Maps of the domain of applicability, and its size against the threshold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.domain.cells import CellAxis
from fixel.domain.claim import CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.domain.push_bound import ErrorBound
from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Style
from fixel.errors import InvalidInput
from fixel.table import Table
from fixel.typing import IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours differ in lightness too; grey stands for no data.
FILLS: Final[Mapping[str, Style]] = {
    "trusted": {"facecolor": palette.BODY},
    "doubtful": {"facecolor": palette.PUSHER},
    "not trusted": {"facecolor": "#8C2D04"},
    "no data": {"facecolor": "#E8E8E8"},
    "predicted": {"facecolor": "#D6E6F2", "hatch": "////", "edgecolor": palette.BODY},
}
LIGHT: Final = ("trusted", "not trusted")  # cells whose letters are white
COLUMNS: Final = 5
MAX_PANELS: Final = 30
MAX_LETTERS: Final = 400  # maximum number of cells in a panel that shows counts of members
LETTER: Final = 0.62 * palette.FONT_SIZE / 72.0  # [inch], width of a letter
LINE: Final = 1.5 * palette.FONT_SIZE / 72.0  # [inch], distance of lines of text


def map_chart(
    domain: DomainMap,
    claim: Claim,
    verdicts: list[list[CellVerdict]],
    across: int = 0,
    up: int | None = None,
) -> Chart:
    """Draw small multiples of a map of the domain, one panel per group; at most 30 are drawn.

    The claim holds in blue cells. Columns are along the axis `across`, rows along `up`; without
    that, the cells through the nominal are drawn.
    """
    grid, axes, groups = domain.cells.grid(across, up), domain.cells.axes, domain.groups
    (n_up, n_across), shown = grid.shape, groups[:MAX_PANELS]
    ticks, up_ticks = _ticks(axes[across]), [""] if up is None else _ticks(axes[up])
    columns = min(len(shown), _most_columns(n_up, n_across))
    lines = math.ceil(len(shown) / columns)
    width = chart.WIDE if columns > 1 or n_across > 8 else palette.COLUMN + 0.6
    room = (width - 0.6 - LETTER * max(map(len, up_ticks))) / columns
    longest = max(map(len, ticks))
    upwards = LETTER * (longest + 1) > room / n_across
    side = max(min(0.42, room / n_across), 0.17)
    height = lines * (side * n_up + 0.42) + 0.75 + (LETTER * longest if upwards else 0.0)
    places = list(range(0, n_across, math.ceil(LINE * n_across / room)))
    inside = domain.domains(claim)

    def fill(figure: Figure) -> None:
        for k, own in enumerate(figure.subplots(lines, columns, squeeze=False).flat):
            if k >= len(shown):
                own.set_visible(False)
                continue
            last, labelled = k + columns >= len(shown), k % columns == 0 and n_up > 1
            _draw_cells(own, grid, domain.counts[k], verdicts[k], domain.cells.nominal)
            _outline(own, np.isin(grid, inside[k]))
            own.set_yticks(range(n_up), up_ticks if labelled else [""] * n_up)
            own.set_xticks(places, [ticks[j] if last else "" for j in places],
                             rotation=90 if upwards else 0)  # fmt: skip
            own.set_xlabel(axes[across].label if last else "")
            if labelled and up is not None:
                own.set_ylabel(axes[up].label)
            title = chart.shorten(shown[k] or "all experiments", int(room / LETTER))
            own.set_title(title, fontsize=palette.FONT_SIZE, pad=2.5)
        _legend(figure, {own[c].colour for own in verdicts[: len(shown)] for c in grid.flat})

    kind = "error" if claim.measure == "absolute" else "excess"
    share = f"{100.0 * claim.level:g} % of experiments"
    more = f" (and {len(groups) - len(shown)} more)" if len(groups) > len(shown) else ""
    return Chart(
        title=f"held-out {kind} within τ = {claim.text()} for {share}{more}",
        size=(width, max(height, 1.3)),
        fill=fill,
        data=_map_table(domain, claim, verdicts),
    )


def _map_table(domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]]) -> Table:
    inside, error = domain.domains(claim), domain.statistic(claim.level)
    head = ("group", "cell", "members", "error", "confidence", "colour", "in_domain", "reason")
    rows = [
        (group, domain.cells.text(c), domain.counts[g, c], error[g, c], verdict.confidence,
         verdict.colour, int(c in inside[g]), verdict.reason)
        for g, group in enumerate(domain.groups)
        for c, verdict in enumerate(verdicts[g])
    ]  # fmt: skip
    return Table(head, rows)


def _draw_cells(
    axes: Axes, grid: IntArray, counts: IntArray, verdicts: list[CellVerdict], nominal: int
) -> None:
    from matplotlib.patches import Rectangle

    for (i, j), cell in np.ndenumerate(grid):
        name, count = verdicts[cell].colour, int(counts[cell])
        style = {"edgecolor": "white", "linewidth": 0.6, **FILLS[name]}
        axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, **style))
        if count and grid.size <= MAX_LETTERS:
            ink = "white" if name in LIGHT else palette.INK
            axes.text(j, i, str(count), ha="center", va="center", color=ink,
                      fontsize=palette.FONT_SIZE - 1.5)  # fmt: skip
        if cell == nominal:
            # Circle a short number; put the mark next to a long one.
            place, size = ((j - 0.38, i + 0.3), 5.0) if count > 99 else ((j, i), 9.0)
            axes.plot(*place, marker="o", markersize=size, markerfacecolor="none",
                      markeredgecolor="white", markeredgewidth=1.1, zorder=5)  # fmt: skip
    axes.set(xlim=(-0.5, grid.shape[1] - 0.5), ylim=(-0.5, grid.shape[0] - 0.5))
    axes.tick_params(length=0.0, pad=1.5)
    axes.spines[:].set_visible(False)


def _legend(figure: Figure, used: set[str]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(label=name, **{"edgecolor": "white", **style})
        for name, style in FILLS.items()
        if name in used or name != "predicted"
    ]
    ring: Style = {"linestyle": "none", "marker": "o", "markerfacecolor": "none"}
    handles.append(Line2D([], [], color=palette.INK, linewidth=1.6, label="D(τ)"))
    handles.append(Line2D([], [], markeredgecolor=palette.INK, label="nominal", **ring))
    chart.legend_of(figure, handles, 4 if figure.get_figwidth() < 5.0 else len(handles))


def _most_columns(n_up: int, n_across: int) -> int:
    """Number of panels side by side, by the number of cells in one."""
    if n_up == 1:
        return 2 if n_across > 6 else 3
    return max(1, min(COLUMNS, 28 // max(n_across, 4)))


def _ticks(axis: CellAxis) -> list[str]:
    if axis.edges:
        return [f"{axis.factor * centre + 0.0:.3g}" for centre in axis.centres]
    return [axis.text(k) for k in range(len(axis))]


def _outline(axes: Axes, inside: Any) -> None:
    """Draw a line around D(tau), also along the edges of the map."""
    padded = np.pad(inside, 1)
    for i, j in zip(*np.nonzero(padded), strict=True):
        y, x = i - 1.5, j - 1.5
        sides = (
            (padded[i - 1, j], (x, x + 1), (y, y)),
            (padded[i + 1, j], (x, x + 1), (y + 1, y + 1)),
            (padded[i, j - 1], (x, x), (y, y + 1)),
            (padded[i, j + 1], (x + 1, x + 1), (y, y + 1)),
        )
        for covered, across, up in sides:
            if not covered:
                axes.plot(across, up, color=palette.INK, linewidth=1.6, clip_on=False, zorder=4,
                          solid_capstyle="projecting")  # fmt: skip


def size_chart(domain: DomainMap, claim: Claim | None = None) -> Chart:
    """Draw the number of cells in the domain of applicability against the threshold."""
    claim = claim or domain.claimed
    absolute, cells = claim.measure == "absolute", len(domain.cells)
    thresholds = domain.usual_thresholds
    sizes = np.asarray(domain.curve(claim, thresholds.tolist()), np.float64)
    single = len(sizes) == 1
    thin: Style = {"color": palette.BODY if single else palette.TRAIL, "linewidth": 0.7}
    marks = [chart.steps(thresholds, own, where="post", alpha=0.7, **thin) for own in sizes]
    if not single:
        marks.append(chart.steps([], [], label=f"{len(sizes)} maps", **thin))
        marks.append(chart.steps(thresholds, sizes.mean(axis=0), where="post", linewidth=1.6,
                                 color=palette.BODY, label="mean"))  # fmt: skip
    curves = chart.panel(
        *marks,
        chart.vline(claim.threshold, color=palette.INK, linewidth=0.8, linestyle=chart.DASHED,
                    label="requested τ"),
        lambda axes: axes.legend(frameon=False, loc="upper left"),
        log={"x": thresholds},
        whole="y",
        ylim=(-0.02 * cells, 1.04 * max(float(sizes.max()), 1.0)),
        xlabel=f"threshold τ{' [mm]' if absolute else ', share above the smallest error'}",
        ylabel=f"cells in D(τ), of {cells}",
    )  # fmt: skip
    names = [f"cells_{group or 'all'}".replace(" ", "_") for group in domain.groups]
    columns = dict(zip(names, sizes, strict=True))
    threshold = f"threshold_{'mm' if absolute else 'share'}"
    return Chart(
        size=(palette.COLUMN + 0.9, 2.7),
        fill=chart.panels([[curves]], legend=0),
        data=Table.from_columns({threshold: thresholds, **columns}),
    )


def claimed_map_chart(found: DomainMap, *, axis: str | None = None) -> Chart:
    """Draw the verdicts of a map over its axes, or along one of them through the nominal."""
    names = [own.name for own in found.cells.axes]
    if axis is not None and axis not in names:
        raise InvalidInput("axis", found=repr(axis), expected="one of " + ", ".join(names))
    alone = found.cells.is_strips or axis is not None
    across, up = 0 if axis is None else names.index(axis), None if alone else 1
    return map_chart(found, found.claimed, found.verdicts(found.claimed), across, up)


def bound_chart(found: ErrorBound) -> Chart:
    """Draw held-out errors of end positions against their bounds; those below the line hold."""
    return Chart(
        title="End position: held-out errors and their bounds",
        size=(palette.COLUMN, 2.8),
        fill=chart.panels([[_bound_panel(found)]]),
        data=found._data(),
    )


def _bound_panel(found: ErrorBound) -> chart.Mark:
    data = found.to_dict()
    pairs = zip(data["position"], data["position_bound"], strict=True)
    shown = [
        (1e3 * bound, 1e3 * error)
        for error, bound in pairs
        if isinstance(error, float) and isinstance(bound, float)
    ]
    most = 1.1 * max((bound for bound, _ in shown), default=1.0)
    return chart.panel(
        chart.line(*np.reshape(shown, (-1, 2)).T, ".", color=palette.BODY),
        chart.line([0.0, most], [0.0, most], color=palette.INK, linewidth=0.8),
        xlim=(0.0, most),
        ylim=(0.0, None),
        xlabel=f"bound, {100.0 * found.level:g} % [mm]",
        ylabel="held-out error [mm]",
    )


def draw_bounds(found: ErrorBound, *, ax: Axes | None = None) -> Any:
    """Draw the chart of bounds, or into axes."""
    if ax is None:
        return chart.plot_axes(bound_chart(found).figure)
    _bound_panel(found)(ax)
    return ax
