"""`fixel doctor`: one screen, and an exit code."""

import json

import pytest
from tests.cli.shell import exit_code as call

from fixel.workflows import installation


@pytest.fixture
def quick(monkeypatch):
    checks = {"fine": lambda: (True, "as it should be", 1e-12)}
    monkeypatch.setattr(installation, "_CHECKS", checks)
    monkeypatch.setattr("fixel.workflows.installation.get_ready", lambda *_: None)
    return checks


def test_a_healthy_machine_exits_0_on_one_screen(quick, capsys):
    code = call("doctor")
    out = capsys.readouterr().out
    assert code == 0
    assert "PASS  fine" in out
    assert "All checks passed" in out
    assert len(out.splitlines()) <= 24


def test_a_failure_exits_1(quick, capsys):
    quick["broken"] = lambda: (False, "wrong", None)
    assert call("doctor") == 1
    assert "FAIL  broken" in capsys.readouterr().out


def test_it_prints_at_once_that_code_cannot_be_stored(quick, capsys, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(installation, "cache_folder", lambda: f"{tmp_path}/file/cache")

    def compiled(*_):
        assert "Every process compiles all code again" in capsys.readouterr().err
        raise KeyboardInterrupt

    monkeypatch.setattr(installation, "get_ready", compiled)
    assert call("doctor") == 130


def test_json(quick, capsys):
    call("doctor", "--json")
    answer = json.loads(capsys.readouterr().out)
    assert answer["passed"] is True
    assert answer["checks"][-1]["name"] == "fine"
    assert answer["max_residual"] == 1e-12
    assert set(answer) >= {"versions", "machine", "cache", "seconds"}
