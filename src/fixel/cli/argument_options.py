"""Translation of Python arguments in an `InvalidInput` to options of the command."""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import typer

from fixel.errors import InvalidInput

# Options of each argument; the first that the running command has replaces it.
OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    name: (f"--{name.replace('_', '-')}",)
    for name in (
        *("axes", "base", "budget", "confidence", "error", "folds", "held_out", "leave_out"),
        *("level", "mode", "motion", "name", "nominal", "optimiser", "relative", "samples"),
        "workers",
    )
} | {
    "cells": ("--step",),
    "facets": ("--by",),
    "filter.n_particles": ("--particles",),
    "noise": ("--noise-mm",),
    "overrides": ("--set",),
    "tactile": ("--no-tactile",),
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
    where, space, rest = error.where.partition(" ")
    own = _option(where, options)
    hint = error.hint
    if hint:
        hint = re.sub(r"\b([a-z_]+)=(False)?", lambda found: _setting(found, options), hint)
    if (own, hint) == (where, error.hint):
        return error
    return InvalidInput(
        f"{own}{space}{rest}", found=error.found, expected=error.expected, hint=hint
    )


def _option(argument: str, options: set[str]) -> str:
    return next((o for o in OPTIONS.get(argument, ()) if o in options), argument)


def _setting(found: re.Match[str], options: set[str]) -> str:
    own = _option(found[1], options)
    return found[0] if own == found[1] else own if found[2] else f"{own} "


def _options(program: typer.Typer, words: Sequence[str]) -> set[str]:
    """Options of the command that these words run."""
    command = typer.main.get_command(program)
    for word in words:
        command = getattr(command, "commands", {}).get(word, command)
    return {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
