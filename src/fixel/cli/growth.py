"""`fixel domain growth`: how far from the nominal pose one set of parameters serves."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.cli.options import AsJson, DatasetName, ProjectFolder
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.growth.explore import Exploration


def growth(
    folder: ProjectFolder = Path(),
    shape: Annotated[str | None, typer.Option(help="Only this shape.", metavar="NAME")] = None,
    dataset: DatasetName = None,
    index: Annotated[
        str,
        typer.Option(
            help="corrected, or printed: the rows of the thesis's code, theta one too early.",
            metavar="WHICH",
        ),
    ] = "corrected",
    threshold: Annotated[
        str | None,
        typer.Option(
            help="Of the error, in its unit, or as a distance: 5, or 2.2mm.",
            metavar="E",
            show_default="the thesis's 5 mm²",
        ),
    ] = None,
    sizes: Annotated[
        list[str] | None,
        typer.Option(
            help="Samples of the intervals, 2 to 5; for one axis or for all; may be repeated.",
            metavar="[AXIS=]N[,N]",
            show_default="x=2,4 y=3,5 theta=2,4",
        ),
    ] = None,
    motion: Annotated[
        str | None, typer.Option(help="Only calibrations with this motion model.", metavar="MODEL")
    ] = None,
    error: Annotated[
        str | None, typer.Option(help="Only calibrations with this error.", metavar="NAME")
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Folder for the pictures, beside the project's own.", metavar="FOLDER"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Grow the domain of applicability from stored calibrations, as the thesis did.

    Step i adds the experiments x+i, y+i, y-i and theta+i to the nominal one; one set of parameters
    simulates them all, and the largest error counts.
    """
    from fixel.cli.screen import notify
    from fixel.database.project import Project
    from fixel.domain.growth import INDEXES
    from fixel.workflows.growth.run import GrowthRequest, run_growth

    if index not in INDEXES:
        raise InvalidInput("--index", found=repr(index), expected="corrected or printed")
    asked = GrowthRequest(
        shape=shape,
        dataset=dataset,
        index="printed" if index == "printed" else "corrected",
        sizes=_sizes(sizes or []),
        threshold=threshold,
        motion=motion,
        error=error,
    )
    if plot is not None:
        from fixel.workflows.figures import make_folder

        make_folder(plot)
    where = "" if folder == Path() else f" --project {shlex.quote(str(folder))}"
    command = "fixel " + shlex.join(sys.argv[1:])
    found, kept = run_growth(
        Project.open(folder),
        asked,
        command=command,
        where=where,
        notify=notify if sys.stderr.isatty() else None,
    )
    copied = [] if plot is None else kept.copy_pictures(plot)
    if as_json:
        typer.echo(json.dumps(_plain(kept, copied), allow_nan=False))
        return
    typer.echo("\n".join(_lines(found, kept, copied, where)))


def _sizes(texts: list[str]) -> dict[str, tuple[int, ...]] | None:
    from fixel.domain.growth import AXES

    found: dict[str, tuple[int, ...]] = {}
    for text in texts:
        axis, equals, numbers = text.rpartition("=")
        try:
            own = tuple(int(number) for number in numbers.split(","))
        except ValueError:
            own = ()
        if not own or (equals and axis not in AXES):
            raise InvalidInput(
                "--sizes", found=repr(text), expected="numbers of samples, such as y=3,5 or 2,4"
            )
        found |= dict.fromkeys((axis,) if equals else AXES, own)
    return found or None


def _plain(kept: "StoredAnalysis", copied: list[Path]) -> dict[str, Any]:
    analysis = kept.analysis
    return {
        "headline": list(analysis.headline),
        "warnings": list(analysis.warnings),
        "folder": str(kept.folder),
        "pictures": [str(kept.picture(shown.name)) for shown in analysis.pictures],
        "copied": [str(path) for path in copied],
        "seconds": analysis.seconds,
        **analysis.numbers,
    }


def _lines(
    found: "Exploration", kept: "StoredAnalysis", copied: list[Path], where: str
) -> list[str]:
    from fixel.cli.screen import seconds

    analysis = kept.analysis
    lines = []
    for one in analysis.tables:
        lines += [one.title, *one.lines(), ""]
    lines += [*analysis.headline, ""]
    lines += [f"Warning: {sentence}" for sentence in analysis.warnings]
    lines += [f"wrote {path}" for path in copied if path.suffix == ".png"]
    n = len(found.added)
    new = f", {n} sets of parameters stored as calibrations" if n else ""
    lines.append(
        f"{found.rollouts} simulations, {seconds(analysis.seconds)}{new}; kept with its pictures in"
        f" {kept.folder}"
    )
    lines.append(f"Next: fixel report{where}")
    return lines
