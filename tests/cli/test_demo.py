"""`fixel demo`: the first command of the README."""

import pytest

from fixel.cli import main

pytestmark = pytest.mark.system


def call(*arguments: str) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as end:
        main.run(arguments)
    return int(end.value.code or 0)


def test_demo_tells_what_happened_and_what_to_type_next(tmp_path, capsys):
    folder = tmp_path / "demo"

    code = call("demo", "--quick", "--out", str(folder))

    out = capsys.readouterr().out
    assert code == 0
    assert "face to face" in out
    assert "the drive stalls at 34.3 N" in out
    assert f"fixel simulate {folder / 'grasp.yaml'}" in out
    assert {p.suffix for p in folder.iterdir()} == {".yaml", ".png", ".mp4", ".csv"}


def test_the_suggested_commands_work(tmp_path, capsys, monkeypatch):
    """Every line that starts with `fixel` in the answer is a command that does what it says."""
    monkeypatch.chdir(tmp_path)
    call("demo", "--quick")
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    commands = [line.split()[1:] for line in lines if line.startswith("fixel simulate")]
    commands = [c for c in commands if c[-1] != "options."]

    codes = [call(*command) for command in commands]

    assert codes == [3, 0]
    assert (tmp_path / "slippery.png").exists()


@pytest.mark.slow
def test_the_whole_tour_ends_in_a_report(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert call("demo") == 0

    out = capsys.readouterr().out
    report = tmp_path / "fixel-demo" / "report" / "report.html"
    text = report.read_text(encoding="utf-8")
    for part in ("data", "errors", "parameters", "domain", "sensitivity", "uncertainty"):
        assert f'<section id="{part}">' in text
    assert "was not analysed" not in text
    assert "were not tested on held-out experiments" not in text
    assert str(report.relative_to(tmp_path)) in out
    assert call("demo") == 0  # again, from what is there
    commands = [line.split()[1:] for line in out.splitlines() if line.startswith("  fixel domain")]
    assert [call(*command) for command in commands] == [0]
