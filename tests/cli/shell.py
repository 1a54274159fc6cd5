"""The command as a shell runs it."""

import pytest

from fixel.cli.main import run


def fixel(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as end:
        run([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return end.value.code or 0, out, err
