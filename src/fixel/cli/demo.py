"""`fixel demo`: a short tour that leaves figures behind."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[
        Path, typer.Option(help="Folder for the figures; made when missing.", metavar="FOLDER")
    ] = Path("fixel-demo"),
) -> None:
    """Simulate, replay and draw a few examples."""
    typer.echo("fixel demo is not part of this version yet.", err=True)
    raise typer.Exit(1)
