"""Run a calibration in the background: `python -m fixel.workflows.calibration.unattended FOLDER`.

The job runs as any other; at its end the result is stored in the project. The process may be
killed at any moment: the next process that resumes or inspects the job does the rest.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from fixel.database.project import Project
from fixel.errors import FixelError
from fixel.jobs import coordinator
from fixel.jobs import folder as files
from fixel.workflows.calibration.commands import command_of
from fixel.workflows.calibration.run import collect, experiments_of, request_of

MODULE: Final = "fixel.workflows.calibration.unattended"


def collected(project: Project, folder: Path) -> list[int]:
    """Return the ids of the stored calibrations of a finished job; store them if necessary.

    Raises
    ------
    JobRefused
        Another process is storing them.
    """
    request, ids = request_of(folder), experiments_of(folder)
    command = command_of(project.folder.resolve(), request, [str(number) for number in ids])
    return collect(project, folder, command, {}).ids


def main(arguments: list[str] | None = None) -> int:
    """Run the job, then store its result."""
    given = sys.argv[1:] if arguments is None else arguments
    folder = Path(given[0])
    status = coordinator.main(given)
    if status or files.read_status(folder).state != "done":
        return status
    try:
        collected(Project.open(folder.resolve().parents[1]), folder)
    except FixelError as problem:
        files.log(folder, str(problem))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
