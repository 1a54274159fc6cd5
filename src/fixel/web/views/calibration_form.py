"""Begin, stop and go on with a calibration that runs by itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.calibration.target import Target, target_of
from fixel.database.project import Project
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.space import Unknown
from fixel.workflows import jobs
from fixel.workflows.calibration.parameter_options import default_unknowns, usual
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions
from fixel.workflows.calibration.run import ExperimentSelection, prepare, stored_points
from fixel.workflows.calibration.unattended import MODULE
from fixel.workflows.project.filters import view_of

LOOKED_AT: Final = 12  # experiments from which the offer is made

# What they are good for, for who has to choose.
OPTIMISERS: Final = {
    "pattern-search": "the thesis's search: slow and sure",
    "nelder-mead": "few evaluations, for a handful of parameters",
    "cma-es": "many evaluations; gets out of local minima",
    "least-squares": "fastest for many experiments, one set for all",
}


class ParameterOption(NamedTuple):
    """A parameter one may search for."""

    unknown: Unknown
    unit: str
    meaning: str
    usual: bool  # of those one searches for first


class Offer(NamedTuple):
    """Experiments and parameters that can be calibrated.

    Attributes
    ----------
    ids : list of int
        Experiments that match, but for those with a fault in their data.
    faulty : int
        Those.
    unknowns : list of ParameterOption
        The usual ones first.
    """

    ids: list[int]
    faulty: int
    unknowns: list[ParameterOption]


def offer(store: Store, filter: str, ids: Sequence[int] = ()) -> Offer:
    """Return what can be calibrated for experiments that match a filter or have given ids."""
    found, faulty = _matching(store, filter, ids)
    step = max(1, len(found) // LOOKED_AT)
    scenes = [target.case.scene for target in _targets(store, found[::step])[0]]
    if not scenes:
        return Offer(found, faulty, [])
    first = [unknown.name for unknown in default_unknowns(scenes)]
    offered = []
    for name in [*first, *(name for name in KNOWN_PARAMETERS if name not in first)]:
        # An experiment that can inform it, if there is one: fixels may stand in some only.
        scene = next((s for s in scenes if name != "mu_fixel" or s.fixels), scenes[0])
        try:
            unknown = usual(name, scene)
        except InvalidInput:
            continue
        info = info_of(name)
        offered.append(ParameterOption(unknown, info.unit, info.meaning, name in first))
    return Offer(found, faulty, offered)


def chosen_from(store: Store, filter: str, ids: Sequence[int] = ()) -> ExperimentSelection:
    """The experiments that match and can be compared; a refusal where there are none."""
    found, _ = _matching(store, filter, ids)
    targets, kept, left_out = _targets(store, found)
    if not targets:
        reason = next(iter(left_out.values()), "")
        raise InvalidInput(
            "experiments",
            found=f"none to calibrate with{f' ({reason})' if reason else ''}",
            expected="one at least with a scene and measured poses, and no fault",
            hint="try the filter on the page Experiments",
        )
    return ExperimentSelection(ids=kept, targets=targets, left_out=left_out)


def begin(
    project: Project, store: Store, chosen: ExperimentSelection, request: CalibrationRequest
) -> Path:
    """Run a calibration in a process of its own, which outlives this one; the folder of its job.

    One that was begun before, and stopped, goes on.
    """
    request = request.model_copy(update={"sample_of": chosen.sample_of})
    if request.mode == "stored":
        points = stored_points(store, request)
        request = request.model_copy(update={"stored": points, "verdicts": False})
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
    return jobs.run_detached(folder, MODULE)


def request_from(
    name: str,
    mode: str,
    unknowns: Sequence[Unknown],
    optimiser: str,
    most: int | None,
    **more: Any,
) -> CalibrationRequest:
    """A request out of a form's fields; `most` evaluations of a search, where that is limited."""
    options: dict[str, Any] = {}
    if most is not None:
        limits = {"pattern-search": "max_function_evaluations", "nelder-mead": "max_evaluations"}
        if optimiser not in limits:
            raise InvalidInput(
                "most_evaluations",
                found=f"{most} for {optimiser}",
                expected="nothing; it ends by itself",
            )
        options[limits[optimiser]] = most
    return CalibrationRequest.model_validate(
        {
            "name": name,
            "mode": mode,
            "unknowns": list(unknowns),
            "optimiser": NamedOptions(name=optimiser, options=options),
            **more,
        }
    )


def _matching(store: Store, filter: str, ids: Sequence[int]) -> tuple[list[int], int]:
    if ids:
        return sorted(set(ids)), 0
    view = view_of(filter)
    every = store.experiment_ids(view)
    clean = every if "faulty" in view.marks else store.experiment_ids(view_of(f"{filter} is:clean"))
    return sorted(clean), len(every) - len(clean)


def _targets(store: Store, ids: Sequence[int]) -> tuple[list[Target], list[int], dict[str, str]]:
    targets, kept, left_out = [], [], {}
    for number in ids:
        experiment = store.experiment(number)
        try:
            targets.append(target_of(experiment))
            kept.append(number)
        except InvalidInput as problem:
            left_out[experiment.key] = str(problem)
    return targets, kept, left_out
