"""What `fixel bench` prints: trouble without a terminal, and what to do next."""

import json
from types import SimpleNamespace

import pytest
from tests.fixtures import short_plan

from fixel.cli import bench
from fixel.cli.main import run
from fixel.formats.plan_file import plan_text


def performed(capsys, *arguments):
    """Return what the command printed: standard output, and standard error."""
    with pytest.raises(SystemExit) as end:
        run(["bench", *map(str, arguments)])
    assert end.value.code in (0, None)
    return capsys.readouterr()


@pytest.mark.system
def test_next_is_a_command_that_does_something(tmp_path, capsys):
    plan, lab = tmp_path / "few.yaml", tmp_path / "lab"
    plan.write_text(plan_text(short_plan()))
    with pytest.raises(SystemExit):
        run(["new", str(lab)])
    capsys.readouterr()
    usual = (plan, "--project", lab, "--emulated", "--auto", "--fit", "mu_support")
    out = performed(capsys, *usual, "--limit", "1").out
    assert "the limit is reached" in out
    following = out.splitlines()[-1]
    assert following.startswith("Next: fixel bench")
    assert "--limit" not in following
    # An interval this wide is narrow enough at once, but only twice in a row.
    out = performed(capsys, *usual, "--until", "mu_support=0.9").out
    assert out.splitlines()[-1].startswith("Next: fixel calibrate --dataset few")


def test_trouble_is_printed_once_without_a_terminal(capsys):
    usual = {"look": None, "number": 1, "rows": 2, "row": "a", "phase": "trouble", "problems": []}
    last = ""
    for problems in ([], ["no camera"], ["no camera"], [], ["no camera"], ["no drive"]):
        report = json.dumps(usual | {"problems": problems})
        last = bench._show(SimpleNamespace(view=SimpleNamespace(report=report)), last)
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["trouble: no camera", "trouble: no camera", "trouble: no drive"]
