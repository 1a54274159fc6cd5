"""A scene file through the workflow: which method it is simulated with, which files it leaves."""

import sys
from pathlib import Path

import pytest
from tests.fixtures import refused

import fixel
from fixel.formats import SceneFile, load_scene, save_scene
from fixel.simulation import Adaptive, StewartTrinkle
from fixel.simulation.stepping import stepper_of
from fixel.testing import scenes
from fixel.workflows.capabilities import call
from fixel.workflows.simulation import Outputs, simulate_file, simulate_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "block.yaml"
    save_scene(SceneFile(scene=scenes.sliding_block(duration=0.2)), path)
    return path


def test_the_file_says_the_method(scene):
    save_scene(SceneFile(scene=scenes.grasp(), motion="quasistatic", step=0.5), scene)

    method = simulate_file(load_scene(scene)).method

    assert (method["motion"], method["stepper.step"]) == ("quasistatic", 0.5)


def test_options_come_before_the_file(scene):
    save_scene(SceneFile(scene=scenes.grasp(), step=0.5), scene)

    method = simulate_file(
        load_scene(scene),
        motion="quasistatic",
        stepper=stepper_of(1.0, None),
        solver="gauss-seidel",
    ).method

    assert method["motion"] == "quasistatic"
    assert method["stepper.step"] == 1.0
    assert method["solver"] == "gauss-seidel"


def test_a_tolerance_selects_adaptive_steps():
    assert stepper_of(None, 1e-5) == Adaptive(tolerance=1e-5)
    assert stepper_of(0.1, None) == StewartTrinkle(step=0.1)
    assert stepper_of(None, None) is None


def test_all_files_are_written(scene, tmp_path):
    outputs = Outputs(
        trajectory=tmp_path / "block.parquet",
        plot=tmp_path / "block.svg",
        animate=tmp_path / "block.gif",
    )

    run = simulate_file(load_scene(scene, ["bodies.block.velocity=[0.2, 0, 0]"]), outputs)

    assert run.converged
    assert {p.suffix for p in tmp_path.iterdir()} == {".gif", ".parquet", ".svg", ".yaml"}


def test_impossible_files_are_refused_before_anything_is_simulated(scene, tmp_path, monkeypatch):
    module = sys.modules["fixel.simulation.simulate"]
    monkeypatch.setattr(module, "get_ready", lambda *_: pytest.fail("too late"))

    for outputs in (
        Outputs(plot=tmp_path / "a.bmp"),
        Outputs(animate=tmp_path / "a.avi"),
        Outputs(trajectory=tmp_path / "a.txt"),
        Outputs(trajectory=tmp_path / "nowhere" / "a.csv"),
    ):
        refused(simulate_file, load_scene(scene), outputs)


def test_settings_are_parameters_or_keys_of_the_scene(tmp_path):
    """A parameter, with or without its unit, gives what the function and a changed file give."""
    path = scenes.pushed_square().save(tmp_path / "scene.yaml")
    end = fixel.simulate(path, {"mu_pusher": 0.1, "tripod_radius": 0.03}).final
    assert simulate_scene(path, overrides=["mu_pusher=0.1", "tripod_radius_mm=30"]).final == end
    mass = fixel.simulate(load_scene(path, ["bodies.0.mass=0.3", "duration=0.5"])).final
    varied = simulate_scene(path, overrides=["duration=0.5", "mass=0.3"]).final["part"]
    assert varied == pytest.approx(mass["part"], abs=1e-9)
    for setting, words in {
        "mu_puser=0.1": "did you mean 'mu_pusher'",
        "bodis.0.mass=1": "did you mean 'bodies'",
        "mu_pusher=low": "must be a number",
        "mu_pusher": "found no value",
    }.items():
        refused(simulate_scene, path, overrides=[setting], match=words)


def test_a_comparison_takes_the_settings_of_a_simulation(tmp_path):
    lab = fixel.Project.create(tmp_path / "lab")
    lab.add(fixel.datasets.example()[:1])

    def error(**settings):
        found = call(lab, "compare", experiment="1", motion="quasistatic", parameters=settings)
        return found.run.error_mm2

    usual = error()
    assert error(mu_pusher=0.1) != usual
    assert error(tripod_radius_mm=30) == error(tripod_radius=0.03) != usual
    assert error(**{"bodies.0.support.tripod.radius": 0.03}) == error(tripod_radius=0.03)
    assert error(**{"bodies.0.support.tripod.radius": 0.03, "tripod_radius_mm": 38}) == error(
        tripod_radius=0.038
    )
