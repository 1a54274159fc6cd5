"""Plan as a job in its own process, to be inspected, stopped and resumed."""

from __future__ import annotations

import hashlib
import json
import time
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
from fixel.workflows.planning.report import store_plan
from fixel.workflows.planning.request import PlanRequest, find_plan, inputs_of

MAKER: Final = "plan:plan_work"
STAGE: Final = "stage.txt"  # what the job is doing
SEARCH: Final = "search"  # folder of the finished simulations


@callable_by_jobs
def plan_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Search for a plan as `fixel plan` does; finished simulations are stored as they are made."""
    yield from ()  # makes this a generator, as all work is

    def show(now: Progress) -> None:
        share = f"{100.0 * now.done / now.total:.0f} %" if now.total else ""
        with written_whole(inputs.parent / STAGE) as path:
            path.write_text(", ".join(part for part in (now.stage, share, now.note) if part))

    # The job is in the folder `jobs` of its project.
    project = Project(inputs.resolve().parents[2])
    began = time.monotonic()
    request = PlanRequest(**options["question"])
    found = find_plan(project, request, store=inputs.parent / SEARCH, progress=show)
    kept = store_plan(project, found, str(options["command"]), time.monotonic() - began)
    return kept.folder.name.encode()


def begin(project: Project, request: PlanRequest, command: str) -> Path:
    """Start a search in its own process, which outlives this one; return the job's folder.

    Raises
    ------
    InvalidInput
        The request is invalid, or its goal does not fit the scene.
    """
    present = inputs_of(project, request)  # errors appear here, not in the job
    question = asdict(request)
    digest = hashlib.sha256(json.dumps([question, present.calibration]).encode()).hexdigest()[:10]
    folder = project.folder / jobs.JOBS / f"plan-{digest}"
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
