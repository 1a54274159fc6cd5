"""Run calibrations in this process, in a folder, or in a project."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, default_unknowns, search_space
from fixel.errors import Interrupted, InvalidInput
from fixel.jobs.work import run_work
from fixel.model import Experiment, Scene
from fixel.model.selection import parse_filter
from fixel.model.space import ParameterSpace
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.trust import permit
from fixel.workflows.calibration.calibration import Calibrations
from fixel.workflows.calibration.commands import plain_options
from fixel.workflows.calibration.job import SearchState, calibration_rounds, comparer_of
from fixel.workflows.calibration.parameter_options import (
    fixed_unknowns,
    from_dakota,
    read_space,
    searched_unknowns,
)
from fixel.workflows.calibration.plan import (
    CalibrationPlan,
    DirectEngine,
    best_so_far,
    reporting,
)
from fixel.workflows.calibration.request import Mode, NamedOptions
from fixel.workflows.calibration.result import outcome_of
from fixel.workflows.calibration.stored_run import job_folder, prepare_folder, run_stored

if TYPE_CHECKING:
    from fixel.database.project import Project

PROJECT_FILE: Final = "fixel.yaml"  # makes a folder a project


def calibrate_in(
    mode: Mode, experiments: Iterable[Experiment | Target], parameters: Space = None, **options: Any
) -> Calibrations:
    """Calibrate in one of the modes of a request; the options are those of `calibrate`."""
    permit(options.get("motion"))
    if (workers := options["workers"]) < 0:
        raise InvalidInput("workers", found=workers, expected="0 or more")
    plan = CalibrationPlan.of(mode, experiments, parameters, **options)
    return _run(plan.rehearse(options.get("threads")), **options)


def _run(
    plan: CalibrationPlan,
    *,
    threads: int | None = None,
    workers: int = 0,
    site: Any = None,
    store: Any = None,
    progress: ProgressOption = None,
    **_: Any,
) -> Calibrations:
    """Run a plan in this process, or in a folder with a journal; store the result in a project."""
    if store is None and not workers and site is None:
        return _run_here(plan, threads, progress)
    given = None if store is None else Path(getattr(store, "folder", store))
    in_project = given is not None and (given / PROJECT_FILE).is_file()
    folder = job_folder(given, plan) if given is not None and in_project else given
    run = run_stored(plan, folder, threads, workers, site, progress)
    if given is None or not in_project:
        return run
    from fixel.database.project import Project
    from fixel.workflows.calibration.project import add_to_project

    return add_to_project(Project(given), run)


def _run_here(plan: CalibrationPlan, threads: int | None, progress: ProgressOption) -> Calibrations:
    comparer = comparer_of(plan.request, plan.targets, threads)
    state = SearchState(plan.request)
    work = calibration_rounds(plan.request, comparer, state)
    engine = DirectEngine(plan.request, comparer)
    with show_progress(progress, "searching") as report:
        try:
            result = run_work(work, engine, Path(), None, progress=reporting(report))
        except KeyboardInterrupt:
            hint = "with store='FOLDER' the same call would continue"
            found = best_so_far(plan, comparer, state, engine.alone)
            best = found[-1] if found and plan.request.mode == "joint" else found
            raise Interrupted(best, hint) from None
    return plan.result(outcome_of(result))


# --- experiments of a project -------------------------------------------------------------------


def run_in_project(
    project: Project, asked: Mapping[str, Any], progress: ProgressOption = None
) -> Calibrations | Path:
    """Calibrate experiments of a project, or only prepare the job and return its folder.

    Parameters
    ----------
    project : Project
    asked : mapping
        Arguments of `calibrate_in_project` and of `calibrate`, by name.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.
    """
    if asked["prepare"]:
        return prepare_in_project(project, asked)
    plan = plan_in_project(project, asked)
    return _run(plan, **asked, store=project, progress=progress)


def prepare_in_project(project: Project, asked: Mapping[str, Any]) -> Path:
    """Make the job of a calibration in a project, if it is not there; return its folder."""
    plan = plan_in_project(project, asked)
    folder = job_folder(project.folder, plan)
    prepare_folder(plan, folder)
    return folder


def plan_in_project(project: Project, asked: Mapping[str, Any]) -> CalibrationPlan:
    """Return the plan of a calibration of experiments of a project, checked and rehearsed."""
    from fixel.workflows.calibration.project import draw_sample, select_experiments, stored_points
    from fixel.workflows.compilation import get_ready

    keys, given = asked["experiments"], {k: asked[k] for k in ("dataset", "where") if asked[k]}
    if keys and given:
        name = next(iter(given))
        raise InvalidInput(name, found="names of experiments too", expected="one of them")
    query = parse_filter(*asked["where"], dataset=asked["dataset"], include_faulty=asked["faulty"])
    with project.store() as store:
        chosen = select_experiments(store, keys, query)
    if asked["sample"] is not None:
        chosen = draw_sample(chosen, asked["sample"], asked["seed"])
    mode: Mode = asked["mode"] or ("each" if len(chosen.targets) == 1 else "joint")
    search, space = _search_and_space(asked, [target.case.scene for target in chosen.targets])
    own: dict[str, Any] = {
        "error": {"name": asked["error"], "angle_scale": asked["angle_scale"]},
        "optimiser": search,
    }
    if mode == "stored":
        points = stored_points(project, search_space(space, targets_of(chosen)))
        own |= {"stored": points, "verdicts": False}
    get_ready(chosen.targets[0].case.scene)  # before the clock runs
    plan = CalibrationPlan.of(mode, chosen, space, **{**asked, **own})
    plain = plain_options(asked) | {"project": str(project.folder)}
    return replace(plan.rehearse(asked["threads"]), asked=plain)


def _search_and_space(
    asked: Mapping[str, Any], scenes: list[Scene]
) -> tuple[NamedOptions, ParameterSpace]:
    search = NamedOptions(name=asked["optimiser"], options=dict(map(_setting, asked["option"])))
    if asked["dakota"] is not None:
        search, unknowns = from_dakota(asked["dakota"])
    elif asked["space"] is not None:
        unknowns = list(read_space(asked["space"]).unknowns)
    else:
        unknowns = searched_unknowns(asked["fit"], scenes) or default_unknowns(scenes)
    fixed = fixed_unknowns(asked["fixed"])
    names = {unknown.name for unknown in fixed}
    free = [unknown for unknown in unknowns if unknown.name not in names]
    return search, ParameterSpace(unknowns=(*free, *fixed))


def _setting(text: str) -> tuple[str, Any]:
    """Parse NAME=VALUE; a value is JSON, or else text."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidInput("option", found=repr(text), expected="NAME=VALUE")
    try:
        return name.strip(), json.loads(value)
    except json.JSONDecodeError:
        return name.strip(), value
