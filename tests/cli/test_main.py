import itertools
import os
import subprocess
import sys

import pytest
import typer
from tests.cli import shell
from typer.testing import CliRunner

import fixel
from fixel.cli import main
from fixel.cli.capability import typer_command
from fixel.errors import DatasetMissing, Interrupted, InvalidInput, SolveFailed
from fixel.workflows.capabilities import CAPABILITIES

GROUP = typer.main.get_command(main.app)
COMMANDS = [command.name for command in main.app.registered_commands if command.name]


def groups(command, path=()):
    """Return the words of the command itself and of all groups below it."""
    if not hasattr(command, "commands"):
        return []
    below = [groups(one, (*path, name)) for name, one in command.commands.items()]
    return [path, *itertools.chain(*below)]


@pytest.mark.parametrize("words", groups(GROUP), ids=lambda words: " ".join(words) or "fixel")
def test_summaries_of_commands_are_whole_at_80_columns(words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    result = CliRunner().invoke(main.app, [*words, "--help"])
    usage, *lines = result.output.strip().splitlines()
    assert usage.startswith("Usage:")
    assert len(lines) > 3
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if line.rstrip().endswith("...")] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_and_option_has_help(command):
    found = GROUP.commands[command]
    assert found.help
    assert all(getattr(parameter, "help", None) for parameter in found.params)
    assert CliRunner().invoke(main.app, [command, "--help"]).exit_code == 0


def test_version(capsys):
    with pytest.raises(SystemExit) as end:
        main.run(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out == f"fixel {fixel.__version__}\n"


@pytest.mark.parametrize(("error", "code", "sentence"), [
    (InvalidInput("bodies[0].mass", found=-1, expected="a positive number"), 2,
     "bodies[0].mass is -1"),
    (DatasetMissing("pushes"), 2, "pushes: no such file or folder"),
    (SolveFailed("the pusher is jammed"), 3, "the pusher is jammed"),
    (KeyboardInterrupt(), 130, "stopped"),
], ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "")  # fmt: skip
def test_failure_becomes_a_sentence_and_an_exit_code(error, code, sentence, capsys):
    app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)

    @app.command()
    def fail():
        raise error

    with pytest.raises(SystemExit) as end:
        main.run([], program=app)

    printed = capsys.readouterr()
    assert end.value.code == code
    assert sentence in printed.err
    assert "Traceback" not in printed.err
    assert printed.out == ""


def test_an_interrupted_command_shows_how_to_continue(capsys, monkeypatch):
    def stopped():
        raise Interrupted(None, "the same request continues")

    monkeypatch.setitem(main.COMMANDS, "doctor", stopped)
    sentence = "stopped; the same request continues"
    assert shell.fixel(capsys, "doctor") == (130, "", f"fixel: {sentence}\n")


def test_an_interrupted_plan_names_the_flag_that_continues_it(capsys, monkeypatch):
    def stopped(*_):
        raise Interrupted(None, "with store=FOLDER the same request continues")

    command = typer_command(CAPABILITIES["plan"], stopped)
    monkeypatch.setitem(main.COMMANDS, "doctor", command)
    sentence = "fixel: stopped; with --store FOLDER the same request continues\n"
    assert shell.fixel(capsys, "doctor", "goal.yaml") == (130, "", sentence)


def test_ctrl_c_while_modules_load_ends_with_a_sentence():
    code = (
        "import os, signal, sys\n"
        "class CtrlC:\n"
        "    def find_spec(name, *_):\n"
        "        name == 'typer' and os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, CtrlC)\n"
        "from fixel.cli import run\n"
        "run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "fixel: stopped.\n")


@pytest.mark.parametrize(
    "words", ["--help", "--version", "jobs status", "list --project NO --json"]
)
def test_output_that_nothing_reads_is_no_error(words, tmp_path):
    code = [sys.executable, "-c", "from fixel.cli import run; run()", *words.split()]
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(code, stdout=write, stderr=subprocess.PIPE, cwd=tmp_path)
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")
