"""Charts of maps: what is drawn is what the table says."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing.collisions import collisions

from fixel.domain.cells import CellAxis, Cells
from fixel.domain.claim import CellVerdict, Claim
from fixel.drawing import palette
from fixel.drawing.domain import FILLS, map_chart, size_chart

CLAIM = Claim(threshold=2.0)


def _axis(name, ticks):
    return CellAxis(name=name, labels=tuple(ticks))


def _chart(rows, columns, panels, name="{}"):
    """A chart of a stand-in for a map: every colour, counts, and the trusted cells inside."""
    colours = list(FILLS)
    axes = [_axis("offset_y", [name.format(k) for k in range(columns)])]
    if rows > 1:
        axes.append(_axis("offset_theta", [name.format(k) for k in range(rows)]))
    index = [(j, i)[: len(axes)] for i in range(rows) for j in range(columns)]
    own = [
        CellVerdict(colours[(k // columns + k % columns) % len(colours)], 0.5, "why")
        for k in range(len(index))
    ]
    inside = [k for k, verdict in enumerate(own) if verdict.colour == "trusted"]
    counts = np.array([[(k // columns) * (k % columns) for k in range(len(index))]] * panels)
    domain = SimpleNamespace(
        groups=tuple(f"{name.format(k)} on plywood" for k in range(panels)),
        cells=Cells(axes=tuple(axes), index=tuple(index), nominal=columns // 2, arms=False),
        counts=counts,
        domains=lambda claim: [inside] * panels,
        statistic=lambda level: np.ones(counts.shape),
    )
    return map_chart(domain, CLAIM, [own] * panels, up=1 if rows > 1 else None)


@pytest.mark.parametrize(("rows", "columns", "panels"), [(1, 11, 20), (6, 11, 4), (2, 7, 1)])
def test_every_cell_of_every_panel_is_drawn(tmp_path, rows, columns, panels):
    from matplotlib.patches import Rectangle

    chart = _chart(rows, columns, panels)
    shown = [axes for axes in chart.figure().axes if axes.get_visible()]
    assert len(shown) == panels
    for axes in shown:
        assert len([p for p in axes.patches if isinstance(p, Rectangle)]) == rows * columns
    chart.save(tmp_path / "map.png", banner="SIMULATED")
    assert (tmp_path / "map.png").stat().st_size > 5000


def test_of_many_maps_the_first_are_drawn_and_the_heading_says_so():
    chart = _chart(1, 6, 40)
    figure = chart.figure()
    assert len([axes for axes in figure.axes if axes.get_visible()]) == 30
    assert any("and 10 more" in text.get_text() for text in figure.texts)


def test_colours_differ_in_lightness():
    from matplotlib.colors import to_rgb

    weights = np.array([0.2126, 0.7152, 0.0722])
    names = ("not trusted", "trusted", "doubtful", "no data")
    light = [float(weights @ to_rgb(FILLS[name]["facecolor"])) for name in names]
    assert np.diff(light).min() > 0.08


def test_sizes_against_thresholds(tmp_path):
    taus = np.geomspace(0.5, 10.0, 12)
    sizes = np.array([np.arange(12.0), np.arange(12.0)[::-1]])
    domain = SimpleNamespace(
        groups=("square", "pentagon"),
        usual_thresholds=taus,
        cells=range(21),
        curve=lambda claim, thresholds: sizes,
    )
    chart = size_chart(domain, CLAIM)
    chart.save(tmp_path / "size.png")
    table = chart.table()
    assert table.head == ("threshold_mm", "cells_square", "cells_pentagon")
    assert len(table.rows) == 12
    assert table.rows[3][1:] == (3.0, 8.0)


@pytest.mark.parametrize("name", ["{}", "-{}.25", "collinear-tight-{}"])
@pytest.mark.parametrize(
    ("rows", "columns", "panels"), [(1, 3, 4), (6, 3, 4), (1, 11, 2), (2, 40, 1), (20, 4, 2)]
)
def test_numbers_and_titles_of_a_map_do_not_collide(rows, columns, panels, name):
    with mpl.rc_context(palette.STYLE):
        figure = _chart(rows, columns, panels, name).figure()
    assert not collisions(figure)


def test_what_is_called_blue_is_blue():
    """A trusted cell has the palette's blue, in the cells and in the legend."""
    figure = _chart(1, 5, 1).figure()
    cells = [to_hex(patch.get_facecolor()) for patch in figure.axes[0].patches]
    assert cells[0] == palette.BODY.lower()
    (legend,) = figure.legends
    shown = {
        text.get_text(): handle
        for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }
    assert to_hex(shown["trusted"].get_facecolor()) == palette.BODY.lower()
