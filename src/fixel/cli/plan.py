"""`fixel plan`: pushes that reach a goal despite what is unknown."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup

from fixel.capability.capability import named
from fixel.cli.capability import typer_command
from fixel.cli.options import AsJson, ProjectFolder, Seed, option, require_folder, with_options
from fixel.cli.screen import command_of, notify, paragraphs, print_answer, wrote
from fixel.errors import InvalidInput
from fixel.workflows.planning.run import ENDING, PLAN

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.planning.trials import Trials
    from fixel.typing import FloatArray
    from fixel.workflows.acquisition.record import RecordPlan
    from fixel.workflows.planning.execute import CheckedPlan

FIND: Final = "find"
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

PlanPath = Annotated[
    Path, typer.Argument(help="Plan file.", metavar="PLAN", exists=True, dir_okay=False)
]


app.command(FIND)(typer_command(PLAN))


@app.command("check")
@with_options
def check(
    *,
    plan: PlanPath,
    folder: ProjectFolder = Path(),
    waypoints: Path | None = option(
        None, "Write the motion of the tool for another robot: .csv or .json."
    ),
    plot: Path | None = option(
        None, "Folder for charts as PNG and PDF, and for their data.", metavar="FOLDER"
    ),
    as_json: AsJson = False,
) -> None:
    """Compute the success probability of a plan; count its trials.

    The probability is that under the present calibration.
    """
    from fixel.io.atomic import write_whole
    from fixel.workflows.figures import write_pictures
    from fixel.workflows.planning.execute import check_plan
    from fixel.workflows.planning.report import pictures_of, waypoints_text

    require_folder(plot)
    checked = check_plan(_project(folder), plan)
    files = write_pictures(plot, pictures_of(checked.found.plan)) if plot is not None else []
    if waypoints is not None:
        write_whole(waypoints, waypoints_text(checked.found.plan, waypoints))
        files.append(waypoints)
    _print_checked(checked, files, as_json)


@app.command()
@with_options
def held(
    *,
    folder: ProjectFolder = Path(),
    calibration: int | None = option(None, "Id of a calibration; by default the newest one."),
    position_mm: float = option(3.0, "Tolerance of the position [mm].", min=1e-6),
    angle_deg: float = option(3.0, "Tolerance of the angle [deg].", min=1e-6),
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Compare stated with observed success on left-out experiments."""
    from fixel.units import deg, mm
    from fixel.workflows.analysis import analysis_of
    from fixel.workflows.planning.execute import stored_held_success

    project = _project(folder)
    if project is None:
        raise InvalidInput("--project", found=str(folder), expected="a project with a calibration")
    found = stored_held_success(
        project, calibration, position=position_mm * mm, angle=angle_deg * deg, seed=seed
    )
    words = analysis_of("plan", found).texts()
    print_answer(as_json, lambda: words | found.to_dict(), lambda: str(found))


@app.command("next")
@with_options
def next_(
    *,
    plan: PlanPath,
    seen: Annotated[
        list[str],
        typer.Option(
            help="Seen pose of the part: x,y,angle [mm, mm, deg]; in a plan with looks one for"
            " each look so far.",
            metavar="X,Y,ANGLE",
        ),
    ],
    done: int = option(0, "Number of pushes that were carried out.", min=0),
    out: Path | None = option(
        None, "Write the new plan to this file.", "--out", "--save", show_default="PLAN-next.plan"
    ),
    rollouts: int = option(12_000, "Number of simulated pushes.", min=1000),
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Choose the next push from a seen pose.

    A plan with looks chooses at once. Other plans are made again, with the pushes that are left.
    """
    from fixel.model.fields import pose_of
    from fixel.workflows.planning.execute import next_plan, next_step
    from fixel.workflows.planning.report import analysis_of
    from fixel.workflows.planning.request import save_plan

    poses = [pose_of(text, "--seen") for text in seen]
    try:
        step = next_step(plan, poses, done)
        if step is not None:
            print_answer(as_json, lambda: step.numbers, lambda: [step.sentence])
            return
        found = next_plan(_project(folder), plan, poses[0], done=done, rollouts=rollouts)
    except InvalidInput as error:
        raise named(error, {name: f"--{name}" for name in ("done", "seen")}) from None
    target = out or plan.with_name(f"{plan.stem}-next{ENDING}")
    save_plan(found, target)
    analysis = analysis_of(found)
    print_answer(
        as_json,
        lambda: {"met": False, **analysis.numbers, **analysis.texts(), "files": [str(target)]},
        lambda: paragraphs(
            analysis.lines(),
            wrote([target]),
            [f"Next: {command_of('plan', 'run', target, project=folder)}"],
        ),
    )


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """Options of `fixel plan run` for a drive and a camera."""

    driver: str = option(
        "testbed",
        "Device: testbed (simulated), or a drive: grbl, manual or simulated.",
        metavar="DRIVER",
    )
    port: str | None = option(None, "Serial port of the drive.", metavar="PORT")
    start: str | None = option(
        None, "Pose of the part before: x,y,angle [mm, mm, deg]; by default a prompt.",
        metavar="X,Y,ANGLE",
    )  # fmt: skip
    end: str | None = option(
        None, "Pose of the part after: x,y,angle [mm, mm, deg]; by default a prompt.",
        metavar="X,Y,ANGLE",
    )  # fmt: skip
    camera: str | None = option(
        None, "Camera to record with, as for fixel record; by default none.", metavar="SOURCE"
    )
    out: Path | None = option(None, "New folder for the recording.", metavar="FOLDER")
    rig: str | None = option(
        None, "Rig of the camera: the end of the part is then tracked.", metavar="RIG"
    )
    by: str = option("", "Person who carries it out, stored with the trial.", metavar="NAME")

    @property
    def recording(self) -> "RecordPlan | None":
        """Recording to make while the drive moves."""
        from fixel.workflows.acquisition.record import RecordPlan

        if self.camera is None:
            if self.out is None and self.rig is None:
                return None
            raise InvalidInput("--camera", found=None, expected="the camera for --out and --rig")
        if self.out is None:
            raise InvalidInput("--out", found=None, expected="a new folder for the recording")
        return RecordPlan(camera=self.camera, folder=self.out, rig=self.rig)

    def run(self, plan: Path, project: Path | None) -> "Trials":
        """Carry out a plan once with the drive."""
        from fixel.model.fields import pose_of
        from fixel.workflows.acquisition.devices import chosen_actuator
        from fixel.workflows.planning.execute import run_on_drive

        given = iter([self.start, self.end])

        def seen(sentence: str) -> "FloatArray":
            notify(sentence)
            text = next(given)
            return pose_of(text or typer.prompt("Seen pose [mm, mm, deg]"), "seen pose")

        return run_on_drive(
            plan,
            chosen_actuator(self.driver, self.port, notify=notify),
            seen=seen,
            notify=notify,
            by=self.by,
            recording=self.recording,
            project=project,
        )


@app.command("run")
@with_options
def run(
    *,
    plan: PlanPath,
    options: DriveOptions,
    trials: int = option(1, "Number of trials on the simulated testbed.", "--trials", "-n", min=1),
    engine: str = option(
        "",
        "Other simulator, such as pymunk: what is unknown is drawn for every trial, and none is "
        "added.",
        metavar="ENGINE",
    ),
    seed: Seed = 1,
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Carry out a plan and add the trial.

    Ctrl-C, an alarm, or a start that was not planned stops the drive.
    """
    from fixel.workflows.analysis import analysis_of
    from fixel.workflows.planning.execute import present_belief, run_on_testbed
    from fixel.workflows.planning.request import load_plan

    _check_run(options, trials, engine)
    found, project = load_plan(plan).found, _project(folder)
    if engine:
        held, stated = found.plan.success_in(engine, trials, seed=seed), found.plan.success.mean
        return print_answer(
            as_json,
            lambda: {"engine": engine, "trials": trials, "held": held.value,
                     "low": held.low, "high": held.high, "stated": stated},
            lambda: [f"Held in {engine}: {held}; stated success probability {stated:.4f}"],
        )  # fmt: skip
    again = command_of("plan", "check", plan, project=folder)
    if present_belief(project, found)[1] != found.calibration:
        notify(f"The calibration has changed since: {again}")
    if options.driver == "testbed":
        done = run_on_testbed(plan, trials=trials, seed=seed)
    else:
        done = options.run(plan, None if project is None else folder)
    last = done.trials[-1]
    print_answer(
        as_json,
        lambda: {"met": last.met, "failure": last.failure, "trials": done.n,
                 "successes": done.successes, "stated": done.mean, "least": done.stated,
                 "refuted": done.refuted, **analysis_of("plan", done).texts()},
        lambda: [*str(done).splitlines(), f"Next: {again}"],
    )  # fmt: skip


def _check_run(options: DriveOptions, trials: int, engine: str) -> None:
    """Raise for options that the driver does not use."""
    if options.driver == "testbed":
        given = {one.name: getattr(options, one.name) != one.default for one in fields(options)}
        expected = "a drive: grbl, manual or simulated"
    else:
        given, expected = {"trials": trials > 1, "engine": engine != ""}, "the driver testbed"
    if unused := [name for name, differs in given.items() if differs]:
        found = f"the driver {options.driver}"
        raise InvalidInput(f"--{unused[0]}", found=found, expected=expected)


def _project(folder: Path) -> "Project | None":
    """Return the project of a folder; none if the present folder is none."""
    from fixel.database.project import Project

    if folder == Path() and not (folder / "fixel.yaml").is_file():
        return None
    return Project(folder)


def _print_checked(checked: "CheckedPlan", files: list[Path], as_json: bool) -> None:
    plan = checked.found.plan
    words = [str(plan.goal)], [f"push {k}: {one}" for k, one in enumerate(plan.pushes, 1)]
    content = {
        "plan": checked.id,
        "stated": plan.success.stated,
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
    print_answer(
        as_json, lambda: content, lambda: paragraphs(*words, checked.sentences, wrote(files))
    )
