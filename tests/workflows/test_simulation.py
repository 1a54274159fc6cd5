"""A scene file through the workflow: which method it is simulated with, which files it leaves."""

import sys
from pathlib import Path

import pytest

from fixel.errors import InvalidInput
from fixel.formats import SceneFile, load_scene, save_scene
from fixel.simulation import Adaptive, StewartTrinkle
from fixel.simulation.stepper import stepper_of
from fixel.testing import scenes
from fixel.workflows.simulation import Outputs, simulate_file


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
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "block.gif",
        "block.parquet",
        "block.svg",
        "block.yaml",
    ]


def test_impossible_files_are_refused_before_anything_is_simulated(scene, tmp_path, monkeypatch):
    module = sys.modules["fixel.simulation.simulate"]
    monkeypatch.setattr(module, "get_ready", lambda *_: pytest.fail("too late"))

    for outputs in (
        Outputs(plot=tmp_path / "a.bmp"),
        Outputs(animate=tmp_path / "a.avi"),
        Outputs(trajectory=tmp_path / "a.txt"),
        Outputs(trajectory=tmp_path / "nowhere" / "a.csv"),
    ):
        with pytest.raises(InvalidInput):
            simulate_file(load_scene(scene), outputs)


def test_plain_and_compiled_loops_give_the_same(scene):
    compiled = simulate_file(load_scene(scene))
    plain = simulate_file(load_scene(scene), plain=True)

    assert compiled.final == plain.final
