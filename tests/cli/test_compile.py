"""`fixel compile`: parts, times, and an exit code."""

import json
import sys
from importlib import import_module
from pkgutil import walk_packages

import pytest
from tests.cli.shell import exit_code as call

from fixel.kernels.code_cache import CodeCache
from fixel.workflows import installation


@pytest.fixture
def programs(monkeypatch, tmp_path):
    """Programs that run instead of the parts."""
    found = {"one": "print(2.5)", "two": "print(0.0)"}
    monkeypatch.setattr(installation, "_PARTS", found)
    real = installation.subprocess.run

    def run(command, **options):
        assert command[1:4] == ["-P", "-m", "fixel.workflows.installation"]
        return real([sys.executable, "-c", found[command[4]]], **options)

    monkeypatch.setattr(installation.subprocess, "run", run)
    return found


def test_parts_and_what_was_stored_before(programs, capsys):
    assert call("compile") == 0
    out = capsys.readouterr().out
    assert "2.5 s  one" in out
    assert "stored before  two" in out
    assert out.splitlines()[-1] == "Next: fixel demo"


def test_a_part_that_dies_is_named_and_exits_1(programs, capsys):
    programs["two"] = "import os; os.kill(os.getpid(), 9)"
    assert call("compile", "--json") == 1
    parts = json.loads(capsys.readouterr().out)["parts"]
    assert [part["name"] for part in parts] == ["one", "two"]
    assert parts[0]["problem"] == ""
    assert "-9" in parts[1]["problem"]


def test_parts_of_missing_extras_are_left_out(programs, monkeypatch, capsys):
    monkeypatch.setattr(installation, "_NEEDED", {"two": "no_such_package", "one": "json"})
    assert call("compile") == 0
    assert "two" not in capsys.readouterr().out


@pytest.mark.system
@pytest.mark.parametrize(
    ("part", "package"),
    [("films: rendering and tracking", "vision"), ("environments", "environments")],
)
def test_every_entry_of_an_extra_is_compiled(part, package):
    pytest.importorskip(installation._NEEDED[part])
    installation._PARTS[part]()
    own = import_module(f"fixel.{package}")
    for module in walk_packages(own.__path__, f"{own.__name__}."):
        for name, entry in vars(import_module(module.name)).items():
            if isinstance(getattr(entry, "_cache", None), CodeCache):
                assert entry.signatures, f"{module.name}.{name}"


def test_two_processes_run_at_once(programs, tmp_path):
    for own, other in (("one", "two"), ("two", "one")):  # each waits for the other
        programs[own] = f"""
import pathlib, time
pathlib.Path({str(tmp_path / own)!r}).touch()
until = time.monotonic() + 60.0
while not pathlib.Path({str(tmp_path / other)!r}).exists():
    assert time.monotonic() < until
    time.sleep(0.05)
print(1)
"""
    seen = []
    parts = installation.compile_kernels(lambda progress: seen.append(str(progress)))
    assert [(part.seconds, part.problem) for part in parts] == [(1.0, "")] * 2
    assert "0 of 2 parts" in seen[0]
