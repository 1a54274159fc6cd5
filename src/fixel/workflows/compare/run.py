"""Compare an experiment of a project with a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

from fixel.capability.capability import Capability
from fixel.capability.options import Door
from fixel.capability.usual import CalibrationId, Motion, Save
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.database.store import Store
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.workflows.project.compare import PathComparison, RunComparison


class StoredComparison(NamedTuple):
    """Experiment of a project, compared with simulations."""

    experiment_id: int
    experiment: Experiment
    run: RunComparison | None  # simulation by fixel; None for an experiment without a scene
    # Simulation by the publisher of the experiment, if one is stored.
    published: PathComparison | None
    unseen: tuple[str, ...] = ()  # what no experiment of the calibration has
    calibration: int | None = None  # id of the calibration whose parameters were used
    simulation_id: int | None = None  # id of the stored simulation


def compare_stored(
    project: Project,
    experiment: Annotated[str, Door(metavar="EXPERIMENT")],
    *,
    parameters: Annotated[
        Mapping[str, float] | None, Door(flag="--set", metavar="NAME=NUMBER")
    ] = None,
    calibration: CalibrationId = None,
    motion: Motion = None,
    save: Save = False,
    progress: ProgressOption = None,
) -> StoredComparison:
    """Simulate an experiment and compare it with its measurement.

    Parameters
    ----------
    experiment : str
        Experiment: its id, its name, or DATASET/NAME.
    parameters : mapping of str to float, optional
        Value of a parameter, such as mu_pusher=0.2, or of a key of the scene, such as
        bodies.0.mass=0.2; may be repeated.
    calibration : int, optional
        Id of a stored calibration, whose parameters and motion model are used; other options
        override them.
    motion : str, optional
        Motion model: dynamic (default), quasistatic or first-order; or another engine: mujoco,
        drake, pymunk, box2d, or the path of a program, with choices as in mujoco:step=0.001.
    save : bool
        Whether to store the simulation.

    Raises
    ------
    NotStored
        There is no such experiment or calibration.
    InvalidInput
        The experiment has no scene or no motion to compare with, or a parameter changes nothing.
    """
    call = locals()
    from fixel.calibration.target import target_of
    from fixel.formats import scene_file
    from fixel.model import Parameters
    from fixel.simulation.motion import motion_model
    from fixel.simulation.simulate import get_ready
    from fixel.workflows.calibration.stored import known_pushes, load_values
    from fixel.workflows.project.compare import RunComparison
    from fixel.workflows.project.comparison import compare

    request = COMPARE.asked(call)
    with project.store() as store:
        number = store.find(experiment)
        own = store.experiment(number)
        published = _published(store, number, own)
        if own.scene is None and published is not None and not save:
            return StoredComparison(number, own, None, published)
        model = motion_model(motion) if motion else None
        keys, given = scene_file.split_settings(f"{k}={v!r}" for k, v in (parameters or {}).items())
        if save and (keys or project.view):
            expected = "parameters alone, since a stored simulation is of the stored scene"
            found = f"another scene ({keys[0] if keys else 'on a mapped table'})"
            raise InvalidInput("save", found=found, expected=expected)
        if keys and own.scene is not None:
            content = scene_file.scene_dict(scene_file.SceneFile(scene=own.scene))
            own = replace(own, scene=scene_file.scene_file_from_dict(content, keys).scene)
        values, unseen = Parameters(given), []
        if calibration is not None:
            fit = load_values(store, calibration)
            values, model = Parameters({**fit.values_for(own), **values}), model or fit.motion
            unseen = list(known_pushes(store, fit).texts(target_of(own)))
        if own.scene is not None:
            get_ready(own.scene)  # compile before the clock runs
        run = compare(own, {"given": values}, motion=model, progress=False).rows[0].run
        assert isinstance(run, RunComparison)
        command = COMPARE.command(request, project.folder)
        stored = store.add_simulation(run.record(number, command)) if save else None
    return StoredComparison(number, own, run, published, tuple(unseen), calibration, stored)


def _published(store: Store, number: int, experiment: Experiment) -> PathComparison | None:
    from fixel.workflows.project.compare import compare_path

    simulation = store.published_simulations().get(number)
    return None if simulation is None else compare_path(experiment, store.simulation(simulation))


COMPARE: Final = Capability(name="compare", function=compare_stored, plot="file", on_table=True)
