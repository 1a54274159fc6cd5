"""`fixel report`: one page about a calibration."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fixel.cli.options import AsJson, CalibrationEngine, ProjectFolder, option, with_options
from fixel.cli.screen import command_line, notify, print_answer

if TYPE_CHECKING:
    from fixel.workflows.report.write import Report


@with_options
def report(
    *,
    folder: ProjectFolder = Path(),
    out: Path = option(
        Path("report"), "Folder of the report; created if missing.", metavar="FOLDER"
    ),
    calibration: int | None = option(
        None,
        "Id of the calibration.",
        metavar="ID",
        show_default="the newest for several experiments",
    ),
    engine: CalibrationEngine = None,
    title: str = option("", "Title of the report.", metavar="TEXT"),
    as_json: AsJson = False,
) -> None:
    """Write a report on a calibration, with errors and verdicts.

    The page needs no network. Next to it: every figure as PDF, and a bibliography.
    """
    from fixel.database.project import Project

    done = Project(folder).report(
        out,
        calibration=calibration,
        engine=engine or "",
        title=title,
        command=command_line(),
        notify=notify if sys.stderr.isatty() else None,
    )
    print_answer(as_json, done.summary, lambda: _lines(done))


def _lines(done: "Report") -> list[str]:
    from fixel.workflows.report.write import next_command

    content = done.content
    n = len(content.warnings)
    return [
        *content.findings,
        "",
        f"{n} warning{'s' * (n != 1)}, at the top of the report:" if n else "no warnings",
        *(f"  - {sentence}" for sentence in content.warnings),
        "",
        f"wrote {done.page} ({done.size / 1e6:.1f} MB), {len(done.figures)} figures as PDF in"
        f" {done.page.parent / 'figures'}, {done.bibliography}",
        f"Next: {next_command(done)}",
    ]
