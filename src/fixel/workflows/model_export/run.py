"""Write a model for another engine, with a program that runs it and a card of its accuracy."""

from __future__ import annotations

import json
import math
import os
import platform
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.drawing.view import evenly
from fixel.engine_names import ENGINES, EngineName
from fixel.errors import InvalidInput, check_name
from fixel.formats.frames_file import folder_whole, refuse_folder
from fixel.model import Experiment, Scene, pose_error
from fixel.model.fields import instance, path_of, whole
from fixel.progress import ProgressOption, show_progress
from fixel.simulation import AbstractMotionModel, AbstractStepper
from fixel.simulation.engines import AbstractPhysicsEngine, engine_of
from fixel.simulation.engines.contract import model_of
from fixel.simulation.engines.mujoco import mjcf
from fixel.simulation.engines.sdf import sdf
from fixel.simulation.engines.task import PlainTask, bench_units, task_of, unsupported
from fixel.simulation.motion import OtherEngine
from fixel.simulation.rollouts import RolloutCase, ensemble_of
from fixel.typing import FloatArray, ProgressCallback
from fixel.uncertainty.error_terms import StartError
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.workflows.model_export.recording import WRITERS, BodyMotion, motion_of
from fixel.workflows.model_export.source import Exportable, ModelSource, SourceCase, source_of, urdf

TARGETS: Final = ("mujoco", "drake", "pymunk", "box2d", "urdf", *WRITERS)
FORMAT: Final = "fixel-model-1"
# Files of engines that read models, by name.
MODELS: Final[Mapping[str, Callable[[PlainTask, Mapping[str, Any]], Mapping[str, str]]]] = {
    "mujoco": lambda task, choices: {"model.xml": mjcf(task, choices)},
    "drake": sdf,
}
# Fields of an estimate in a card.
STATED: Final = ("unit", "value", "best_fit", "low", "high", "level", "verdict")
_SCRIPTS: Final = "fixel.simulation.engines.scripts"


class ModelExport(NamedTuple):
    """Result of an export of a model."""

    folder: Path
    to: str  # engine with its version, or ``urdf``
    files: tuple[str, ...]  # names of the files
    card: Mapping[str, Any]  # contents of ``card.json``

    def summary(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return self._asdict() | {"folder": str(self.folder), "card": dict(self.card)}


def export_model(
    what: Exportable,
    folder: str | os.PathLike[str],
    *,
    to: str,
    calibration: int | None = None,
    held_out: Iterable[Experiment] = (),
    scenes: int = 100,
    seed: int = 0,
    progress: ProgressOption = None,
) -> ModelExport:
    """Write a scene as a model for another engine, or its motion as a recording for viewers.

    The folder contains the model, ``run.py``, which simulates it without fixel and prints poses as
    CSV, and ``card.json``: versions, parameters with their intervals, the distance between end
    poses of the engine and of fixel, and errors on experiments. Distances are measured on scenes
    that differ in the start pose: by up to 5 % of the size of the body, and by up to 5 degrees. The
    folder of a recording contains ``motion.mcap`` or ``motion.rrd``, and the card.

    Parameters
    ----------
    what : Scene, SceneFile, path, Experiment, Calibration, Project, Simulation or PushPlan
        Scene or experiment; or a calibration, whose first experiment is written with the calibrated
        parameters. Simulations and plans have recordings only: a plan as simulated with its
        most likely parameters.
    folder : path
        New or empty folder.
    to : str
        ``"mujoco"``, ``"drake"``, ``"pymunk"``, ``"box2d"``, with choices as in
        ``"mujoco:step=0.001"``; ``"urdf"``, the body with its support alone; ``"mcap"``, a
        recording for Foxglove; or ``"rerun"``, one for rerun.
    calibration : int, optional
        Id of a calibration of a project; by default the newest for several experiments.
    held_out : iterable of Experiment, optional
        Experiments that the calibration has not used, on which errors are computed. By default
        errors are those on the experiments of the calibration.
    scenes : int
        Number of scenes on which the distance from fixel is measured; 0 for none.
    seed : int
        Seed of the random number generator.
    progress : bool or callable, optional

    Returns
    -------
    ModelExport

    Raises
    ------
    InvalidInput
        The engine cannot represent the scene, or the folder is not empty.
    MissingExtra
        The package of the engine is not installed.

    Examples
    --------
    >>> import fixel, tempfile
    >>> from fixel.testing.scenes import pushed_square
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fixel.export_model(pushed_square(), f"{folder}/model", to="urdf")
    >>> done.files
    ('card.json', 'object.urdf')
    """
    instance(to, str, "to", "a name")
    target, wanted = path_of(folder, "folder"), EngineName.of(to)
    check_name("to", wanted.name if wanted.name in ENGINES else to, TARGETS)
    whole(scenes, "scenes", 0, 100_000)
    refuse_folder(target)
    source = source_of(what, calibration, held_out)
    exported, recorded = source.cases[0], wanted.name in WRITERS
    if not recorded and (source.runs or (found := unsupported(exported.scene))):
        raise _refused(wanted.name, f"a {source.kind}" if source.runs else found)
    # A recording, and a description of a body, have no motion of their own to compare.
    stated, judged = wanted.name, {"to": wanted.name, "distance_from_fixel": None}
    texts, motions = dict[str, str](), list[BodyMotion]()
    if recorded:
        motions, lost = motion_of(source)
    elif wanted.name == "urdf":
        texts, lost = _urdf(exported)
    else:
        engine = _engine(wanted, exported)
        texts, lost = _model(engine, exported)
        stated = f"{engine.name} {engine.version}"
        judged = _judged(source, engine, wanted, scenes, seed, progress)
    card = _head(source) | {"not_in_the_model": lost} | judged
    contents = {**texts, "card.json": json.dumps(card, indent=2, allow_nan=False) + "\n"}
    with folder_whole(target) as unfinished:
        for name, text in contents.items():
            (unfinished / name).write_text(text, encoding="utf-8")
        if recorded:
            name, write = WRITERS[wanted.name]
            write(unfinished / name, motions)
            contents[name] = ""
    return ModelExport(folder=target, to=stated, files=tuple(sorted(contents)), card=card)


def _engine(wanted: EngineName, case: SourceCase) -> AbstractPhysicsEngine:
    """Return the engine with the calibrated values of its own parameters."""
    engine = engine_of(str(wanted))
    if wanted.version and engine.version != wanted.version:
        found, expected = f"version {engine.version}", f"version {wanted.version}"
        raise InvalidInput(f"engine {wanted.name}", found=found, expected=expected)
    own = {
        name.partition(".")[2]: value
        for name, value in case.values.items()
        if name.partition(".")[0] == wanted.name
    }
    return engine.under(own)


def _task(case: SourceCase) -> tuple[PlainTask, list[float]]:
    """Return the task of a case, and the frame of its poses in that of the body of the task."""
    shared = {name: value for name, value in case.values.items() if "." not in name}
    task, scene_poses = task_of(case.scene, case.times, shared, {})
    return task, scene_poses(np.zeros(3)).tolist()


def _model(engine: AbstractPhysicsEngine, case: SourceCase) -> tuple[dict[str, str], list[str]]:
    """Return the texts of a model's files by name, and what the model lacks."""
    task, frame = _task(case)
    if found := engine.refusal(task):
        raise _refused(engine.name, found)
    units = bench_units(task.body)
    task = units.task(task)
    document = {
        "format": FORMAT,
        "fixel": version("fixel"),
        "engine": f"{engine.name} {engine.version}",
        "units": {
            "length_m": units.length,
            "mass_kg": units.mass,
            "time_s": units.time,
            "origin_m": units.origin,
        },
        "frame": frame,
        **model_of(engine, task),
    }
    del document["values"]
    contents = {"model.json": json.dumps(document, indent=1, allow_nan=False) + "\n"}
    if engine.name in MODELS:
        contents |= MODELS[engine.name](task, asdict(engine))
    contents |= {"run.py": _script(f"run_{engine.name}"), "drive.py": _script("drive")}
    lost = [
        f"{name}, a parameter of another engine"
        for name in case.values
        if "." in name and name.partition(".")[0] != engine.name
    ]
    return contents, lost


def _urdf(case: SourceCase) -> tuple[dict[str, str], list[str]]:
    """Return the same of a description of the body."""
    task, _ = _task(case)
    text, meshes, lost = urdf(task, case.scene.bodies[0].name)
    return {"object.urdf": text, **meshes}, lost


def _script(name: str) -> str:
    text = files(_SCRIPTS).joinpath(f"{name}.py").read_text("utf-8")
    return text.replace(f"from {_SCRIPTS}.drive import", "from drive import")


def _head(source: ModelSource) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "fixel": version("fixel"),
        "platform": f"{platform.system()} {platform.machine()}",
        "source": {
            "kind": source.kind,
            "name": source.name,
            "calibration": source.calibration_id,
            "exported": source.cases[0].key or None,
            "experiments": sum(case.measured is not None for case in source.cases),
        },
        "parameters": [
            {"name": own.label, **{name: getattr(own, name) for name in STATED}}
            for own in source.estimates
        ],
        "exported_values": dict(source.cases[0].values),
    }


def _judged(
    source: ModelSource,
    engine: AbstractPhysicsEngine,
    wanted: EngineName,
    scenes: int,
    seed: int,
    progress: ProgressOption,
) -> dict[str, Any]:
    other = OtherEngine(str(wanted))
    found: dict[str, Any] = {
        "to": engine.name,
        "version": engine.version,
        "choices": asdict(engine),
        "distance_from_fixel": None,
        "errors_on_experiments": None,
    }
    if scenes:
        with show_progress(progress, f"comparing {engine.name} with fixel") as report:
            distances = distances_from_fixel(source, other, scenes, seed, report)
        found["distance_from_fixel"] = {
            "of": "end poses",
            "motion": source.motion.name,
            "seed": seed,
            **distances.stated(),
        }
    cases = source.held_out or [case for case in source.cases if case.measured is not None]
    if cases:
        by: dict[str, Distances] = {
            engine.name: errors_on(cases, other),
            "fixel": errors_on(cases, source.motion, source.stepper),
        }
        found["errors_on_experiments"] = {
            "of": "end poses",
            "held_out": bool(source.held_out),
            **{name: own.stated() for name, own in by.items()},
        }
    return found


def _refused(engine: str, found: str) -> InvalidInput:
    return InvalidInput(
        f"export to {engine}", found=found, expected="a scene that the engine can represent"
    )


SHIFT: Final = 0.05  # half-width of start errors, over the size of the body
TURN: Final = math.radians(5.0)
MAX_AROUND: Final = 10  # experiments of a calibration around which scenes are drawn
MAX_JUDGED: Final = 200  # experiments on which errors are computed
RESAMPLES: Final = 1000  # of the bootstrap
LEVEL: Final = 0.95  # of the intervals of medians


class Distances(NamedTuple):
    """Distances of end poses, and simulations without an end, by reason."""

    position: FloatArray  # (k,) [m]
    angle: FloatArray  # (k,) [rad]
    failures: Counter[str]

    def stated(self) -> dict[str, Any]:
        """Return medians with intervals, 90 % quantiles and maxima in mm and degrees."""
        return {
            "simulations": len(self.position) + self.failures.total(),
            "failures": self.failures.total(),
            "reasons": dict(self.failures.most_common(5)),
            "position_mm": _statistics(1e3 * self.position),
            "angle_deg": _statistics(np.degrees(self.angle)),
        }


def start_error_of(scene: Scene) -> StartError:
    """Return the start errors with which scenes are drawn around one: 5 % of the body, 5 deg."""
    size = SHIFT * float(np.ptp(scene.bodies[0].shape.outline, axis=0).max())
    return StartError(x=size, y=size, theta=TURN, kind="uniform")


def distances_from_fixel(
    source: ModelSource,
    engine: OtherEngine,
    n: int,
    seed: int,
    progress: ProgressCallback | None = None,
) -> Distances:
    """Simulate scenes drawn around those of a source by an engine and by fixel, and compare ends.

    `n` scenes are shared by at most ten cases of the source; `seed` is that of the start poses.
    """
    cases = [source.cases[k] for k in evenly(len(source.cases), min(MAX_AROUND, n))]
    position, angle, failures, done = [], [], Counter[str](), 0
    for k, case in enumerate(cases):
        count = n // len(cases) + (k < n % len(cases))
        drawn = start_error_of(case.scene).samples(count, seed + k)
        own, why_own = _ends(case, drawn, source.motion, source.stepper)
        other, why_other = _ends(case, drawn, engine, None)
        good = ~np.isnan(own[:, 0]) & ~np.isnan(other[:, 0])
        apart = pose_error(own[good], other[good])
        position.append(apart[0])
        angle.append(np.abs(apart[1]))
        for row in np.flatnonzero(~good).tolist():
            failures[f"fixel: {why_own[row]}" if why_own[row] else why_other[row]] += 1
        done += count
        if progress is not None:
            progress(done, n)
    return Distances(np.concatenate(position), np.concatenate(angle), failures)


def errors_on(
    cases: Sequence[SourceCase], motion: AbstractMotionModel, stepper: AbstractStepper | None = None
) -> Distances:
    """Return the distances of simulated end poses from the measured ones."""
    position, angle, failures = [], [], Counter[str]()
    for case in (cases[k] for k in evenly(len(cases), MAX_JUDGED)):
        if case.measured is None:
            continue
        values = {k: np.array([v]) for k, v in _own(case.values, motion).items()}
        ensemble = ensemble_of([RolloutCase(case.scene, case.times)], motion, stepper, 1)
        outcome = ensemble.simulate(np.zeros(1, np.int64), values)
        if not outcome.converged[0]:
            failures[outcome.reasons[0]] += 1
            continue
        apart = pose_error(outcome.pose[0, len(case.times) - 1], case.measured[-1])
        position.append(float(apart[0]))
        angle.append(abs(float(apart[1])))
    return Distances(np.array(position), np.array(angle), failures)


def _ends(
    case: SourceCase,
    drawn: FloatArray,
    motion: AbstractMotionModel,
    stepper: AbstractStepper | None,
) -> tuple[FloatArray, Sequence[str]]:
    """Return the end poses (n, 3) from drawn starts, NaN without an end, and the reasons."""
    error, values = start_error_of(case.scene), _own(case.values, motion)
    try:
        found = simulate_starts(
            case.scene,
            error,
            drawn=drawn,
            values=values,
            times=case.times,
            motion=motion,
            stepper=stepper,
        )
    except InvalidInput as problem:
        return np.full((len(drawn), 3), np.nan), [str(problem)] * len(drawn)
    # A jam is an end for fixel, and a failure here: no other engine stops there.
    good = found.ended & np.array([not reason for reason in found.reasons])
    return np.where(good[:, None], found.pose[:, -1], np.nan), found.reasons


def _own(values: Mapping[str, float], motion: AbstractMotionModel) -> dict[str, float]:
    """Return the parameters that a motion model or an engine has."""
    engine = motion.name.partition(":")[0] if isinstance(motion, OtherEngine) else ""
    return {
        name: value
        for name, value in values.items()
        if "." not in name or name.partition(".")[0] == engine
    }


def _statistics(values: FloatArray) -> dict[str, float] | None:
    """Return quantiles, and the bootstrap interval of the median; None without values."""
    if not len(values):
        return None
    rows = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    medians = np.median(values[rows], axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(medians, (tail, 1.0 - tail)).tolist()
    return {
        "median": float(np.median(values)),
        "median_low": low,
        "median_high": high,
        "quantile_90": float(np.quantile(values, 0.9)),
        "maximum": float(values.max()),
    }
