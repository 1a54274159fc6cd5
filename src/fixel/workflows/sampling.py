"""Load or create a sampling plan, check, save and draw it; read the rows of any plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

from fixel.capability.capability import Capability
from fixel.capability.options import Door
from fixel.errors import InvalidInput, counted

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import PlannedExperiment, Scene
    from fixel.sampling import Plan, PlanProblem
    from fixel.table import Table
    from fixel.workflows.analysis import AnalysisReport, StoredAnswer

PLAN_ENDINGS: Final = (".yaml", ".yml")
MAX_PROBLEMS: Final = 20


class SampleAnswer(NamedTuple):
    """Sampling plan with its problems."""

    plan: Plan
    problems: tuple[PlanProblem, ...]  # in order of the plan
    rehearsed: bool  # whether problems were also searched for by simulation


def planned_rows(
    path: Path, project: Project | None = None, *, scene: Path | None = None
) -> tuple[PlannedExperiment, ...]:
    """Read the experiments of a plan in order, each with its scene.

    Raise `InvalidInput` with the first error of the file, and its key, or its row and column.

    Parameters
    ----------
    path : Path
        Plan file, or a table with one row per experiment, as `fixel sample --scenes` writes it.
    project : Project, optional
        Project of the stored experiments that a table names.
    scene : Path, optional
        Scene file from which the rows of a table differ; by default `scene.yaml` in its folder.
    """
    from fixel.calibration.target import scene_of
    from fixel.datasets.plan_table import read_rows
    from fixel.datasets.table import ENDINGS
    from fixel.errors import NotStored
    from fixel.formats.plan_file import load_plan

    if not path.name.lower().endswith(ENDINGS):
        if scene is not None:
            expected = "a table of experiments, .csv: a plan file describes its scenes itself"
            raise InvalidInput("scene", found=f"the plan file {path}", expected=expected)
        return load_plan(path).experiments

    def stored(name: str) -> Scene:
        if project is None:
            raise InvalidInput(name, found="no project", expected="a project with this experiment")
        try:
            with project.store() as store:
                return scene_of(store.experiment(store.find(name)))
        except NotStored as missing:  # the place is that of its cell
            found, expected = f"no {missing.what}", "a stored experiment"
            raise InvalidInput("", found=found, expected=expected, hint=missing.hint) from None

    return read_rows(path, scene, stored)


def sample(
    plan: Annotated[
        Path | None, Door(metavar="PLAN", usual="the 420 experiments of the thesis")
    ] = None,
    *,
    out: Annotated[Path | None, Door(also=("--output",), writes=True, effort=True)] = None,
    scenes: Annotated[Path | None, Door(metavar="FOLDER", writes=True, effort=True)] = None,
    eight_push: bool = False,
    table: bool = False,
    simulate: bool = False,
    progress: object = None,
) -> SampleAnswer:
    """Create a plan of experiments and report its problems.

    Parameters
    ----------
    plan : Path, optional
        Plan file, YAML or JSON.
    out : Path, optional
        Plan file to write, .yaml.
    scenes : Path, optional
        New folder for the scene of each experiment and a table of them, plan.csv.
    eight_push : bool
        Whether to use the eight pushes of the ASME paper, which identify three support points,
        instead of the scheme of the thesis.
    table : bool
        Whether to plan equal pushes for `fixel table check`. The rig moves to places and
        orientations of the table.
    simulate : bool
        Whether to simulate every experiment and check that the object touches a fixel.
    """
    from fixel.datasets.plan_table import write_rows
    from fixel.drawing.chart import require_file
    from fixel.formats.frames_file import refuse_folder
    from fixel.formats.plan_file import load_plan, plan_text
    from fixel.io.atomic import write_whole
    from fixel.sampling import eight_push_plan, rehearse, table_plan, thesis_plan
    from fixel.simulation.simulate import get_ready

    given = {"eight_push": eight_push, "table": table, "plan": plan is not None}
    first, *others = [name for name, own in given.items() if own] or [""]
    if others:
        expected = "one of the eight pushes, the check of a table, and a plan file"
        raise InvalidInput(first, found="another plan too", expected=expected)
    require_file(out, PLAN_ENDINGS, "plan")
    if out is not None and plan is not None and out.resolve() == plan.resolve():
        expected = "another file to write"
        raise InvalidInput(str(out), found="the plan file itself", expected=expected)
    if scenes is not None:
        refuse_folder(scenes)
    if plan is not None:
        own = load_plan(plan)
    else:
        own = eight_push_plan() if eight_push else table_plan() if table else thesis_plan()
    problems = own.check()
    if simulate and own.experiments:
        get_ready(own.experiments[0].scene)
        problems = tuple(sorted([*problems, *rehearse(own).problems]))
    if out is not None:
        write_whole(out, plan_text(own))
    if scenes is not None:
        write_rows(scenes, own.experiments)
    return SampleAnswer(own, problems, simulate)


# --- presentation ---------------------------------------------------------------------------------


def report_of(answer: SampleAnswer) -> AnalysisReport:
    """Return counts, problems and every experiment of a plan."""
    from fixel.sampling.published import sources_of
    from fixel.table import Table
    from fixel.workflows.analysis import Analysis, AnalysisReport

    plan = answer.plan
    said = sources_of(plan)
    numbered = {own.name: own.number for own in plan.layouts if own.number is not None}
    titles = [own.title for own in plan.layouts if own.number is not None]
    hours = plan.total * plan.rig.duration / 3600.0
    numbers = {
        "plan": plan.name,
        "shapes": len(plan.shapes),
        "layouts": len(plan.layouts),
        "configurations": plan.configurations,
        "repetitions": plan.repetitions,
        "total": plan.total,
        "layout_numbers": numbered,
        "duration_s": plan.rig.duration,
        "rehearsed": answer.rehearsed,
        "problems": [problem._asdict() for problem in answer.problems],
        "experiments": [{"name": own.name, **own.conditions} for own in plan.experiments],
    }
    return AnalysisReport(
        Analysis(
            kind="sample",
            title=f"Plan {plan.name}",
            question={},
            headline=(f"plan {plan.name}",),
            tables=(_table(plan), *([Table(("value", "source"), said, left=2)] if said else [])),
            notes=(
                *([f"layouts: {', '.join(titles)}"] if titles else []),
                *([f"{n} places of the rig on the table"] if (n := len(plan.places)) > 1 else []),
                f"{plan.rig.duration:.3g} s per push, {hours:.2g} h in total",
                *_problems(answer),
            ),
            numbers=numbers,
        )
    )


def draw(answer: SampleAnswer, path: Path) -> None:
    """Draw a plan into a file."""
    from fixel.drawing.plan import draw_plan
    from fixel.io.atomic import written_whole

    with written_whole(path) as unfinished:
        draw_plan(answer.plan, unfinished)


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that most users need next."""
    request: Any = done.request
    plan, found = request.out or request.plan, done.result.plan
    if request.scenes and found.experiments:
        scene = request.scenes / f"{found.experiments[0].name}.yaml"
        return ["overlay", scene, "--rig", "thesis-tags"]
    if plan is None:
        return [*done.again, "--out", "plan.yaml"]
    # The testbed is for grasps and tables.
    if len(found.places) == 1 and not any(layout.pegs for layout in found.layouts):
        return ["sample", plan, *(["--scenes", plan.stem] if request.simulate else ["--simulate"])]
    return ["testbed", "run", plan]


def _table(plan: Plan) -> Table:
    from fixel.table import Table

    n_layouts, n = len(plan.layouts), plan.total // len(plan.shapes)
    rows: list[tuple[str | int, ...]] = [
        (shape.name, n_layouts, plan.configurations, plan.repetitions, n) for shape in plan.shapes
    ]
    rows.append((f"{len(plan.shapes)} in all", "", "", "", plan.total))
    return Table(("shape", "layouts", "configurations", "repetitions", "experiments"), rows)


def _problems(answer: SampleAnswer) -> list[str]:
    from fixel.table import shortened

    how = "by geometry and simulation" if answer.rehearsed else "by geometry"
    n = len(answer.problems)
    if not n:
        return [f"No problems, checked {how}."]
    shown = [f"  {own.name}: {own.sentence}" for own in answer.problems[:MAX_PROBLEMS]]
    return [f"{counted(n, 'problem')}, checked {how}", *shortened(shown, n, "  ")]


SAMPLE: Final = Capability(name="sample", function=sample, plot="file")
