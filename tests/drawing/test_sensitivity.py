"""Pictures of fans and indices, and the numbers behind them."""

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from tests.drawing.collisions import collisions
from tests.uncertainty.forks import fork, grid

from fixel.drawing import palette
from fixel.drawing.sensitivity import OutcomePoses, ends_chart, indices_chart
from fixel.uncertainty.indices import Factor, Indices


def ensemble_chart():
    drawn = grid(50, 1e-4)
    end = drawn + np.array([0.06, 0.0, 0.1])
    end[40:, 1] += 0.02
    ends = OutcomePoses(
        scene=fork(), drawn=drawn, end=end, nominal=end[0],
        outcome=(np.arange(50) >= 40).astype(int), share=(0.8, 0.2),
    )  # fmt: skip
    return ends_chart(ends, "a fork")


def a_push():
    table = np.array([[0.6, 0.3]] * 2)
    indices = Indices(
        factors=(Factor("mu_pusher", 0.1, 0.3), Factor("start_x", -1e-4, 1e-4)),
        outcomes=("along", "across"), units=("m", "m"), first=table, total=1.2 * table,
        first_error=0.1 * table, total_error=0.1 * table, deviation=np.array([1e-3, 1e-3]),
        evaluations=1, failed=0,
    )  # fmt: skip
    return indices_chart(SimpleNamespace(indices=indices))


@pytest.mark.parametrize("make", [ensemble_chart, a_push])
def test_a_picture_is_drawn_and_has_its_numbers(make, tmp_path):
    chart, file = make(), tmp_path / "one.png"
    chart.save(file, banner="SIMULATED by a test")
    assert file.read_bytes().startswith(b"\x89PNG")
    table = chart.table()
    assert table.rows
    assert all(len(row) == len(table.head) for row in table.rows)


def test_a_fan_names_its_outcomes_and_keeps_every_start():
    chart = ensemble_chart()
    labels = chart.figure().axes[0].get_legend_handles_labels()[1]
    assert {"outcome 1: 80%", "outcome 2: 20%", "nominal"} <= set(labels)
    assert [row[-1] for row in chart.table().rows] == [1] * 40 + [2] * 10


@pytest.mark.parametrize("turn", [1e-9, 1.0])
@pytest.mark.parametrize("size", [2e-9, 3e-4, 0.2])
def test_numbers_of_a_fan_do_not_collide(size, turn):
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3)) * (size, size, turn)
    end = drawn * (1.0, 0.01, 1.0) + np.array([0.06, 0.0, -1e-9])
    chart = ends_chart(OutcomePoses(fork(), drawn, end, end[0], np.zeros(60, int), (1.0,)))
    with mpl.rc_context(palette.STYLE):
        figure = chart.figure()
    assert not collisions(figure)
    assert "from -0.0" not in figure.axes[3].get_xlabel()


@pytest.mark.parametrize(("size", "unit"), [(5e-6, "µm"), (2e-3, "mm"), (0.012, "mm")])
def test_errors_have_the_unit_of_their_size(size, unit):
    errors = size * np.array([[1.0, 0.5, 0.0], [-0.5, 1.0, 0.0], [0.2, -0.3, 0.0]])
    chart = ends_chart(OutcomePoses(fork(), errors, errors, np.zeros(3), np.zeros(3, int), [1.0]))
    assert f"start error, x [{unit}]" in [axes.get_xlabel() for axes in chart.figure().axes]
