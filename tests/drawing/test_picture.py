"""Pictures: every kind of scene can be drawn, and what is drawn is where it should be."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from fixel import Polygon, QuasiStatic, StewartTrinkle, simulate
from fixel.drawing import palette
from fixel.drawing.picture import draw_simulation, force_text
from fixel.drawing.view import Rectangle, carried, contacts_at, ghosts, round_number, unit_for
from fixel.testing import scenes

RUNS = {
    "seated": lambda: simulate(scenes.grasp("seated")),
    "jammed": lambda: simulate(scenes.grasp("seated", force_limit=None)),
    "micrometres": lambda: simulate(scenes.micro_push(), motion=QuasiStatic()),
    "no pusher": lambda: simulate(scenes.sliding_block()),
    "heap": lambda: simulate(scenes.heap(9, duration=0.2)),
    "pressure": lambda: simulate(scenes.spinning_disk(duration=0.1)),
}


@pytest.mark.parametrize("name", RUNS)
def test_every_kind_of_scene_can_be_drawn(name, tmp_path):
    draw_simulation(RUNS[name](), tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 5000


def test_a_failed_run_is_marked():
    axes = Figure().add_subplot()
    draw_simulation(RUNS["jammed"](), axes)
    assert axes.get_title(loc="left").startswith("jammed at")
    assert "stopped here" in [text.get_text() for text in axes.get_legend().get_texts()]


def test_the_end_is_drawn_where_the_body_ends():
    run = RUNS["seated"]()
    axes = Figure().add_subplot()

    draw_simulation(run, axes)

    drawn = [
        path.vertices[:-1]
        for collection in axes.collections
        if isinstance(collection, PolyCollection)
        for path in collection.get_paths()
        if len(path.vertices) == 5
    ]
    centres = np.array([corners.mean(axis=0) for corners in drawn])
    expected = 1e3 * run.pose["object"][-1][:2]
    assert np.hypot(*(centres - expected).T).min() < 1e-9
    assert axes.get_aspect() == 1.0
    assert axes.get_xlabel() == "x [mm]"


def test_only_touched_fixels_are_highlighted():
    axes = Figure().add_subplot()
    draw_simulation(RUNS["jammed"](), axes)
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert {"fixel", "fixel, touched"} <= set(labels)
    assert len({palette.BODY, palette.PUSHER, palette.FIXEL, palette.TOUCHED, palette.FORCE}) == 5


@pytest.mark.parametrize(
    ("size", "name"), [(1e-4, "µm"), (2e-3, "µm"), (0.3, "mm"), (4.0, "mm"), (20.0, "m")]
)
def test_unit_suits_the_size(size, name):
    assert unit_for(size).name == name


@pytest.mark.parametrize(
    ("value", "rounded"), [(34.3, 20.0), (1.0, 1.0), (0.99, 0.5), (5e-9, 5e-9)]
)
def test_round_number(value, rounded):
    assert round_number(value) == pytest.approx(rounded)


@pytest.mark.parametrize(
    ("newtons", "text"), [(20.0, "20 N"), (0.5, "500 mN"), (2e-6, "2 µN"), (1e-10, "1e-10 N")]
)
def test_forces_have_the_prefix_that_suits_them(newtons, text):
    assert force_text(newtons) == text


def test_a_box_grows_to_an_aspect_and_keeps_its_centre():
    box = Rectangle((0.0, 4.0), (0.0, 1.0)).with_aspect(1.0)
    assert box == Rectangle((0.0, 4.0), (-1.5, 2.5))


def test_ghosts_stand_at_equal_travel():
    square = Polygon([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    # Slow first, then fast.
    poses = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [6, 0, 0]], float)
    found = ghosts(poses, square, most=5)
    np.testing.assert_allclose(found[:, 0], np.arange(1, 6))


@pytest.mark.parametrize("stepper", [None, StewartTrinkle(step=0.02)])
def test_contacts_are_carried_to_the_face_of_their_body(stepper):
    run = simulate(scenes.grasp("slip"), stepper=stepper, duration=3.0)
    end = float(run.time[-1])
    head = run.pose["actuator"][-1][0] + 0.0145
    points, _, _ = carried(run, contacts_at(run, end), end)
    assert len(points)
    np.testing.assert_allclose(points[:, 0], head, atol=2e-4)
