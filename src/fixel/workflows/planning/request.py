"""Goal of a plan, with the scene and the calibration that it refers to; plan and its file."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.goal_file import GoalFile, goal_file_from_dict, load_goal
from fixel.formats.scene_file import load_scene
from fixel.formats.trials_file import append_trials, read_trials, write_trials
from fixel.io.array_bytes import array_of, stored_in
from fixel.io.atomic import usable
from fixel.io.journal import Journal
from fixel.io.saved import load, save
from fixel.model import Experiment, Scene
from fixel.model.goal_checks import check_goal
from fixel.model.goals import Goal
from fixel.planning.belief import Belief, check_centres
from fixel.planning.plan import PushPlan
from fixel.planning.pushes import FreePushes, RigPushes
from fixel.planning.trials import PlanTrial, Trials
from fixel.typing import FloatArray
from fixel.uncertainty.run_to_run import MIN_EXPERIMENTS, RunToRun, learn_run_to_run
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.stored import newest_calibration, stored_calibration


class PlanRequest(dict[str, Any]):
    """Request of a found plan: the content of the goal file, and options of `plan_goal` by name."""


class PlanInputs(NamedTuple):
    """Goal, scene and belief of a plan, loaded and checked."""

    file: GoalFile
    request: PlanRequest
    scene: Scene
    belief: Belief
    calibration: int | None  # id of the calibration whose parameters the belief has
    warnings: tuple[str, ...]

    @property
    def parts(self) -> tuple[Scene, Goal, FreePushes | RigPushes, Belief]:
        """First arguments of `plan`."""
        return self.scene, self.file.goal, self.file.choose or FreePushes(), self.belief


@dataclass(frozen=True, kw_only=True)
class FoundPlan:
    """Plan with the request that it answers."""

    plan: PushPlan
    request: PlanRequest
    calibration: int | None = None  # id of the calibration whose parameters it uses
    wanted: float = 0.95  # wanted success probability
    warnings: tuple[str, ...] = field(default=())


class PlanAnswer(NamedTuple):
    """Plan for a goal file, and the plan file that was written."""

    found: FoundPlan
    file: Path | None


def is_content(goal: str) -> bool:
    """Whether a text is the content of a goal file in JSON, and not the name of one."""
    return goal.lstrip().startswith("{")


def settled(project: Project, request: Any) -> Any:
    """Return a request for a job, which depends on no file of goals and no later calibration."""
    own = inputs_for(project, request)
    changes = {"goal": goal_text(own.request), "calibration": own.calibration}
    return request.model_copy(update=changes)


def goal_text(request: PlanRequest) -> str:
    """Return the goal of a request in JSON, with the whole path of its scene file."""
    content = dict(request["goal"])
    if content.get("scene"):
        content["scene"] = str(Path(request["folder"], content["scene"]).resolve())
    return json.dumps(content, sort_keys=True)


def goal_content(goal: str) -> tuple[Any, Path]:
    """Return the content of a goal file, of which the name or the content in JSON is given.

    The second value is the folder in which its scene file is searched.
    """
    if not is_content(goal):
        return dict(load_goal(goal).raw), Path(goal).parent
    with usable("goal", "a goal file in JSON", ValueError):
        return json.loads(goal), Path()


def inputs_for(project: Project, request: Any) -> PlanInputs:
    """Load and check what a request for a plan refers to."""
    asked = request.scene, request.experiment, request.calibration
    return inputs_of(project, *goal_content(request.goal), *asked)


def inputs_of(
    project: Project | None,
    content: Any,
    folder: Path,
    scene: Path | None = None,
    experiment: str = "",
    calibration: int | None = None,
) -> PlanInputs:
    """Load the scene and the calibration that a goal refers to, and check the goal.

    `content` is that of a goal file, whose scene file is searched in `folder`. The other arguments
    are those of `plan_goal`. A scene file is put on the mapped table of the project, if it has one.
    """
    file = goal_file_from_dict(content, folder)
    number = calibration or file.calibration
    if number is None and project is not None and not file.belief.parameters:
        with project.store() as store:
            number = newest_calibration(store)
    if number is not None and project is None:
        raise InvalidInput("project", found="none", expected="the project of the calibration")
    belief, warnings = file.belief, list[str]()
    experiments: list[Experiment] = []
    if number is not None and project is not None:
        calibrated, experiments = with_experiments(project, number)
        belief = replace(belief, parameters=calibrated)
        if file.run_to_run:
            scatter, note = _run_to_run(calibrated, experiments)
            belief = replace(belief, run_to_run=scatter)
            warnings += [note] if note else []
    given = scene or file.scene
    if experiment:
        if project is None:
            raise InvalidInput("experiment", found="no project", expected="that of the experiment")
        if scene is not None:
            raise InvalidInput("experiment", found="a scene file too", expected="one of them")
        with project.store() as store:
            experiments, given = [store.experiment(store.find(experiment))], None
    own = _scene(given, experiments, project)
    check_goal(file.goal, own)
    check_centres(belief, own)
    request = PlanRequest(
        goal=dict(file.raw), folder=str(folder), scene=str(scene or ""), experiment=experiment
    )
    return PlanInputs(file, request, own, belief, number, tuple(warnings))


def with_experiments(project: Project, number: int) -> tuple[Calibration, list[Experiment]]:
    """Return a stored calibration and its experiments."""
    with project.store() as store:
        members = store.calibration(number).members
        experiments = [store.experiment(own.experiment_id) for own in members]
    return stored_calibration(project, number), experiments


def found_plan(own: PlanInputs, found: PushPlan, options: Mapping[str, Any]) -> FoundPlan:
    """Return a plan with its request and the warnings that belong to it."""
    return FoundPlan(
        plan=found,
        request=PlanRequest(
            own.request | {k: x for k, x in options.items() if isinstance(x, bool | int)}
        ),
        calibration=own.calibration,
        wanted=own.file.success,
        warnings=(*own.warnings, *warnings_of(found, own.file.success)),
    )


def warnings_of(found: PushPlan, wanted: float) -> list[str]:
    """Return what a reader must know before relying on a plan, in sentences."""
    own = found.success
    warnings = list(found.unseen)
    if found.belief.misfit:
        warnings.append(f"Calibration: {found.belief.misfit}")
    if own.stated < wanted:
        warnings.append(f"The success probability {own.stated:.4f} is below the wanted {wanted:g}")
    if found.advice:
        warnings.append(found.advice)
    if not found.belief.is_calibrated:
        warnings.append("No calibration: the parameters were given, and not measured")
    return warnings


def _scene(given: Path | None, experiments: list[Experiment], project: Project | None) -> Scene:
    if given:
        own = load_scene(given).scene
        return own if project is None or project.view is None else project.view.of_scene(own)
    scenes = [own.scene for own in experiments if own.scene is not None]
    if not scenes:
        raise InvalidInput(
            "scene", found="none", expected="a scene file", hint="name one: scene=scene.yaml"
        )
    return scenes[0]


def _run_to_run(calibration: Calibration, experiments: list[Experiment]) -> tuple[RunToRun, str]:
    """Learn the scatter between runs; that of public pushes where experiments are too few."""
    usable = [own for own in experiments if own.scene is not None]
    if len(usable) >= MIN_EXPERIMENTS:
        try:
            fitted = min(len(calibration), 3 * len(usable) - 1)
            return learn_run_to_run(usable, calibration, fitted=fitted), ""
        except InvalidInput as problem:
            return RunToRun(), f"The scatter between runs is that of public pushes: {problem}"
    return RunToRun(), (
        f"The scatter between runs is that of public pushes: the calibration has {len(usable)}"
        f" experiments, and {MIN_EXPERIMENTS} are needed to learn it"
    )


JOURNAL: Final = "answers.journal"


@dataclass(frozen=True, kw_only=True)
class PlanFile:
    """Content of a plan file."""

    found: FoundPlan
    version: str  # version of fixel
    created: str  # time of creation, as ISO 8601 in UTC

    @property
    def id(self) -> str:
        """Id of the plan: a digest of its motions and of its stated success probability."""
        return plan_id(self.found.plan)


def plan_id(plan: PushPlan) -> str:
    """Return the id of a plan."""
    digest = hashlib.sha256(np.ascontiguousarray(plan.path).tobytes())
    digest.update(np.ascontiguousarray(plan.start).tobytes())
    digest.update(repr(plan.success.stated).encode())
    return digest.hexdigest()[:12]


def save_plan(found: FoundPlan, path: Path) -> PlanFile:
    """Write a plan file, whole or not at all."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    content = PlanFile(found=found, version=version("fixel"), created=now)
    save(content, path)
    return content


def load_plan(path: Path) -> PlanFile:
    """Load a plan file; also a plan that `PushPlan.save` wrote."""
    content = load(path)
    if isinstance(content, PushPlan):
        found = FoundPlan(plan=content, request=PlanRequest(goal={}))
        return PlanFile(found=found, version="", created="")
    if not isinstance(content, PlanFile):
        raise InvalidInput(
            str(path), found=f"a saved {type(content).__name__}", expected="a plan file"
        )
    return content


def trials_path(path: Path) -> Path:
    """Return the file of the trials of a plan file."""
    return path.with_name(f"{path.name}.trials.csv")


def load_trials(path: Path, file: PlanFile) -> Trials:
    """Load the trials of a plan file; none if there is no file of trials."""
    where = trials_path(path)
    if where.exists():
        return read_trials(where, plan=file.id)
    success = file.found.plan.success
    return Trials(plan=file.id, stated=min(success.least, 1.0 - 1e-9), mean=success.mean)


def add_trials(path: Path, file: PlanFile, *trials: PlanTrial) -> Trials:
    """Add trials to those of a plan file, durably; return all of them."""
    where = trials_path(path)
    if not where.exists():
        write_trials(where, load_trials(path, file))
    return append_trials(where, *trials, plan=file.id)


class StoredAnswers(dict[str, FloatArray]):
    """Arrays by name, each durable in a journal once it is set."""

    def __init__(self, journal: Journal) -> None:
        super().__init__((name, array_of(journal.get(name) or b"")) for name in journal)
        self._journal = journal

    def __setitem__(self, name: str, array: FloatArray) -> None:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        self._journal.append([(name, stream.getvalue())])
        super().__setitem__(name, array)


@contextmanager
def answers_in(folder: PathLike[str] | str | None) -> Iterator[dict[str, FloatArray]]:
    """Yield the arrays by name that are stored in a folder; without one they are in memory."""
    place = stored_in(folder)
    if place is None:
        yield {}
        return
    with Journal(place / JOURNAL) as journal:
        yield StoredAnswers(journal)
