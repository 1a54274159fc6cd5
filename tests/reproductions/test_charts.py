"""Pictures of reproductions are drawn, whatever they hold, and only into files that can be."""

from pathlib import Path

import numpy as np
import pytest

from fixel.errors import InvalidInput
from fixel.reproductions.charts.reproductions import (
    ClusterPicture,
    PathCurve,
    PathPicture,
    SupportPanel,
    SupportPicture,
    TriangleCluster,
    draw,
)

SQUARE = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
TRIANGLE = 0.03 * np.array([[0.0, 1.0], [-1.0, -0.5], [1.0, -0.5]])
WAY = np.column_stack((np.linspace(0.0, 0.02, 5), np.zeros(5), np.zeros(5)))

PICTURES = {
    "supports": SupportPicture([SupportPanel("one", SQUARE, TRIANGLE, TRIANGLE, -TRIANGLE)]),
    "paths": PathPicture(
        outline=SQUARE,
        time=np.arange(5.0),
        curves=[
            PathCurve("measured", WAY, np.zeros(0)),
            PathCurve("before", WAY + 0.01, np.full(5, 0.014)),
        ],
        fixels=np.array([[0.1, 0.0]]),
        fixel_radius=0.005,
        actuator_outline=0.2 * SQUARE,
        actuator=WAY[[0, -1]] - (0.1, 0.0, 0.0),
    ),
    "clusters": ClusterPicture(
        SQUARE,
        TRIANGLE,
        [TriangleCluster(str(k), TRIANGLE[None], np.full((1, 3), 1 / 3)) for k in range(6)],
    ),
    "no cluster": ClusterPicture(SQUARE, TRIANGLE, []),
}


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_every_kind_is_drawn(name: str, ending: str, tmp_path: Path) -> None:
    file = tmp_path / f"picture{ending}"
    draw(PICTURES[name], file)
    assert file.stat().st_size > 5_000


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"\.png"):
        draw(PICTURES["paths"], tmp_path / "picture.txt")
