"""Sample the posterior of experiments' parameters, and predict paths and final poses."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import CalibrationId, Door, Fit, Motion, NoiseOption, Seed, Threads

if TYPE_CHECKING:
    from fixel.calibration.usual_parameters import Space
    from fixel.database.project import Project
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.uncertainty.error_terms import ModelError
    from fixel.uncertainty.posterior import Posterior
    from fixel.workflows.calibration.calibration import Calibration
    from fixel.workflows.uncertainty.sampling import Uncertainty

ModelErrorOption = Annotated["bool | ModelError", Door(plain=bool)]


def posterior(
    experiments: Experiment | Iterable[Experiment],
    parameters: Space | Calibration = None,
    *,
    noise: NoiseOption = None,
    model_error: ModelErrorOption = True,
    samples: Annotated[int, Door(least=10, most=1_000_000)] = 1000,
    motion: Motion = None,
    seed: Seed = 0,
    threads: Threads = None,
    progress: ProgressOption = None,
) -> Posterior:
    """Sample the probability distribution of parameters given experiments.

    Parameters
    ----------
    experiments : Experiment or sequence of Experiment
        Measured pushes, each with a scene.
    parameters : mapping, sequence of str, Calibration or None
        Parameters to infer, in SI units, as for `fixel.calibrate`. Priors are uniform within the
        bounds, or normal where a `Parameter` has a prior. A calibration gives its parameters with
        their bounds, its motion model and its stated noise. By default the usual parameters.
    noise : Noise, optional
        Standard deviations of measured poses; by default those stated for the calibration, else
        estimated.
    model_error : bool or ModelError
        Whether to include the error of the model itself, with a standard deviation that is
        inferred as the last unknown, `"model_error"` [m]. Without it, intervals are too narrow
        wherever the model is wrong.
    samples : int
        Number of effective samples, at least 10 and at most one million.
    motion : AbstractMotionModel or str, optional
        `"dynamic"`, `"quasistatic"`, `"first-order"`, or another engine; by default that of the
        calibration, else dynamic.
    seed : int
        Seed of the random numbers.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    Posterior
        Samples of equal weight, quantiles, separate modes, and the evidence.

    Raises
    ------
    InvalidInput
        An experiment cannot be compared with a simulation, or a parameter is not known or informed
        by no experiment.
    MissingExtra
        dynesty is not installed.

    References
    ----------
    :cite:t:`skilling2006`; :cite:t:`speagle2020`; :cite:t:`kennedy2001`.

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(1, duration=0.3)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> found = posterior(pushes, space, model_error=False, samples=20, progress=False)
    >>> low, median, high = found.quantiles()[:, 0]
    >>> bool(low < 0.25 < high)
    True
    """
    from fixel.calibration.objective import Comparer
    from fixel.calibration.target import targets_of
    from fixel.calibration.usual_parameters import search_space
    from fixel.model import Experiment
    from fixel.simulation.motion import motion_model
    from fixel.trust import permit
    from fixel.workflows.calibration.calibration import Calibration
    from fixel.workflows.uncertainty.sampling import sample

    permit(motion)
    targets = targets_of([experiments] if isinstance(experiments, Experiment) else experiments)
    if isinstance(parameters, Calibration):
        begun = parameters.space.started_at(parameters.found.point)
        space, stated = begun.under([own.conditions for own in targets]), parameters.noise
        motion = parameters.motion if motion is None else motion
    else:
        space, stated = search_space(parameters, targets), None
    comparer = Comparer(targets, space, motion=motion_model(motion), threads=threads)
    return sample(comparer, len(targets), stated, noise, model_error, samples, seed, progress)[0]


def uncertainty(
    project: Project,
    experiments: Annotated[tuple[str, ...], Door(metavar="[EXPERIMENT]...")] = (),
    *,
    calibration: CalibrationId = None,
    fit: Fit = (),
    held_out: Annotated[tuple[str, ...], Door(metavar="NAME")] = (),
    progress: ProgressOption = None,
    **options: Any,
) -> Uncertainty:
    """Compute a posterior and predict the end of a repeated push.

    Priors are uniform within the bounds of the parameters.

    Parameters
    ----------
    experiments : tuple of str
        Ids or names of experiments; by default those of the calibration.
    calibration : int, optional
        Stored calibration whose parameters, motion model, stated noise and experiments are used.
    fit : tuple of str
        Parameter to infer, in SI units or with the suffix _mm, _deg or _mrad; may be repeated.
    held_out : tuple of str
        Experiment that is only predicted; may be repeated.
    **options
        Options of `posterior`.
    """
    asked = UNCERTAINTY.asked(locals())
    from fixel.workflows.calibration.stored import request_in
    from fixel.workflows.uncertainty.sampling import sample, selected, with_predictions

    own = selected(project, asked)
    options.pop("motion", None)
    one = own.calibration and own.calibration.record
    stated = request_in(one).noise if one and one.request else None
    found, point = sample(own.comparer, own.n_used, stated, progress=progress, **options)
    return with_predictions(own, found, options["samples"], point)


UNCERTAINTY: Final = Capability(
    name="uncertainty",
    function=uncertainty,
    of=posterior,
    leave_out=("experiments", "parameters", "threads"),
    on_table=True,
)
