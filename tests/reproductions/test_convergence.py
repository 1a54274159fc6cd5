"""Searches that converge: their errors lie between 5 and 30 um, as those of the ASME paper do."""

import numpy as np
from reproductions.charts.convergence import BestSoFar, convergence_figure
from tests.drawing.collisions import collisions


def test_numbers_of_the_errors_do_not_collide():
    triangle = 4e-4 * np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.5]])
    outline = 1e-4 * np.array([[-4.2, -8.1], [4.2, -8.1], [4.2, 8.1], [-4.2, 8.1]])
    descents = [
        BestSoFar(
            f"search {k}", np.arange(50), np.geomspace(high, 0.005, 50),
            np.geomspace(8.0, 1e-3, 50), np.linspace(0.5 * triangle, triangle, 50),
            np.array([0.5, 0.5]),
        )
        for k, high in ((1, 0.031), (2, 0.017))
    ]  # fmt: skip
    assert not collisions(convergence_figure(outline, triangle, descents))
