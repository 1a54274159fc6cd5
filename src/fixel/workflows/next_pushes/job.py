"""Propose pushes as a job in its own process, to be inspected, stopped and resumed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from fixel.database.project import Project
from fixel.jobs.functions import callable_by_jobs
from fixel.jobs.work import Work, report_stage
from fixel.workflows import jobs
from fixel.workflows.next_pushes.report import store_proposal
from fixel.workflows.next_pushes.run import NextPushesRequest, propose_pushes

MAKER: Final = "next:next_work"


@callable_by_jobs
def next_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Propose pushes as `fixel next` does; fits are stored in the project as they are made."""
    yield from ()  # makes this a generator, as all work is
    # The job is in the folder `jobs` of its project.
    project = Project(inputs.resolve().parents[2])
    request = NextPushesRequest(**options["question"] | {"where": ()})
    found = propose_pushes(project, request, progress=report_stage)
    return store_proposal(project, found, str(options["command"])).folder.name.encode()


def begin(project: Project, request: NextPushesRequest, command: str) -> Path:
    """Start a proposal in its own process, which outlives this one; return the job's folder."""
    # Another number of experiments is another question.
    with project.store() as store:
        stored = sum(store.datasets().values())
    question = [asdict(request), stored]
    return jobs.begin_for_page(project.folder, "next", MAKER, question, command)
