"""Calibrate experiments: `calibrate`, `calibrate_each`, `calibrate_campaign`; and in a project."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from fixel.capability.capability import Capability
from fixel.capability.options import (
    MAX_WORKERS,
    Dataset,
    Door,
    Fit,
    Flagged,
    Level,
    NoiseOption,
    Seed,
    Threads,
    Where,
)

if TYPE_CHECKING:
    from os import PathLike

    from pydantic import BaseModel

    from fixel.calibration.objective import AbstractError
    from fixel.calibration.optimiser import AbstractOptimiser
    from fixel.calibration.target import Target
    from fixel.calibration.usual_parameters import Space
    from fixel.database.project import Project
    from fixel.jobs.site import Site
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.simulation.motion import AbstractMotionModel
    from fixel.workflows.calibration.calibration import Calibration, Calibrations

Named = Mapping[str, Any] | str
Mode = Literal["each", "joint", "campaign", "stored"]
Combine = Literal["sum", "mean", "largest"]


def _errors() -> list[str]:
    from fixel.calibration.objective import ERRORS

    return [kind.name for kind in ERRORS]


def _searches() -> list[str]:
    from fixel.workflows.calibration.request import AUTO, SEARCHES

    return [AUTO, *(kind.name for kind in SEARCHES)]


ErrorName = Annotated["Named | AbstractError", Door(plain=str, among=_errors)]
SearchName = Annotated["Named | AbstractOptimiser", Door(plain=str, among=_searches)]
SiteFile = Annotated["PathLike[str] | str | Site | None", Door(plain=Path | None, effort=True)]
MotionName = Annotated[
    "str | AbstractMotionModel", Door(plain=str, metavar="NAME", also=("--engine",), program=True)
]


def calibrate(
    experiments: Iterable[Experiment | Target],
    parameters: Space = None,
    *,
    error: ErrorName = "mean-square",
    combine: Combine = "sum",
    optimiser: SearchName = "auto",
    starts: Annotated[int, Door(least=1)] = 1,
    start: Mapping[str, float] | None = None,
    noise: NoiseOption = None,
    level: Level = 0.95,
    verdicts: bool = True,
    max_evaluations: Annotated[int | None, Door(least=1)] = None,
    motion: MotionName = "dynamic",
    seed: Seed = 0,
    threads: Threads = None,
    workers: Annotated[int, Door(least=0, most=MAX_WORKERS, effort=True)] = 0,
    site: SiteFile = None,
    store: PathLike[str] | str | Project | None = None,
    budget: Annotated[float | None, Door(flag="--budget", unit="s", above=0.0)] = None,
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
    options = locals()
    from fixel.workflows.calibration.execution import calibrate_in

    return calibrate_in("joint", **options)[-1]


def calibrate_each(
    experiments: Iterable[Experiment | Target], parameters: Space = None, **options: Any
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
    return _in_mode("each", experiments, parameters, **options)


def calibrate_campaign(
    experiments: Iterable[Experiment | Target], parameters: Space = None, **options: Any
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
    return _in_mode("campaign", experiments, parameters, **options)


def _in_mode(mode: str, *arguments: Any, **options: Any) -> Calibrations:
    """Calibrate in a mode with arguments of `calibrate`; raise `TypeError` for unknown ones."""
    from fixel.workflows.calibration.execution import calibrate_in

    call = signature(calibrate).bind(*arguments, **options)
    call.apply_defaults()
    return calibrate_in(mode, **call.arguments)


def calibrate_in_project(
    project: Project,
    experiments: Annotated[tuple[str, ...], Door(metavar="EXPERIMENT")] = (),
    *,
    mode: Annotated[Mode | None, Door(usual="each for one experiment, else joint")] = None,
    fit: Fit = (),
    fixed: Annotated[tuple[str, ...], Door(flag="--set", metavar="NAME=VALUE")] = (),
    space: Path | None = None,
    dakota: Path | None = None,
    angle_scale: Annotated[float, Door(unit="mm", above=0.0)] = 0.035,
    option: Annotated[tuple[str, ...], Door(metavar="NAME=VALUE")] = (),
    sample: Annotated[int | None, Door(least=1)] = None,
    dataset: Dataset = "",
    where: Where = (),
    flagged: Flagged = False,
    **options: Any,
) -> Calibrations:
    """Estimate parameters from experiments, with verdicts.

    Finished evaluations are stored: repeat the command after an interruption to continue.

    Parameters
    ----------
    experiments : tuple of str
        Ids or names of experiments; by default all that match the options.
    mode : str, optional
        Kind of calibration. each: one set per experiment; joint: one set for all; campaign: each,
        then joint, with the intermediate steps of the thesis; stored: the best of the stored sets.
    fit : tuple of str
        Parameter to calibrate, in SI units or with the suffix _mm, _deg or _mrad; may be repeated.
    fixed : tuple of str
        Parameter with a fixed value; may be repeated.
    space : path, optional
        File with the parameters, instead of parameters to calibrate.
    dakota : path, optional
        Input file of Dakota's pattern search, for search and parameters.
    angle_scale : float
        Weight of angles in the error, per radian.
    option : tuple of str
        Option of the optimiser; may be repeated.
    sample : int, optional
        Number of experiments in a random sample, spread over their conditions.
    **options
        Options of `calibrate`.

    Raises
    ------
    NotStored
        There is no such experiment.
    InvalidInput
        No experiment matches, or the options do not fit together.
    """
    request = CALIBRATE.asked(locals())
    from fixel.workflows.calibration.execution import plan_in_project, run_plan

    asked = {**options, **CALIBRATE.arguments(request), "store": project}
    return run_plan(plan_in_project(project, request), SimpleNamespace(**asked))


def _inputs(project: Project, request: BaseModel) -> dict[str, bytes]:
    from fixel.workflows.calibration.execution import plan_in_project

    return plan_in_project(project, request).inputs


def _rounds(*place: Any, **options: Any) -> Iterator[Any]:
    from fixel.workflows.calibration.stored import stored_rounds

    return stored_rounds(*place, **options)


CALIBRATE: Final = Capability(
    name="calibrate",
    function=calibrate_in_project,
    of=calibrate,
    leave_out=("experiments", "parameters", "start", "store"),
    rounds=_rounds,
    inputs=_inputs,
    on_table=True,
)
