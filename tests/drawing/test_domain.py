"""Charts of maps: what is drawn is what the table says."""

import numpy as np
import pytest

from fixel.drawing.chart import draw_chart
from fixel.drawing.domain import FILLS, MapChart, Panel, SizeChart, Strip

HEAD = ("group", "cell", "colour")


def _panel(rows, columns, name="a map"):
    names = list(FILLS)
    colour = [[names[(i + j) % len(names)] for j in range(columns)] for i in range(rows)]
    count = [[i * j for j in range(columns)] for i in range(rows)]
    inside = [[colour[i][j] == "trusted" for j in range(columns)] for i in range(rows)]
    return Panel(title=name, colour=colour, count=count, inside=inside, nominal=(0, columns // 2))


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
    assert table.columns == ("threshold_mm", "cells_square", "cells_pentagon")
    assert len(table.rows) == 12
    assert table.rows[3][1:] == (3.0, 8.0)
