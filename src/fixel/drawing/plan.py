"""Figure of a sampling plan: a top view per shape and layout, with offsets as ghosts."""

from __future__ import annotations

from itertools import product
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, legend_of, save_figure, sheet, tint
from fixel.drawing.top_view import DASHED, add_arrow, add_outlines, frame_axes, hollow, solid
from fixel.drawing.view import Rectangle, unit_for
from fixel.model import Disk, SupportPoints, placed
from fixel.sampling import FixelLayout, Offset, Plan, PlannedShape
from fixel.sampling.plan import object_pose
from fixel.sampling.rig import shape_of
from fixel.typing import FloatArray
from fixel.units import DisplayUnit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Panel = tuple[PlannedShape, FixelLayout]

COLUMNS: Final = 5
MAX_PANELS: Final = 40  # more would be too small to read
MAX_GHOSTS: Final = 200  # maximum number of outlines in one panel, evenly selected

ABOVE: Final = 0.22  # [inch], height of a title and of the gap between rows


def draw_plan(plan: Plan, path: str | Path) -> None:
    """Draw a plan: a small top view for each shape and layout.

    At most 40 pairs of shape and layout are drawn, and a note has the number of others. The ending
    of the file is `.pdf`, `.svg` or `.png`; another one raises `InvalidInput`.
    """
    save_figure(lambda: plan_figure(plan), path)


def plan_figure(plan: Plan) -> Figure:
    """Create the figure that `draw_plan` saves."""
    panels = list(product(plan.shapes, plan.layouts))[:MAX_PANELS]
    rows = _rows(plan, panels)
    columns = max(len(row) for row in rows)
    box = _extent(plan, panels)
    wide = WIDE if columns > 2 else palette.COLUMN
    height = (wide - 0.6) / columns * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    left_out = len(plan.shapes) * len(plan.layouts) - len(panels)
    note = f"and {left_out} more layouts" if left_out else ""
    figure = sheet(wide, len(rows) * (height + ABOVE) + 0.8, note)
    handles: list[Artist] = []
    for k, line in enumerate(figure.subplots(len(rows), columns, squeeze=False)):
        below = len(rows[k + 1]) if k + 1 < len(rows) else 0
        for column, axes in enumerate(line):
            if column >= len(rows[k]):
                axes.remove()
                continue
            shape, _ = rows[k][column]
            handles = _draw_panel(plan, rows[k][column], axes, box)
            axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
            axes.tick_params(labelleft=column == 0, labelbottom=column >= below, length=2.0)
            axes.set_xlabel(axes.get_xlabel() if column >= below else "")
            axes.set_ylabel("" if column else f"{shape.name}\n{axes.get_ylabel()}")
    legend_of(figure, handles, len(handles) if wide == WIDE else 3)
    return figure


def _rows(plan: Plan, panels: list[Panel]) -> list[list[Panel]]:
    """Arrange panels in rows of at most five; every shape begins a new row."""
    rows = []
    for shape in plan.shapes:
        own = [panel for panel in panels if panel[0].name == shape.name]
        rows += [own[k : k + COLUMNS] for k in range(0, len(own), COLUMNS)]
    return rows


def _extent(plan: Plan, panels: list[Panel]) -> Rectangle:
    """Common extent of all panels [m]."""
    corners = [_head_outline(plan, 0.0), _head_outline(plan, plan.rig.travel)]
    shapes = {shape.name: shape for shape, _ in panels}
    for shape in shapes.values():
        corners += _ghosts(plan, shape)
        if any(layout.pegs for _, layout in panels):
            corners.append(_zone(plan, shape))
    box = Rectangle.around(np.concatenate(corners))
    (left, right), (low, high) = box.x, box.y
    margin = 0.03 * (right - left)
    # Symmetric about the line of motion, so that the head moves through the middle of every panel.
    side = max(high, -low) + margin
    return Rectangle((left - margin, right + margin), (-side, side))


def _draw_panel(plan: Plan, panel: Panel, axes: Axes, box: Rectangle) -> list[Artist]:
    from matplotlib.lines import Line2D

    unit = unit_for(box.size)
    frame_axes(axes, box, unit)
    shape, layout = panel
    axes.set_title(layout.title, loc="left", fontsize=palette.FONT_SIZE, pad=2.0)
    handles = _draw_head(plan, axes, unit) + _draw_object(plan, shape, axes, unit)
    if not layout.pegs:
        return handles
    disk = Disk(plan.rig.fixel_radius)
    pegs = [disk.outline + place for place in plan.rig.peg_places(*panel)]
    add_outlines(axes, pegs, unit, zorder=6, linewidth=0.3, color=palette.INK)
    dashed = solid("#F4F4F4", palette.FIXEL, 0.4, linestyle=(0, (4, 2)), zorder=0.5)
    zone = add_outlines(axes, [_zone(plan, shape)], unit, "fixel zone", **dashed)
    dot = Line2D([], [], marker="o", linestyle="none", markersize=3.0, label="fixel",
                 color=palette.INK)  # fmt: skip
    return [*zone, *handles, dot]


def _draw_head(plan: Plan, axes: Axes, unit: DisplayUnit) -> list[Artist]:
    first, last = (_head_outline(plan, way) for way in (0.0, plan.rig.travel))
    start = solid(palette.PUSHER, palette.INK, 0.4, zorder=4)
    end = hollow(palette.PUSHER, 0.7, linestyle=DASHED, zorder=4)
    handles = add_outlines(axes, [first], unit, "head, start", **start)
    handles += add_outlines(axes, [last], unit, "head, end of travel", **end)
    way = np.array([[0.0, 0.0], [plan.rig.travel * unit.factor, 0.0]])
    add_arrow(axes, way[0], way[1], head=0.3, color=palette.INK, linewidth=0.6, zorder=5)
    return handles


def _draw_object(plan: Plan, shape: PlannedShape, axes: Axes, unit: DisplayUnit) -> list[Artist]:
    offset = hollow(tint(palette.BODY, 0.45), 0.3, zorder=2)
    nominal = solid((*tint(palette.BODY, 0.25), 0.55), palette.BODY, 0.9, zorder=3)
    at_nominal = Offset(axis="nominal", step=0.0)
    outlines = [_outline(plan, shape, at_nominal)]
    handles = add_outlines(axes, outlines, unit, "object, nominal", **nominal)
    handles += add_outlines(axes, _ghosts(plan, shape), unit, "object, offset", **offset)
    if isinstance(shape.support, SupportPoints):
        points = placed(shape.support.points, object_pose(plan.rig, shape, at_nominal))
        handles += axes.plot(*(points.T * unit.factor), "^", color=palette.INK, markersize=3.5,
                             label="support point", zorder=5)  # fmt: skip
    return handles


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
