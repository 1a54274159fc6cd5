"""Drawings of experiments: everything inside, nothing invented, never a simulation as real."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.text import Text
from PIL import Image
from tests.drawing.collisions import axes_of, check_page
from tests.fixtures import bare_experiment

from fixel import InvalidInput, SimulatedTestbed, Trajectory
from fixel.drawing import palette
from fixel.drawing.chart import save_figure
from fixel.drawing.experiment import comparison_figure, experiment_figure
from fixel.drawing.thumbnail import thumbnail
from fixel.model import Channel
from fixel.sampling import thesis_plan
from fixel.testing.scenes import grasp

TIME = np.linspace(0.0, 2.0, 61)
SCENE = grasp("slip")
START = SCENE.bodies[0].pose
PATH = Trajectory(time=TIME, pose=START + TIME[:, None] * (0.03, 0.002, 0.1))
AWAY = Trajectory(time=TIME, pose=PATH.pose + TIME[:, None] * (0.004, 0.0, 0.05))
ON = np.column_stack((TIME > 1.0, np.zeros(61), (TIME > 0.5) & (TIME < 0.6))).astype(float)
TACTILE = Channel(
    name="tactile", time=TIME, columns=("fixel_1_bool", "fixel_2_bool", "fixel_3_bool"), values=ON
)
REAL = bare_experiment(
    "1", dataset="bench", object_name=SCENE.bodies[0].name, trajectory=PATH,
    pusher=Trajectory(time=TIME, pose=SCENE.pushers[0].pose + TIME[:, None] * (0.03, 0.0, 0.0)),
    scene=SCENE, channels=(TACTILE,), contact_mode="100", effective=(0.5, 2.0),
)  # fmt: skip
NOT_REAL = replace(REAL, real=False, simulated_by="a test")
PATH_ONLY = replace(REAL, scene=None, pusher=None, channels=())
ENDS = Trajectory(time=TIME[[0, -1]], pose=PATH.pose[[0, -1]])
TWO_POSES = replace(REAL, trajectory=ENDS, pusher=None, channels=(), effective=None)

EVERY = {"real": REAL, "simulated": NOT_REAL, "path only": PATH_ONLY, "two poses": TWO_POSES}


def test_names_are_no_formulas(tmp_path):
    """Matplotlib would refuse the first name, and draw the second as a letter."""
    for name in ("$\\frac{$", "$\\mu$"):
        figures = []

        def make(name=name, figures=figures):
            figures.append(experiment_figure(replace(REAL, dataset=name)))
            return figures[0]

        save_figure(make, tmp_path / "one.png")
        named = [text for text in figures[0].findobj(Text) if name in text.get_text()]
        assert named
        assert not any(text.get_parse_math() or text.get_usetex() for text in named)


def test_users_get_embedded_fonts_and_300_pixels_an_inch(tmp_path, full_style, monkeypatch):
    monkeypatch.setattr(palette, "STYLE", full_style)
    both = tmp_path / "both.png", tmp_path / "both.pdf"
    save_figure(lambda: comparison_figure(REAL, AWAY, TACTILE), *both)
    with Image.open(tmp_path / "both.png") as image:
        assert image.info["dpi"] == pytest.approx((300.0, 300.0), abs=0.1)
    written = (tmp_path / "both.pdf").read_bytes()
    assert b"/FontFile2" in written  # TrueType
    assert b"/Type3" not in written


@pytest.mark.parametrize("experiment", EVERY.values(), ids=EVERY)
def test_pages_are_complete_and_show_no_simulation_as_real(experiment):
    for figure in (experiment_figure(experiment), comparison_figure(experiment, AWAY)):
        check_page(figure, "SIMULATED by a test", experiment.real)


def test_poses_are_those_measured_in_millimetres_and_degrees():
    axes = axes_of(experiment_figure(REAL))
    for k, (label, factor) in enumerate(
        (("x [mm]", 1e3), ("y [mm]", 1e3), ("θ [deg]", 180.0 / np.pi))
    ):
        (line,) = axes[label].lines
        np.testing.assert_allclose(line.get_ydata(), PATH.pose[:, k] * factor, rtol=1e-12)


def test_nothing_is_drawn_between_two_poses():
    def outlines(experiment):
        view = axes_of(experiment_figure(experiment))["view"]
        return sum(len(c.get_paths()) for c in view.collections if isinstance(c, PolyCollection))

    assert outlines(replace(REAL, pusher=None)) > outlines(TWO_POSES) == len(SCENE.fixels) + 2


def test_the_strip_is_filled_while_a_fixel_is_touched():
    strip = axes_of(experiment_figure(REAL))["tactile"]
    first, second, third = (c for c in strip.collections)

    assert [tick.get_text() for tick in strip.get_yticklabels()] == [
        "fixel-1",
        "fixel-2",
        "fixel-3",
    ]
    assert not second.get_paths()
    spans = [np.ptp(c.get_paths()[0].vertices[:, 0]) for c in (first, third)]
    frame = TIME[1]
    np.testing.assert_allclose(spans, [ON[:, 0].sum() * frame, ON[:, 2].sum() * frame])
    assert "tactile" not in axes_of(experiment_figure(PATH_ONLY))


def test_errors_are_those_of_the_simulation():
    axes = axes_of(comparison_figure(REAL, AWAY))
    position = axes["position\nerror [mm]"].lines[0].get_ydata()
    angle = axes["angle\nerror [deg]"].lines[0].get_ydata()
    np.testing.assert_allclose(position, 4.0 * TIME, atol=1e-9)
    np.testing.assert_allclose(angle, np.degrees(0.05 * TIME), atol=1e-9)


def test_a_simulation_that_stopped_has_no_errors_afterwards():
    short = Trajectory(time=TIME[:20], pose=AWAY.pose[:20])
    axes = axes_of(comparison_figure(REAL, short))
    assert len(axes["position\nerror [mm]"].lines[0].get_xdata()) == 20


def test_a_simulation_of_another_time_is_refused():
    later = Trajectory(time=TIME + 10.0, pose=PATH.pose)
    with pytest.raises(InvalidInput, match="0 to 2 s"):
        comparison_figure(REAL, later)


def test_start_and_end_alone_are_drawn_as_two_poses(tmp_path, monkeypatch):
    """No line joins them, on the plate or against time: nothing was measured between."""
    (whole,) = SimulatedTestbed(seed=1).run(thesis_plan().experiments[:1])
    track = whole.trajectory
    ends = Trajectory(time=track.time[[0, -1]], pose=track.pose[[0, -1]])
    lines = []
    plain = Axes.plot

    def noted(self, *values, **style):
        drawn = plain(self, *values, **style)
        lines.extend((line.get_linestyle(), len(line.get_xdata())) for line in drawn)
        return drawn

    monkeypatch.setattr(Axes, "plot", noted)
    two = replace(whole, trajectory=ends, channels=(), effective=None)
    save_figure(lambda: experiment_figure(two), tmp_path / "two.png")
    assert lines
    assert {style for style, n in lines if n == 2 and style != "None"} <= set()
    # A dot is a line of no length; a measured way has one piece for each pose after the first.
    assert "L" in thumbnail(whole).rpartition("<path")[2]
    assert "L" not in thumbnail(two).rpartition("<path")[2]
