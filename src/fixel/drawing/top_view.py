"""Top views of the plate, alone or over panels against time, and what is drawn in them."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import Style, add_banner, clean, legend_of, sheet, tint
from fixel.drawing.view import UNITS, Rectangle, evenly
from fixel.model import Channel, Experiment, Fixel, Scene, Shape, placed
from fixel.typing import BoolArray, FloatArray
from fixel.units import DisplayUnit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM: Final = UNITS[1]
DASHED: Final = (0, (3, 2))
DOTTED: Final = (0, (1, 1))
MAX_OUTLINES: Final = 60  # maximum number of outlines from which an extent is computed
MAX_NAMES: Final = 12  # maximum number of fixels with names
LETTER: Final = 0.046  # [inch], mean width of a letter of a fixel's name
FEW_POSES: Final = 3  # up to this number of poses, draw dots: the motion between them is unknown
MARGIN: Final = 0.05  # share of the larger side, around all that is drawn
MIN_SIDE: Final = 5e-3  # [m], minimum side of a view, so that noise does not look like motion

# Sizes of a page of one column [inch].
WIDTH: Final = palette.COLUMN - 0.72  # of the axes
TALLEST, LOWEST = 3.4, 1.1  # of the view
PANEL, STRIP_ROW, LABELS = 0.72, 0.14, 0.42


def frame_axes(axes: Axes, box: Rectangle, unit: DisplayUnit = MM) -> None:
    """Set limits and labels of a top view."""
    axes.set_xlim(box.x[0] * unit.factor, box.x[1] * unit.factor)
    axes.set_ylim(box.y[0] * unit.factor, box.y[1] * unit.factor)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"x [{unit.name}]", labelpad=1.5)
    axes.set_ylabel(f"y [{unit.name}]", labelpad=1.5)
    axes.tick_params(pad=1.5)
    axes.locator_params(nbins=6, steps=[1, 2, 5, 10])
    axes.set_axisbelow(True)


def add_outlines(
    axes: Axes,
    outlines: Sequence[FloatArray],
    unit: DisplayUnit = MM,
    label: str = "",
    **style: Any,
) -> list[Artist]:
    """Draw filled outlines [m]; return their entry for a legend, if they have a label."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    scaled = [outline * unit.factor for outline in outlines]
    axes.add_collection(PolyCollection(scaled, **style), autolim=False)
    return [Patch(label=label, **style)] if label else []


def closed_line(outline: FloatArray, unit: DisplayUnit = MM) -> FloatArray:
    """Return the corners of a closed line (2, n + 1) about an outline [m], in a unit."""
    return np.vstack((outline, outline[:1])).T * unit.factor


def hollow(colour: Any, width: float = 0.8, **more: Any) -> Style:
    """Style of an outline that is not filled."""
    return {"facecolor": "none", "edgecolor": colour, "linewidth": width, **more}


def solid(colour: Any, edge: Any = palette.INK, width: float = 0.5, **more: Any) -> Style:
    """Style of a filled outline."""
    return {"facecolor": colour, "edgecolor": edge, "linewidth": width, **more}


def plain_view(axes: Axes, unit: DisplayUnit, of: str = "", margin: float = 0.05) -> None:
    """Set scales, margins and labels of a view whose limits follow its content."""
    axes.set_aspect("equal", adjustable="datalim")  # a flat panel would have no room for labels
    axes.margins(margin)
    axes.set(xlabel=f"x{of} [{unit.name}]", ylabel=f"y{of} [{unit.name}]")
    axes.spines[["top", "right"]].set_visible(False)


def add_arrow(
    axes: Axes, start: FloatArray, end: FloatArray, head: float = 0.35, **style: Any
) -> None:
    """Draw an arrow between two points of the axes."""
    look = {"arrowstyle": f"-|>,head_length={head},head_width={head / 2}", "shrinkA": 0.0}
    own = {k: style.pop(k) for k in ("color", "linewidth")}
    axes.annotate("", tuple(end), tuple(start), arrowprops=look | {"shrinkB": 0.0} | own, **style)


def add_name(axes: Axes, name: str, place: tuple[float, float], **style: Any) -> None:
    """Write a name to the right of a place of the axes, with a white rim."""
    import matplotlib.patheffects as effects

    style = {"xytext": (2.5, 0.0), "ha": "left", "va": "center", **style}
    axes.annotate(
        name,
        place,
        textcoords="offset points",
        fontsize=palette.FONT_SIZE - 1.5,
        color=palette.INK,
        zorder=8,
        annotation_clip=True,
        path_effects=[effects.withStroke(linewidth=1.5, foreground="white")],
        **style,
    )


def swept_points(shape: Shape | None, poses: FloatArray) -> list[FloatArray]:
    """Points that a motion covers [m]: outlines, or positions if the shape is unknown."""
    if shape is None:
        return [poses[:, :2]]
    return [placed(shape.outline, pose) for pose in poses[evenly(len(poses), MAX_OUTLINES)]]


def extent_of(
    corners: Iterable[FloatArray], fixels: Sequence[Fixel] = (), shape: Shape | None = None
) -> Rectangle:
    """Return the extent of outlines and fixels [m], with a margin and room for their names.

    It is at least `MIN_SIDE`, or half the radius of a small `shape`.
    """
    least = MIN_SIDE if shape is None else min(MIN_SIDE, 0.5 * shape.radius)
    points = np.concatenate([*corners, *(placed(f.shape.outline, f.pose) for f in fixels)])
    box = Rectangle.around(points, least).widened(MARGIN)
    per_inch = (box.x[1] - box.x[0]) / WIDTH
    ends = [
        float(f.pose[0]) + f.shape.radius + (LETTER * len(f.name) + 0.1) * per_inch
        for f in fixels[:MAX_NAMES]
    ]
    return Rectangle((box.x[0], max(box.x[1], *ends) if ends else box.x[1]), box.y)


def fixel_outlines(
    axes: Axes,
    fixels: Sequence[Fixel],
    touched: Container[str],
    unit: DisplayUnit = MM,
    label: str = "fixel, touched",
    **style: Any,
) -> list[Artist]:
    """Draw fixels; those that are `touched`, by name, have another colour and label."""
    handles: list[Artist] = []
    for colour, name, wanted in ((palette.FIXEL, "fixel", False), (palette.TOUCHED, label, True)):
        some = [f for f in fixels if (f.name in touched) == wanted]
        if some:
            outlines = [placed(f.shape.outline, f.pose) for f in some]
            handles += add_outlines(axes, outlines, unit, name, **solid(colour), **style)
    return handles


def add_fixels(axes: Axes, scene: Scene | None, mode: str = "") -> list[Artist]:
    """Draw fixels with their names; those whose digit of a contact mode is 1 were touched."""
    fixels = () if scene is None else scene.fixels
    # There may be a contact mode without fixels (no scene), or fixels without a contact mode.
    touched = [f.name for f, digit in zip(fixels, mode, strict=False) if digit == "1"]
    for fixel in fixels[:MAX_NAMES]:
        edge = placed(fixel.shape.outline, fixel.pose).max(axis=0) * MM.factor
        add_name(axes, fixel.name, (float(edge[0]), float(fixel.pose[1]) * MM.factor))
    return fixel_outlines(axes, fixels, touched, label="fixel touched at the end", zorder=4)


def add_start_and_end(
    axes: Axes, name: str, shape: Shape, poses: FloatArray, colour: str, strength: float
) -> list[Artist]:
    """Draw the outline of a body at the first pose, dashed, and filled at the last one."""
    first, last = (placed(shape.outline, poses[k]) for k in (0, -1))
    start = hollow(colour, linestyle=DASHED, zorder=2.7)
    end = solid(tint(colour, strength), colour, 0.8, zorder=2.5)
    return [
        *add_outlines(axes, [first], label=f"{name}, start", **start),
        *add_outlines(axes, [last], label=f"{name}, end", **end),
    ]


class ColumnPage(NamedTuple):
    """Axes of a page of one column, from top to bottom."""

    figure: Figure
    view: Axes
    panels: list[Axes]
    strip: Axes | None  # with a row for each fixel

    @property
    def against_time(self) -> list[Axes]:
        """Panels and strip, which share the axis of time."""
        return [*self.panels, *([] if self.strip is None else [self.strip])]


def column_page(
    box: Rectangle,
    labels: Sequence[str] = (),
    heights: Sequence[float] = (),
    fixels: Sequence[str] = (),
    row: float = STRIP_ROW,
    unit: DisplayUnit = MM,
) -> ColumnPage:
    """Create a page of one column: a top view, panels against time, a strip for fixels.

    The box is the extent of the view [m]. Panels have labels and heights [inch]. The strip has a
    row of the height `row` [inch] for each name of `fixels`; there is none without any.
    """
    height = WIDTH * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    height = min(TALLEST, max(LOWEST, height))
    tall = [height, *heights, *([row * len(fixels)] if fixels else [])]
    figure = sheet(palette.COLUMN, sum(tall) + 0.1 * len(tall) + LABELS * (1 + (len(tall) > 1)))
    view, *others = figure.subplots(len(tall), 1, height_ratios=tall, squeeze=False)[:, 0]
    view.set_label("view")
    view.set_anchor("N")  # constrained layout keeps room for its title
    box = box.with_aspect(height / WIDTH)
    frame_axes(view, box, unit)
    for axes, label in zip(others, labels, strict=False):
        axes.set_label(label)
        axes.set_ylabel(label, labelpad=2.0)
    strip = others[-1] if fixels else None
    if strip is not None:
        strip.set_label("tactile")
        strip.set_yticks(range(len(fixels)), fixels)
        strip.set_ylim(len(fixels) - 0.5, -0.5)
        strip.tick_params(axis="y", labelsize=palette.FONT_SIZE - 1.5, length=0.0)
    figure.align_ylabels(others[: len(labels)])
    return ColumnPage(figure, view, list(others[: len(labels)]), strip)


def _cut_short(text: str, most: int = 44) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def finish_page(
    page: ColumnPage,
    handles: Sequence[Artist],
    title: str = "",
    experiment: Experiment | None = None,
) -> Figure:
    """Add a legend at the bottom, a title, and a banner over a simulated experiment."""
    width, height = page.figure.get_size_inches()
    rows = legend_of(page.figure, handles)
    page.figure.set_size_inches(width, height + 0.15 * rows)
    if title:
        page.view.set_title(_cut_short(title, 52), loc="left", pad=3.5)
    if experiment is not None and not experiment.real:
        add_banner(page.figure, f"SIMULATED by {_cut_short(experiment.simulated_by)}")
    return page.figure


def time_axes(every: Sequence[Axes], time: FloatArray) -> tuple[float, float]:
    """Set limits, grids and labels of panels against time; return the limits [s]."""
    margin = 0.02 * float(time[-1] - time[0]) or 0.5
    limits = (float(time[0]) - margin, float(time[-1]) + margin)
    for axes in every:
        axes.set_xlim(limits)
        clean(axes)
        axes.tick_params(labelbottom=axes is every[-1])
    every[-1].set_xlabel("time [s]", labelpad=1.5)
    return limits


def touch_spans(time: FloatArray, on: BoolArray) -> list[tuple[float, float]]:
    """Intervals (start, length) of consecutive readings that are on [s]."""
    if len(time) < 2:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
    # A reading lasts until the next one; the last has the median duration.
    ends = np.append(time, time[-1] + float(np.median(np.diff(time))))
    return [(float(ends[a]), float(ends[b] - ends[a])) for a, b in edges.reshape(-1, 2)]


def readings(channel: Channel | None) -> dict[str, list[tuple[float, float]]]:
    """Intervals in which each fixel was touched, by its name: (start, length) [s]."""
    if channel is None:
        return {}
    return {
        column.removesuffix("_bool").replace("_", "-"): touch_spans(channel.time, values > 0.5)
        for column, values in zip(channel.columns, channel.values.T, strict=True)
        if column.endswith("_bool")
    }
