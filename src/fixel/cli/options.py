"""Options that several commands share, with the same wording everywhere."""

from pathlib import Path
from typing import Annotated

import typer

from fixel.errors import InvalidInput

ProjectFolder = Annotated[
    Path,
    typer.Option(
        "--project", "-p", help="Folder of the project.", metavar="FOLDER", show_default="here"
    ),
]
ProjectPlace = Annotated[
    Path | None,
    typer.Argument(help="The same as --project.", metavar="[PROJECT]", show_default=False),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]
DatasetName = Annotated[str | None, typer.Option(help="Only this dataset.", metavar="NAME")]
Where = Annotated[
    list[str] | None,
    typer.Option(
        help="Only with this condition, also !=, <, <=, >, >= in quotes; may be repeated.",
        metavar="CONDITION=VALUE",
    ),
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
Seed = Annotated[int, typer.Option(help="Seed of the random number generator.", min=0)]
PictureFolder = Annotated[
    Path | None,
    typer.Option(help="Folder for pictures, as PNG and PDF, and their data.", metavar="FOLDER"),
]


def project_at(place: Path | None, folder: Path) -> Path:
    """Return the folder of the project, given as an argument or with --project."""
    if place is not None and folder != Path():
        raise InvalidInput(
            "--project", found=f"{folder} and the argument {place}", expected="one of them"
        )
    return folder if place is None else place


def project_words(folder: Path) -> list[str]:
    """Return the words that a command needs at its end to find the same project."""
    return [] if folder == Path() else ["--project", str(folder)]
