"""Tables of a database and their references, as an entity relationship diagram."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fixel.drawing import palette
from fixel.drawing.chart import new_figure, save_figure, tint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE: Final = 0.145  # [inch], height of a column's name
WIDTH: Final = 1.75  # [inch], width of a table
BETWEEN: Final = 0.75  # [inch] between two tables in a row
ABOVE: Final = 0.28  # [inch] between two tables on top of each other
MARGIN: Final = 0.15  # [inch]
SIZE: Final = 6.5  # [point], size of letters


class Entity(NamedTuple):
    """Table of a database, with its columns and references."""

    name: str
    columns: Sequence[str]
    references: dict[str, str]  # column -> table


def draw_relations(entities: Sequence[Entity], file: str | Path) -> None:
    """Draw tables as boxes, and a line from each column to the table that it refers to.

    Tables stand right of those they refer to. The three-pronged end of a line is at the table whose
    rows, possibly many, refer to one row of the other.
    """
    save_figure(lambda: _figure(entities), file)


def columns_of(entities: Sequence[Entity]) -> list[list[Entity]]:
    """Arrange tables in columns, each right of all tables it refers to, and near them."""
    known = {entity.name: entity for entity in entities}

    def depth(entity: Entity) -> int:
        above = {name for name in entity.references.values() if name != entity.name}
        return 1 + max((depth(known[name]) for name in above), default=-1)

    depths = {entity.name: depth(entity) for entity in entities}
    for name in sorted(depths, key=lambda name: -depths[name]):
        used = [
            depths[e.name] for e in entities if name in e.references.values() and e.name != name
        ]
        depths[name] = min(used) - 1 if used else depths[name]
    return [
        [entity for entity in entities if depths[entity.name] == k]
        for k in range(max(depths.values()) + 1)
    ]


def _figure(entities: Sequence[Entity]) -> Figure:
    stacks = columns_of(entities)
    tall = max(sum(_height(e) + ABOVE for e in stack) for stack in stacks)
    wide = len(stacks) * (WIDTH + BETWEEN) - BETWEEN
    figure = new_figure(figsize=(wide + 2 * MARGIN, tall + 2 * MARGIN))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(-MARGIN, wide + MARGIN)
    axes.set_ylim(-tall - MARGIN, MARGIN)
    axes.axis("off")
    places: dict[str, tuple[float, float]] = {}
    for k, stack in enumerate(stacks):
        spare = (tall - sum(_height(e) + ABOVE for e in stack)) / max(len(stack), 1)
        y = -0.5 * spare
        for entity in stack:
            places[entity.name] = (k * (WIDTH + BETWEEN), y)
            _box(axes, entity, *places[entity.name])
            y -= _height(entity) + ABOVE + spare
    gaps = _gaps(stacks, places, tall)
    others = sorted({name for entity in entities for name in entity.references.values()})
    for entity in entities:
        for column, other in entity.references.items():
            # Lines to one table share a vertical segment, so that different tables are distinct.
            turn = BETWEEN * (0.2 + 0.6 * others.index(other) / len(others))
            _line(axes, entity, column, other, turn, places, gaps)
    return figure


def _gaps(
    stacks: Sequence[Sequence[Entity]], places: dict[str, tuple[float, float]], tall: float
) -> list[list[float]]:
    """Heights at which a line can pass between the tables of each column."""
    found = []
    for stack in stacks:
        tops = [places[entity.name][1] for entity in stack]
        ends = [top - _height(entity) for top, entity in zip(tops, stack, strict=True)]
        above = [0.5 * MARGIN, *ends]
        below = [*tops, -tall - 0.5 * MARGIN]
        found.append([0.5 * (a + b) for a, b in zip(above, below, strict=True)])
    return found


def _height(entity: Entity) -> float:
    return LINE * (len(entity.columns) + 1.6)


def _box(axes: Axes, entity: Entity, x: float, y: float) -> None:
    from matplotlib.patches import Rectangle

    style: dict[str, Any] = {"edgecolor": palette.INK, "linewidth": 0.6}
    body = tint(palette.BODY, 0.06)
    axes.add_patch(
        Rectangle((x, y - _height(entity)), WIDTH, _height(entity), facecolor=body, **style)
    )
    head = tint(palette.BODY, 0.25)
    axes.add_patch(Rectangle((x, y - 1.3 * LINE), WIDTH, 1.3 * LINE, facecolor=head, **style))
    axes.text(x + 0.06, y - 0.65 * LINE, entity.name, va="center", fontsize=SIZE, weight="bold")
    for column in entity.columns:
        key = column in entity.references
        axes.text(
            x + 0.06, _row(entity, column, y), column, va="center", fontsize=SIZE,
            color=palette.BODY if key else palette.INK, style="italic" if key else "normal",
        )  # fmt: skip


def _row(entity: Entity, column: str, y: float) -> float:
    return y - LINE * (list(entity.columns).index(column) + 1.9)


def _line(
    axes: Axes,
    entity: Entity,
    column: str,
    other: str,
    bend: float,
    places: dict[str, tuple[float, float]],
    gaps: list[list[float]],
) -> None:
    x, top = places[entity.name]
    y = _row(entity, column, top)
    style: dict[str, Any] = {"color": palette.FORCE, "linewidth": 0.7, "solid_capstyle": "round"}
    if other == entity.name:  # a record that replaces another of its table
        right = x + WIDTH
        up = top - 0.65 * LINE
        turn = right + 0.22 * BETWEEN
        axes.plot([right, turn, turn, right], [y, y, up, up], **style)
        return
    to_x, to_top = places[other]
    end, up = to_x + WIDTH, to_top - 0.65 * LINE
    turn = x - bend
    way = [(x, y), (turn, y)]
    first, last = round(to_x / (WIDTH + BETWEEN)) + 1, round(x / (WIDTH + BETWEEN))
    for k in range(last - 1, first - 1, -1):  # around the tables of the columns between
        height = min(gaps[k], key=lambda gap: abs(gap - up))
        left = k * (WIDTH + BETWEEN) - bend
        way += [(way[-1][0], height), (left, height)]
    axes.plot(*zip(*way, (way[-1][0], up), (end, up), strict=True), zorder=0.5, **style)
    fork = 0.07
    for prong in (-0.4, 0.4):
        axes.plot([x - fork, x], [y, y + prong * LINE], **style)
    axes.plot([end + 0.05, end + 0.05], [up - 0.3 * LINE, up + 0.3 * LINE], **style)
