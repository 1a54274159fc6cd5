"""Figure of a sampling plan: a top view per shape and layout, with offsets as ghosts."""

from __future__ import annotations

from itertools import product
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.picture import frame_axes, save_made, tint
from fixel.drawing.view import LengthUnit, Rectangle, unit_for
from fixel.model import Disk, SupportPoints, placed
from fixel.sampling import FixelLayout, Offset, Plan, PlannedShape
from fixel.sampling.plan import object_pose
from fixel.sampling.rig import shape_of
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = tuple[PlannedShape, FixelLayout]
Style = dict[str, Any]

COLUMNS: Final = 5
MAX_PANELS: Final = 40  # more would be too small to read
MAX_GHOSTS: Final = 200  # maximum number of outlines in one panel, evenly selected

# Width of two columns of text, and margins of the panels [inch].
WIDTH: Final = 7.16
LEFT, RIGHT, BOTTOM, TOP = 0.48, 0.06, 0.36, 0.18
WIDE_LEFT: Final = 0.60  # left margin of a narrow page, whose numbers may have four digits
BETWEEN, ABOVE = 0.07, 0.17
SHAPE_GAP: Final = 0.20  # space before the rows of the next shape
LEGEND_ROW: Final = 0.18


def draw_plan(plan: Plan, path: str | Path) -> None:
    """Draw a plan: a small top view for each shape and layout.

    Parameters
    ----------
    plan : Plan
        Plan; at most 40 pairs of shape and layout are drawn, and a note has the number of others.
    path : str or Path
        File to write (`.pdf`, `.svg` or `.png`).

    Raises
    ------
    InvalidInput
        The file name has another ending.
    """
    save_made(lambda: plan_figure(plan), path)


def plan_figure(plan: Plan) -> Figure:
    """Create the figure that `draw_plan` saves, laid out in inches."""
    from matplotlib.figure import Figure

    panels = list(product(plan.shapes, plan.layouts))[:MAX_PANELS]
    rows = _rows(plan, panels)
    columns = max(len(row) for row in rows)
    box = _extent(plan, panels)
    page = palette.COLUMN if columns <= 2 else WIDTH
    margin = LEFT if page == WIDTH else WIDE_LEFT
    width = (page - margin - RIGHT - BETWEEN * (columns - 1)) / columns
    height = width * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    breaks = sum(_begins_shape(rows, k) for k in range(1, len(rows)))
    legend = LEGEND_ROW * (1 if page == WIDTH else 2)
    total = BOTTOM + legend + TOP + len(rows) * (height + ABOVE) + breaks * SHAPE_GAP
    figure = Figure(figsize=(page, total))
    top = total - TOP
    handles: list[Artist] = []
    for k, row in enumerate(rows):
        top -= ABOVE + (SHAPE_GAP if k and _begins_shape(rows, k) else 0.0)
        if _begins_shape(rows, k):
            _shape_name(figure, row[0][0], margin / page, (top + ABOVE) / total)
        for column, panel in enumerate(row):
            left = margin + column * (width + BETWEEN)
            place = (left / page, (top - height) / total, width / page, height / total)
            axes = figure.add_axes(place)
            handles = _draw_panel(plan, panel, axes, box)
            below = rows[k + 1] if k + 1 < len(rows) else []
            _label_edges(axes, column == 0, column >= len(below))
        top -= height
    _legend(figure, handles, page, total)
    left_out = len(plan.shapes) * len(plan.layouts) - len(panels)
    if left_out:
        note = f"and {left_out} more layouts"
        figure.text(1.0 - RIGHT / page, 1.0 - 0.05 / total, note, ha="right", va="top")
    return figure


def _rows(plan: Plan, panels: list[Panel]) -> list[list[Panel]]:
    """Arrange panels in rows of at most five; every shape begins a new row."""
    rows = []
    for shape in plan.shapes:
        own = [panel for panel in panels if panel[0].name == shape.name]
        rows += [own[k : k + COLUMNS] for k in range(0, len(own), COLUMNS)]
    return rows


def _begins_shape(rows: list[list[Panel]], k: int) -> bool:
    return k == 0 or rows[k][0][0].name != rows[k - 1][0][0].name


def _extent(plan: Plan, panels: list[Panel]) -> Rectangle:
    """Common extent of all panels [m]."""
    corners = [_head_outline(plan, 0.0), _head_outline(plan, plan.rig.travel)]
    shapes = {shape.name: shape for shape, _ in panels}
    for shape in shapes.values():
        corners += _ghosts(plan, shape)
        if any(layout.pegs for _, layout in panels):
            corners.append(_zone(plan, shape))
    points = np.concatenate(corners)
    (left, low), (right, high) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    margin = 0.03 * (right - left)
    # Symmetric about the line of motion, so that the head moves through the middle of every panel.
    side = max(high, -low) + margin
    return Rectangle((left - margin, right + margin), (-side, side))


def _draw_panel(plan: Plan, panel: Panel, axes: Axes, box: Rectangle) -> list[Artist]:
    unit = unit_for(box.size)
    frame_axes(axes, box, unit)
    shape, layout = panel
    handles = [_draw_zone(plan, shape, axes, unit)] if layout.pegs else []
    handles += _draw_head(plan, axes, unit)
    handles += _draw_object(plan, shape, axes, unit)
    if layout.pegs:
        _draw_pegs(plan, panel, axes, unit)
        handles.append(_peg_key())
    axes.set_title(layout.title, loc="left", fontsize=palette.FONT_SIZE, pad=2.0)
    return handles


def _draw_zone(plan: Plan, shape: PlannedShape, axes: Axes, unit: LengthUnit) -> Artist:
    style: Style = {"facecolor": "#F4F4F4", "edgecolor": palette.FIXEL, "linewidth": 0.4}
    style |= {"linestyle": (0, (4, 2))}
    _patches(axes, [_zone(plan, shape)], unit, zorder=0.5, **style)
    return _key("fixel zone", style)


def _draw_head(plan: Plan, axes: Axes, unit: LengthUnit) -> list[Artist]:
    start: Style = {"facecolor": palette.PUSHER, "edgecolor": palette.INK, "linewidth": 0.4}
    end: Style = {"facecolor": "none", "edgecolor": palette.PUSHER, "linewidth": 0.7}
    end |= {"linestyle": (0, (3, 2))}
    _patches(axes, [_head_outline(plan, 0.0)], unit, zorder=4, **start)
    _patches(axes, [_head_outline(plan, plan.rig.travel)], unit, zorder=4, **end)
    axes.annotate(
        "",
        (plan.rig.travel * unit.per_metre, 0.0),
        (0.0, 0.0),
        arrowprops={
            "arrowstyle": "-|>,head_length=0.3,head_width=0.15",
            "color": palette.INK,
            "linewidth": 0.6,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        },
        zorder=5,
    )
    return [_key("head, start", start), _key("head, end of travel", end)]


def _draw_object(plan: Plan, shape: PlannedShape, axes: Axes, unit: LengthUnit) -> list[Artist]:
    ghost: Style = {"facecolor": "none", "edgecolor": tint(palette.BODY, 0.45), "linewidth": 0.3}
    nominal: Style = {"edgecolor": palette.BODY, "linewidth": 0.9}
    nominal |= {"facecolor": (*tint(palette.BODY, 0.25), 0.55)}
    _patches(axes, _ghosts(plan, shape), unit, zorder=2, **ghost)
    _patches(axes, [_outline(plan, shape, Offset(axis="nominal", step=0.0))], unit, **nominal)
    handles = [_key("object, nominal", nominal), _key("object, offset", ghost | {"linewidth": 0.6})]
    if isinstance(shape.support, SupportPoints):
        pose = object_pose(plan.rig, shape, Offset(axis="nominal", step=0.0))
        handles += axes.plot(
            *(placed(shape.support.points, pose).T * unit.per_metre),
            marker="^",
            linestyle="none",
            color=palette.INK,
            markersize=3.5,
            label="support point",
            zorder=5,
        )
    return handles


def _draw_pegs(plan: Plan, panel: Panel, axes: Axes, unit: LengthUnit) -> None:
    disk = Disk(plan.rig.fixel_radius)
    places = plan.rig.peg_places(*panel)
    outlines = [disk.outline + place for place in places]
    style: Style = {"facecolor": palette.INK, "edgecolor": palette.INK, "linewidth": 0.3}
    _patches(axes, outlines, unit, zorder=6, **style)


def _peg_key() -> Artist:
    from matplotlib.lines import Line2D

    return Line2D(
        [], [], marker="o", linestyle="none", color=palette.INK, markersize=3.0, label="fixel"
    )


def _patches(axes: Axes, outlines: list[FloatArray], unit: LengthUnit, **style: Any) -> None:
    from matplotlib.collections import PolyCollection

    style.setdefault("zorder", 3)
    scaled = [outline * unit.per_metre for outline in outlines]
    axes.add_collection(PolyCollection(scaled, **style), autolim=False)


def _key(label: str, style: Style) -> Artist:
    from matplotlib.patches import Patch

    return Patch(label=label, **style)


def _label_edges(axes: Axes, left: bool, bottom: bool) -> None:
    """Label the axes of the outer panels only."""
    axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    axes.tick_params(labelleft=left, labelbottom=bottom, length=2.0)
    if not left:
        axes.set_ylabel("")
    if not bottom:
        axes.set_xlabel("")


def _shape_name(figure: Figure, shape: PlannedShape, x: float, y: float) -> None:
    figure.text(x, y, shape.name, weight="bold", fontsize=palette.FONT_SIZE + 1.0, va="bottom")


def _legend(figure: Figure, handles: list[Artist], page: float, total: float) -> None:
    figure.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.02 / total),
        ncols=len(handles) if page == WIDTH else 3,
        frameon=False,
        borderpad=0.0,
        handlelength=1.5,
        columnspacing=1.3,
        handletextpad=0.5,
    )


def _outline(plan: Plan, shape: PlannedShape, offset: Offset) -> FloatArray:
    return placed(shape.shape.outline, object_pose(plan.rig, shape, offset))


def _ghosts(plan: Plan, shape: PlannedShape) -> list[FloatArray]:
    """Outlines of the object at its offsets, or at an even selection of very many."""
    stride = ceil(len(plan.offsets) / MAX_GHOSTS)
    return [_outline(plan, shape, offset) for offset in plan.offsets[::stride]]


def _head_outline(plan: Plan, way: float) -> FloatArray:
    return placed(shape_of(plan.rig.head).outline, (way, 0.0, 0.0))


def _zone(plan: Plan, shape: PlannedShape) -> FloatArray:
    near, side = shape.zone_start, plan.rig.zone_side
    far, half = near + side, 0.5 * side
    return np.array([[near, -half], [far, -half], [far, half], [near, half]])
