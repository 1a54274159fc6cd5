"""Compare an experiment of a project with a simulation, and report the comparison."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

from fixel.capability.capability import Capability
from fixel.capability.options import CalibrationId, Door, Motion, Save, Values
from fixel.errors import InvalidInput
from fixel.table import Column, Table

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.database.store import Store
    from fixel.model import Experiment
    from fixel.progress import ProgressOption
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer
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
    parameters: Values = None,
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


# --- report -------------------------------------------------------------------------------------


def report_of(found: StoredComparison) -> AnalysisReport:
    """Return headline, tables and numbers of a comparison."""
    from fixel.workflows.analysis import Analysis, AnalysisReport
    from fixel.workflows.sentences import origin_of

    run, experiment = found.run, found.experiment
    notes = [] if found.simulation_id is None else [f"stored as simulation {found.simulation_id}"]
    return AnalysisReport(
        Analysis(
            kind="compare",
            title=f"Comparison of {experiment.key} with a simulation",
            question={"experiment": experiment.key},
            headline=(origin_of(experiment), *_status(run), *_modes("", run),
                      *_modes("by the publisher, ", found.published)),
            warnings=tuple(f"Unseen: {text}" for text in found.unseen),
            tables=tuple(table for table in _tables(found) if table.rows),
            notes=tuple(notes),
            numbers=_numbers(found),
            calibrations=() if found.calibration is None else (found.calibration,),
            experiments=(found.experiment_id,),
            seconds=0.0 if run is None else run.simulation.wall_time_s,
        )
    )  # fmt: skip


def draw(found: StoredComparison, path: Path) -> None:
    """Draw measured and simulated motion into a file."""
    from fixel.drawing.chart import save_figure
    from fixel.drawing.experiment import comparison_figure

    shown = found.run or found.published
    assert shown is not None  # one of them was compared
    pair = shown.simulated, shown.contacts
    save_figure(lambda: comparison_figure(found.experiment, *pair), path)


def failed(found: StoredComparison) -> bool:
    """Whether the simulation stopped before the end of the measurement."""
    return found.run is not None and not found.run.complete


def next_words(done: StoredAnswer) -> list[str]:
    """Return the words of the command that most users need next."""
    found: StoredComparison = done.result
    if not done.drawn:
        return [*done.again, "--plot", f"{found.experiment.name.replace('/', '-')}.png"]
    if found.run is None:
        return ["show", found.experiment.key]
    if found.simulation_id is None:
        return [*done.again, "--save"]
    return ["compare", found.experiment.key, "--set", "mu_pusher=0.2"]


def _numbers(found: StoredComparison) -> dict[str, Any]:
    own: dict[str, Any] = {"experiment": found.experiment.key}
    if found.run is not None:
        own = {"unseen": list(found.unseen)} | found.run.summary()
        own |= {"simulation_id": found.simulation_id}
    by_publisher = {} if found.published is None else {"by_publisher": found.published.errors()}
    return own | {"experiment_id": found.experiment_id} | by_publisher


def _status(run: RunComparison | None) -> list[str]:
    if run is None:
        return ["no scene, so fixel cannot simulate it"]
    first, last = run.time[0], run.time[-1]
    if run.complete:
        return [f"{run.status}; {len(run.time)} frames from {first:.4g} to {last:.4g} s"]
    stopped = run.simulation.stopped_at
    return [
        f"{run.status}, stopped at {stopped:.6g} s: no error can be computed",
        run.simulation.advice,
    ]


def _modes(by: str, run: PathComparison | None) -> list[str]:
    if run is None or not run.contact_mode:
        return []
    measured = run.experiment.contact_mode or "not known"
    verdict = {True: ", the same", False: ", different", None: ""}[run.same_contact_mode]
    what = "measured" if run.experiment.real else "recorded"
    return [f"{by}contact mode, {what} {measured}, simulated {run.contact_mode}{verdict}"]


def _tables(found: StoredComparison) -> Iterator[Table]:
    values = {} if found.run is None else found.run.parameters
    yield Table(("parameter", Column("value", format=".6g")), list(values.items()))
    unit, metre = found.experiment.length_unit
    every = {"fixel": found.run, "the publisher of the data": found.published}
    shown = [(name, run) for name, run in every.items() if run is not None and run.complete]
    rows = [
        (
            name,
            *(None if x is None else x / metre for x in (run.position_rms, run.final_position)),
            None if run.final_angle is None else degrees(run.final_angle),
            # The thesis's E weighs angles for objects of its own size.
            *([run.error_mm2] if unit == "mm" else []),
        )
        for name, run in shown
    ]
    lengths = (Column(f"position, {which}", unit, ".3f") for which in ("rms", "at end"))
    weighed = [Column("E, 35 mm/rad", "mm^2", ".3f")] if unit == "mm" else []
    columns: tuple[Column | str, ...]
    columns = ("simulation by", *lengths, Column("angle, at end", "deg", ".3f"), *weighed)
    yield Table(columns, rows)
