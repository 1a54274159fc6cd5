"""Compare sets of parameters on one experiment, repeatedly while a slider is moved."""

from __future__ import annotations

import shlex
import threading
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import Field

from fixel.calibration.result import CalibratedValues, FitKind
from fixel.calibration.target import scene_of, target_of
from fixel.calibration.usual_parameters import default_unknowns, usual_unknown
from fixel.database.store import Store
from fixel.engine_names import EngineName, motion_words
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.records import CalibrationRecord, SimulationRecord
from fixel.model.selection import ExperimentQuery
from fixel.simulation import simulate
from fixel.simulation.motion import motion_model
from fixel.simulation.simulate import INSTANT, get_ready
from fixel.simulation.stepping import Adaptive
from fixel.web.values import Answer, Finite
from fixel.web.views.motion_views import MotionView, compared_motion, stored_motion
from fixel.workflows.calibration.stored import known_pushes
from fixel.workflows.project.compare import RunComparison, compare_run

DYNAMIC: Final = "dynamic"
ready = threading.Event()  # once the engine is loaded or compiled
MAX_STEPS: Final = 20_000  # of one simulation; those of the thesis take about a hundred
MAX_KEPT: Final = 16  # experiments in memory
MAX_SETS: Final = 40  # that are offered of one kind, the newest first


class ParameterSlider(Answer):
    """A parameter that may be changed."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    nominal: float = Field(description="value in the scene of the experiment")


class StoredSet(Answer):
    """Values that can be selected for comparison."""

    id: str = Field(description="identifier: nominal, calibration-3, simulation-12")
    label: str
    kind: Literal["nominal", "calibration", "simulation"]
    parameters: dict[str, float] = Field(
        description="parameters that replace values of the scene, in SI units"
    )
    motion: str = Field(description="motion model")
    error_mm2: float | None = Field(
        description="mean squared error E of the thesis; null if not computed yet"
    )
    unseen: list[str] = Field(
        default=[],
        description="new part, surface, side or speed, which no experiment of the calibration has",
    )


class ComparedSimulation(Answer):
    """A simulation of the experiment, and how far it is from what was measured."""

    motion: MotionView
    position_rms: Finite = Field(
        serialization_alias="position_rms_m", description="null if the simulation stopped early"
    )
    final_position: Finite = Field(serialization_alias="final_position_m")
    final_angle: Finite = Field(serialization_alias="final_angle_rad")
    error_mm2: Finite = Field(
        description="mean squared error E of the thesis, with angles weighted by 35 mm/rad"
    )
    contact_mode: str = Field(description="contact mode at the end, one digit per fixel")
    measured_contact_mode: str
    command: str = Field(description="command for the same simulation")
    python: str
    wall_time_s: float | None = Field(
        description="wall time of the simulation; null for a stored one"
    )


class NewSimulations(Answer):
    """Result per experiment; those that have such a simulation, or no scene, are in neither."""

    stored: list[int] = Field(description="experiments")
    refused: dict[int, str] = Field(description="reason by experiment that could not be simulated")


class LiveComparison:
    """Experiments in memory, and simulations of them at once; any thread may use it."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._keeping = threading.Lock()
        self.refused: dict[int, str] = {}  # reasons why experiments cannot be simulated
        self.experiment = lru_cache(MAX_KEPT)(store.experiment)  # an experiment never changes
        self.sliders = lru_cache(MAX_KEPT)(self._sliders)
        # Of the sets that a page shows, only the adjusted one changes.
        self.repeated = lru_cache(MAX_KEPT)(self.compared)
        self._known = lru_cache(MAX_SETS)(
            lambda id_: known_pushes(store, CalibratedValues(id_, store.calibration(id_)))
        )

    def _sliders(self, experiment_id: int) -> list[ParameterSlider]:
        """Return every parameter that has a meaning in the experiment's scene, with its usual
        bounds, starting at the scene's own value; those usually calibrated come first."""
        scene = scene_of(self.experiment(experiment_id))
        first = [unknown.name for unknown in default_unknowns([scene])]
        found = []
        for name in dict.fromkeys((*first, *KNOWN_PARAMETERS)):
            try:
                unknown = usual_unknown(name, scene)
                simulate(scene, Parameters({name: unknown.nominal}), duration=INSTANT)
            except InvalidInput:
                continue  # the name has no meaning in this scene
            found.append(
                ParameterSlider(
                    name=name,
                    unit=unknown.unit,
                    meaning=info_of(name).meaning,
                    low=unknown.low,
                    high=unknown.high,
                    nominal=unknown.nominal,
                )
            )
        return found

    def sets(self, experiment_id: int) -> list[StoredSet]:
        """Return the sets for comparison: the scene's own values, those of calibrations, and those
        of stored simulations."""
        experiment = self.experiment(experiment_id)
        scene_of(experiment)
        found = [
            StoredSet(
                id="nominal",
                label="nominal",
                kind="nominal",
                parameters={},
                motion=DYNAMIC,
                error_mm2=None,
            )
        ]
        every = reversed(self._store.calibration_summaries().items())
        known = [one for one in every if one[1].method.get("how") != FitKind.GROWTH]
        known.sort(key=lambda one: all(m.experiment_id != experiment_id for m in one[1].members))
        for id_, record in known[:MAX_SETS]:  # those of this experiment come first
            own = _calibrated_set(id_, record, experiment, experiment_id)
            unseen = list(self._known(id_).texts(target_of(experiment)))
            found.append(own.model_copy(update={"unseen": unseen}))
        for id_ in reversed(self._store.simulations(experiment_id)[-MAX_SETS:]):
            run = self._store.simulation(id_)
            found.append(
                StoredSet(
                    id=f"simulation-{id_}",
                    label=simulation_label(id_, run),
                    kind="simulation",
                    parameters=dict(run.parameters),
                    motion=str(run.method.get("motion", DYNAMIC)),
                    error_mm2=run.error_mm2,
                )
            )
        return found

    def compared(
        self,
        experiment_id: int,
        parameters: Mapping[str, float] | tuple[tuple[str, float], ...],
        motion: str,
        folder: Path,
    ) -> ComparedSimulation:
        """Simulate an experiment of the project in a folder; compare it with the measurement."""
        answer = self._comparison(experiment_id, dict(parameters), motion)
        return ComparedSimulation(
            motion=compared_motion(answer, "simulated", id="simulated"),
            position_rms=answer.position_rms,
            final_position=answer.final_position,
            final_angle=answer.final_angle,
            error_mm2=answer.error_mm2,
            contact_mode=answer.contact_mode,
            wall_time_s=answer.simulation.wall_time_s,
            **_repeated(answer.experiment, folder, answer.parameters, motion),
        )

    def _comparison(
        self, experiment_id: int, parameters: Mapping[str, float], motion: str
    ) -> RunComparison:
        return compare_run(
            self.experiment(experiment_id),
            Parameters(parameters),
            motion_model(_shown(motion)),
            Adaptive(max_steps=MAX_STEPS),
        )

    def stored(self, experiment_id: int, simulation: int, folder: Path) -> ComparedSimulation:
        """Return a stored simulation of an experiment, with the errors stored with it."""
        record = self._record(experiment_id, simulation)
        motion = self.simulated(experiment_id, simulation)
        errors = None if record.error_mm2 is None else motion.errors
        model = str(record.method.get("motion", DYNAMIC))
        return ComparedSimulation(
            motion=motion,
            position_rms=float(np.sqrt(np.mean(errors.position**2))) if errors else None,
            final_position=float(errors.position[-1]) if errors else None,
            final_angle=float(errors.angle[-1]) if errors else None,
            error_mm2=record.error_mm2,
            contact_mode=record.contact_mode,
            wall_time_s=None,
            **_repeated(self.experiment(experiment_id), folder, record.parameters, model),
        )

    def simulated(self, experiment_id: int, simulation: int) -> MotionView:
        """Return the motion of a stored simulation of an experiment."""
        record = self._record(experiment_id, simulation)
        label, name = simulation_label(simulation, record), f"simulation-{simulation}"
        return stored_motion(self.experiment(experiment_id), record, label, id=name)

    def _record(self, experiment_id: int, simulation: int) -> SimulationRecord:
        record = self._store.simulation(simulation)
        if record.experiment_id != experiment_id:
            found = f"{simulation}, which is one of experiment {record.experiment_id}"
            expected = f"a simulation of experiment {experiment_id}"
            raise InvalidInput("simulation", found=found, expected=expected)
        return record

    def keep(
        self, experiment_id: int, parameters: Mapping[str, float], motion: str, folder: Path
    ) -> int:
        """Store a simulation with these parameters; return its id."""
        command = f"{command_of(self.experiment(experiment_id), folder, parameters, motion)} --save"
        answer = self._comparison(experiment_id, parameters, motion)
        return self._store.add_simulation(answer.record(experiment_id, command))

    def keep_nominal(self, ids: Sequence[int], folder: Path) -> NewSimulations:
        """Store simulations with nominal values of those experiments that have none yet."""
        stored: list[int] = []
        refused: dict[int, str] = {}
        with self._keeping:  # or two pages would do the same twice
            missing = self._store.unsimulated_ids(ExperimentQuery(include_faulty=True))
            for experiment_id in sorted({*missing}.intersection(ids)):
                try:
                    experiment = self._store.experiment(experiment_id)
                    command = f"{command_of(experiment, folder, {}, DYNAMIC)} --save"
                    answer = compare_run(experiment, stepper=Adaptive(max_steps=MAX_STEPS))
                    self._store.add_simulation(answer.record(experiment_id, command))
                    stored.append(experiment_id)
                except InvalidInput as problem:
                    refused[experiment_id] = str(problem)
            self.refused |= refused
        return NewSimulations(stored=stored, refused=refused)


def calibrated_of(offered: Iterable[StoredSet]) -> StoredSet | None:
    """Return the newest calibration that was fitted to the experiment, or the newest of all."""
    known = [one for one in offered if one.kind == "calibration"]
    return next((one for one in known if one.error_mm2 is not None), next(iter(known), None))


def warm_up() -> None:
    """Load or compile the engine, so that the first slider is as fast as the tenth."""
    from fixel.testing.scenes import grasp

    try:
        get_ready(grasp())
    finally:
        ready.set()


def _shown(motion: str) -> str:
    """Return a motion model or an engine that a page may ask for; no program of this machine."""
    if EngineName.of(motion).is_program:
        expected = "a motion model, or an engine by its name"
        hint = "pages start no programs: use fixel compare --engine"
        raise InvalidInput("motion", found=motion, expected=expected, hint=hint)
    return motion


def command_of(
    experiment: Experiment, folder: Path, parameters: Mapping[str, float], motion: str
) -> str:
    """Return the command for the same comparison."""
    words = ["fixel", "compare", experiment.key, "--project", str(folder)]
    for name, value in parameters.items():
        words += ["--set", f"{name}={value!r}"]
    if motion != DYNAMIC:
        words += motion_words(motion)
    return shlex.join(words)


def python_of(
    experiment: Experiment, folder: Path, parameters: Mapping[str, float], motion: str
) -> str:
    """Return the script for the same comparison."""
    return (
        f"import fixel\n\nlab = fixel.Project({str(folder)!r})\n"
        f"experiment = lab.experiment({experiment.key!r})\n"
        f"found = fixel.compare(experiment, {dict(parameters)!r}, motion={motion!r})\n"
        "print(found)\nfound.plot()\n"
    )


def _repeated(
    experiment: Experiment, folder: Path, parameters: Mapping[str, float], motion: str
) -> dict[str, str]:
    """Return how to repeat a comparison, and the measured contacts."""
    return {
        "measured_contact_mode": experiment.contact_mode,
        "command": command_of(experiment, folder, parameters, motion),
        "python": python_of(experiment, folder, parameters, motion),
    }


def _calibrated_set(
    number: int, record: CalibrationRecord, experiment: Experiment, experiment_id: int
) -> StoredSet:
    one = CalibratedValues(number, record)
    own = next((m for m in record.members if m.experiment_id == experiment_id), None)
    label = record.name or f"calibration {number}"
    return StoredSet(
        id=f"calibration-{number}",
        label=f"{label} "
        f"({'calibrated on this experiment' if own else 'not calibrated on this experiment'})",
        kind="calibration",
        parameters=one.values_for(experiment),
        motion=one.motion.name,
        error_mm2=own.error_mm2 if own else None,
    )


def simulation_label(number: int, record: SimulationRecord) -> str:
    """Return the name of a stored simulation on pages."""
    by = " by the publisher of the data" if record.provenance.source else ""
    return f"simulation {number}{by}"
