"""Banners of pictures: they fit, measured by Matplotlib."""

import io

import pytest
from matplotlib.figure import Figure

from fixel.drawing.chart import add_banner
from fixel.workflows.analysis import banner_of

FILM = "SIMULATED by fixel testbed film of %03d-square-collinear-tight-nominal, seed 1"


@pytest.mark.parametrize("n", [1, 2, 3, 40])
def test_the_banner_of_films_fits_across_a_picture(n: int) -> None:
    banner = banner_of([FILM % k for k in range(n)])
    figure = Figure(figsize=(7.16, 3.0), layout="constrained")
    add_banner(figure, banner)
    figure.savefig(io.BytesIO(), format="png")
    box = figure.texts[0].get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1
    assert banner.startswith("SIMULATED")


def test_short_makers_are_all_named_and_real_experiments_have_no_banner() -> None:
    assert banner_of(["SIMULATED by a", "SIMULATED by b", "SIMULATED by a"]) == (
        "SIMULATED by a and SIMULATED by b"
    )
    assert banner_of(["", ""]) == ""
    assert banner_of(["", FILM % 1]) == "1 of 2 experiments SIMULATED"
