"""Plan as a job in its own process, to be inspected, stopped and resumed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.jobs.folder import read_job
from fixel.jobs.functions import callable_by_jobs, threads
from fixel.jobs.work import Answer, Chunk, Failure, Round, Work, report_stage
from fixel.planning.plan import plan_rounds, search_of
from fixel.planning.pushes import FreePushes
from fixel.planning.search import MarginRequest, PlanSearch, SearchStage
from fixel.progress import Progress
from fixel.typing import FloatArray
from fixel.workflows import jobs
from fixel.workflows.planning.report import store_plan
from fixel.workflows.planning.request import PlanInputs, PlanRequest, found_plan, inputs_of

MAKER: Final = "plan:plan_work"
CHUNK: Final = 4096  # rollouts of a chunk


@callable_by_jobs
def plan_work(inputs: Path, options: Mapping[str, Any]) -> Work:
    """Search for a plan as `fixel plan` does, in rounds of chunks that workers simulate."""
    began = time.monotonic()
    project, request, own, search = _search(inputs, options, report_stage)
    rounds = plan_rounds(search, untrusted=request.untrusted)
    number = 0
    try:
        wanted = next(rounds)
        while True:
            chunks = [Chunk(f"{number}-{k}", _bytes(part)) for k, part in enumerate(_split(wanted))]
            answers = yield Round("plan:margins", chunks, note=f"success {search.best:.3f}")
            wanted = rounds.send(np.concatenate([_margins(answers[own.name]) for own in chunks]))
            number += 1
    except StopIteration as end:
        found = found_plan(request, own, end.value)
    kept = store_plan(project, found, str(options["command"]), time.monotonic() - began)
    return kept.folder.name.encode()


@callable_by_jobs
def margins(inputs: Path, payload: bytes) -> bytes:
    """Simulate the margins of some plans, on any worker."""
    return bytes_of(margins=_worker_search(inputs).margins(_request(payload)))


@lru_cache(maxsize=1)
def _worker_search(inputs: Path) -> PlanSearch:
    return _search(inputs, read_job(inputs.parent).options)[-1]


def _search(
    inputs: Path, options: Mapping[str, Any], report: Callable[[Progress], None] | None = None
) -> tuple[Project, PlanRequest, PlanInputs, PlanSearch]:
    # The job is in the folder `jobs` of its project.
    project = Project(inputs.resolve().parents[2])
    request = PlanRequest(**options["question"])
    own = inputs_of(project, request)
    search = search_of(
        own.scene, own.file.goal, own.file.choose or FreePushes(), own.belief,
        rollouts=request.rollouts, seed=request.seed, threads=threads(), report=report,
    )  # fmt: skip
    return project, request, own, search


def _split(request: MarginRequest) -> Iterator[MarginRequest]:
    """Split the plans of a request into chunks of some seconds."""
    each = max(1, CHUNK // (request.last - request.first))
    for k in range(0, len(request.plans), each):
        yield request._replace(plans=request.plans[k : k + each])


def _bytes(request: MarginRequest) -> bytes:
    return bytes_of(
        pushes=[len(plan) for plan in request.plans],
        numbers=np.concatenate(request.plans),
        stage=request.stage,
        rows=(request.first, request.last),
    )


def _request(payload: bytes) -> MarginRequest:
    own = arrays_of(payload)
    plans = np.split(own["numbers"], np.cumsum(own["pushes"])[:-1])
    first, last = own["rows"].tolist()
    return MarginRequest(plans, SearchStage(*own["stage"].tolist()), first, last)


def _margins(answer: Answer) -> FloatArray:
    if isinstance(answer, Failure):
        raise InvalidInput("simulations of a plan", found=answer.reason, expected="margins")
    return np.asarray(arrays_of(answer)["margins"])


def begin(project: Project, request: PlanRequest, command: str) -> Path:
    """Start a search in its own process, which outlives this one; return the job's folder.

    Raises
    ------
    InvalidInput
        The request is invalid, or its goal does not fit the scene.
    """
    present = inputs_of(project, request)  # errors appear here, not in the job
    # A calibration that is added later must not change a job that is resumed.
    question = asdict(replace(request, calibration=present.calibration))
    return jobs.begin_for_page(project.folder, "plan", MAKER, question, command)
