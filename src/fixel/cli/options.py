"""Options that several commands share, said in the same words everywhere."""

from pathlib import Path
from typing import Annotated

import typer

ProjectFolder = Annotated[
    Path,
    typer.Option(
        "--project", "-p", help="Folder of the project.", metavar="FOLDER", show_default="here"
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]
DatasetName = Annotated[str | None, typer.Option(help="Only this dataset.", metavar="NAME")]
Where = Annotated[
    list[str] | None,
    typer.Option(help="Only with this condition; may be repeated.", metavar="CONDITION=VALUE"),
]
Flagged = Annotated[bool, typer.Option("--all", help="Also those whose data was found wanting.")]
NoiseMm = Annotated[
    float | None,
    typer.Option(help="Standard deviation of measured positions [mm].", show_default="found out"),
]
NoiseMrad = Annotated[
    float | None,
    typer.Option(help="Standard deviation of measured angles [mrad].", show_default="found out"),
]
Seed = Annotated[int, typer.Option(help="Of everything random.", min=0)]
PictureFolder = Annotated[
    Path | None,
    typer.Option(help="Folder for pictures, as PNG and PDF, and their data.", metavar="FOLDER"),
]
