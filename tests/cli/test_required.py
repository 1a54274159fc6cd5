"""The help of every command names what the command cannot do without."""

import re

import pytest
import typer
from typer.testing import CliRunner

from fixel import errors
from fixel.cli.main import app, run
from fixel.errors import FixelError, InvalidInput

LASTING = {"compile", "demo", "doctor", "serve"}  # they work or wait, and need nothing
MISSING = re.compile(r"(--[a-z-]+) is missing")


def leaves(command, path=()):
    """Every command of the tree with its words."""
    own = getattr(command, "commands", {})
    if not own or command.invoke_without_command:
        yield path, command
    for name, below in own.items():
        yield from leaves(below, (*path, name))


COMMANDS = {
    " ".join(path): command
    for path, command in leaves(typer.main.get_command(app))
    if path and path[0] not in LASTING
}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_required_of_every_option_that_a_command_misses(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command, runner = COMMANDS[name], CliRunner()
    needed = [one for one in command.params if one.param_type_name == "argument" and one.required]
    words = [*name.split(), *("nothing" for _ in needed)]
    words += ["--json"] * any("--json" in one.opts for one in command.params)  # else it prints help
    missed = set()
    for _ in command.params:
        answer = runner.invoke(app, words)
        found = MISSING.match(str(answer.exception)) if answer.exception else None
        if found is None or found[1] in missed:
            break
        missed.add(found[1])
        words += [found[1], "nothing"]

    said = {one.opts[0]: one.help for one in command.params if one.param_type_name == "option"}
    assert [flag for flag in missed if "required" not in said[flag].lower()] == []
    stated = {flag for flag, text in said.items() if text.startswith("Required.")}
    assert stated <= missed


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_no_error_of_python(name):
    command = COMMANDS[name]
    texts = [command.help, *(getattr(one, "help", None) for one in command.params)]
    own = [kind for kind in vars(errors) if isinstance(vars(errors)[kind], type)
           and issubclass(vars(errors)[kind], FixelError)]  # fmt: skip
    said = set(re.findall(r"\w+", " ".join(filter(None, texts))))
    assert sorted(said & {*own, "ValueError", "TypeError"}) == []


def test_an_error_states_the_meaning_of_a_missing_value():
    with pytest.raises(InvalidInput) as problem:
        CliRunner().invoke(app, ["camera", "calibrate", "a.png"], catch_exceptions=False)
    assert str(problem.value).startswith("--board is missing; calibration board")
    assert "charuco:7x5:30mm:22mm" in str(problem.value)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_lists_arguments_without_types_of_python(name, capsys):
    with pytest.raises(SystemExit):
        run([*name.split(), "--help"])
    listed = capsys.readouterr().out
    assert not re.search(r"<\w+(\[\w+\])?>", listed)
    metavars = [p.metavar for p in COMMANDS[name].params if p.param_type_name == "argument"]
    assert [one for one in metavars if one not in listed] == []
