"""`fixel report`: write one page about a calibration."""

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, ProjectFolder

if TYPE_CHECKING:
    from fixel.workflows.report.write import Report


def report(
    folder: ProjectFolder = Path(),
    out: Annotated[
        Path, typer.Option(help="Folder to write to; made when missing.", metavar="FOLDER")
    ] = Path("report"),
    calibration: Annotated[
        int | None,
        typer.Option(
            help="Id of the calibration it is about.",
            metavar="ID",
            show_default="the newest for several experiments",
        ),
    ] = None,
    title: Annotated[str, typer.Option(help="Of the report.", metavar="TEXT")] = "",
    as_json: AsJson = False,
) -> None:
    """Write what is known of a calibration on one page: data, errors, verdicts, domain, limits.

    The page needs no network. Next to it: every figure as PDF, and a bibliography.
    """
    from fixel.cli.screen import notify
    from fixel.database.project import Project
    from fixel.workflows.report.write import write_report

    done = write_report(
        Project.open(folder),
        out,
        number=calibration,
        title=title,
        command="fixel " + shlex.join(sys.argv[1:]),
        notify=notify if sys.stderr.isatty() else None,
    )
    if as_json:
        typer.echo(json.dumps(done.summary()))
        return
    typer.echo("\n".join(_lines(done)))


def _lines(done: "Report") -> list[str]:
    from fixel.workflows.report.write import next_command

    content = done.content
    n = len(content.warnings)
    warnings = [f"{n} warning{'s' * (n != 1)}, which stand first:" if n else "no warnings"]
    return [
        *content.findings,
        "",
        *warnings,
        *(f"  - {sentence}" for sentence in content.warnings),
        "",
        f"wrote {done.page} ({done.size / 1e6:.1f} MB), {len(done.figures)} figures as PDF in"
        f" {done.page.parent / 'figures'}, {done.bibliography}",
        f"Next: {next_command(done)}",
    ]
