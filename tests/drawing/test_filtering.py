"""Drawings of filter runs: everything inside, the occlusion marked, never a simulation as real."""

from dataclasses import replace

import numpy as np
import pytest
from tests.drawing.collisions import axes_of, check_page
from tests.filtering.recordings import push

from fixel.drawing.chart import save_figure
from fixel.drawing.filtering import HIDDEN, filter_figure
from fixel.filtering.particle_filter import ParticleFilter
from fixel.filtering.recorded import run_filter
from fixel.model import Scene

FEW = ParticleFilter(n_particles=20)


def without_fixels(experiment):
    scene = experiment.scene
    bare = Scene(bodies=scene.bodies, pushers=scene.pushers, duration=scene.duration)
    return replace(experiment, scene=bare, channels=(), contact_mode="")


@pytest.fixture(scope="module")
def runs():
    recorded = push(duration=1.5)
    bare, seen = without_fixels(recorded), replace(recorded, real=True, simulated_by="")
    return {
        "hidden": (recorded, run_filter(recorded, FEW, occlusion=(0.5, 1.0))),
        "seen": (seen, run_filter(seen, FEW)),
        "bare": (bare, run_filter(bare, replace(FEW, priors={"mu_pusher": None}))),
    }


def test_runs_can_be_drawn(runs, tmp_path):
    save_figure(lambda: filter_figure(runs["hidden"][1]), tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 5000


@pytest.mark.parametrize("name", ["hidden", "seen", "bare"])
def test_pages_are_complete_and_show_no_simulation_as_real(name, runs):
    check_page(filter_figure(runs[name][1]), "SIMULATED by", runs[name][0].real)


def test_the_occlusion_is_marked(runs):
    def marked(name):
        view = axes_of(filter_figure(runs[name][1]))["view"]
        return [line for line in view.lines if line.get_color() == HIDDEN]

    (line,) = marked("hidden")
    shown = np.isfinite(line.get_xdata())
    np.testing.assert_array_equal(shown, runs["hidden"][1].hidden)
    assert marked("seen") == marked("bare") == []


def test_curves_are_those_of_the_run(runs):
    experiment, found = runs["hidden"]
    axes = axes_of(filter_figure(found))
    measured, estimated = axes["x [mm]"].lines

    np.testing.assert_allclose(measured.get_ydata(), 1e3 * experiment.trajectory.pose[:, 0])
    np.testing.assert_allclose(estimated.get_ydata(), 1e3 * found.pose[:, 0])
    (tripod,) = axes["tripod\n[mm]"].lines
    np.testing.assert_allclose(tripod.get_ydata(), 1e3 * found.quantiles[:, 3, 1])
    assert set(axes_of(filter_figure(runs["bare"][1]))) == {
        "view", "x [mm]", "y [mm]", "θ [deg]", "μ\nsupport", "tripod\n[mm]",
    }  # fmt: skip
