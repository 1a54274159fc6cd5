"""Map where a calibrated simulator can be trusted: experiments in memory, or of a project."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability import options as usual
from fixel.capability.capability import Capability
from fixel.capability.options import Door

if TYPE_CHECKING:
    from fixel.calibration.usual_parameters import Space
    from fixel.database.project import Project
    from fixel.domain.domain import DomainMap
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.simulation.motion import AbstractMotionModel
    from fixel.workflows.calibration.calibration import Calibration
    from fixel.workflows.domain.mapping import DomainAnswer

AxisValues = Annotated[
    Mapping[str, str | float] | None, Door(metavar="AXIS=VALUE[,AXIS=VALUE]", commas=True)
]
Widths = Annotated[
    Mapping[str, float] | None, Door(metavar="AXIS=WIDTH", commas=True, above=0.0, also=("--step",))
]
Facets = Annotated[
    Sequence[str], Door(plain=tuple[str, ...], metavar="NAME[,NAME]", commas=True, also=("--by",))
]


def map_domain(
    experiments: Iterable[Experiment],
    fit: Calibration | Space = None,
    *,
    threshold: Annotated[float | None, Door(unit="mm", above=0.0)] = None,
    relative: Annotated[float | None, Door(metavar="SHARE", above=0.0)] = None,
    level: usual.Level = 0.9,
    confidence: Annotated[float, Door(above=0.5, below=1.0)] = 0.95,
    axes: usual.Names = (),
    facets: Facets = (),
    leave_out: Annotated[str, Door(metavar="CONDITION")] = "",
    nominal: AxisValues = None,
    cells: Widths = None,
    folds: Annotated[int | None, Door(least=2)] = None,
    motion: AbstractMotionModel | str | None = None,
    seed: usual.Seed = 0,
    threads: usual.Threads = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> DomainMap:
    """Map the experiments for which one set of parameters can be trusted.

    The parameters are calibrated again without each fold of the experiments, so experiments that
    the fit has used may be given.

    Parameters
    ----------
    experiments : sequence of Experiment
        Experiments of one kind, six at least, each with a scene.
    fit : Calibration, mapping, sequence of str or None
        Calibration whose parameters and motion model are used, or parameters as for
        `fixel.calibrate`; by default the usual parameters of the scenes.
    threshold : float, optional
        Root mean square error that must not be exceeded [m], angles at 35 mm per radian; by default
        twice the median of the held-out errors.
    relative : float, optional
        Relative threshold: how much larger the squared error may be than with parameters fitted to
        the experiment itself, as a share of that error.
    level : float
        Share of new experiments that have to stay within the threshold.
    confidence : float
        Probability from which a cell is called trusted, or not trusted.
    axes : sequence of str
        Conditions that the map goes over; also `"contact_angle_rad"`, `"push_angle_rad"` and
        `"travel_m"`, which are computed from the scenes. By default the conditions that vary.
    facets : sequence of str
        Conditions with a map for each of their values.
    leave_out : str
        Condition whose values are held out as a whole, instead of random folds.
    nominal : mapping of str to str or float, optional
        Coordinates from which the domain of applicability grows [SI].
    cells : mapping of str to float, optional
        Widths of the cells along axes [SI].
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
        fits is refused there, with the difference; one with another threshold, axes or
        facets is not.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    DomainMap
        `.at(scene)` returns the verdict on a push; `.held_out`, `.next_experiment`, `.plot()`.

    Raises
    ------
    InvalidInput
        There are too few experiments, a threshold lies below the measurement noise, or an axis is
        no condition of the experiments, or the folder `store` belongs to another call.

    Notes
    -----
    There is no `workers=`: the fits of the folds follow one another, each on all `threads`.

    References
    ----------
    :cite:t:`rpi2011`; :cite:t:`rasmussen2006`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(6, duration=0.2)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> trust = map_domain(pushes, space, axes=["side"], threshold=2e-3, folds=2, progress=False)
    >>> trust.at(pushes[0]).nearby
    3
    >>> trust.at(pushes[0].scene, side="left").probability
    1.00 (0.29 to 1.00, n = 3)
    """
    asked = DOMAIN.asked({**locals(), "fit": ()})
    from fixel.calibration.target import targets_of
    from fixel.workflows.domain.evidence import apart_of, calibration_model, fit_store
    from fixel.workflows.domain.mapping import check, claim_of, map_targets

    targets = targets_of(experiments)
    model = calibration_model(fit, targets, motion)
    claim_of(asked, 1.0)  # refused before any fit
    check(targets, asked)
    finished = fit_store(store, targets, model, apart_of(targets, asked))
    return replace(
        map_targets(targets, model, asked, finished, progress), question=DOMAIN.question(asked)
    )


def map_stored(
    project: Project,
    *,
    calibration: usual.CalibrationId = None,
    fit: usual.Fit = (),
    engine: usual.EngineName = "",
    apart: usual.Names = (),
    dataset: usual.Dataset = "",
    where: usual.Where = (),
    flagged: usual.Flagged = False,
    progress: ProgressOption = None,
    **options: Any,
) -> DomainAnswer:
    """Map where one parameter set predicts held-out experiments.

    Fits are stored, so other axes, thresholds and nominals need no new fits.

    Parameters
    ----------
    calibration : int, optional
        Stored calibration to start from; by default the newest for several experiments.
    fit : sequence of str
        Parameter to calibrate, instead of those of the calibration; may be repeated.
    engine : str
        Use the newest calibration by this engine, such as mujoco.
    apart : sequence of str
        Conditions with a parameter set for each of their values, such as surface,shape.
    **options
        Options of `fixel.map_domain`.
    """
    asked = DOMAIN.asked(locals())
    from fixel.progress import show_progress
    from fixel.workflows.domain.evidence import gather
    from fixel.workflows.domain.mapping import DomainAnswer, claim_of, map_of

    claim_of(asked, 1.0)  # refused before any fit
    with show_progress(progress, "holding out") as report:
        gathered = gather(project, asked, report)
    return DomainAnswer(asked, gathered, *map_of(gathered, asked))


DOMAIN: Final = Capability(
    name="domain",
    function=map_stored,
    of=map_domain,
    leave_out=("experiments", "motion", "store"),
    on_table=True,
)
