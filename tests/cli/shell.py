"""The command as a shell runs it."""

import json
import re
import sys

import pytest
from typer.testing import CliRunner

from fixel.cli.main import run


def exit_code(*arguments):
    """Exit code of a command, which sets `sys.argv` while it runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", sys.argv)
        with pytest.raises(SystemExit) as end:
            run([str(argument) for argument in arguments])
    return end.value.code or 0


def fixel(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    code = exit_code(*arguments)
    out, err = capsys.readouterr()
    return code, out, err


def output(capsys, *arguments):
    """Standard output of a command that succeeds."""
    code, out, err = fixel(capsys, *arguments)
    assert code == 0, err
    return out


def json_of(capsys, *arguments):
    """The JSON object of a command that succeeds."""
    return json.loads(output(capsys, *arguments, "--json"))


def refusal(capsys, *arguments):
    """Standard error of a command that refuses its input, and prints nothing else."""
    code, out, err = fixel(capsys, *arguments)
    assert (code, out) == (2, ""), err
    assert "Traceback" not in err
    return err


def missing(text, content, without=("Next:", "Took", "stored in", "wrote")):
    """Numbers of a text that a JSON text has neither as written nor with more digits.

    Lines with paths and with the time it took are left out.
    """
    number = r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?"
    lines = [line for line in text.splitlines() if not line.startswith(without)]
    known = re.findall(number, content)
    return [
        one
        for one in re.findall(number, "\n".join(lines))
        if one not in known
        and not any(f"{float(own):.{len(one.partition('.')[2])}f}" == one for own in known)
    ]


def invoked(app, *arguments):
    """Exit code and standard output; a refusal is raised, for `main` to put into words."""
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout
