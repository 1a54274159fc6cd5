"""Filter an experiment, and one of a project."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, MotionName, Seed

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.filtering.particle_filter import ParticleFilter
    from fixel.filtering.recorded import FilterRun
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.workflows.filtering.report import FilterAnswer


def filter(
    experiment: Experiment,
    priors: Annotated[
        Mapping[str, tuple[float, float] | None] | None,
        Door(flag="--prior", metavar="NAME=LOW:HIGH"),
    ] = None,
    *,
    particles: Annotated[int, Door(least=2, most=1_000_000)] = 125,
    occlusion: Annotated[
        tuple[float, float] | None, Door(flag="--occlude", metavar="FROM:TO")
    ] = None,
    tactile: bool = True,
    motion: MotionName = None,
    options: ParticleFilter | None = None,
    seed: Seed = 0,
    threads: Annotated[int, Door(least=1, effort=True)] = 1,
    progress: ProgressOption = None,
) -> FilterRun:
    """Estimate pose and parameters during a recorded experiment with a particle filter.

    Parameters
    ----------
    experiment : Experiment
        Experiment with a scene and the measured path of its pusher.
    priors : mapping of str to (float, float) or None, optional
        Uniform priors of parameters [SI], in addition to the usual ones; None leaves a parameter
        at the value of the scene.
    particles : int
        Number of particles, at least 2 and at most one million.
    occlusion : (float, float), optional
        First and last instant at which the object is hidden from the filter [s].
    tactile : bool
        Whether to use the readings of the fixels, if there are any.
    motion : AbstractMotionModel or str, optional
        `"quasistatic"` (default) or `"first-order"`.
    options : ParticleFilter, optional
        All other settings, such as the noise of the camera; `priors`, `particles`, `motion` and
        `threads` are then taken from it.
    seed : int
        Seed of the random numbers.
    threads : int
        Number of threads of the simulation. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    FilterRun
        Pose, parameters and contacts of every frame, with their uncertainty.

    Raises
    ------
    InvalidInput
        There is no scene or no measured path of the pusher, the occlusion lies outside the
        recording, or a prior does not fit the scene.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fixel
    >>> from fixel.model import PlannedExperiment
    >>> from fixel.testbed.simulated import SimulatedTestbed
    >>> from fixel.testing.scenes import grasp
    >>> planned = PlannedExperiment(name="grasp", scene=replace(grasp("seated"), duration=1.0))
    >>> (experiment,) = SimulatedTestbed.ideal(seed=1).run([planned])
    >>> found = fixel.filter(experiment, particles=10, progress=False)
    >>> sorted(found.parameters)
    ['mu_fixel', 'mu_pusher', 'mu_support', 'tripod_radius']
    """
    from fixel.filtering.particle_filter import ParticleFilter, usual_lengths
    from fixel.filtering.recorded import run_filter
    from fixel.model import Experiment
    from fixel.model.fields import instance, whole
    from fixel.progress import show_progress
    from fixel.simulation.motion import motion_model

    instance(experiment, Experiment, "experiment", "an Experiment")
    if options is None:
        whole(particles, "particles", 2)
        own: dict[str, Any] = {} if motion is None else {"motion": motion_model(motion)}
        own |= usual_lengths(experiment.scene)
        options = ParticleFilter(n_particles=particles, priors=priors or {}, threads=threads, **own)
    with show_progress(progress, "filtering") as report:
        return run_filter(
            experiment,
            options,
            occlusion=occlusion,
            use_tactile=tactile,
            seed=seed,
            progress=report,
        )


def filter_stored(
    project: Project,
    experiment: Annotated[str, Door(metavar="EXPERIMENT")],
    *,
    save: Annotated[bool, Door(effort=True)] = True,
    progress: ProgressOption = None,
    **options: Any,
) -> FilterAnswer:
    """Estimate pose and friction with a particle filter.

    Parameters
    ----------
    experiment : str
        Experiment: its id, its name, or DATASET/NAME.
    save : bool
        Whether to store the run.
    **options
        Options of `filter`.
    """
    from fixel.workflows.filtering.report import FilterAnswer, store_run

    asked = FILTER.asked(locals())
    with project.store() as store:
        number = store.find(experiment)
        estimates = filter(store.experiment(number), **options, progress=progress)
        of_it = {
            key: record
            for key, record in store.calibration_summaries().items()
            if number in {member.experiment_id for member in record.members}
        }
    run_id = None
    if save:
        command = FILTER.command(asked, project.folder)
        run_id = store_run(project, estimates, command)
    return FilterAnswer(number, estimates, run_id, of_it)


FILTER: Final = Capability(
    name="filter",
    function=filter_stored,
    of=filter,
    leave_out=("experiment", "options"),
    plot="file",
    on_table=True,
)
