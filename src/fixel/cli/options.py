"""Options of commands: groups of options as dataclasses, and those that several commands share."""

from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar, get_type_hints

import typer

from fixel.capability.options import Door
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.database.project import Project

T = TypeVar("T")
_INFO: Final = "typer"  # key in the metadata of a dataclass field

ProjectFolder = Annotated[
    Path,
    typer.Option(
        "--project", "-p", help="Folder of the project.", metavar="FOLDER", show_default="here"
    ),
]
ProjectPlace = Annotated[Path | None, Door(metavar="PROJECT", meaning="Same as --project.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the answer as one JSON object.")]
CAMERA: Final = typer.Option(
    help="Camera (0, /dev/video0, http://...), video file or folder of a recording.",
    metavar="SOURCE",
)
Seed = Annotated[int, typer.Option(help="Seed of the random number generator.", min=0)]


def option(default: T, help: str, *names: str, **more: Any) -> T:
    """Declare an option of a command `with_options`.

    Its name is by default that of the field or parameter. Further arguments are those of
    `typer.Option`; `metavar` is FILE for a path without one.
    """
    return field(default=default, metadata={_INFO: typer.Option(*names, help=help, **more)})


def argument(default: T, help: str, **more: Any) -> T:
    """Declare an argument of a command `with_options` that may be left out."""
    return field(default=default, metadata={_INFO: typer.Argument(help=help, **more)})


def required(help: str, **more: Any) -> Any:
    """Declare an argument of a command `with_options` that is required."""
    return field(metadata={_INFO: typer.Argument(help=help, **more)})


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Show Typer the options of a command that are declared with `option` or in groups.

    A group is a parameter whose type is a dataclass; each of its fields is an option. Typer sees
    one parameter for each option, and the command gets the dataclass.
    """
    declared = signature(command, eval_str=True).parameters.values()
    groups: dict[str, Any] = {p.name: p.annotation for p in declared if is_dataclass(p.annotation)}
    parameters: list[Parameter] = []
    for parameter in declared:
        if parameter.name in groups:
            parameters += _options_of(groups[parameter.name])
        else:
            parameters.append(_parameter(parameter.name, parameter.annotation, parameter.default))

    defaults = {p.name: p.default for p in parameters if p.default is not Parameter.empty}

    @wraps(command)
    def run(**given: Any) -> None:
        values = defaults | given
        made = {
            name: group(**{one.name: values.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        command(**values, **made)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return run


def _options_of(group: Any) -> list[Parameter]:
    """Parameters for the fields of a group, in their order."""
    hints = get_type_hints(group, include_extras=True)
    return [
        _parameter(one.name, hints[one.name], one if _INFO in one.metadata else one.default)
        for one in fields(group)
    ]


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    """Parameter for Typer; a default made by `option` and its kin brings the declaration."""
    if isinstance(default, Field):
        info, default = default.metadata[_INFO], default.default
        if info.metavar is None and hint in (Path, Path | None):
            info.metavar = "FILE"
        hint = Annotated[hint, info]
    default = Parameter.empty if default is MISSING else default
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


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
