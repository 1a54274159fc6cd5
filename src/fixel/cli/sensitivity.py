"""`fixel sensitivity`: outcomes of pushes over the error of their start."""

import json
import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder, project_words
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.uncertainty.starts import StartError
    from fixel.workflows.sensitivity.run import SensitivityAnswer

HERE = Path()


def sensitivity(
    things: Annotated[
        list[str] | None,
        typer.Argument(
            help="Experiments (id, name or DATASET/NAME) or scene files; all experiments with a"
            " scene where left out.",
            metavar="[EXPERIMENT|SCENE.yaml]...",
            show_default=False,
        ),
    ] = None,
    project: ProjectFolder = HERE,
    calibration: Annotated[
        int | None,
        typer.Option(
            help="Stored calibration to simulate with.",
            metavar="ID",
            show_default="the newest; nominal values without any",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="A parameter's value; may be repeated.", metavar="NAME=VALUE"),
    ] = None,
    start_error_mm: Annotated[
        float | None,
        typer.Option(help="Half-width of the start's error along x and y.  [default: 0.3]"),
    ] = None,
    start_error_deg: Annotated[
        float | None, typer.Option(help="Half-width of its angle's.  [default: 0.5]")
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(
            help="Instead: asme (+-5 um, +-0.5 deg) or rpi-camera (noise of RPI's camera).",
            show_default=False,
        ),
    ] = None,
    normal: Annotated[
        bool, typer.Option("--normal", help="The errors are standard deviations, not half-widths.")
    ] = False,
    samples: Annotated[int, typer.Option(help="Perturbed starts of each push.", min=50)] = 1000,
    indices: Annotated[
        bool, typer.Option("--indices/--no-indices", help="Sobol indices, too (needs SALib).")
    ] = False,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="An uncertain parameter for the indices; may be repeated. The intervals of the"
            " calibration where left out.",
            metavar="NAME=LOW:HIGH",
        ),
    ] = None,
    base: Annotated[int, typer.Option(help="Base samples of the indices, a power of two.")] = 128,
    seed: Annotated[int, typer.Option(help="Seed of the random number generator.")] = 0,
    threads: Annotated[
        int | None, typer.Option(help="Of the simulation; all cores where left out.", min=1)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Pictures go here, too.", metavar="FOLDER", file_okay=False),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Report how errors of the start grow, and which pushes part ways, before they are executed."""
    from fixel.cli.screen import notify, progress_bar
    from fixel.database.project import Project
    from fixel.workflows.compilation import get_ready
    from fixel.workflows.figures import make_folder, write_picture
    from fixel.workflows.project.importing import typed
    from fixel.workflows.sensitivity.request import SensitivityRequest
    from fixel.workflows.sensitivity.run import analyse_sensitivity

    request = SensitivityRequest(
        error=_error(start_error_mm, start_error_deg, preset, normal),
        samples=samples,
        values=dict(_value(text) for text in set_ or ()),
        ranges=dict(_range(text) for text in vary or ()),
        calibration=calibration,
        indices=indices or bool(vary),
        base=base,
        seed=seed,
        threads=threads,
    )
    if plot is not None:
        make_folder(plot)
    speaks = notify if sys.stderr.isatty() or not as_json else None
    answer = analyse_sensitivity(
        things or (),
        request,
        lambda: Project.open(project),
        command=typed(),
        progress=progress_bar,
        ready=lambda scene: get_ready(scene, speaks),
    )
    files = []
    if plot is not None and answer.kept is not None:
        files = answer.kept.copy_pictures(plot)
    elif plot is not None:
        files = [path for picture in answer.pictures for path in write_picture(plot, picture)]
    if as_json:
        from fixel.formats.trajectory_file import plain_numbers

        found = {
            "headline": list(answer.analysis.headline),
            "warnings": list(answer.analysis.warnings),
            **answer.analysis.numbers,
            "folder": None if answer.kept is None else str(answer.kept.folder),
            "files": [str(path) for path in files],
        }
        typer.echo(json.dumps(plain_numbers(found), allow_nan=False))
        return
    typer.echo("\n".join(_lines(answer, files, plot, project)))


def _error(mm: float | None, deg: float | None, name: str | None, normal: bool) -> "StartError":
    from fixel.uncertainty.starts import StartError, preset

    if name is not None:
        if mm is not None or deg is not None or normal:
            raise InvalidInput(
                "--preset", found="with a start error of its own", expected="one or the other"
            )
        return preset(name)
    place = 1e-3 * (0.3 if mm is None else mm)
    angle = math.radians(0.5 if deg is None else deg)
    return StartError(x=place, y=place, theta=angle, kind="normal" if normal else "uniform")


def _value(text: str) -> tuple[str, float]:
    from fixel.model import Parameters

    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise InvalidInput("--set", found=repr(text), expected="NAME=VALUE") from None
    return name.strip(), Parameters({name.strip(): number})[name.strip()]


def _range(text: str) -> tuple[str, tuple[float, float]]:
    from fixel.model.parameters import info_of

    name, _, interval = text.partition("=")
    low, _, high = interval.partition(":")
    info_of(name.strip())
    try:
        return name.strip(), (float(low), float(high))
    except ValueError:
        raise InvalidInput("--vary", found=repr(text), expected="NAME=LOW:HIGH") from None


def _lines(
    answer: "SensitivityAnswer", files: list[Path], plot: Path | None, project: Path
) -> list[str]:
    from fixel.cli.screen import seconds

    analysis = answer.analysis
    lines = [*analysis.headline, ""]
    for table in analysis.tables:
        lines += [table.title, *table.lines(), ""]
    lines += [f"Note: {warning}" for warning in analysis.warnings]
    lines.append(f"Took {seconds(analysis.seconds)}.")
    if answer.kept is not None:
        lines.append(f"Kept: {answer.kept.folder}")
    if files:
        lines.append(f"wrote {len(files)} files to {plot}")
    lines.append(f"Next: {_next(answer, plot, project)}")
    return lines


def _next(answer: "SensitivityAnswer", plot: Path | None, project: Path) -> str:
    """Return the command that most users need next."""
    again = answer.analysis.command or "fixel sensitivity"
    if plot is None:
        return f"{again} --plot sensitivity"
    if answer.findings[0].indices is None:
        return f"{again} --indices"
    if answer.kept is not None:
        return shlex.join(["fixel", "report", *project_words(project)])
    return f"{again} --samples {10 * len(answer.findings[0].ensemble.reasons)}"
