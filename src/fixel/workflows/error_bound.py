"""Bound the errors of untried pushes, from experiments in memory or of a project; the report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

from fixel.capability import options as usual
from fixel.capability.capability import Capability
from fixel.capability.options import Door
from fixel.errors import counted

if TYPE_CHECKING:
    from fixel.calibration.usual_parameters import Space
    from fixel.database.project import Project
    from fixel.domain.held_out import CalibrationModel
    from fixel.domain.push_bound import ErrorBound, FinishedFits
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.simulation.motion import AbstractMotionModel
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer
    from fixel.workflows.calibration.calibration import Calibration

JSON: Final = ("folder", "pictures")  # what `--json` has besides numbers
LeftOut = Annotated[
    str | Sequence[str], Door(plain=tuple[str, ...], metavar="CONDITION[,CONDITION]", commas=True)
]


class BoundAnswer(NamedTuple):
    """Error bounds of experiments of a project."""

    bound: ErrorBound
    experiments: list[int]  # ids
    calibration: int | None  # calibration at which the fits started
    left_out: dict[str, str]  # reason why an experiment cannot be compared, by its name
    is_real: bool


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
    from fixel.domain.push_bound import bound_of
    from fixel.progress import show_progress
    from fixel.workflows.domain.evidence import calibration_model

    targets = targets_of(experiments)
    model = calibration_model(fit, targets, motion)
    with show_progress(progress, "holding out") as report:
        return bound_of(targets, model, asked, _fits(store, model), report)


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
    """
    asked = ERROR_BOUND.asked(locals())
    from fixel.database.project import ANALYSES
    from fixel.domain.push_bound import bound_of
    from fixel.progress import show_progress
    from fixel.workflows.calibration.execution import select_experiments
    from fixel.workflows.domain.evidence import FOLDER, ProjectRequest, mark_of, stored_model

    with show_progress(progress, "holding out") as report, project.store() as store:
        of = ProjectRequest(project, store, asked)
        chosen = select_experiments(store, (), of.query)
        started = stored_model(of, chosen.targets)
        folder = project.folder / ANALYSES / FOLDER / f"bound-{mark_of(of, chosen.ids)}"
        fits = _fits(folder, started.model)
        bound = bound_of(chosen.targets, started.model, asked, fits, report)
        real = all(row.is_real for row in store.experiments(of.query).rows)
    return BoundAnswer(bound, chosen.ids, started.calibration, dict(chosen.left_out), real)


def _fits(folder: str | Path | None, model: CalibrationModel) -> FinishedFits:
    """Return the cache of fits in a folder; one that stores nothing without a folder."""
    from fixel.workflows.domain.evidence import fit_store

    return lambda targets, apart, name: fit_store(
        None if folder is None else Path(folder) / name, targets, model, apart
    )


ERROR_BOUND: Final = Capability(
    name="error-bound",
    title="Error bounds",
    function=bound_stored,
    of=error_bound,
    leave_out=("experiments", "motion", "store"),
    on_table=True,
)


def report_of(answer: BoundAnswer) -> AnalysisReport:
    """Return headline, warnings, table, chart and numbers of error bounds."""
    from fixel.drawing.domain import bound_chart
    from fixel.workflows.analysis import Analysis, AnalysisReport, Picture

    bound, n = answer.bound, len(answer.left_out)
    summary = bound._summary()
    medians = [f"{row[2]:.2g}" for row in summary.tables[0].rows]
    why = next(iter(answer.left_out.values()), "")
    caption = "Held-out errors of end positions against their bounds; those below the line hold."
    banner = "" if answer.is_real else "SIMULATED"
    return AnalysisReport(
        Analysis(
            kind="error-bound",
            title="Error bounds of untried pushes",
            question={},
            headline=(
                f"The errors of {100.0 * bound.level:g} % of new pushes stay within their bounds,"
                f" at the median {medians[0]} mm and {medians[1]} deg ({len(bound.keys)}"
                " experiments, held out).",
            ),
            warnings=(f"{counted(n, 'experiment')} cannot be compared: {why}",) if n else (),
            tables=tuple(summary.tables),
            notes=tuple(summary.notes),
            references=("vovk2005", "barber2021", "dunn2022", "lee2023"),
            numbers={
                "level": bound.level,
                "coverage": {name: [*share] for name, share in bound.coverage.items()},
                "experiments": bound.to_dict(),
            },
            calibrations=() if answer.calibration is None else (answer.calibration,),
            experiments=tuple(answer.experiments),
        ),
        [Picture("bounds", bound_chart(bound), banner, caption)],
    )


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    return ["report"] if done.drawn else [*done.again, "--plot", "bounds"]
