"""`fixel domain`: map where one parameter set can be trusted."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.growth import growth
from fixel.cli.options import (
    AsJson,
    DatasetName,
    Flagged,
    PictureFolder,
    ProjectFolder,
    Seed,
    Where,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.domain.request import DomainRequest
    from fixel.workflows.domain.run import DomainResult

MAX_ROWS = 30

app = typer.Typer(invoke_without_command=True, rich_markup_mode=None)
app.command("growth")(growth)


@app.callback()
def domain(
    context: typer.Context,
    folder: ProjectFolder = Path(),
    calibration: Annotated[
        int | None,
        typer.Option(
            help="Stored calibration to start from.",
            metavar="N",
            show_default="the newest for several",
        ),
    ] = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter to find, in place of the calibration's; may be repeated.",
            metavar="NAME[=LOW:HIGH[:START]]",
        ),
    ] = None,
    dataset: DatasetName = None,
    where: Where = None,
    flagged: Flagged = False,
    axes: Annotated[
        str | None,
        typer.Option(
            help="Conditions the map goes over: offset_y_m,offset_theta_rad.",
            metavar="NAME[,NAME]",
            show_default="the offsets that vary",
        ),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            help="Conditions with a map for each of their values: shape,layout.",
            metavar="NAME[,NAME]",
        ),
    ] = None,
    apart: Annotated[
        str | None,
        typer.Option(
            help="Conditions with parameters for each of their values: surface,shape.",
            metavar="NAME[,NAME]",
        ),
    ] = None,
    leave_out: Annotated[
        str | None,
        typer.Option(
            help="Condition whose values are held out whole: layout.", metavar="CONDITION"
        ),
    ] = None,
    nominal: Annotated[
        str | None,
        typer.Option(
            help="Where the domain grows from, in SI units.", metavar="AXIS=VALUE[,AXIS=VALUE]"
        ),
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option(
            help="Width of the cells along an axis, in SI units; may be repeated.",
            metavar="AXIS=WIDTH",
        ),
    ] = None,
    threshold_mm: Annotated[
        float | None,
        typer.Option(
            help="Root mean square error that must not be exceeded [mm].",
            show_default="twice the median",
        ),
    ] = None,
    relative: Annotated[
        float | None,
        typer.Option(
            help="In place of it: how much larger E may be than an experiment's own best,"
            " as a share of that.",
            metavar="SHARE",
        ),
    ] = None,
    level: Annotated[
        float, typer.Option(help="Share of new experiments that have to stay below.")
    ] = 0.9,
    confidence: Annotated[float, typer.Option(help="At which a cell is called trusted.")] = 0.95,
    folds: Annotated[
        int | None,
        typer.Option(
            help="Of the cross-validation.", min=2, show_default="5; 2 for more than 2000"
        ),
    ] = None,
    seed: Seed = 0,
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Map where one parameter set can be trusted, on experiments it was found without.

    The fits are kept: other axes, thresholds and nominals cost nothing.
    """
    if context.invoked_subcommand is not None:
        return
    from fixel.cli.screen import progress_bar
    from fixel.database.project import Project
    from fixel.workflows.domain.request import DomainRequest
    from fixel.workflows.domain.run import map_domain
    from fixel.workflows.project.filters import query_of

    if threshold_mm is not None and relative is not None:
        raise InvalidInput("--relative", found="--threshold-mm too", expected="one of them")
    asked = DomainRequest(
        query=query_of(dataset=dataset, where=where or (), flagged=flagged),
        calibration=calibration,
        fit=tuple(fit or ()),
        axes=_names(axes),
        by=_names(by),
        apart=_names(apart),
        leave_out=leave_out or "",
        nominal=_values("--nominal", (nominal or "").split(",") if nominal else []),
        steps=_widths(step or []),
        threshold=threshold_mm if relative is None else relative,
        measure="absolute" if relative is None else "relative",
        level=level,
        confidence=confidence,
        folds=folds,
        seed=seed,
    )
    done = map_domain(
        Project.open(folder),
        asked,
        plot=plot,
        progress=progress_bar("Holding out"),
        command="fixel " + shlex.join(sys.argv[1:]),
    )
    if as_json:
        typer.echo(json.dumps(_answer(done)))
        return
    for line in _lines(done, folder, asked):
        typer.echo(line)


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _values(where: str, settings: list[str]) -> dict[str, str | float]:
    found: dict[str, str | float] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InvalidInput(where, found=repr(setting), expected="AXIS=VALUE")
        try:
            found[name.strip()] = float(text)
        except ValueError:
            found[name.strip()] = text.strip()
    return found


def _widths(settings: list[str]) -> dict[str, float]:
    found = {}
    for name, value in _values("--step", settings).items():
        if isinstance(value, str):
            raise InvalidInput(f"--step {name}", found=repr(value), expected="a number, SI units")
        found[name] = value
    return found


def _answer(done: "DomainResult") -> dict[str, object]:
    analysis = done.kept.analysis
    return {
        "title": analysis.title,
        "headline": list(analysis.headline),
        "warnings": list(analysis.warnings),
        "numbers": analysis.numbers,
        "calibration": done.gathered.calibration,
        "folder": str(done.kept.folder),
        "pictures": [str(path) for path in done.files],
    }


def _lines(done: "DomainResult", folder: Path, asked: "DomainRequest") -> list[str]:
    analysis = done.kept.analysis
    lines = [*analysis.headline, ""]
    for one in analysis.tables:
        lines += [f"{one.title}:", *one.lines(MAX_ROWS)]
        more = len(one.rows) - MAX_ROWS
        lines += [f"... and {more} more; --json has them all"] if more > 0 else []
        lines.append("")
    lines += [f"Warning: {sentence}." for sentence in analysis.warnings]
    lines += [f"wrote {path}" for path in done.files]
    lines.append(f"kept in {done.kept.folder}")
    lines.append(f"Next: {_next(done, folder, asked)}")
    return lines


def _next(done: "DomainResult", folder: Path, asked: "DomainRequest") -> str:
    """Return the next command: charts, then a tighter threshold or, below the noise, a report."""
    from dataclasses import replace

    from fixel.workflows.domain.request import command_of

    if not done.files:
        return f"{command_of(folder, asked, done.claim)} --plot domain"
    tighter = replace(done.claim, threshold=0.5 * done.claim.threshold)
    floor = done.gathered.floor_mm
    if floor is not None and tighter.measure == "absolute" and tighter.threshold < floor:
        return "fixel report" + (
            "" if folder == Path() else f" --project {shlex.quote(str(folder))}"
        )
    return command_of(folder, asked, tighter)
