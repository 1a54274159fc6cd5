"""Propose pushes as a job in its own process, to be inspected, stopped and resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from fixel.database.project import Project
from fixel.io.atomic import written_whole
from fixel.jobs.functions import callable_by_jobs
from fixel.jobs.work import Work
from fixel.progress import Progress
from fixel.workflows import jobs
from fixel.workflows.next_pushes.report import store_proposal
from fixel.workflows.next_pushes.run import NextPushesRequest, propose_pushes

MAKER: Final = "next:next_work"
STAGE: Final = "stage.txt"  # what the job is doing


@callable_by_jobs
def next_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Propose pushes as `fixel next` does; fits are stored in the project as they are made."""
    yield from ()  # makes this a generator, as all work is

    def show(now: Progress) -> None:
        with written_whole(inputs.parent / STAGE) as path:
            path.write_text(f"{now.stage} {now.done} of {now.total}")

    # The job is in the folder `jobs` of its project.
    project = Project(inputs.resolve().parents[2])
    request = NextPushesRequest(**options["question"] | {"where": ()})
    found = propose_pushes(project, request, progress=show)
    return store_proposal(project, found, str(options["command"])).folder.name.encode()


def begin(project: Project, request: NextPushesRequest, command: str) -> Path:
    """Start a proposal in its own process, which outlives this one; return the job's folder."""
    question = asdict(request)
    # Another number of experiments is another question.
    with project.store() as store:
        stored = sum(store.datasets().values())
    digest = hashlib.sha256(json.dumps([question, stored]).encode()).hexdigest()[:10]
    folder = project.folder / jobs.JOBS / f"next-{digest}"
    if not (folder / "job.json").is_file():
        jobs.prepare_job(folder, maker=MAKER, options={"question": question, "command": command})
    jobs.arrange(folder)
    jobs.run_detached(folder)
    return folder


def stage_of(folder: Path) -> str:
    """Return what a job is doing; empty before it has begun."""
    try:
        return (folder / STAGE).read_text()
    except OSError:
        return ""
