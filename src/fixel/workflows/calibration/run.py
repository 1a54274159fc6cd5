"""Calibrate experiments: `calibrate`, `calibrate_each` and `calibrate_campaign`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypedDict, Unpack

from fixel.calibration.noise import Noise
from fixel.calibration.objective import AbstractError
from fixel.calibration.optimiser import AbstractOptimiser
from fixel.calibration.target import Target, targets_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import Interrupted, InvalidInput
from fixel.jobs.work import run_work
from fixel.model import Experiment
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.job import SearchState, calibration_rounds, comparer_of
from fixel.workflows.calibration.plan import (
    CalibrationPlan,
    DirectEngine,
    Named,
    best_so_far,
    reporting,
)
from fixel.workflows.calibration.request import Combine, Mode
from fixel.workflows.calibration.result import outcome_of

if TYPE_CHECKING:
    from os import PathLike

    from fixel.database.project import Project
    from fixel.jobs.site import Site

PROJECT_FILE: Final = "fixel.yaml"  # makes a folder a project


class CalibrationOptions(TypedDict, total=False):
    """Options of `calibrate`, `calibrate_each` and `calibrate_campaign`."""

    error: Named | AbstractError
    combine: Combine
    optimiser: Named | AbstractOptimiser
    starts: int
    start: Mapping[str, float] | None
    noise: Noise | None
    level: float
    verdicts: bool
    max_evaluations: int | None
    motion: str | AbstractMotionModel
    seed: int
    threads: int | None
    workers: int
    site: PathLike[str] | str | Site | None
    store: PathLike[str] | str | Project | None
    budget: float | None
    progress: ProgressOption
    name: str


def calibrate(
    experiments: Iterable[Experiment | Target],
    parameters: Space = None,
    *,
    error: Named | AbstractError = "mean-square",
    combine: Combine = "sum",
    optimiser: Named | AbstractOptimiser = "auto",
    starts: int = 1,
    start: Mapping[str, float] | None = None,
    noise: Noise | None = None,
    level: float = 0.95,
    verdicts: bool = True,
    max_evaluations: int | None = None,
    motion: str | AbstractMotionModel = "dynamic",
    seed: int = 0,
    threads: int | None = None,
    workers: int = 0,
    site: PathLike[str] | str | Site | None = None,
    store: PathLike[str] | str | Project | None = None,
    budget: float | None = None,
    progress: ProgressOption = None,
    name: str = "calibration",
) -> Calibration:
    """Calibrate one set of parameters for all experiments together.

    Parameters
    ----------
    experiments : sequence of Experiment
        One or more, each with a scene.
    parameters : mapping, sequence of str, or None
        Parameters to search, in SI units: `{"mu_pusher": (0, 1)}` is free within bounds,
        `{"mu_pusher": 0.3}` is fixed, `["mu_pusher"]` has its usual bounds, and None selects the
        usual parameters. A `Parameter` sets more than bounds. `known_parameters` lists the names.
    error : str, mapping or error
        Error of one experiment: `"mean-square"` of all poses, `"root-mean-square"`, `"end-pose"`,
        or `"robust"` against outliers. `{"name": "robust", "distance": 0.002}` has options.
    combine : str
        How errors of experiments are combined: `"sum"`, `"mean"` or `"largest"`.
    optimiser : str, mapping or optimiser
        `"least-squares"`, `"pattern-search"`, `"nelder-mead"`, `"cma-es"`, `"mads"` or
        `"fixed-step"`. `"auto"` is least squares where there are several experiments and the error
        is a sum of squares, else pattern search.
    starts : int
        Number of searches, all but the first from random points.
    start : mapping from name to float, optional
        Start of the search, such as an earlier calibration; the scenes' own values by default.
    noise : Noise, optional
        Noise of measured poses; estimated from the measurements by default.
    level : float
        Confidence level of the intervals.
    verdicts : bool
        Whether to compute intervals, profiles and verdicts.
    max_evaluations : int, optional
        Number of simulated parameter sets after which the search ends, in total over interruptions.
    motion : str or motion model
        `"dynamic"`, `"quasistatic"` or `"first-order"`.
    seed : int
        Seed of the random number generator.
    threads : int, optional
        Number of threads in this process; all cores by default. The result does not depend on it.
    workers : int
        Number of worker processes; 0 computes in this process.
    site : path, optional
        Site template of a cluster on which the workers run, as for `fixel jobs`.
    store : path or Project, optional
        Folder with the journal of the calibration. The same call continues after an interruption.
        With a project, the result is stored in its database too.
    budget : float, optional
        Computing time [s], in total over interruptions: half of it for the search, the rest for
        the verdicts. It is exceeded by at most one batch.
    progress : bool or callable, optional
        None shows a bar in terminals and notebooks, False nothing; a function is called with
        every `fixel.progress.Progress`.
    name : str
        Name of the calibration in a project.

    Returns
    -------
    Calibration
        A mapping from names to the values that fit best, with estimates and verdicts.

    Raises
    ------
    InvalidInput
        An experiment has no scene, no experiment can inform a parameter, the bounds are reversed,
        or the folder `store` belongs to another calibration.
    Interrupted
        Ctrl-C; the best result so far is its `result`.

    References
    ----------
    :cite:t:`raue2009`; :cite:t:`venzon1988`; :cite:t:`mackinnon1985`.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fit = fixel.calibrate(example_pushes(2), space, progress=False)
    >>> fit.identified
    ('mu_pusher',)
    >>> print(f"{fit['mu_pusher']:.2f}")
    0.25
    """
    return _calibrated(
        "joint",
        experiments,
        parameters,
        error=error,
        combine=combine,
        optimiser=optimiser,
        starts=starts,
        start=start,
        noise=noise,
        level=level,
        verdicts=verdicts,
        max_evaluations=max_evaluations,
        motion=motion,
        seed=seed,
        threads=threads,
        workers=workers,
        site=site,
        store=store,
        budget=budget,
        progress=progress,
        name=name,
    )[-1]


def calibrate_each(
    experiments: Iterable[Experiment | Target],
    parameters: Space = None,
    **options: Unpack[CalibrationOptions],
) -> Calibrations:
    """Calibrate every experiment by itself.

    Parameters
    ----------
    experiments, parameters
        As for `calibrate`.
    **options
        Options of `calibrate`. A budget is not supported.

    Returns
    -------
    Calibrations
        Sequence with one `Calibration` for each experiment.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes, space = example_pushes(2), {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fits = fixel.calibrate_each(pushes, space, verdicts=False, progress=False)
    >>> [round(fit["mu_pusher"], 2) for fit in fits]
    [0.25, 0.25]
    """
    return _calibrated("each", experiments, parameters, **options)


def calibrate_campaign(
    experiments: Iterable[Experiment | Target],
    parameters: Space = None,
    **options: Unpack[CalibrationOptions],
) -> Calibrations:
    """Calibrate every experiment by itself, then all together, with the steps of the RPI thesis.

    Parameters
    ----------
    experiments, parameters
        As for `calibrate`.
    **options
        Options of `calibrate`. A budget is not supported.

    Returns
    -------
    Calibrations
        `each` has the calibrations of single experiments, `joint` that of all together.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes, space = example_pushes(2), {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> fits = fixel.calibrate_campaign(pushes, space, verdicts=False, progress=False)
    >>> round(fits.joint["mu_pusher"], 2)
    0.25
    """
    return _calibrated("campaign", experiments, parameters, **options)


def calibrate_stored(
    experiments: Iterable[Experiment | Target],
    parameters: Space = None,
    **options: Unpack[CalibrationOptions],
) -> Calibrations:
    """Select the stored calibration of a project whose largest error is smallest; no search.

    Parameters
    ----------
    experiments, parameters
        As for `calibrate`.
    **options
        Options of `calibrate`; `store` is the project.
    """
    from fixel.workflows.calibration.project import stored_points

    project: Any = options.get("store")
    points = stored_points(project, search_space(parameters, targets_of(experiments)))
    options["verdicts"] = False
    return _calibrated("stored", experiments, parameters, stored=points, **options)


def _calibrated(
    mode: Mode,
    experiments: Iterable[Experiment | Target],
    parameters: Space,
    *,
    threads: int | None = None,
    workers: int = 0,
    site: PathLike[str] | str | Site | None = None,
    store: PathLike[str] | str | Project | None = None,
    progress: ProgressOption = None,
    **options: Any,
) -> Calibrations:
    """Calibrate in one of the modes of a request."""
    if workers and workers < 0:
        raise InvalidInput("workers", found=workers, expected="0 or more")
    plan = CalibrationPlan.of(mode, experiments, parameters, **options)
    plan = plan.rehearse(threads)
    if store is not None or workers or site is not None:
        return _in_store(plan, store, threads, workers, site, progress)
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
            best = found[-1] if found and mode == "joint" else found
            raise Interrupted(best, hint) from None
    return plan.result(outcome_of(result))


def _in_store(
    plan: CalibrationPlan,
    store: PathLike[str] | str | Project | None,
    threads: int | None,
    workers: int,
    site: PathLike[str] | str | Site | None,
    progress: ProgressOption,
) -> Calibrations:
    """Calibrate in a folder with a journal; in a project, store the result."""
    from fixel.workflows.calibration.stored_run import job_folder, run_stored

    given = None if store is None else Path(getattr(store, "folder", store))  # type: ignore[arg-type]
    in_project = given is not None and (given / PROJECT_FILE).is_file()
    folder = job_folder(given, plan) if given is not None and in_project else given
    run = run_stored(plan, folder, threads, workers, site, progress)
    if given is None or not in_project:
        return run
    from fixel.database.project import Project
    from fixel.workflows.calibration.project import add_to_project

    return add_to_project(Project(given), run)
