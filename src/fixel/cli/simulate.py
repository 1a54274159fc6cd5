"""`fixel simulate SCENE`: move the bodies of a scene file."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Motion(StrEnum):
    """Names of the motion models, as in scene files."""

    DYNAMIC = "dynamic"
    QUASISTATIC = "quasistatic"
    FIRST_ORDER = "first-order"


def simulate(
    scene: Annotated[
        Path,
        typer.Argument(
            help="Scene file, YAML or JSON.",
            metavar="SCENE",
            exists=True,
            dir_okay=False,
            show_default=False,
        ),
    ],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the answer as one JSON object.")
    ] = False,
    trajectory: Annotated[
        Path | None,
        typer.Option(help="Write the motion to this file: .csv or .parquet.", metavar="FILE"),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Change one value of the scene, e.g. bodies.0.mass=0.2; may be repeated.",
            metavar="PATH=VALUE",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the motion: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    animate: Annotated[
        Path | None, typer.Option(help="Film the motion: .mp4 or .gif.", metavar="FILE")
    ] = None,
    motion: Annotated[
        Motion | None,
        typer.Option(help="Motion model, instead of the scene's.", show_default=False),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(help="Time step in seconds, instead of the scene's.", metavar="SECONDS"),
    ] = None,
) -> None:
    """Simulate a scene file; say where everything came to rest."""
    typer.echo("fixel simulate is not part of this version yet.", err=True)
    raise typer.Exit(1)
