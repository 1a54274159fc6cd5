"""Output of `fixel bench`: trouble without a terminal, and the next command."""

import json
import re
import socket
from html import unescape
from types import SimpleNamespace

import pytest
from tests.cli.shell import refusal
from tests.fixtures import short_plan
from tests.web.bench import Bench

from fixel.cli import bench
from fixel.cli.main import run
from fixel.database.project import Project
from fixel.formats.plan_file import plan_text


def performed(capsys, *arguments):
    """Return what the command printed: standard output, and standard error."""
    with pytest.raises(SystemExit) as end:
        run(["bench", *map(str, arguments)])
    assert end.value.code in (0, None)
    return capsys.readouterr()


@pytest.mark.system
@pytest.mark.usefixtures("small_laboratory")
def test_next_is_a_command_that_does_something(tmp_path, capsys):
    plan, lab = tmp_path / "few.yaml", tmp_path / "lab"
    plan.write_text(plan_text(short_plan()))
    with pytest.raises(SystemExit):
        run(["new", str(lab)])
    capsys.readouterr()
    usual = (plan, "--project", lab, "--emulated", "--auto", "--fit", "mu_support")
    out = performed(capsys, *usual, "--limit", "1").out
    assert out.startswith("Rows with experiments: 1 of 2; the limit is reached.")
    following = out.splitlines()[-1]
    assert following.startswith("Next: fixel bench")
    assert "--limit" not in following
    # An interval this wide is narrow enough at once, but only twice in a row.
    out = performed(capsys, *usual, "--until", "mu_support=0.9").out
    assert out.splitlines()[-1].startswith("Next: fixel calibrate --dataset few")
    answer = json.loads(performed(capsys, *usual, "--until", "mu_support=0.9", "--json").out)
    rows = [row for table in answer["tables"] for row in table["rows"]]
    assert [row[0] for row in rows][:1] == ["mu_support"]


def test_rows_and_trouble_are_printed_once_without_a_terminal(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(bench, "time", SimpleNamespace(monotonic=lambda: now[0]))
    usual = {"number": 1, "rows": 2, "row": "a", "phase": "trouble", "problems": [], "checks": []}
    session = SimpleNamespace(view=SimpleNamespace(report=json.dumps({})))
    show = bench._reporter(session)

    def reports(seconds, **changes):
        session.view.report = json.dumps(usual | changes)
        for _ in range(round(seconds / bench.EVERY)):
            now[0] += bench.EVERY
            show()

    show()
    reports(0.1, row="", number=0)
    for problems in ([], ["no camera"], ["no camera"], [], ["no camera"], ["no drive"], []):
        reports(0.1, problems=problems)
    full = {"name": "disk", "passed": False, "words": "full"}
    away = {"name": "in place", "passed": False, "words": "object: move it"}
    placing = {"phase": "placing", "checks": [full, away]}
    reports(bench.PATIENCE - 0.2, **placing)  # too short to be trouble
    reports(0.1, phase="placing")
    reports(bench.PATIENCE + 5.0, **placing)
    reports(bench.PATIENCE + 5.0, phase="placing", checks=[away])
    reports(0.1, number=2, row="b")
    first, *lines, second = capsys.readouterr().err.splitlines()
    assert (first, second) == ("row 1/2 a", "row 2/2 b")
    assert lines == [f"trouble: no {own}" for own in ("camera", "camera", "drive")] + [
        "trouble: disk: full"
    ]


@pytest.mark.usefixtures("small_laboratory")
def test_a_dry_run_serves_no_page(tmp_path, capsys, monkeypatch):
    plan, lab = tmp_path / "few.yaml", tmp_path / "lab"
    plan.write_text(plan_text(short_plan()))
    with pytest.raises(SystemExit):
        run(["new", str(lab)])
    monkeypatch.setattr(socket.socket, "listen", lambda *_: pytest.fail("a port was opened"))
    capsys.readouterr()
    printed = performed(capsys, plan, "--project", lab, "--emulated", "--dry-run")
    assert "Open http" not in printed.err
    assert "the drive can perform every row" in printed.out
    assert printed.out.splitlines()[-1] == f"Next: fixel bench {plan} --emulated --project {lab}"


def test_a_missing_rig_is_named_as_its_door_names_it(tmp_path, capsys):
    plan, lab = tmp_path / "few.yaml", tmp_path / "lab"
    plan.write_text(plan_text(short_plan()))
    Project.create(lab)
    message = refusal(capsys, "bench", plan, "--project", lab)
    assert "--rig: found none" in message
    assert "set --rig FILE" in message
    page = Bench(lab)
    shown = unescape(page.submit("/bench").text)
    page.close()
    assert "set rig FILE, or write it once into fixel.yaml" in shown
    assert "--" not in re.search(r"rig: found[^<]*", shown)[0]
