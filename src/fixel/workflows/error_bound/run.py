"""Bound the errors of untried pushes: experiments in memory, or of a project."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability import options as usual
from fixel.capability.capability import Capability
from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.calibration.usual_parameters import Space
    from fixel.database.project import Project
    from fixel.domain.push_bound import ErrorBound
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.simulation.motion import AbstractMotionModel
    from fixel.workflows.calibration.calibration import Calibration
    from fixel.workflows.error_bound.report import BoundAnswer

LeftOut = Annotated[
    str | Sequence[str], Door(plain=tuple[str, ...], metavar="CONDITION[,CONDITION]", commas=True)
]


def error_bound(
    experiments: Iterable[Experiment],
    fit: Calibration | Space = None,
    *,
    level: usual.Level = 0.9,
    groups: usual.Names = (),
    leave_out: LeftOut = (),
    folds: Annotated[int | None, Door(least=2)] = None,
    motion: AbstractMotionModel | str | None = None,
    seed: usual.Seed = 0,
    threads: usual.Threads = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> ErrorBound:
    """Bound the error of the calibrated simulator in new pushes, with a stated probability.

    The parameters are calibrated again without each fold of the experiments, so experiments that
    the fit has used may be given.

    Parameters
    ----------
    experiments : sequence of Experiment
        Experiments like the new pushes, each with a scene: 9 at least for a level of 90 %.
    fit : Calibration, mapping, sequence of str or None
        Calibration whose parameters and motion model are used, or parameters as for
        `fixel.calibrate`; by default the usual parameters of the scenes.
    level : float
        Probability with which each bound holds.
    groups : sequence of str
        Conditions such as `"surface"`; bounds then hold for each of their values that has enough
        experiments.
    leave_out : str or sequence of str
        Conditions whose values are left out as a whole, each in fits of its own, such as
        `"shape"`; also `"dataset"`, `"side"` and `"speed"`. Pushes with a new value then have two
        bounds, a typical and a cautious one; without it they have none.
    folds : int, optional
        Number of folds; 5 by default, 2 for more than 2000 experiments.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration, else `Dynamic()`.
    seed : int
        Seed of the folds.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder for finished fits, so that an interrupted call continues. A call that needs other
        fits is refused there, with the difference; one with another level or groups is
        not.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    ErrorBound
        `.at(scene)` returns the bounds of a push; ``.coverage`` is the measured coverage.

    Raises
    ------
    InvalidInput
        There are too few different experiments for the level, an experiment lacks a condition, a
        condition to leave out has a single value, or the folder `store` belongs to another call.

    Notes
    -----
    There is no `workers=`: the fits of the folds follow one another, each on all `threads`.

    References
    ----------
    :cite:t:`vovk2005`; :cite:t:`barber2021`; :cite:t:`dunn2022`; :cite:t:`lee2023`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(10, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> bound = error_bound(pushes, space, folds=2, progress=False)
    >>> bound.at(pushes[0].scene).verdict
    'bounded'
    >>> bool(bound.at(pushes[0].scene).position < 1e-3)
    True
    """
    left_out = [leave_out] * bool(leave_out) if isinstance(leave_out, str) else leave_out
    asked = ERROR_BOUND.asked({**locals(), "fit": (), "leave_out": left_out})
    from fixel.calibration.target import targets_of
    from fixel.progress import show_progress
    from fixel.workflows.domain.fits import calibration_model
    from fixel.workflows.error_bound.report import bound_of

    targets = targets_of(experiments)
    model = calibration_model(fit, targets, motion)
    with show_progress(progress, "holding out") as report:
        return bound_of(targets, model, asked, store, report)


def bound_stored(
    project: Project,
    *,
    calibration: usual.CalibrationId = None,
    fit: usual.Fit = (),
    engine: usual.EngineName = "",
    dataset: usual.Dataset = "",
    where: usual.Where = (),
    flagged: usual.Flagged = False,
    progress: ProgressOption = None,
    **options: Any,
) -> BoundAnswer:
    """Bound the errors of untried pushes, with a stated probability.

    The parameters are calibrated again without each fold of the experiments. Fits are stored.

    Parameters
    ----------
    calibration : int, optional
        Stored calibration to start from; by default the newest for several experiments.
    fit : sequence of str
        Parameter to calibrate, instead of those of the calibration; may be repeated.
    engine : str
        Use the newest calibration by this engine, such as mujoco.
    **options
        Options of `fixel.error_bound`.

    Raises
    ------
    InvalidInput
        There are too few different experiments for the level, an experiment lacks a condition, or a
        condition to leave out has a single value.
    """
    from fixel.progress import show_progress
    from fixel.workflows.error_bound.report import bound_experiments

    asked = ERROR_BOUND.asked(locals())
    with show_progress(progress, "holding out") as report:
        return bound_experiments(project, asked, report)


ERROR_BOUND: Final = Capability(
    name="error-bound",
    title="Error bounds",
    function=bound_stored,
    of=error_bound,
    leave_out=("experiments", "motion", "store"),
    on_table=True,
)
