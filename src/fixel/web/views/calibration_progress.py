"""Progress of a running calibration: its objective, read from the journal of its job."""

from __future__ import annotations

import math
import threading
from functools import lru_cache
from pathlib import Path
from typing import Final, final

import numpy as np
from pydantic import Field

from fixel.calibration.optimiser import AbstractOptimiser
from fixel.calibration.result import FitKind
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import FixelError, NotStored
from fixel.io.damaged_files import each_readable
from fixel.jobs import folder as files
from fixel.web.values import Answer, Finite
from fixel.web.views.calibration_detail import Residual
from fixel.workflows import jobs
from fixel.workflows.calibration.calibration import collect
from fixel.workflows.calibration.execution import LiveSearch
from fixel.workflows.calibration.parameter_options import command_of
from fixel.workflows.calibration.plan import plan_in
from fixel.workflows.calibration.stored import add_to_project

KIND: Final = "calibrate"  # capability of its jobs
SEARCHES: Final = ("all together", "squares")  # stages of searches by errors and by residuals
# Fields of the status of a job that are shown as they are.
OF_JOB: Final = ("name", "state", "ended", "reason", "note", "share", "started_utc")


class LiveProgress(Answer):
    """A calibration that is not stored yet, and how far it is."""

    name: str = Field(description="name of the job")
    label: str = Field(description="name of the calibration")
    mode: str
    optimiser: str
    experiments: int
    unknowns: list[str]
    unit: str
    state: str = Field(
        description="status of the job: queued, preparing, running, done, "
        "stopped, lost, failed, ..."
    )
    ended: bool
    reason: str
    stage: str = Field(description="part of the calibration that was computed last")
    note: str = Field(description="part that is computed now")
    evaluations: int
    most: int | None = Field(description="maximum number of evaluations")
    rate: float = Field(description="recent evaluations per second")
    left_s: float | None = Field(description="estimated remaining time [s]; null if unknown")
    at_most: bool = Field(
        description="whether `left_s` is an upper bound, since a search may converge earlier"
    )
    share: float | None = Field(description="share of the work that is done; null if unknown")
    best: float | None = Field(description="smallest mean error per experiment so far")
    start: float | None = Field(description="mean error per experiment at the nominal values")
    started_utc: str
    stored: list[int] = Field(description="ids of the stored calibrations")
    command: str
    objective: list[Finite] = Field(
        description="mean error of each evaluation; null if a simulation failed"
    )
    singles: list[Residual] = Field(
        description="results of the experiments calibrated so far, in mode each"
    )


@final
class ProgressReader:
    """Reader of the progress of a project's calibrations, which reads only what is new."""

    def __init__(self, project: Project, store: Store) -> None:
        self._project, self._store, self._lock = project, store, threading.Lock()
        self._opened = lru_cache(None)(self._open)

    def _open(self, folder: Path) -> tuple[LiveSearch, list[int]]:
        """Return the search of a job, and the ids of its experiments."""
        plan = plan_in(folder)
        ids = [self._store.find(target.key) for target in plan.targets]
        return LiveSearch(plan, plan.task()), ids

    def folder(self, name: str) -> Path:
        """Return the folder of a calibration's job; raise if there is none of the name."""
        found = jobs.job_folders(self._project.folder).get(name)
        if found is None or jobs.capability_of(found) != KIND:
            raise NotStored(f"calibration job {name!r}", hint="the page Calibrations lists all")
        return found

    def _stored(self) -> dict[str, list[int]]:
        """Return the ids of stored calibrations by the name of their job."""
        found: dict[str, list[int]] = {}
        for k, record in self._store.calibration_summaries().items():
            found.setdefault(str(record.method.get("job")), []).append(k)
        return found

    def unfinished(self) -> tuple[list[LiveProgress], list[FixelError]]:
        """Return calibrations that are not stored yet, newest first, and errors of unreadable ones.

        Calibrations that are done become stored.
        """
        known, every = self._stored(), jobs.job_folders(self._project.folder)
        own = [f for k, f in every.items() if k not in known and jobs.capability_of(f) == KIND]
        newest = sorted(own, key=lambda folder: files.read_job(folder).made_utc, reverse=True)
        found, unreadable = each_readable(self.look, newest)
        return [seen for seen in found if not seen.stored], unreadable

    def look(self, folder: Path) -> LiveProgress:
        """Return the progress of one."""
        status, (live, ids) = jobs.status_of(folder), self._opened(folder)
        stored = self._stored().get(folder.name, []) if status.state == "done" else []
        with self._lock:
            if status.kept > live.n_read:
                live.read(folder / files.JOURNAL)
            if status.state == "done" and not stored:  # it was computed elsewhere
                run = collect(plan_in(folder), folder)
                stored = list(add_to_project(self._project, run).ids)
        plan, request, search = live.plan, live.plan.request, live.search
        errors = np.append(search.task.combined(search.nominal[None]), search.trace().errors)
        start, *objective = request.error_of_one(errors, len(ids)).tolist()
        # The job counts chunks, which have about the same number of evaluations each.
        searching = live.stage in SEARCHES and not status.ended
        rate = status.rate * len(objective) / max(1, status.kept) if searching else 0.0
        limit, left = None, None if status.ended else status.left_s
        if isinstance(method := request.made_search, AbstractOptimiser) and request.mode != "each":
            limit = request.max_evaluations or method.limit
        at_most = left is None and limit is not None and rate > 0.0
        if at_most and limit is not None:
            left = max(0.0, (limit - len(objective)) / rate)
        return LiveProgress(
            **{name: getattr(status, name) for name in OF_JOB},
            label=request.name,
            mode=request.mode,
            optimiser=request.optimiser.name,
            experiments=len(ids),
            unknowns=list(request.space.labels),
            unit=request.made_error.unit,
            stage=live.stage,
            evaluations=len(objective),
            most=limit,
            rate=rate,
            left_s=left,
            at_most=at_most,
            best=min(filter(math.isfinite, objective), default=None),
            start=start if math.isfinite(start) else None,
            stored=stored,
            command=command_of({**plan.asked, "project": self._project.folder}),
            objective=objective,
            singles=[
                Residual(id=ids[k], key=plan.targets[k].key, before=search.nominal[k], after=error)
                for one in live.found
                if one.how == FitKind.ALONE
                for k, error in zip(one.members, one.errors, strict=True)
            ],
        )
