"""Begin, stop and go on with a calibration that runs by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, StringConstraints

from fixel.calibration.usual_parameters import default_unknowns, usual_in
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.space import ParameterSpace, Unknown
from fixel.web.values import Answer, FilterText, Id, RequestBody, Text
from fixel.workflows import jobs
from fixel.workflows.calibration.plan import CalibrationPlan
from fixel.workflows.calibration.project import (
    STORE_RESULT,
    ExperimentSelection,
    comparable,
    draw_sample,
)
from fixel.workflows.calibration.stored_run import job_folder, prepare_folder
from fixel.workflows.project.filters import view_of

LOOKED_AT: Final = 12  # experiments from which the offer is made

# What they are good for, for who has to choose.
OPTIMISERS: Final = {
    "pattern-search": "search of the thesis: slow and robust",
    "nelder-mead": "few evaluations, for up to about five parameters",
    "cma-es": "many evaluations; escapes local minima",
    "least-squares": "fastest for a joint calibration of many experiments",
}

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ParameterOption(Answer):
    """A parameter one may search for, in SI units."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    start: float
    usual: bool


class OptimiserOption(Answer):
    """A search."""

    name: str
    meaning: str


class CalibrationOffer(Answer):
    """Experiments, parameters and searches for a calibration."""

    experiments: int
    faulty: int = Field(
        description="number of matching experiments that are skipped because their data have faults"
    )
    unknowns: list[ParameterOption] = Field(
        description="parameters that can be calibrated, the usual ones first"
    )
    optimisers: list[OptimiserOption]


class SearchedParameter(RequestBody):
    """A parameter to search for, in SI units."""

    name: Annotated[Text, Field(min_length=1, max_length=80)]
    low: Finite
    high: Finite
    start: Finite


class CalibrationForm(RequestBody):
    """A calibration to begin."""

    filter: FilterText = Field(default="", description="filter as on the page Experiments")
    experiments: list[Id] = Field(
        default_factory=list,
        max_length=20_000,
        description="ids of experiments, instead of the filter",
    )
    name: Annotated[
        str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$", max_length=40)
    ] = "calibration"
    mode: Literal["each", "joint", "campaign"] = "joint"
    unknowns: list[SearchedParameter] = Field(min_length=1, max_length=64)
    optimiser: Literal["pattern-search", "nelder-mead", "cma-es", "least-squares"] = (
        "pattern-search"
    )
    starts: Annotated[int, Field(ge=1, le=100)] = 1
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    most_evaluations: Annotated[int, Field(ge=1, le=10_000_000)] | None = None
    verdicts: bool = True
    budget_s: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = Field(
        default=None, description="computing time of search and verdicts [s]; only in mode joint"
    )
    sample: Annotated[int, Field(ge=1, le=2**31 - 1)] | None = Field(
        default=None, description="size of a random sample, spread over the conditions"
    )

    def plan(self, chosen: ExperimentSelection) -> CalibrationPlan:
        """Return the plan of this form for the selected experiments."""
        unknowns = [
            Unknown(name=one.name, low=one.low, high=one.high, nominal=one.start)
            for one in self.unknowns
        ]
        return CalibrationPlan.of(
            self.mode,
            chosen,
            ParameterSpace(unknowns=tuple(unknowns)),
            optimiser=self.optimiser,
            max_evaluations=self.most_evaluations,
            starts=self.starts,
            seed=self.seed,
            verdicts=self.verdicts,
            budget=self.budget_s,
            name=self.name,
        )

    def selection(self, store: Store) -> ExperimentSelection:
        """Return the experiments that match and can be compared, or a sample of these.

        Raises
        ------
        InvalidInput
            There are none.
        """
        found, _ = _matching(store, self.filter, self.experiments)
        every = comparable(store, found)
        every.check_some(
            "an experiment with a scene and measured poses, without faults",
            "try the filter on the page Experiments",
        )
        return every if self.sample is None else draw_sample(every, self.sample, self.seed)


def offer(store: Store, filter: str, ids: Sequence[int] = ()) -> CalibrationOffer:
    """Return what can be calibrated for experiments that match a filter or have given ids."""
    found, faulty = _matching(store, filter, ids)
    step = max(1, len(found) // LOOKED_AT)
    scenes = [target.case.scene for target in comparable(store, found[::step]).targets]
    first = [unknown.name for unknown in default_unknowns(scenes)] if scenes else []
    offered = []
    for name in dict.fromkeys((*first, *KNOWN_PARAMETERS)) if scenes else ():
        try:
            unknown = usual_in(name, scenes)
        except InvalidInput:
            continue
        offered.append(
            ParameterOption(
                name=name,
                unit=unknown.unit,
                meaning=info_of(name).meaning,
                low=unknown.low,
                high=unknown.high,
                start=unknown.nominal,
                usual=name in first,
            )
        )
    return CalibrationOffer(
        experiments=len(found),
        faulty=faulty,
        unknowns=offered,
        optimisers=[
            OptimiserOption(name=name, meaning=meaning) for name, meaning in OPTIMISERS.items()
        ],
    )


def begin(project: Project, plan: CalibrationPlan) -> Path:
    """Run a calibration in its own process, which outlives this one; return the job folder.

    One that was begun before, and stopped, continues.
    """
    plan = plan.rehearse()
    folder = job_folder(project.folder, plan)
    prepare_folder(plan, folder)
    if jobs.status_of(folder).state != "done":
        go_on(folder)
    return folder


def go_on(folder: Path) -> jobs.JobStatus:
    """Run a job that was stopped, lost or never run; it goes on from what is finished.

    Raises
    ------
    JobRefused
        It is running.
    """
    jobs.arrange(folder)
    return jobs.run_detached(folder, STORE_RESULT)


def _matching(store: Store, filter: str, ids: Sequence[int]) -> tuple[list[int], int]:
    if ids:
        return sorted(set(ids)), 0
    view = view_of(filter)
    every = store.experiment_ids(view)
    clean = every if "faulty" in view.marks else store.experiment_ids(view_of(f"{filter} is:clean"))
    return sorted(clean), len(every) - len(clean)
