"""`fixel trust [PROGRAM] [--remove]`: programs that files may name."""

from typing import Annotated

import typer

from fixel.cli.options import AsJson
from fixel.cli.screen import print_answer


def trust(
    program: Annotated[
        str | None,
        typer.Argument(
            help="Path of a program, with its arguments as after --engine; the list is printed "
            "without it.",
            show_default=False,
        ),
    ] = None,
    remove: Annotated[
        bool, typer.Option("--remove", help="Remove the program from the list.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Allow files to run a program until it changes.

    A calibration by a program of your own then works in later commands. Trust only what you have
    read or made: the program can do everything that you can.
    """
    from fixel.errors import InvalidInput
    from fixel.simulation.trust import distrust, trust_program, trusted_entries

    if remove:
        removed = [] if program is None else distrust(program)
        if not removed:
            raise InvalidInput(
                "program",
                found=program,
                expected="an entry of the list",
                hint="print the list: fixel trust",
            )
        title, entries = "Removed:", removed
    elif program is None:
        entries = trusted_entries()
        title = "Trusted:" if entries else "No program is trusted. Add one: fixel trust PROGRAM"
    else:
        title, entries = "Added:", [trust_program(program)]
    print_answer(
        as_json,
        lambda: {"entries": [entry.content for entry in entries]},
        lambda: [title, *(f"  {line}" for entry in entries for line in entry.lines)],
    )
