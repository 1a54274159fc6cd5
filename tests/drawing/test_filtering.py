"""Drawings of filter runs: everything inside, the occlusion marked, never a simulation as real."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from tests.filtering.recordings import push

from fixel.drawing.filtering import HIDDEN, draw_filter, filter_figure
from fixel.errors import InvalidInput
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.recorded import run_filter
from fixel.model import Scene

FEW = ParticleFilter(n_particles=40)


def without_fixels(experiment):
    scene = experiment.scene
    bare = Scene(bodies=scene.bodies, pushers=scene.pushers, duration=scene.duration)
    return replace(experiment, scene=bare, channels=(), contact_mode="")


@pytest.fixture(scope="module")
def runs():
    recorded = push(duration=3.0)
    bare = without_fixels(recorded)
    return {
        "hidden": (recorded, run_filter(recorded, FEW, occlusion=(1.0, 2.0))),
        "seen": (replace(recorded, real=True, simulated_by=""), run_filter(recorded, FEW)),
        "bare": (bare, run_filter(bare, replace(FEW, priors={"mu_pusher": None}))),
    }


def axes_of(figure):
    return {axes.get_label(): axes for axes in figure.axes}


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_runs_can_be_drawn(ending, runs, tmp_path):
    path = tmp_path / f"run.{ending}"
    draw_filter(*runs["hidden"], path)

    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    assert path.read_bytes().startswith(starts[ending])


def test_other_endings_are_refused(runs, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.pdf, \.png, \.svg"):
        draw_filter(*runs["seen"], tmp_path / "run.bmp")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["hidden", "seen", "bare"])
def test_no_axes_overlap_nor_leave_the_page(name, runs):
    places = [axes.get_position() for axes in filter_figure(*runs[name]).axes]

    assert all(0.0 < place.y0 < place.y1 < 1.0 for place in places)
    for above, below in pairwise(places):
        assert above.y0 > below.y1


@pytest.mark.parametrize("name", ["hidden", "seen", "bare"])
def test_everything_is_inside_the_view(name, runs):
    view = axes_of(filter_figure(*runs[name]))["view"]
    drawn = [line.get_xydata() for line in view.lines]
    drawn += [
        path.vertices
        for collection in view.collections
        if isinstance(collection, PolyCollection)
        for path in collection.get_paths()
    ]
    points = np.concatenate(drawn)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = np.array([view.get_xlim(), view.get_ylim()]).T
    assert (points >= low).all()
    assert (points <= high).all()


def test_only_what_no_camera_has_seen_carries_the_banner(runs):
    for name, real in (("hidden", False), ("seen", True)):
        words = " ".join(text.get_text() for text in filter_figure(*runs[name]).texts)
        assert ("SIMULATED by" in words) != real


def test_the_occlusion_is_marked(runs):
    def marked(name):
        view = axes_of(filter_figure(*runs[name]))["view"]
        return [line for line in view.lines if line.get_color() == HIDDEN]

    (line,) = marked("hidden")
    shown = np.isfinite(line.get_xdata())
    np.testing.assert_array_equal(shown, runs["hidden"][1].hidden)
    assert marked("seen") == marked("bare") == []


def test_curves_are_those_of_the_run(runs):
    experiment, found = runs["hidden"]
    axes = axes_of(filter_figure(experiment, found))
    measured, estimated = axes["x [mm]"].lines

    np.testing.assert_allclose(measured.get_ydata(), 1e3 * experiment.trajectory.pose[:, 0])
    np.testing.assert_allclose(estimated.get_ydata(), 1e3 * found.pose[:, 0])
    (tripod,) = axes["tripod\n[mm]"].lines
    np.testing.assert_allclose(tripod.get_ydata(), 1e3 * found.quantiles[:, 3, 1])
    assert set(axes_of(filter_figure(*runs["bare"]))) == {
        "view", "x [mm]", "y [mm]", "θ [deg]", "μ\nsupport", "tripod\n[mm]",
    }  # fmt: skip
