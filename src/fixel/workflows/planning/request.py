"""Request for a plan: a goal file, with a scene and a calibration of a project."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, final

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.goal_file import GoalFile, goal_file_from_dict
from fixel.formats.scene_file import load_scene
from fixel.io.document import read_document
from fixel.model import Experiment, Scene
from fixel.model.goal_checks import check_goal
from fixel.planning.belief import Belief, check_centres
from fixel.planning.plan import PushPlan
from fixel.planning.pushes import FreePushes
from fixel.progress import ProgressOption
from fixel.uncertainty.run_to_run import MIN_EXPERIMENTS, RunToRun, learn_run_to_run
from fixel.workflows.calibration.calibration import Calibration
from fixel.workflows.calibration.project import stored_calibration
from fixel.workflows.calibration.stored import newest_calibration
from fixel.workflows.planning.run import ROLLOUTS, plan


@final
@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """Request for a plan.

    Parameters
    ----------
    goal : mapping
        Content of a goal file.
    folder : str
        Folder in which the goal file's scene is searched.
    scene : str
        Scene file; by default that of the goal file, else the first experiment's of the
        calibration.
    experiment : str
        Experiment of the project whose scene is used, by id or name.
    calibration : int, optional
        Id of a stored calibration; by default that of the goal file, else the newest one.
    rollouts, seed : int
    untrusted : bool
        Whether pushes may be chosen that resemble no experiment.
    """

    goal: Mapping[str, Any]
    folder: str = ""
    scene: str = ""
    experiment: str = ""
    calibration: int | None = None
    rollouts: int = ROLLOUTS
    seed: int = 0
    untrusted: bool = False

    @classmethod
    def of_file(cls, path: Path, **options: Any) -> PlanRequest:
        """Return the request for a goal file."""
        raw = read_document(path, "goal file")
        goal_file_from_dict(raw, path.parent)  # reports its errors
        return cls(goal=raw, folder=str(path.parent), **options)


class PlanInputs(NamedTuple):
    """Scene, goal and belief that a request for a plan refers to."""

    file: GoalFile
    scene: Scene
    belief: Belief
    calibration: int | None
    warnings: tuple[str, ...]


@final
@dataclass(frozen=True, kw_only=True)
class FoundPlan:
    """Plan with the request that it answers.

    Attributes
    ----------
    plan : PushPlan
    request : PlanRequest
    calibration : int or None
        Id of the calibration whose parameters it uses.
    wanted : float
        Wanted success probability.
    warnings : tuple of str
    """

    plan: PushPlan
    request: PlanRequest
    calibration: int | None = None
    wanted: float = 0.95
    warnings: tuple[str, ...] = field(default=())


def inputs_of(project: Project | None, request: PlanRequest) -> PlanInputs:
    """Load the scene and the calibration that a request refers to, and check its goal.

    Raises
    ------
    InvalidInput
        The goal file is invalid, there is no scene, or the goal does not fit the scene.
    """
    file = goal_file_from_dict(dict(request.goal), Path(request.folder))
    number = request.calibration or file.calibration
    if number is None and project is not None and not file.belief.parameters:
        with project.store() as store:
            number = newest_calibration(store)
    if number is not None and project is None:
        raise InvalidInput("--project", found="none", expected="the project of the calibration")
    belief, warnings, experiments = file.belief, [], []
    if number is not None and project is not None:
        calibration = stored_calibration(project, number)
        with project.store() as store:
            members = store.calibration(number).members
            experiments = [store.experiment(own.experiment_id) for own in members]
        belief = replace(belief, parameters=calibration)
        if file.run_to_run:
            scatter, note = _run_to_run(calibration, experiments)
            belief = replace(belief, run_to_run=scatter)
            warnings += [note] if note else []
    if request.experiment and project is not None:
        with project.store() as store:
            experiments = [store.experiment(store.find(request.experiment)), *experiments]
    scene = _scene(request.scene or file.scene, experiments)
    check_goal(file.goal, scene)
    check_centres(belief, scene)
    return PlanInputs(file, scene, belief, number, tuple(warnings))


def find_plan(
    project: Project | None,
    request: PlanRequest,
    *,
    threads: int | None = None,
    store: Path | None = None,
    progress: ProgressOption = None,
) -> FoundPlan:
    """Answer a request for a plan, as `fixel.plan` does.

    Parameters
    ----------
    project : Project or None
    request : PlanRequest
    threads : int, optional
    store : Path, optional
        Folder in which the work is stored as it is done.
    progress : bool or callable, optional

    Raises
    ------
    InvalidInput
        The request is invalid, or the goal cannot be reached.
    """
    own = inputs_of(project, request)
    found = plan(
        own.scene,
        own.file.goal,
        own.file.choose or FreePushes(),
        own.belief,
        rollouts=request.rollouts,
        seed=request.seed,
        untrusted=request.untrusted,
        threads=threads,
        store=store,
        progress=progress,
    )
    return found_plan(request, own, found)


def found_plan(request: PlanRequest, own: PlanInputs, found: PushPlan) -> FoundPlan:
    """Return a plan with its request and the warnings that belong to it."""
    return FoundPlan(
        plan=found,
        request=request,
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
        warnings.append(
            f"The stated success probability {own.stated:.3f} is below the wanted {wanted:g}"
        )
    if own.calibrate_first:
        warnings.append("Success depends on parameters that are not known well: calibrate first")
    if not found.belief.is_calibrated:
        warnings.append("No calibration: the parameters were given, and not measured")
    return warnings


def _scene(given: str | Path | None, experiments: list[Experiment]) -> Scene:
    if given:
        return load_scene(given).scene
    scenes = [own.scene for own in experiments if own.scene is not None]
    if not scenes:
        raise InvalidInput(
            "scene", found="none", expected="a scene file", hint="name one: --scene scene.yaml"
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
