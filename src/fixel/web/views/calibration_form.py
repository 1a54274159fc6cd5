"""Begin, stop and go on with a calibration that runs by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, StringConstraints

from fixel.calibration.usual_parameters import default_unknowns, usual_unknown
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.space import Unknown
from fixel.web.values import Answer, FilterText, Id, RequestBody, Text
from fixel.workflows import jobs
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions
from fixel.workflows.calibration.run import (
    STORE_RESULT,
    ExperimentSelection,
    comparable,
    draw_sample,
    prepare,
)
from fixel.workflows.project.filters import view_of

LOOKED_AT: Final = 12  # experiments from which the offer is made

# What they are good for, for who has to choose.
OPTIMISERS: Final = {
    "pattern-search": "the thesis's search: slow and sure",
    "nelder-mead": "few evaluations, for a handful of parameters",
    "cma-es": "many evaluations; gets out of local minima",
    "least-squares": "fastest for many experiments, one set for all",
}
# Options by which searches limit their evaluations.
LIMITS: Final = {"pattern-search": "max_function_evaluations", "nelder-mead": "max_evaluations"}

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
    faulty: int = Field(description="that match too, and are left out for faults in their data")
    unknowns: list[ParameterOption] = Field(description="the usual ones first")
    optimisers: list[OptimiserOption]


class SearchedParameter(RequestBody):
    """A parameter to search for, in SI units."""

    name: Annotated[Text, Field(min_length=1, max_length=80)]
    low: Finite
    high: Finite
    start: Finite


class CalibrationForm(RequestBody):
    """A calibration to begin."""

    filter: FilterText = Field(default="", description="as on the page Experiments")
    experiments: list[Id] = Field(
        default_factory=list, max_length=20_000, description="instead of the filter"
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
        default=None, description="computing time of search and verdicts; mode joint only"
    )
    sample: Annotated[int, Field(ge=1, le=2**31 - 1)] | None = Field(
        default=None, description="size of a random sample, spread over the conditions"
    )

    def request(self) -> CalibrationRequest:
        """Return the request of this form."""
        entries = [
            Unknown(name=one.name, low=one.low, high=one.high, nominal=one.start)
            for one in self.unknowns
        ]
        options: dict[str, Any] = {}
        if self.most_evaluations is not None:
            if self.optimiser not in LIMITS:
                raise InvalidInput(
                    "most_evaluations",
                    found=f"{self.most_evaluations} for {self.optimiser}",
                    expected="nothing; it ends by itself",
                )
            options[LIMITS[self.optimiser]] = self.most_evaluations
        return CalibrationRequest(
            name=self.name,
            mode=self.mode,
            unknowns=entries,
            optimiser=NamedOptions(name=self.optimiser, options=options),
            starts=self.starts,
            seed=self.seed,
            verdicts=self.verdicts,
            budget=self.budget_s,
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
            "with a scene and measured poses, and no fault",
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
        # An experiment that can inform it, if there is one: fixels may stand in some only.
        scene = next((s for s in scenes if name != "mu_fixel" or s.fixels), scenes[0])
        try:
            unknown = usual_unknown(name, scene)
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


def begin(project: Project, chosen: ExperimentSelection, request: CalibrationRequest) -> Path:
    """Run a calibration in a process of its own, which outlives this one; the folder of its job.

    One that was begun before, and stopped, goes on.
    """
    request = request.model_copy(update={"sample_of": chosen.sample_of})
    folder = prepare(project, chosen, request)
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
