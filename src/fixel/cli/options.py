"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.capability.options import Door
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.database.project import Project

ProjectFolder = Annotated[
    Path,
    typer.Option(
        "--project", "-p", help="Folder of the project.", metavar="FOLDER", show_default="here"
    ),
]
ProjectPlace = Annotated[Path | None, Door(metavar="PROJECT", meaning="Same as --project.")]
FilmPath = Annotated[Path, Door(metavar="FILM", meaning="Video file or folder of a recording.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]


def project_at(place: Path | None, folder: Path) -> "Project":
    """Return the project in a folder, given as an argument or with --project."""
    from fixel.database.project import Project

    return Project(one_place(place, folder))


def one_place(place: Path | None, folder: Path) -> Path:
    """Return a folder, given as an argument or with --project."""
    if place is not None and folder != Path():
        found = f"{folder} and the argument {place}"
        raise InvalidInput("--project", found=found, expected="one of them")
    return folder if place is None else place


def require_folder(folder: Path | None) -> None:
    """Reject a place where no folder for pictures can be made, before any work."""
    if folder is not None:
        from fixel.workflows.figures import new_folder

        with new_folder(folder):
            pass


def require_picture(file: Path | None) -> None:
    """Reject an invalid or unwritable file for a picture before any work."""
    if file is not None:
        from fixel.drawing.chart import require_file

        require_file(file)
