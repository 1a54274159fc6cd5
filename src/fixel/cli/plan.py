"""`fixel plan`: pushes that reach a goal despite what is unknown."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup

from fixel.cli.options import (
    AsJson,
    PictureFolder,
    ProjectFolder,
    Seed,
    option,
    require_folder,
    required,
    with_options,
)
from fixel.cli.screen import (
    command_line,
    command_of,
    notify,
    paragraphs,
    print_answer,
    seconds,
    wrote,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.drawing.chart import AbstractChart
    from fixel.planning.trials import Trials
    from fixel.typing import FloatArray
    from fixel.workflows.acquisition.record import RecordPlan
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.planning.check import CheckedPlan
    from fixel.workflows.planning.request import FoundPlan, PlanRequest

FIND: Final = "find"


class GoalFirst(TyperGroup):
    """Command group whose first argument may be a goal file: `plan GOAL` is `plan find GOAL`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, *ctx.help_option_names):
            args = [FIND, *args]
        found: list[str] = super().parse_args(ctx, args)
        return found


app = typer.Typer(
    cls=GoalFirst,
    help="Plan pushes that reach a goal, and check and run plans.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

PlanPath = Annotated[
    Path, typer.Argument(help="Plan file.", metavar="PLAN", exists=True, dir_okay=False)
]


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Options of `fixel plan`."""

    scene: Path | None = option(
        None,
        "Scene file; by default that of the goal file, else that of the calibration.",
        exists=True,
        dir_okay=False,
    )
    experiment: str | None = option(
        None, "Experiment of the project whose scene is used, by id or name.", metavar="KEY"
    )
    calibration: int | None = option(
        None, "Id of the calibration; by default that of the goal file, else the newest.", min=1
    )
    rollouts: int = option(
        160_000, "Number of simulated pushes that the search may use.", "--rollouts", "--budget",
        min=1000,
    )  # fmt: skip
    seed: Seed = 0
    untrusted: bool = option(
        False, "Allow pushes that resemble none of the calibration's experiments.", "--untrusted"
    )

    def request(self, goal: Path) -> "PlanRequest":
        """Request for a plan."""
        from fixel.workflows.planning.request import PlanRequest

        return PlanRequest.of_file(
            goal,
            scene="" if self.scene is None else str(self.scene),
            experiment=self.experiment or "",
            calibration=self.calibration,
            rollouts=self.rollouts,
            seed=self.seed,
            untrusted=self.untrusted,
        )


@app.command(FIND)
@with_options
def find(
    *,
    goal: Path = required("Goal file.", metavar="GOAL", exists=True, dir_okay=False),
    folder: ProjectFolder = Path(),
    options: PlanOptions,
    save: Path | None = option(
        None, "Write the plan to this file.", "--save", show_default="GOAL.plan"
    ),
    store: Path | None = option(
        None, "Folder in which the work is stored; the same command continues it.", metavar="FOLDER"
    ),
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Plan pushes that reach a goal, with a success probability.

    `fixel plan GOAL` is short for `fixel plan find GOAL`.
    """
    from fixel.io.atomic import refuse_unwritable
    from fixel.workflows.planning import request as requests
    from fixel.workflows.planning.report import store_plan
    from fixel.workflows.planning.stored import ENDING, save_plan

    began = time.monotonic()
    wanted = options.request(goal)
    target = save or goal.with_suffix(ENDING)
    refuse_unwritable(target)
    require_folder(plot)
    project = _project(folder)
    progress = False if as_json else None
    found = requests.find_plan(project, wanted, store=store, progress=progress)
    save_plan(found, target)
    duration = time.monotonic() - began
    files, kept = [target], None
    if project is not None:
        kept = store_plan(project, found, command_line(), duration)
        files += [] if plot is None else kept.copy_pictures(plot)
    elif plot is not None:
        files += _pictures(found, plot)
    print_answer(
        as_json,
        lambda: _content(found, files),
        lambda: _lines(found, files, target, kept, duration, folder),
    )


@app.command("check")
@with_options
def check(
    *,
    plan: PlanPath,
    folder: ProjectFolder = Path(),
    waypoints: Path | None = option(
        None, "Write the motion of the tool for another robot: .csv or .json."
    ),
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Compute the success probability of a plan; count its trials.

    The probability is that under the present calibration.
    """
    from fixel.io.atomic import written_whole
    from fixel.workflows.planning.check import check_plan
    from fixel.workflows.planning.report import waypoints_text

    require_folder(plot)
    checked = check_plan(_project(folder), plan)
    files = [] if plot is None else _pictures(checked.found, plot)
    if waypoints is not None:
        with written_whole(waypoints) as path:
            path.write_text(waypoints_text(checked.found.plan, waypoints), encoding="utf-8")
        files.append(waypoints)
    print_answer(
        as_json,
        lambda: _checked_content(checked) | {"files": [str(f) for f in files]},
        lambda: paragraphs(
            [str(checked.found.plan.goal)],
            [f"push {k}: {one}" for k, one in enumerate(checked.found.plan.pushes, 1)],
            checked.sentences,
            wrote(files),
        ),
    )


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
    """Compare stated with held success on left-out experiments."""
    from fixel.units import deg, mm
    from fixel.workflows.planning.held_out import held_success_of

    project = _project(folder)
    if project is None:
        raise InvalidInput("--project", found=str(folder), expected="a project with a calibration")
    found = held_success_of(
        project, calibration, position=position_mm * mm, angle=angle_deg * deg, seed=seed
    )
    print_answer(as_json, found.to_dict, lambda: str(found))


@app.command("next")
@with_options
def next_(
    *,
    plan: PlanPath,
    seen: Annotated[
        str,
        typer.Option(help="Seen pose of the part: x,y,angle [mm, mm, deg].", metavar="X,Y,ANGLE"),
    ],
    done: int = option(0, "Number of pushes that were carried out.", min=0),
    save: Path | None = option(None, "Write the new plan to this file.", "--save"),
    rollouts: int = option(12_000, "Number of simulated pushes.", min=1000),
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Plan again from a seen pose, with the pushes that are left."""
    from fixel.workflows.planning.check import next_plan, seen_pose
    from fixel.workflows.planning.stored import ENDING, save_plan

    began = time.monotonic()
    pose = seen_pose(seen)
    progress = False if as_json else None
    found = next_plan(_project(folder), plan, pose, done=done, rollouts=rollouts, progress=progress)
    target = save or plan.with_name(f"{plan.stem}-next{ENDING}")
    save_plan(found, target)
    print_answer(
        as_json,
        lambda: _content(found, [target]),
        lambda: _lines(found, [target], target, None, time.monotonic() - began, folder),
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
            return None
        if self.out is None:
            raise InvalidInput("--out", found=None, expected="a new folder for the recording")
        return RecordPlan(camera=self.camera, folder=self.out, rig=self.rig)

    def run(self, plan: Path, project: Path | None) -> "Trials":
        """Carry out a plan once with the drive."""
        from fixel.workflows.acquisition.actuator import chosen_actuator
        from fixel.workflows.planning.check import seen_pose
        from fixel.workflows.planning.execute import run_on_drive

        given = iter([self.start, self.end])

        def seen(sentence: str) -> "FloatArray":
            notify(sentence)
            text = next(given)
            return seen_pose(text or typer.prompt("Seen pose [mm, mm, deg]"), "seen pose")

        return run_on_drive(
            plan,
            chosen_actuator(self.driver, self.port, notify=notify),
            seen=seen,
            notify=notify,
            by=self.by,
            camera=self.recording,
            project=project,
        )


@app.command("run")
@with_options
def run(
    *,
    plan: PlanPath,
    options: DriveOptions,
    trials: int = option(1, "Number of trials on the simulated testbed.", "--trials", "-n", min=1),
    seed: Seed = 1,
    folder: ProjectFolder = Path(),
    as_json: AsJson = False,
) -> None:
    """Carry out a plan and add the trial.

    Ctrl-C, an alarm or another start stops the drive.
    """
    from fixel.workflows.planning.check import present_belief
    from fixel.workflows.planning.execute import run_on_testbed
    from fixel.workflows.planning.stored import load_plan

    found, project = load_plan(plan).found, _project(folder)
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
                 "successes": done.successes, "stated": done.stated, "refuted": done.refuted},
        lambda: [*str(done).splitlines(), f"Next: {again}"],
    )  # fmt: skip


def _project(folder: Path) -> "Project | None":
    """Return the project of a folder; none if the present folder is none."""
    from fixel.database.project import Project

    if folder == Path() and not (folder / "fixel.yaml").is_file():
        return None
    return Project(folder)


def _pictures(found: "FoundPlan", folder: Path) -> list[Path]:
    from fixel.drawing.chart import draw_chart
    from fixel.drawing.planning import CaptureChart, PathsChart

    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    charts: dict[str, AbstractChart] = {"paths": PathsChart.of(found.plan)}
    if found.plan.pushes:
        charts["capture"] = CaptureChart.of(found.plan)
    for name, chart in charts.items():
        files += [folder / f"{name}.{end}" for end in ("png", "pdf")]
        draw_chart(chart, *files[-2:])
    return files


def _content(found: "FoundPlan", files: list[Path]) -> dict[str, Any]:
    from fixel.workflows.planning.report import numbers_of

    own = numbers_of(found)
    return own | {"warnings": list(found.warnings), "files": [str(f) for f in files]}


def _checked_content(checked: "CheckedPlan") -> dict[str, Any]:
    return {
        "plan": checked.id,
        "stated": checked.found.plan.success.stated,
        "now": checked.now.stated,
        "mean_now": checked.now.mean,
        "calibration": checked.calibration,
        "changed": checked.changed,
        "trials": checked.trials.n,
        "successes": checked.trials.successes,
        "refuted": checked.trials.refuted,
    }


def _lines(
    found: "FoundPlan",
    files: list[Path],
    target: Path,
    kept: "StoredAnalysis | None",
    duration: float,
    folder: Path,
) -> list[str]:
    from fixel.workflows.planning.report import headline_of, pushes_table, success_table

    plan = found.plan
    stored = f"stored in {kept.folder}, " if kept is not None else ""
    return paragraphs(
        [f"Unseen: {text}" for text in plan.unseen],
        [f"Goal: {plan.goal}", *pushes_table(plan).lines(), "", *success_table(plan).lines()],
        [
            *headline_of(found),
            *plan.explain().sentences,
            *(f"Warning: {text}." for text in found.warnings if text not in plan.unseen),
        ],
        [*wrote(files), f"{stored}in {seconds(duration)}"],
        [f"Next: {command_of('plan', 'run', target, project=folder)}"] if plan.pushes else [],
    )
