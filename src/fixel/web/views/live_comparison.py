"""Compare sets of parameters on one experiment, repeatedly while a slider is moved."""

from __future__ import annotations

import shlex
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple, final

import numpy as np

from fixel.calibration.target import scene_of
from fixel.database.query import ExperimentQuery
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters
from fixel.model.parameters import KNOWN_PARAMETERS, info_of
from fixel.model.records import CalibrationRecord, SimulationRecord
from fixel.model.space import Unknown
from fixel.simulation import AbstractMotionModel, simulate
from fixel.simulation.motion import MOTION_MODELS
from fixel.simulation.stepper import Adaptive
from fixel.web.views.motion_views import MotionView, compared_motion, stored_motion
from fixel.workflows.calibration.parameter_options import default_unknowns, usual
from fixel.workflows.calibration.result import GROWTH
from fixel.workflows.calibration.stored import CalibratedValues
from fixel.workflows.compilation import INSTANT, get_ready
from fixel.workflows.project.compare import Comparison, comparison

DYNAMIC: Final = "dynamic"
MOST_STEPS: Final = 20_000  # of one simulation; those of the thesis take about a hundred
KEPT: Final = 16  # experiments in memory
MAX_SETS: Final = 40  # that are offered of one kind, the newest first

SetKind = Literal["nominal", "calibration", "simulation"]


class StoredSet(NamedTuple):
    """Values that can be selected for comparison."""

    id: str  # "nominal", "calibration-3", "simulation-12"
    label: str
    kind: SetKind
    parameters: Parameters
    motion: str  # name of the motion model
    error_mm2: float | None  # the thesis's E, if it is known already


class ComparedSimulation(NamedTuple):
    """Simulation compared with the measurement; no errors if it stopped early."""

    motion: MotionView
    parameters: Parameters
    method: str  # name of the motion model
    position_rms: float | None  # [m]
    final_position: float | None  # [m]
    final_angle: float | None  # [rad]
    error_mm2: float | None  # the thesis's E
    contact_mode: str  # at the end, one digit per fixel
    wall_time: float | None  # of the simulation alone [s]


class NewSimulations(NamedTuple):
    """Experiments with a new simulation, and the reasons why others have none."""

    stored: list[int]
    refused: dict[int, str]


@final
class CompareDesk:
    """Experiments in memory, and simulations of them at once.

    Any thread may use it.

    Parameters
    ----------
    store : Store
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._keeping = threading.Lock()
        self._known: OrderedDict[int, Experiment] = OrderedDict()
        self._sliders: dict[int, tuple[Unknown, ...]] = {}

    def experiment(self, number: int) -> Experiment:
        """Return an experiment; it never changes, so the last few stay in memory."""
        with self._lock:
            if number in self._known:
                self._known.move_to_end(number)
                return self._known[number]
        experiment = self._store.experiment(number)
        with self._lock:
            self._known[number] = experiment
            while len(self._known) > KEPT:
                gone, _ = self._known.popitem(last=False)
                self._sliders.pop(gone, None)
        return experiment

    def sliders(self, number: int) -> tuple[Unknown, ...]:
        """Return every parameter that has a meaning in the experiment's scene, with its usual
        bounds, starting at the scene's own value; those usually calibrated come first."""
        if number not in self._sliders:
            self._sliders[number] = _sliders(self.experiment(number))
        return self._sliders[number]

    def sets(self, number: int) -> list[StoredSet]:
        """Return the sets for comparison: the scene's own values, those of calibrations, and those
        of stored simulations."""
        experiment = self.experiment(number)
        scene_of(experiment)
        found = [StoredSet("nominal", "nominal", "nominal", Parameters(), DYNAMIC, None)]
        for id_, record in reversed(self._store.calibration_summaries().items()):
            if record.method.get("how") != GROWTH and len(found) <= MAX_SETS:
                found.append(_calibrated_set(id_, record, experiment, number))
        for id_ in reversed(self._store.simulations(number)[-MAX_SETS:]):
            found.append(_simulated_set(id_, self._store.simulation(id_)))
        return found

    def compared(
        self, number: int, parameters: Mapping[str, float], motion: str = DYNAMIC
    ) -> ComparedSimulation:
        """Simulate an experiment, and compare the result with the measurement."""
        answer = self._comparison(number, parameters, motion)
        return ComparedSimulation(
            compared_motion(answer, "simulated", id="simulated"),
            answer.parameters,
            motion,
            answer.position_rms,
            answer.final_position,
            answer.final_angle,
            answer.error_mm2,
            answer.contact_mode,
            answer.simulation.wall_time_s,
        )

    def _comparison(self, number: int, parameters: Mapping[str, float], motion: str) -> Comparison:
        return comparison(
            self.experiment(number),
            Parameters(parameters),
            motion_model(motion),
            Adaptive(max_steps=MOST_STEPS),
        )

    def stored(self, number: int, simulation: int) -> ComparedSimulation:
        """Return a stored simulation of an experiment, with the errors stored with it."""
        record = self._record(number, simulation)
        motion = self.simulated(number, simulation)
        known = record.error_mm2 is not None and motion.errors is not None
        position = motion.errors.position if known and motion.errors else None
        angle = motion.errors.angle if known and motion.errors else None
        return ComparedSimulation(
            motion,
            record.parameters,
            str(record.method.get("motion", DYNAMIC)),
            None if position is None else float(np.sqrt(np.mean(position**2))),
            None if position is None else float(position[-1]),
            None if angle is None else float(angle[-1]),
            record.error_mm2,
            record.contact_mode,
            None,
        )

    def simulated(self, number: int, simulation: int) -> MotionView:
        """Return the motion of a stored simulation of an experiment."""
        record = self._record(number, simulation)
        label, name = f"simulation {simulation}", f"simulation-{simulation}"
        return stored_motion(self.experiment(number), record, label, id=name)

    def _record(self, number: int, simulation: int) -> SimulationRecord:
        record = self._store.simulation(simulation)
        if record.experiment_id != number:
            raise InvalidInput(
                "simulation",
                found=f"{simulation}, which is one of experiment {record.experiment_id}",
                expected=f"a simulation of experiment {number}",
            )
        return record

    def keep(self, number: int, parameters: Mapping[str, float], motion: str, command: str) -> int:
        """Store a simulation with these parameters; return its id."""
        answer = self._comparison(number, parameters, motion)
        return self._store.add_simulation(answer.record(number, command))

    def keep_nominal(self, numbers: Sequence[int], folder: Path) -> NewSimulations:
        """Store simulations with nominal values of those experiments that have none yet."""
        stored: list[int] = []
        refused: dict[int, str] = {}
        with self._keeping:  # or two pages would do the same twice
            wanted = set(
                self._store.unsimulated_ids(ExperimentQuery(include_faulty=True))
            ).intersection(numbers)
            for number in sorted(wanted):
                try:
                    experiment = self._store.experiment(number)
                    command = f"{command_of(experiment, folder, {}, DYNAMIC)} --save"
                    answer = comparison(experiment, stepper=Adaptive(max_steps=MOST_STEPS))
                    self._store.add_simulation(answer.record(number, command))
                    stored.append(number)
                except InvalidInput as problem:
                    refused[number] = str(problem)
        return NewSimulations(stored, refused)


def warm_up() -> None:
    """Load or compile the engine, so that the first slider is as fast as the tenth."""
    from fixel.testing.scenes import grasp

    get_ready(grasp())


def motion_model(name: str) -> AbstractMotionModel:
    """Return the motion model of a name."""
    models = {model.name: model for model in MOTION_MODELS}
    if name not in models:
        raise InvalidInput("motion", found=repr(name), expected="one of " + ", ".join(models))
    return models[name]()


def command_of(
    experiment: Experiment, folder: Path, parameters: Mapping[str, float], motion: str
) -> str:
    """Return the command for the same comparison."""
    words = ["fixel", "compare", experiment.key, "--project", str(folder)]
    for name, value in parameters.items():
        words += ["--set", f"{name}={value!r}"]
    if motion != DYNAMIC:
        words += ["--motion", motion]
    return shlex.join(words)


def python_of(
    experiment: Experiment, folder: Path, parameters: Mapping[str, float], motion: str
) -> str:
    """Return the script for the same comparison."""
    named = {model.name: model.__name__ for model in MOTION_MODELS}
    model = named[motion]
    return "\n".join(
        (
            "from pathlib import Path",
            "",
            "from fixel.database.project import Project",
            "from fixel.model import Parameters",
            f"from fixel.simulation import {model}",
            "from fixel.workflows.project.compare import comparison",
            "",
            f"with Project.open(Path({str(folder)!r})).store() as store:",
            f"    experiment = store.experiment(store.find({experiment.key!r}))",
            f"answer = comparison(experiment, {Parameters(parameters)!r}, {model}())",
            "print(answer.summary())",
            "",
        )
    )


def _calibrated_set(
    number: int, record: CalibrationRecord, experiment: Experiment, experiment_id: int
) -> StoredSet:
    one = CalibratedValues(number, record)
    values = one.values({**experiment.conditions, "experiment": experiment.key})
    own = next((m for m in record.members if m.experiment_id == experiment_id), None)
    label = record.name or f"calibration {number}"
    return StoredSet(
        f"calibration-{number}",
        f"{label} ({'fitted to it' if own else 'not fitted to it'})",
        "calibration",
        Parameters({name: value for name, value in values.items() if name in KNOWN_PARAMETERS}),
        one.motion.name,
        own.error_mm2 if own else None,
    )


def _simulated_set(number: int, record: SimulationRecord) -> StoredSet:
    motion = str(record.method.get("motion", DYNAMIC))
    return StoredSet(
        f"simulation-{number}",
        f"simulation {number}",
        "simulation",
        record.parameters,
        motion,
        record.error_mm2,
    )


def _sliders(experiment: Experiment) -> tuple[Unknown, ...]:
    scene = scene_of(experiment)
    first = [unknown.name for unknown in default_unknowns([scene])]
    found = []
    for name in dict.fromkeys((*first, *KNOWN_PARAMETERS)):
        try:
            unknown = usual(name, scene)
            simulate(scene, Parameters({name: unknown.nominal}), duration=INSTANT)
        except InvalidInput:
            continue  # the name has no meaning in this scene
        found.append(unknown)
    return tuple(found)


def meaning_of(name: str) -> str:
    """Return the meaning of a parameter, in a few words."""
    return info_of(name).meaning
