"""Charts of maps: what is drawn is what the table says."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from tests.drawing.collisions import collisions

from fixel.drawing import palette
from fixel.drawing.chart import draw_chart
from fixel.drawing.domain import FILLS, MapChart, MapPanel, SizeChart, Strip

HEAD = ("group", "cell", "colour")


def _panel(rows, columns, name="a map"):
    names = list(FILLS)
    colour = [[names[(i + j) % len(names)] for j in range(columns)] for i in range(rows)]
    count = [[i * j for j in range(columns)] for i in range(rows)]
    inside = [[colour[i][j] == "trusted" for j in range(columns)] for i in range(rows)]
    return MapPanel(
        title=name, colour=colour, count=count, inside=inside, nominal=(0, columns // 2)
    )


def _chart(rows, columns, panels):
    return MapChart(
        across=Strip("offset y [mm]", tuple(f"{k}" for k in range(columns))),
        up=Strip("offset theta [deg]", tuple(f"{k}" for k in range(rows))),
        panels=tuple(_panel(rows, columns, f"map {k}") for k in range(panels)),
        heading="held-out error within 2 mm",
        head=HEAD,
        rows=[("map 0", "y = 0 mm", "trusted")],
    )


@pytest.mark.parametrize(("rows", "columns", "panels"), [(1, 11, 20), (6, 11, 4), (2, 7, 1)])
def test_every_cell_of_every_panel_is_drawn(tmp_path, rows, columns, panels):
    from matplotlib.patches import Rectangle

    chart = _chart(rows, columns, panels)
    shown = [axes for axes in chart.figure().axes if axes.get_visible()]
    assert len(shown) == panels
    for axes in shown:
        squares = [p for p in axes.patches if isinstance(p, Rectangle)]
        assert len(squares) == rows * columns
    draw_chart(chart, tmp_path / "map.png", banner="SIMULATED")
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
    sizes = {"square": np.arange(12.0), "pentagon": np.arange(12.0)[::-1].copy()}
    chart = SizeChart(
        thresholds=taus,
        sizes=sizes,
        cells=21,
        threshold=2.0,
        label="threshold τ [mm]",
        column="threshold_mm",
    )
    draw_chart(chart, tmp_path / "size.png")
    table = chart.table()
    assert table.head == ("threshold_mm", "cells_square", "cells_pentagon")
    assert len(table.rows) == 12
    assert table.rows[3][1:] == (3.0, 8.0)


def _named(rows, columns, panels, name):
    ticks = [name.format(k) for k in range(max(rows, columns))]
    return MapChart(
        across=Strip("offset y [mm]", tuple(ticks[:columns])),
        up=Strip("offset theta [deg]", tuple(ticks[:rows])) if rows > 1 else Strip("", ("",)),
        panels=tuple(_panel(rows, columns, f"{name.format(k)} on plywood") for k in range(panels)),
        heading="held-out error within 2 mm",
        head=HEAD,
    )


@pytest.mark.parametrize("name", ["{}", "-{}.25", "collinear-tight-{}"])
@pytest.mark.parametrize(
    ("rows", "columns", "panels"),
    [(1, 3, 4), (6, 3, 4), (1, 11, 2), (2, 40, 1), (20, 4, 2)],
)
def test_numbers_and_titles_of_a_map_do_not_collide(rows, columns, panels, name):
    with mpl.rc_context(palette.STYLE):
        figure = _named(rows, columns, panels, name).figure()
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


@pytest.mark.parametrize(
    "file",
    [
        "docs/how-to/domain.md",
        "docs/theory/domain.md",
        "src/fixel/domain/domain.py",
        "src/fixel/drawing/domain.py",
    ],
)
def test_no_text_calls_a_trusted_cell_green(file):
    root = Path(__file__).parents[2]
    assert "green" not in (root / file).read_text(encoding="utf-8").lower()
