"""`fixel replay DATASET`: compare recorded pushes with simulated ones."""

from pathlib import Path
from typing import Annotated

import typer


def replay(
    dataset: Annotated[
        Path,
        typer.Argument(
            help="Folder of the dataset.",
            metavar="DATASET",
            exists=True,
            file_okay=False,
            show_default=False,
        ),
    ],
    select: Annotated[
        list[str] | None,
        typer.Option(
            help="Keep only records where COLUMN is VALUE; may be repeated.", metavar="COLUMN=VALUE"
        ),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(help="Replay at most this many records.", min=1, metavar="COUNT")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the answer as one JSON object.")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw measured and simulated motion: .png, .svg or .pdf.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Replay recorded pushes and say how far simulation and measurement lie apart."""
    typer.echo("fixel replay is not part of this version yet.", err=True)
    raise typer.Exit(1)
