"""Search for a plan in rounds of chunks, which workers simulate."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.jobs.functions import callable_by_jobs, threads
from fixel.jobs.work import Answer, Answers, Chunk, Failure, Round
from fixel.planning.plan import plan_rounds, search_of
from fixel.planning.search import MarginRequest, PlanSearch, SearchStage, Views
from fixel.progress import Progress
from fixel.registry import offered
from fixel.typing import FloatArray
from fixel.workflows.planning.request import PlanAnswer, PlanInputs, found_plan, inputs_for

CHUNK: Final = 4096  # rollouts of a chunk


def plan_in_rounds(
    project: Project,
    goal: str,
    *,
    inputs: Path,
    progress: Callable[[Progress], None] | None = None,
    **options: Any,
) -> Generator[Round, Answers, PlanAnswer]:
    """Search for a plan as `plan_goal` does, in rounds of chunks."""
    request, own, search = _search(inputs, progress)
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
        return PlanAnswer(found_plan(own, end.value, options), None)


@callable_by_jobs
def margins(inputs: Path, payload: bytes) -> bytes:
    """Simulate the margins of some plans, on any worker."""
    return bytes_of(margins=_worker_search(inputs).margins(_request(payload)))


@lru_cache(maxsize=1)
def _worker_search(inputs: Path) -> PlanSearch:
    return _search(inputs)[-1]


def _search(
    inputs: Path, report: Callable[[Progress], None] | None = None
) -> tuple[Any, PlanInputs, PlanSearch]:
    _, request, project = offered("methods", "request_of")(inputs)
    own = inputs_for(project, request)
    search = search_of(
        *own.parts, rollouts=request.rollouts, seed=request.seed, threads=threads(),
        views=Views(request.looks, **own.file.views), report=report,
    )  # fmt: skip
    return request, own, search


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
        raise InvalidInput(
            "simulations of a plan", found=f"none ({answer.reason})", expected="some"
        )
    return np.asarray(arrays_of(answer)["margins"])
