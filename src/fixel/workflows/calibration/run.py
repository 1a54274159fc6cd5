"""Calibrate experiments: `calibrate`, `calibrate_each` and `calibrate_campaign`."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self, TypedDict, Unpack, final

import numpy as np

from fixel.calibration.noise import Noise
from fixel.calibration.objective import AbstractError, Comparer, EndPose
from fixel.calibration.optimiser import AbstractOptimiser
from fixel.calibration.study import at_points, run_study
from fixel.calibration.target import Target, target_of
from fixel.calibration.usual_parameters import Space, search_space
from fixel.errors import Interrupted, InvalidInput
from fixel.jobs.work import (
    AbstractEngine,
    Batch,
    Chunk,
    JobProgress,
    Show,
    answer_of,
    run_work,
)
from fixel.model import Experiment
from fixel.model.space import ParameterSpace
from fixel.progress import Progress, ProgressOption, Reporter, show_progress
from fixel.simulation.motion import AbstractMotionModel
from fixel.workflows.calibration.calibration import Calibration, Calibrations
from fixel.workflows.calibration.job import (
    CHUNKS,
    SearchState,
    calibration_rounds,
    comparer_of,
    evaluate_here,
)
from fixel.workflows.calibration.request import (
    CalibrationRequest,
    Combine,
    Mode,
    NamedOptions,
    usual_optimiser,
)
from fixel.workflows.calibration.result import (
    CalibrationResult,
    FitKind,
    ParameterSet,
    outcome_of,
)

if TYPE_CHECKING:
    from os import PathLike

    from fixel.database.project import Project
    from fixel.jobs.site import Site

PREFLIGHT: Final = 16  # experiments that are simulated before any work starts
_BEST: Final = re.compile(r", best RMS (\S+) mm")

Named = Mapping[str, Any] | str


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
        A search ends with a whole batch, so it may exceed the number.
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
    points = stored_points(project, search_space(parameters, _targets(experiments)))
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
    plan = CalibrationPlan.of(mode, experiments, parameters, **options)
    plan.rehearse(threads)
    if store is not None or workers or site is not None:
        from fixel.workflows.calibration.stored_run import run_stored

        return run_stored(
            plan,
            store,
            threads=threads,
            workers=None if site is not None and not workers else workers,
            site=site,
            progress=progress,
        )
    comparer = comparer_of(plan.request, plan.targets, threads)
    state = SearchState(plan.request)
    work = calibration_rounds(plan.request, comparer, state)
    with show_progress(progress, "searching") as report:
        try:
            engine = DirectEngine(plan.request, comparer)
            result = run_work(work, engine, Path(), None, progress=reporting(report))
        except KeyboardInterrupt:
            hint = "with store='FOLDER' the same call would continue"
            raise Interrupted(best_so_far(plan, comparer, state), hint) from None
    return plan.result(outcome_of(result))


@final
@dataclass(frozen=True, kw_only=True)
class CalibrationPlan:
    """Calibration that has not been run yet: its request and its experiments.

    Parameters
    ----------
    request : CalibrationRequest
    targets : sequence of Target
    source : str
        Python expression of the experiments.
    command : str
        Shell command that was typed, if any.
    left_out : mapping from name to reason
        Experiments that were skipped.
    """

    request: CalibrationRequest
    targets: Sequence[Target]
    source: str = "experiments"
    command: str = ""
    left_out: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls,
        mode: Mode,
        experiments: Iterable[Experiment | Target],
        parameters: Space = None,
        *,
        error: Named | AbstractError = "mean-square",
        combine: Combine = "sum",
        optimiser: Named | AbstractOptimiser = "auto",
        start: Mapping[str, float] | None = None,
        noise: Noise | None = None,
        motion: str | AbstractMotionModel = "dynamic",
        **others: Any,
    ) -> Self:
        """Return the plan for arguments of `calibrate`, checked."""
        targets = _targets(experiments)
        space = search_space(parameters, targets, start)
        kind = _named(error, "error")
        search = _named(optimiser, "optimiser")
        if search.name == "auto":
            usual = usual_search(mode, combine, kind.name, targets, space)
            search = search.model_copy(update={"name": usual})
        request = CalibrationRequest(
            mode=mode,
            unknowns=list(space.unknowns),
            error=kind,
            combine=combine,
            optimiser=search,
            noise_position=None if noise is None else noise.position_m,
            noise_angle=None if noise is None else noise.angle_rad,
            motion=motion if isinstance(motion, str) else motion.name,
            sample_of=getattr(experiments, "sample_of", None),
            **others,
        )
        request.check()
        return cls(
            request=request,
            targets=targets,
            source=str(getattr(experiments, "call", "experiments")),
            command=str(getattr(experiments, "command", "")),
            left_out=getattr(experiments, "left_out", {}),
        )

    def rehearse(self, threads: int | None = None) -> None:
        """Simulate a few experiments, to refuse now what cannot be simulated at all."""
        spread = np.unique(np.linspace(0, len(self.targets) - 1, PREFLIGHT).astype(int))
        few = [self.targets[k] for k in spread.tolist()]
        comparer = comparer_of(self.request, self.targets, threads)
        start = np.repeat(self.request.space.nominal[None], len(few), axis=0)
        answer = comparer.errors(spread, start)
        if np.isinf(answer.error).all():
            raise InvalidInput(
                "start",
                found=f"values with which nothing can be simulated: {answer.reasons[0]}",
                expected="values with which an experiment can be simulated",
                hint="choose another start or other bounds",
            )

    def result(self, outcome: CalibrationResult, **more: Any) -> Calibrations:
        """Return the calibrations for the numbers that were found."""
        return Calibrations(
            request=self.request,
            outcome=outcome,
            targets=tuple(self.targets),
            source=self.source,
            command=self.command,
            left_out=self.left_out,
            **more,
        )


class DirectEngine(AbstractEngine):
    """Engine that computes the chunks of one calibration in this process, without files."""

    workers = 1

    def __init__(self, request: CalibrationRequest, comparer: Comparer) -> None:
        self._own = request, comparer

    def results(self, function: str, inputs: Path, chunks: Sequence[Chunk]) -> Iterator[Batch]:
        call = CHUNKS[function]
        for chunk in chunks:
            yield [(chunk.name, answer_of(call, *self._own, chunk.payload))]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def best_so_far(
    plan: CalibrationPlan, comparer: Comparer, state: SearchState
) -> Calibration | None:
    """Return the best parameter set of an interrupted calibration; None if there is none yet."""
    found = list(state.found)
    members = tuple(range(len(plan.targets)))
    here = evaluate_here(comparer)
    if not found and math.isfinite(state.best.error):
        point = state.best.point
        errors, _ = run_study(at_points(members, point[None]), here)
        found.append(
            ParameterSet(
                how=FitKind.DIRECT,
                members=members,
                point=point,
                errors=errors[0],
                trace=state.trace,
            )
        )
    if not found:
        return None
    nominal, _ = run_study(at_points(members, comparer.space.nominal[None]), here)
    outcome = CalibrationResult(
        keys=tuple(target.key for target in plan.targets),
        labels=comparer.space.labels,
        nominal=nominal[0],
        found=tuple(found),
    )
    return plan.result(outcome, interrupted=True)[-1]


def reporting(report: Reporter) -> Show:
    """Return a callback that reports the progress of rounds."""

    def show(progress: JobProgress) -> None:
        best = _BEST.search(progress.note)
        report.show(
            Progress(
                stage=_BEST.sub("", progress.note) or report.stage,
                done=progress.done,
                total=None if progress.share is None else progress.total,
                best=None if best is None else 1e-3 * float(best[1]),
                left=progress.left_s,
            )
        )

    return show


def usual_search(
    mode: Mode, combine: str, error: str, targets: Sequence[Target], space: ParameterSpace
) -> str:
    """Return the name of the search that suits a calibration best."""
    ends = error == EndPose.name
    frames = sum(1 if ends else len(target.pose) for target in targets)
    several = mode if len(targets) > 1 else "each"
    return usual_optimiser(several, combine, error, 3 * frames, len(space.free))


def _targets(experiments: Iterable[Experiment | Target]) -> list[Target]:
    """Return what simulations are compared with."""
    found = [own if isinstance(own, Target) else target_of(own) for own in experiments]
    if not found:
        raise InvalidInput("experiments", found="none", expected="one or more with a scene")
    return found


def _named(choice: Any, where: str) -> NamedOptions:
    """Return a method by name with its options, from a name, a mapping or the object itself."""
    if isinstance(choice, NamedOptions):
        return choice
    if isinstance(choice, str):
        return NamedOptions(name=choice)
    if isinstance(choice, Mapping) and "name" in choice:
        options = {key: value for key, value in choice.items() if key != "name"}
        return NamedOptions(name=str(choice["name"]), options=options)
    if isinstance(choice, AbstractError | AbstractOptimiser):
        names = [own.name for own in dataclasses.fields(choice)]  # type: ignore[arg-type]
        options = {name: getattr(choice, name) for name in names}
        return NamedOptions(name=choice.name, options=options)
    raise InvalidInput(where, found=choice, expected="a name, or a mapping with a name and options")
