"""`fixel doctor`: is this installation in order?"""

from typing import Annotated

import typer


def doctor(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the answer as one JSON object.")
    ] = False,
) -> None:
    """Check this installation and say what to do about anything that is wrong."""
    typer.echo("fixel doctor is not part of this version yet.", err=True)
    raise typer.Exit(1)
