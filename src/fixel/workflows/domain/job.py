"""Run a domain map as a job in its own process, to be inspected, stopped and resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from fixel.database.project import Project
from fixel.errors import FixelError
from fixel.io.atomic import written_whole
from fixel.io.damaged_files import each_readable
from fixel.jobs import folder as files
from fixel.jobs.functions import callable_by_jobs
from fixel.jobs.work import Work
from fixel.progress import Progress
from fixel.workflows import jobs
from fixel.workflows.domain.request import DomainRequest, asked_again
from fixel.workflows.domain.run import map_stored

MAKER: Final = "domain:domain_work"
PROGRESS: Final = "fits.json"  # number of finished fits and their total


@callable_by_jobs
def domain_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Compute a map as `fixel domain` does.

    Its fits are stored in the project as they are made, and an interrupted job continues from
    them; so there are no chunks to distribute.
    """
    yield from ()  # makes this a generator, as all work is

    def show(now: Progress) -> None:
        with written_whole(inputs.parent / PROGRESS) as path:
            path.write_text(json.dumps([now.done, now.total]))

    # The job is in the folder `jobs` of its project.
    project = Project(inputs.resolve().parents[2])
    question, command = options["question"], str(options["command"])
    done = map_stored(project, asked_again(question), progress=show, command=command)
    return done.kept.folder.name.encode()


def begin(project: Project, asked: DomainRequest, command: str) -> Path:
    """Start a map in its own process, which outlives this one; return the folder of its job."""
    question = asked.question()
    digest = hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()[:10]
    folder = project.folder / jobs.JOBS / f"domain-{digest}"
    if not (folder / "job.json").is_file():
        jobs.prepare_job(folder, maker=MAKER, options={"question": question, "command": command})
    jobs.arrange(folder)
    jobs.run_detached(folder)
    return folder


def jobs_of(project: Project) -> tuple[list[jobs.JobStatus], list[FixelError]]:
    """Return the domain jobs of a project, newest first, and the errors of unreadable ones."""
    every = (path.parent for path in (project.folder / jobs.JOBS).glob("domain-*/job.json"))
    own = [one for one in every if files.made_by(one, MAKER)]
    own.sort(key=lambda one: files.read_job(one).made_utc, reverse=True)
    return each_readable(jobs.status_of, own)


def fits_done(folder: Path) -> tuple[int, int]:
    """Return the number of finished fits and their total; zeros if the job has not begun."""
    try:
        done, total = json.loads((folder / PROGRESS).read_text())
        return int(done), int(total)
    except (OSError, TypeError, ValueError):
        return 0, 0
