"""`fixel plan`: pushes that reach a goal despite what is unknown."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup

from fixel.capability.options import CalibrationId, Door, EngineName, Seed
from fixel.cli.capability import subcommand, typer_command
from fixel.cli.screen import CommandAnswer, command_of, notify, paragraphs, require_folder, wrote
from fixel.errors import InvalidInput
from fixel.workflows.planning.run import ENDING, PLAN

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.planning.trials import Trials
    from fixel.typing import FloatArray

FIND: Final = "find"
TESTBED: Final = "testbed"
RANGE: Final = ("mean", "low", "high", "worst", "best")  # of a success probability


class GoalFirst(TyperGroup):
    """Command group whose first argument may be a goal file: `plan GOAL` is `plan find GOAL`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, *ctx.help_option_names):
            args = [FIND, *args]
        found: list[str] = super().parse_args(ctx, args)
        return found


app = typer.Typer(
    cls=GoalFirst,
    help="Plan pushes that reach a goal, and check and run plans.\n\n"
    "`fixel plan GOAL` is short for `fixel plan find GOAL`, whose help lists the options.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

PlanPath = Annotated[Path, Door(metavar="PLAN", meaning="Plan file.")]
Pose = Annotated[str | None, Door(metavar="X,Y,ANGLE")]


app.command(FIND)(typer_command(PLAN))


@subcommand(app, "check")
def check(
    project: "Project | None",
    plan: PlanPath,
    *,
    waypoints: Annotated[Path | None, Door(writes=True)] = None,
    plot: Annotated[Path | None, Door(metavar="FOLDER", writes=True)] = None,
) -> CommandAnswer:
    """Compute the success probability of a plan; count its trials.

    The probability is that under the present calibration.

    Parameters
    ----------
    waypoints : Path, optional
        Write the motion of the tool for another robot: .csv or .json.
    plot : Path, optional
        Folder for charts as PNG and PDF, and for their data.
    """
    from fixel.io.atomic import write_whole
    from fixel.workflows.analysis import write_pictures
    from fixel.workflows.planning.execute import check_plan
    from fixel.workflows.planning.report import pictures_of, waypoints_text

    require_folder(plot)
    checked = check_plan(project, plan)
    own = checked.found.plan
    files = write_pictures(plot, pictures_of(own)) if plot is not None else []
    if waypoints is not None:
        write_whole(waypoints, waypoints_text(own, waypoints))
        files.append(waypoints)
    words = [str(own.goal)], [f"push {k}: {one}" for k, one in enumerate(own.pushes, 1)]
    content = {
        "plan": checked.id,
        "stated": own.success.stated,
        "now": checked.now.stated,
        **{f"{name}_now": getattr(checked.now, name) for name in RANGE},
        "calibration": checked.calibration,
        "changed": checked.changed,
        "trials": checked.trials.n,
        "successes": checked.trials.successes,
        "refuted": checked.trials.refuted,
        "sentences": [*words[0], *words[1], *checked.sentences],
        "files": [str(file) for file in files],
    }
    return CommandAnswer(content, paragraphs(*words, checked.sentences, wrote(files)))


@subcommand(app, "held")
def held(
    project: "Project",
    *,
    calibration: CalibrationId = None,
    position: Annotated[float, Door(unit="mm", above=0.0)] = 3e-3,
    angle: Annotated[float, Door(unit="deg", above=0.0)] = math.radians(3.0),
    seed: Seed = 0,
) -> CommandAnswer:
    """Compare stated with observed success on left-out experiments.

    Parameters
    ----------
    calibration : int, optional
        Id of a calibration; by default the newest one.
    position : float
        Tolerance of the position [m].
    angle : float
        Tolerance of the angle [rad].
    """
    from fixel.workflows.analysis import analysis_of
    from fixel.workflows.planning.execute import stored_held_success

    found = stored_held_success(project, calibration, position=position, angle=angle, seed=seed)
    return CommandAnswer(analysis_of("plan", found).texts() | found.to_dict(), [str(found)])


@subcommand(app, "next")
def next_(
    project: "Project | None",
    plan: PlanPath,
    *,
    seen: Annotated[tuple[str, ...], Door(metavar="X,Y,ANGLE")],
    done: Annotated[int, Door(least=0)] = 0,
    out: Annotated[Path | None, Door(also=("--save",), usual="PLAN-next.plan", writes=True)] = None,
    rollouts: Annotated[int, Door(least=1000, meaning="Number of simulated pushes.")] = 12_000,
) -> CommandAnswer:
    """Choose the next push from a seen pose.

    A plan with looks chooses at once. Other plans are made again, with the pushes that are left.

    Parameters
    ----------
    seen : tuple of str
        Seen pose of the part: x,y,angle [mm, mm, deg]; in a plan with looks one for each look so
        far.
    done : int
        Number of pushes that were carried out.
    out : Path, optional
        Write the new plan to this file.
    """
    from fixel.model.fields import pose_of
    from fixel.workflows.planning.execute import next_plan, next_step
    from fixel.workflows.planning.report import analysis_of
    from fixel.workflows.planning.request import save_plan

    poses = [pose_of(text, "seen") for text in seen]
    step = next_step(plan, poses, done)
    if step is not None:
        return CommandAnswer(step.numbers, [step.sentence])
    found = next_plan(project, plan, poses[0], done=done, rollouts=rollouts)
    target = out or plan.with_name(f"{plan.stem}-next{ENDING}")
    save_plan(found, target)
    analysis = analysis_of(found)
    after = command_of("plan", "run", target, project=project.folder if project else Path())
    return CommandAnswer(
        {"met": False, **analysis.numbers, **analysis.texts(), "files": [str(target)]},
        paragraphs(analysis.lines(), wrote([target]), [f"Next: {after}"]),
    )


@subcommand(app, "run")
def run(
    project: "Project | None",
    plan: PlanPath,
    *,
    driver: Annotated[str, Door(metavar="DRIVER")] = TESTBED,
    port: Annotated[str | None, Door(metavar="PORT")] = None,
    start: Pose = None,
    end: Pose = None,
    camera: Annotated[
        str | None,
        Door(
            metavar="SOURCE", meaning="Camera to record with, as for fixel record; by default none."
        ),
    ] = None,
    out: Annotated[Path | None, Door(metavar="FOLDER")] = None,
    rig: Annotated[str | None, Door(metavar="RIG")] = None,
    by: Annotated[str, Door(metavar="NAME")] = "",
    trials: Annotated[int, Door(least=1, also=("-n",))] = 1,
    engine: EngineName = "",
    seed: Seed = 1,
) -> CommandAnswer:
    """Carry out a plan and add the trial.

    Ctrl-C, an alarm, or a start that was not planned stops the drive.

    Parameters
    ----------
    driver : str
        Device: testbed (simulated), or a drive: grbl, manual or simulated.
    port : str, optional
        Serial port of the drive.
    start : str, optional
        Pose of the part before: x,y,angle [mm, mm, deg]; by default a prompt.
    end : str, optional
        Pose of the part after: x,y,angle [mm, mm, deg]; by default a prompt.
    out : Path, optional
        New folder for the recording.
    rig : str, optional
        Rig of the camera: the end of the part is then tracked.
    by : str
        Person who carries it out, stored with the trial.
    trials : int
        Number of trials on the simulated testbed.
    engine : str
        Other simulator, such as pymunk: what is unknown is drawn for every trial, and none is
        added.
    """
    from fixel.workflows.acquisition import RecordPlan
    from fixel.workflows.acquisition.devices import chosen_actuator
    from fixel.workflows.planning.execute import present_belief, run_on_drive, run_on_testbed
    from fixel.workflows.planning.request import load_plan

    filming = {"--camera": camera, "--out": out, "--rig": rig}
    of_drive = {"--port": port, "--start": start, "--end": end, **filming, "--by": by}
    _check_unused(driver, of_drive, {"--trials": trials > 1, "--engine": engine})
    if any(filming.values()) and (camera is None or out is None):
        missing = next(name for name, given in filming.items() if given is None)
        expected = "both to record: --camera SOURCE --out FOLDER"
        raise InvalidInput(missing, found=None, expected=expected)
    recording = RecordPlan(camera=camera, folder=out, rig=rig) if camera and out else None
    found = load_plan(plan).found
    if engine:
        own, stated = found.plan.success_in(engine, trials, seed=seed), found.plan.success.mean
        content = {"engine": engine, "trials": trials, "held": own.value}
        content |= {"low": own.low, "high": own.high, "stated": stated}
        line = f"Held in {engine}: {own}; stated success probability {stated:.4f}"
        return CommandAnswer(content, [line])
    again = command_of("plan", "check", plan, project=project.folder if project else Path())
    if present_belief(project, found)[1] != found.calibration:
        notify(f"The calibration has changed since: {again}")
    if driver == TESTBED:
        done = run_on_testbed(plan, trials=trials, seed=seed)
    else:
        done = run_on_drive(
            plan,
            chosen_actuator(driver, port, notify=notify),
            seen=_asked_poses(start=start, end=end),
            notify=notify,
            by=by,
            recording=recording,
            project=None if project is None else project.folder,
        )
    return _trials(done, again)


def _trials(done: "Trials", again: str) -> CommandAnswer:
    """Report the trials of a plan, and the command that checks it."""
    from fixel.workflows.analysis import analysis_of

    last = done.trials[-1]
    content = {
        "met": last.met, "failure": last.failure, "trials": done.n, "successes": done.successes,
        "stated": done.mean, "least": done.stated, "refuted": done.refuted,
        **analysis_of("plan", done).texts(),
    }  # fmt: skip
    return CommandAnswer(content, [*str(done).splitlines(), f"Next: {again}"])


def _check_unused(
    driver: str, of_drive: Mapping[str, object], of_testbed: Mapping[str, object]
) -> None:
    """Raise for options that the driver does not use."""
    drive, testbed = "a drive: grbl, manual or simulated", "the driver testbed"
    options, expected = (of_drive, drive) if driver == TESTBED else (of_testbed, testbed)
    if unused := [name for name, given in options.items() if given]:
        raise InvalidInput(unused[0], found=f"the driver {driver}", expected=expected)


def _asked_poses(**given: str | None) -> Callable[[str], "FloatArray"]:
    """Return a function that returns the given poses in turn, and prompts for missing ones."""
    from fixel.model.fields import pose_of

    # A mistake in the pose of the end must not lose the trial of a push that was made.
    poses = iter([t if t is None else pose_of(t, f"--{k}") for k, t in given.items()])

    def seen(sentence: str) -> "FloatArray":
        notify(sentence)
        pose = next(poses)
        while pose is None:
            try:
                pose = pose_of(typer.prompt("Seen pose [mm, mm, deg]"), "seen pose")
            except InvalidInput as mistake:
                notify(str(mistake))
        return pose

    return seen
