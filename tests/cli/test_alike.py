"""What all commands share: --project, what is next, errors for programs, help, completion."""

import json
import os
import shlex
import subprocess
import sys

import pytest
import typer
from tests.cli.shell import fixel, json_of, output, refusal
from tests.fixtures import bare_experiment

from fixel.cli.main import app
from fixel.database.project import Project
from fixel.model import Trajectory
from fixel.testing.scenes import micro_push

# Commands that look into a project.
IN_PROJECTS = {
    "import", "list", "show", "compare", "filter", "export", "calibrate", "domain",
    "domain growth", "sensitivity", "uncertainty", "report", "serve", "overlay", "track",
    "calibrations", "plan check", "plan held", "plan next", "plan run",
    "testbed run", "testbed film", "jobs status", "db upgrade", "db backup", "db check",
}  # fmt: skip


def commands(group, before=()):
    """Every command with its whole name."""
    for name, command in group.commands.items():
        words = (*before, name)
        if hasattr(command, "commands"):
            yield from commands(command, words)
        yield " ".join(words), command


def add(project, key, end, **more):
    """Store an experiment that ends at a pose."""
    dataset, name = key.split("/")
    path = Trajectory(time=[0.0, 1.0], pose=[[0.0, 0.0, 0.0], end])
    with project.store() as store:
        store.add_experiment(bare_experiment(name, dataset=dataset, trajectory=path, **more))


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A project whose folder needs quotes, with experiments whose names do."""
    monkeypatch.chdir(tmp_path)
    project = Project.create(tmp_path / "my lab")
    for name, speed, surface in (("run 1; true", 0.02, "felt"), ("2", 0.05, "plywood")):
        conditions = {"speed_m_s": speed, "surface": surface}
        add(project, f"own/{name}", [0.05, 0.0, 0.1], conditions=conditions)
    return project.folder


def test_the_project_is_named_alike_everywhere():
    known = dict(commands(typer.main.get_command(app)))
    for name in IN_PROJECTS:
        options = [p for p in known[name].params if "--project" in p.opts]
        assert [sorted(p.opts) for p in options] == [["--project", "-p"]], name


def test_every_option_has_a_meaning():
    for name, command in commands(typer.main.get_command(app)):
        for option in command.params:
            assert (option.help or "").endswith("."), (name, option.name)


def test_the_tolerance_of_a_part_is_named_alike_everywhere():
    known = dict(commands(typer.main.get_command(app)))
    options = {name: {word for p in known[name].params for word in p.opts} for name in known}
    for name in ("overlay", "bench"):
        assert {"--tolerance-mm", "--tolerance-deg"} <= options[name], name
    assert "--tolerance-angle-deg" in options["bench"]  # its name in version 0.2


@pytest.mark.parametrize("words", [
    ("list",), ("list", "--where", "speed_m_s>1"), ("show", "own/run 1; true"), ("db", "check"),
    ("db", "upgrade"), ("jobs", "status"), ("import", "run.csv", "--dry-run"),
    ("import", "run.csv"), ("export", "all.zip"),
])  # fmt: skip
def test_what_is_next_can_be_pasted(capsys, lab, words):
    (lab.parent / "run.csv").write_text("t_s,x_mm,y_mm\n0,0,0\n1,2,0\n")
    out = output(capsys, *words, "--project", lab)
    known = dict(commands(typer.main.get_command(app)))
    for line in out.splitlines():
        if not line.startswith("Next: "):
            continue
        typed = shlex.split(line.removeprefix("Next: "))
        assert typed[0] == "fixel"
        assert not any(word.isupper() for word in typed), line
        name = typed[1] if typed[1] in known and not hasattr(known[typed[1]], "commands") else None
        name = name or " ".join(typed[1:3])
        rest = typed[1 + len(name.split()) :]
        if "--help" not in rest:
            known[name].make_context(name, rest)  # refuses what cannot be typed


@pytest.mark.parametrize("command", [("sample",), ("data",), ("new", "another lab")])
def test_what_is_next_without_a_project_can_be_pasted(capsys, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    _, out, _ = fixel(capsys, *command)
    typed = shlex.split(out.splitlines()[-1].removeprefix("Next: "))
    assert typed[0] == "fixel"
    assert not {"then", "or:", "then:"} & {word.strip(",") for word in typed}
    assert not any(word.isupper() for word in typed)


def test_numbers_that_are_an_id_and_a_name_are_distinguished(capsys, lab):
    assert output(capsys, "show", "1", "--project", lab).startswith("own/run 1; true: real\n")
    output(capsys, "show", "2", "--project", lab)  # id and name of one
    add(Project(lab), "own/1", [0.0, 0.0, 0.0])
    assert "id:1 or own/1" in refusal(capsys, "show", "1", "--project", lab)
    assert fixel(capsys, "show", "id:1", "--project", lab)[1].startswith("own/run 1; true")
    assert fixel(capsys, "show", "own/1", "--project", lab)[1].startswith("own/1")


def test_what_was_mistyped_is_asked_about(capsys, lab):
    for words, meant in (
        (("list", "--where", "surface=plywod"), "'plywood'"),
        (("list", "--where", "surfaces=felt"), "'surface'"),
        (("list", "--dataset", "onw"), "'own'"),
        (("calibrate", "--where", "surface=flet"), "'felt'"),
        (("show", "own/run 1; treu"), "'own/run 1; true'"),
    ):
        assert f"did you mean {meant}?" in refusal(capsys, *words, "--project", lab)


def test_conditions_are_compared(capsys, lab):
    for condition, ids in (
        ("speed_m_s>0.03", [2]), ("speed_m_s<=0.02", [1]), ("speed_m_s!=0.02", [2]),
        ("surface!=felt", [2]), ("speed_m_s=0.05", [2]),
    ):  # fmt: skip
        listed = json_of(capsys, "list", "--where", condition, "--project", lab)
        assert [row["id"] for row in listed["experiments"]] == ids, condition
    for condition in ("speed_m_s>fast", "surface>0"):
        assert "--where" in refusal(capsys, "list", "--where", condition, "--project", lab)
    # A filter that is no comparison, and a name that no experiment has.
    for condition in ("x", '"open', "speed>1"):
        words = refusal(capsys, "list", "--where", condition, "--project", lab)
        assert words.startswith("fixel: --where")


@pytest.mark.parametrize(("words", "code", "kind"), [
    (("show", "nothing"), 2, "NotStored"),
    (("list", "--where", "x"), 2, "InvalidInput"),
    (("list", "--limits", "3"), 2, "NoSuchOption"),
    (("show",), 2, "MissingParameter"),
])  # fmt: skip
def test_errors_are_json_where_answers_are(capsys, lab, words, code, kind):
    found, out, _ = fixel(capsys, *words, "--project", lab, "--json")
    assert found == code
    error = json.loads(out)["error"]
    assert (error["exit_code"], error["kind"]) == (code, kind)
    assert error["sentence"]


def test_an_option_of_an_importer_is_named_as_one(capsys, lab):
    words = ("import", "x.csv", "--split-by", "push", "--project", lab, "--json")
    error = json.loads(fixel(capsys, *words)[1])["error"]
    assert error["sentence"].startswith("No such option: --split-by")
    assert "--option split_by=VALUE" in error["sentence"]


def test_help_is_in_the_order_of_a_day(capsys):
    _, out, _ = fixel(capsys, "--help")
    known = typer.main.get_command(app).commands
    words = [line.split()[0] for line in out.splitlines() if line.startswith("  ") and line.strip()]
    listed = [word for word in words if word in known]
    assert sorted(listed) == sorted(known)
    day = ["new", "import", "list", "calibrate", "domain", "report"]
    assert [word for word in listed if word in day] == day


def test_a_shell_completes_commands():
    words = {"_FIXEL_COMPLETE": "complete_bash", "COMP_WORDS": "fixel cal", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-c", "from fixel.cli.main import run; run()"],
        env=os.environ | words, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split() == ["calibrate", "calibrations"]


def test_small_parts_are_read_in_micrometres(capsys, lab):
    scene = micro_push(3, "p1")
    more = {"scene": scene, "object_name": scene.bodies[0].name}
    add(Project(lab), "micro/push", [2.5e-5, 0.0, 0.0], **more)
    _, out, _ = fixel(capsys, "show", "micro/push", "--project", lab)
    assert "x [um]" in out
    assert "path length 25.00 um" in out
    _, out, _ = fixel(capsys, "compare", "micro/push", "--project", lab)
    assert "[um]" in out
    assert "mm" not in out
