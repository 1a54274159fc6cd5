"""A scene file through the workflow: which method it is simulated with, which files it leaves."""

from pathlib import Path

import pytest

from fixel.errors import InvalidInput
from fixel.formats import SceneFile, save_scene
from fixel.simulation import Adaptive, GaussSeidel, QuasiStatic, StewartTrinkle
from fixel.testing import scenes
from fixel.workflows import compilation
from fixel.workflows.simulation import Outputs, SimulationMethod, parts, simulate_file


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "block.yaml"
    save_scene(SceneFile(scene=scenes.sliding_block(duration=0.2)), path)
    return path


def given(**options):
    return SceneFile(scene=scenes.sliding_block(), **options)


def test_the_file_says_the_method():
    motion, stepper, _ = parts(given(motion="quasistatic", step=0.02), SimulationMethod())

    assert isinstance(motion, QuasiStatic)
    assert stepper == StewartTrinkle(step=0.02)


def test_without_a_step_steps_are_adaptive():
    assert parts(given(), SimulationMethod())[1] == Adaptive()


def test_the_command_line_comes_before_the_file():
    method = SimulationMethod(motion="quasistatic", step=0.001, solver="gauss-seidel")

    motion, stepper, solver = parts(given(step=0.02), method)

    assert isinstance(motion, QuasiStatic)
    assert stepper == StewartTrinkle(step=0.001)
    assert isinstance(solver, GaussSeidel)


def test_a_tolerance_asks_for_adaptive_steps():
    assert parts(given(step=0.02), SimulationMethod(tolerance=1e-5))[1] == Adaptive(tolerance=1e-5)


def test_step_and_tolerance_exclude_each_other():
    with pytest.raises(InvalidInput, match="leave one out"):
        parts(given(), SimulationMethod(tolerance=1e-5, step=0.1))


@pytest.mark.parametrize("name", ["motion", "solver"])
def test_an_unknown_name_is_refused(name):
    with pytest.raises(InvalidInput, match="expected one of"):
        parts(given(), SimulationMethod(**{name: "magic"}))


def test_all_files_are_written(scene, tmp_path):
    outputs = Outputs(
        trajectory=tmp_path / "block.parquet",
        plot=tmp_path / "block.svg",
        animate=tmp_path / "block.gif",
    )

    run = simulate_file(scene, ["bodies.block.velocity=[0.2, 0, 0]"], outputs=outputs)

    assert run.converged
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "block.gif",
        "block.parquet",
        "block.svg",
        "block.yaml",
    ]


def test_impossible_files_are_refused_before_anything_is_simulated(scene, tmp_path, monkeypatch):
    monkeypatch.setattr("fixel.workflows.simulation.get_ready", lambda *_: pytest.fail("too late"))

    for outputs in (
        Outputs(plot=tmp_path / "a.bmp"),
        Outputs(animate=tmp_path / "a.avi"),
        Outputs(trajectory=tmp_path / "a.txt"),
        Outputs(trajectory=tmp_path / "nowhere" / "a.csv"),
    ):
        with pytest.raises(InvalidInput):
            simulate_file(scene, outputs=outputs)


def test_plain_and_compiled_loops_give_the_same(scene):
    compiled = simulate_file(scene)
    plain = simulate_file(scene, method=SimulationMethod(plain=True))

    assert compiled.final["block"].tolist() == plain.final["block"].tolist()


def test_compiling_is_announced_only_when_the_cache_is_cold(scene, monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(compilation, "cache_folder", lambda: str(scene.parent / "no-such-folder"))
    simulate_file(scene, notify=said.append)
    assert said == [compilation.COMPILING]

    (scene.parent / "no-such-folder").mkdir()
    (scene.parent / "no-such-folder" / "batch.rollout_batch-1.nbc").touch()
    simulate_file(scene, notify=said.append)
    assert len(said) == 1
