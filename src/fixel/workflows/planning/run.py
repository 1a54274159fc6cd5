"""Plan pushes that reach a goal despite what is unknown, and for a goal file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Seed, Threads

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import Scene
    from fixel.model.goals import Goal
    from fixel.planning.belief import Belief
    from fixel.planning.plan import PushPlan
    from fixel.planning.pushes import FreePushes, PlanPush, RigPush, RigPushes
    from fixel.progress import ProgressOption
    from fixel.simulation.motion import AbstractMotionModel
    from fixel.simulation.simulate import SceneWithMethod
    from fixel.simulation.stepping import AbstractStepper
    from fixel.uncertainty.error_terms import StartError
    from fixel.workflows.planning.request import PlanAnswer

ENDING: Final = ".plan"  # of plan files


def plan(
    scene: Scene | SceneWithMethod | str | PathLike[str],
    goal: Goal,
    choose: FreePushes | RigPushes | None = None,
    belief: Belief | None = None,
    *,
    rollouts: Annotated[int, Door(also=("--budget",), least=1000, most=10**9)] = 160_000,
    looks: Annotated[int, Door(least=0)] = 0,
    camera: StartError | None = None,
    lost_views: float = 0.0,
    seed: Seed = 0,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    untrusted: bool = False,
    first: Sequence[Sequence[PlanPush | RigPush]] = (),
    threads: Threads = None,
    store: Annotated[
        PathLike[str] | str | None, Door(plain=Path | None, metavar="FOLDER", effort=True)
    ] = None,
    progress: ProgressOption = None,
) -> PushPlan:
    """Plan pushes that reach a goal although parameters and start are uncertain.

    Candidates are raced under common samples of what is unknown, the best are refined, and the
    success probability of the chosen plan is computed from samples that the search has not seen.

    Parameters
    ----------
    scene : Scene, scene file or path
        Part at its start, fixels, and perhaps the tool as the pusher.
    goal : Goal
        `PoseRegion`, `Seated`, `Inside`, `Beyond`, or a combination by `AllOf` and `AnyOf`.
    choose : FreePushes or RigPushes, optional
        What may be chosen; by default one push of a free tool.
    belief : Belief, optional
        What is unknown; by default nothing.
    rollouts : int
        Number of simulated pushes that the search may use. The same number, seed and version give
        the same plan to the last bit, for any number of threads.
    looks : int
        Number of times that the part is seen and corrected by a push after the planned ones. The
        success probability is that of the whole policy.
    camera : StartError, optional
        Error of a seen pose; by default that of the stickers' camera.
    lost_views : float
        Share of the looks that see nothing; the part then stays where it is.
    seed : int
        Seed of the random numbers.
    motion, stepper : optional
        Method of the simulations; by default that of the calibration, else quasi-static.
    untrusted : bool
        Whether pushes may be chosen that resemble none of the calibration's experiments.
    first : sequence of sequences of PlanPush or RigPush
        Plans that are tried besides those that the search finds.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder in which the work is stored as it is done; the same call continues it.
    progress : bool or callable, optional
        As for `fixel.calibrate`.

    Returns
    -------
    PushPlan

    Raises
    ------
    InvalidInput
        The goal cannot be reached, names what the scene does not have, or needs pushes that no
        experiment resembles.
    Interrupted
        After Ctrl-C; with `store`, the same call continues.

    Examples
    --------
    >>> from fixel import Belief, PoseRegion, StartError
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import deg, mm
    >>> goal = PoseRegion((0.02, 0.0, 0.0), position=3 * mm, angle=4 * deg)
    >>> start = StartError(x=mm, y=mm, kind="uniform")
    >>> belief = Belief(parameters={"mu_pusher": (0.2, 0.4)}, start=start)
    >>> found = plan(pushed_square(), goal, belief=belief, rollouts=8_000, progress=False)
    >>> found.success.mean > 0.8
    True
    """
    from fixel.errors import Interrupted
    from fixel.model import Scene
    from fixel.planning.belief import Belief
    from fixel.planning.plan import plan_rounds, search_of
    from fixel.planning.pushes import FreePushes
    from fixel.planning.search import Views, conduct
    from fixel.progress import show_progress
    from fixel.simulation.motion import motion_model
    from fixel.simulation.simulate import scene_file
    from fixel.trust import permit
    from fixel.uncertainty.error_terms import RPI_CAMERA
    from fixel.workflows.planning.request import answers_in

    permit(motion)
    # The method of a scene file is not that of the calibration.
    own = scene if isinstance(scene, Scene) else scene_file(scene, "a Scene or a scene file").scene
    with show_progress(progress, "planning") as report, answers_in(store) as answers:
        try:
            search = search_of(
                own, goal, choose or FreePushes(), belief or Belief(),
                rollouts=rollouts, seed=seed, threads=threads,
                motion=None if motion is None else motion_model(motion), stepper=stepper,
                first=first, report=report.show,
                views=Views(looks, RPI_CAMERA if camera is None else camera, lost_views),
            )  # fmt: skip
            return conduct(search, plan_rounds(search, untrusted=untrusted), answers)
        except KeyboardInterrupt:
            where = "" if store else "with store=FOLDER "
            raise Interrupted(None, f"{where}the same request continues") from None


def plan_goal(
    project: Project | None,
    goal: Annotated[str, Door(metavar="GOAL", content=True)],
    *,
    scene: Annotated[
        Path | None, Door(usual="that of the goal file, else of the calibration")
    ] = None,
    experiment: Annotated[str, Door(metavar="KEY")] = "",
    calibration: Annotated[
        int | None, Door(least=1, usual="that of the goal file, else the newest")
    ] = None,
    out: Annotated[
        Path | None, Door(also=("--save",), usual="GOAL.plan", writes=True, effort=True)
    ] = None,
    progress: ProgressOption = None,
    **options: Any,
) -> PlanAnswer:
    """Plan pushes that reach a goal, with a success probability.

    `fixel plan GOAL` is short for `fixel plan find GOAL`.

    Parameters
    ----------
    goal : str
        Goal file, or the content of one in JSON.
    scene : Path, optional
        Scene file.
    experiment : str
        Experiment of the project whose scene is used, by id or name.
    calibration : int, optional
        Id of the calibration whose parameters are used.
    out : Path, optional
        Plan file to write.
    **options
        Options of `plan`.

    Raises
    ------
    InvalidInput
        The goal file is invalid, its goal does not fit the scene or cannot be reached, or there is
        no scene.
    """
    from fixel.io.atomic import refuse_unwritable
    from fixel.workflows.planning import request

    content, folder = request.goal_content(goal)
    if out is None and not request.is_content(goal):
        out = Path(goal).with_suffix(ENDING)
    if out is not None:
        refuse_unwritable(out)
    own = request.inputs_of(project, content, folder, scene, experiment, calibration)
    made = plan(*own.parts, progress=progress, **{**own.file.views, **options})
    found = request.found_plan(own, made, options)
    if out is not None:
        request.save_plan(found, out)
    return request.PlanAnswer(found, out)


def _rounds(*place: Any, **options: Any) -> Iterator[Any]:
    from fixel.workflows.planning.rounds import plan_in_rounds

    return plan_in_rounds(*place, **options)


def _settled(project: Project, request: Any) -> Any:
    from fixel.workflows.planning.request import settled

    return settled(project, request)


PLAN: Final = Capability(
    name="plan",
    title="Plan",
    group="plan",
    verb="find",
    function=plan_goal,
    of=plan,
    leave_out=(
        "scene", "goal", "choose", "belief", "camera", "lost_views", "motion", "stepper", "first",
    ),
    rounds=_rounds,
    settled=_settled,
    on_table=True,
)  # fmt: skip
