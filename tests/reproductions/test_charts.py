"""Pictures of reproductions are drawn, whatever they show."""

from functools import partial

import numpy as np
import pytest
from reproductions.charts.pictures import clusters_figure, paths_figure, supports_figure
from reproductions.repeats import GroupPrediction, repeats_figure

from fixel.drawing.chart import save_figure
from fixel.model import Body, Disk, Fixel, PathDrive, Polygon, Pusher, Scene, UniformPressure

SQUARE = 0.05 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
TRIANGLE = 0.03 * np.array([[0.0, 1.0], [-1.0, -0.5], [1.0, -0.5]])
WAY = np.column_stack((np.linspace(0.0, 0.02, 5), np.zeros(5), np.zeros(5)))
ACTUATOR = WAY[[0, -1]] - (0.1, 0.0, 0.0)
SCENE = Scene(
    bodies=(
        Body(
            name="square", shape=Polygon(SQUARE), mass=0.2, pose=WAY[0],
            support=UniformPressure(friction=0.3),
        ),
    ),
    pushers=(
        Pusher(
            name="head", shape=Polygon(0.2 * SQUARE), pose=ACTUATOR[0],
            drive=PathDrive(waypoints=np.column_stack(([0.0, 1.0], ACTUATOR))), friction=0.3,
        ),
    ),
    fixels=(
        Fixel(name="fixel-1", shape=Disk(0.005), pose=np.array([0.1, 0.0, 0.0]), friction=0.3),
    ),
    duration=1.0,
)  # fmt: skip
CLUSTERS = {str(k): (TRIANGLE[None], np.full((1, 3), 1 / 3)) for k in range(6)}


def prediction(name, end):
    size = np.array([1e-3, 0.01])
    return GroupPrediction(
        name, "two fingers", 3, size, end * size, size, 2.0 * size, 0.5 * size, failed=0
    )


REPEATS = partial(repeats_figure, [prediction("inside #1", 1.0), prediction("outside #1", 3.0)])
PICTURES = {
    "supports": partial(supports_figure, SQUARE, {"one": (TRIANGLE, TRIANGLE, -TRIANGLE)}),
    "paths": partial(paths_figure, SCENE, np.arange(5.0), WAY, {"before": WAY + 0.01}, ACTUATOR),
    "clusters": partial(clusters_figure, SQUARE, TRIANGLE, CLUSTERS),
    "no cluster": partial(clusters_figure, SQUARE, TRIANGLE, {}),
    "repeats": REPEATS,
}


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_every_kind_is_drawn(name, ending, tmp_path):
    file = tmp_path / f"picture{ending}"
    save_figure(PICTURES[name], file)
    assert file.stat().st_size > 2_000


def test_only_what_is_wider_than_predicted_is_marked():
    figure = REPEATS()
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels.count("measured, wider than predicted") == 1
