"""Pictures of domains that grow: what is drawn where, and the numbers behind it."""

from types import SimpleNamespace

import numpy as np
import pytest

from fixel.domain.along_axis import AxisStudy
from fixel.drawing.growth import axis_chart, growth_matrix, growth_steps

STEPS = np.arange(-5, 6)


def _study(size=3):
    error = np.vstack((np.abs(STEPS) + 1.0, 2.0 * np.abs(STEPS) + 1.0))
    error[1, 0] = np.nan
    return AxisStudy(
        shape="square", axis="y", size=size, interval=(-1, 1), steps=STEPS, layouts=("a", "b"),
        sets=(), error=error, own=np.full((2, 11), 0.5),
    )  # fmt: skip


def _growth():
    """A stand-in for the growth of two groups, the second of which ends early."""
    matrix = np.linspace(0.5, 30.0, 12).reshape(2, 6).tolist()
    matrix[1][4:] = [None, None]
    groups = [
        SimpleNamespace(shape=shape, layout="a", name=f"{shape} a")
        for shape in ("square", "pentagon")
    ]
    return SimpleNamespace(groups=groups, matrix=matrix)


def test_every_cell_of_the_matrix_has_its_number():
    chart = growth_matrix(_growth(), "mm^2")
    texts = [text.get_text() for text in chart.figure().axes[0].texts]
    assert texts.count("none") == 2
    assert texts[0] == "0.5"
    assert len(texts) == 12
    assert chart.table().head[1] == "step_0_mm2"
    assert chart.table().rows[1][-1] is None


def test_steps_have_a_line_a_layout_and_the_average():
    chart = growth_steps(_growth(), 5.0, "mm^2")
    figure = chart.figure()
    assert [axes.get_title() for axes in figure.axes] == ["square", "pentagon"]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["a", "average", "threshold 5 mm²"]
    assert ("pentagon", "a", 5, None) in chart.table().rows


def test_edges_lie_on_the_drawn_average():
    chart = axis_chart([_study()], 4.0, "mm^2", 0.008)
    above = chart.figure().axes[0]
    lines = {line.get_label(): line for line in above.get_lines()}
    x, y = lines["average"].get_data()
    edges = [line for line in above.get_lines() if line.get_marker() == "D"]
    assert len(edges) == 2
    for edge in edges:
        (place,), (level,) = edge.get_data()
        assert np.interp(place, x, y) == pytest.approx(level, rel=1e-3)
    assert lines["average"].get_markevery()[:2] == [0, 24]
    assert above.patches[0].get_x() == -1
    assert above.patches[0].get_width() == 2


def test_the_table_has_layouts_and_averages():
    table = axis_chart([_study()], 4.0, "mm^2").table()
    assert len(table.rows) == 33
    assert next(row for row in table.rows if row[5:7] == ("b", -5))[7:] == (None, 0.5, None)
    assert next(row for row in table.rows if row[5:7] == ("average", 2))[7:] == (4.0, 0.5, 3.5)
