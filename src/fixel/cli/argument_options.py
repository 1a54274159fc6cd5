"""Translation of Python arguments in an `InvalidInput` to options of the command."""

from collections.abc import Mapping, Sequence
from typing import Final

import typer

from fixel.capability.capability import named
from fixel.errors import InvalidInput

# Options of each argument; the first that the running command has replaces it.
OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    name: (f"--{name.replace('_', '-')}",)
    for name in (
        *("axes", "base", "budget", "confidence", "error", "fit", "folds", "held_out", "leave_out"),
        *("level", "mode", "motion", "name", "nominal", "optimiser", "relative", "samples"),
        *("done", "seen", "workers"),
    )
} | {
    "cells": ("--step",),
    "facets": ("--by",),
    "noise": ("--noise-mm",),
    "overrides": ("--set",),
    "threshold": ("--threshold-mm", "--threshold"),
}


def in_options(error: InvalidInput, program: typer.Typer, words: Sequence[str]) -> InvalidInput:
    """Return the error with options of the running command instead of Python arguments.

    Parameters
    ----------
    error : InvalidInput
        Its `where` begins with an argument (`nominal side`), its hint may set one (`folds=2`).
    program : Typer
    words : sequence of str
        Words of the command line behind the name of the program.
    """
    options = _options(program, words)
    chosen = {name: (o for o in own if o in options) for name, own in OPTIONS.items()}
    return named(error, {k: first for k, own in chosen.items() if (first := next(own, ""))})


def _options(program: typer.Typer, words: Sequence[str]) -> set[str]:
    """Options of the command that these words run."""
    command = typer.main.get_command(program)
    for word in words:
        command = getattr(command, "commands", {}).get(word, command)
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
