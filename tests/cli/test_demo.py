"""`fixel demo`: the first command of the README."""

import shlex

import pytest
from tests.cli.shell import exit_code as call

pytestmark = pytest.mark.system


@pytest.fixture
def short_film(monkeypatch):
    monkeypatch.setattr("fixel.drawing.animation.RATE", 3)


@pytest.mark.usefixtures("short_film")
def test_demo_tells_what_happened_and_what_to_type_next(tmp_path, capsys):
    folder = tmp_path / "demo"
    code = call("demo", "--quick", "--out", str(folder))
    out = capsys.readouterr().out
    assert code == 0
    assert "face to face" in out
    assert "the drive stalls at 34.3 N" in out
    assert f"fixel simulate {folder / 'grasp.yaml'}" in out
    assert {p.suffix for p in folder.iterdir()} == {".yaml", ".png", ".mp4", ".csv"}


@pytest.mark.usefixtures("short_film")
def test_the_suggested_commands_work(tmp_path, capsys, monkeypatch):
    """Every line that starts with `fixel` in the answer is a command that does what it says."""
    monkeypatch.chdir(tmp_path)
    call("demo", "--quick")
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    commands = [line.split()[1:] for line in lines if line.startswith("fixel simulate")]
    commands = [c for c in commands if c[-1] != "options."]
    assert [call(*command) for command in commands] == [3, 0]
    assert (tmp_path / "slippery.png").exists()


@pytest.mark.slow
def test_the_story_is_right_and_its_commands_work(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert call("demo") == 0

    out = capsys.readouterr().out
    assert "WRONG" not in out
    assert out.count("  right  ") == 6
    report = tmp_path / "fixel-demo" / "laboratory-1" / "report" / "report.html"
    text = report.read_text(encoding="utf-8")
    for part in ("data", "errors", "parameters", "error-bound", "plan"):
        assert f'<section id="{part}">' in text
    lines = [line.strip() for line in out.splitlines()]
    commands = [shlex.split(line)[1:] for line in lines if line.startswith("fixel plan run")]
    assert [call(*command[:-4], "-n", "3", *command[-2:]) for command in commands] == [0]
    assert "Held in pymunk" in capsys.readouterr().out


@pytest.mark.slow
def test_the_tour_of_a_misfit_ends_in_a_report(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert call("demo", "--misfit") == 0

    out = capsys.readouterr().out
    assert out.startswith("This laboratory does not fit the model")
    report = tmp_path / "fixel-demo" / "report" / "report.html"
    text = report.read_text(encoding="utf-8")
    for part in ("data", "errors", "parameters", "domain", "sensitivity"):
        assert f'<section id="{part}">' in text
    assert "were not tested on held-out experiments" not in text
    assert str(report.relative_to(tmp_path)) in out
    assert call("demo", "--misfit") == 0  # again, from what is there
    commands = [line.split()[1:] for line in out.splitlines() if line.startswith("  fixel domain")]
    assert [call(*command) for command in commands] == [0]


@pytest.mark.parametrize("which", [[], ["--misfit"], ["--quick"], ["--camera"]])
def test_a_file_is_no_folder_for_a_demo(tmp_path, capsys, which):
    """The file was named only after pushes had been performed, as a folder inside of itself."""
    (tmp_path / "notes").write_text("mine")
    assert call("demo", "--out", tmp_path / "notes", *which) == 2
    said = "".join(capsys.readouterr())
    assert f"--out: found the file {tmp_path / 'notes'}" in said
    assert "performing" not in said
    assert (tmp_path / "notes").read_text() == "mine"
