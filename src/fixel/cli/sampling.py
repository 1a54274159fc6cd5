"""`fixel sample [PLAN.yaml]`: plan experiments."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from fixel.cli.options import AsJson, argument, option, with_options
from fixel.cli.screen import command_of, paragraphs, print_answer, shortened, wrote
from fixel.errors import InvalidInput
from fixel.table import Table

if TYPE_CHECKING:
    from fixel.workflows.sampling import SampleAnswer

MAX_PROBLEMS = 20


@with_options
def sample(
    *,
    plan: Path | None = argument(
        None,
        "Plan file, YAML or JSON; by default the 420 experiments of the thesis.",
        metavar="PLAN",
        exists=True,
        dir_okay=False,
        show_default=False,
    ),
    plot: Path | None = option(None, "Draw the plan: .png, .svg or .pdf."),
    as_json: AsJson = False,
    output: Path | None = option(None, "Write the plan to this file: .yaml."),
    eight_push: bool = option(
        False,
        "Use the eight pushes of the ASME paper, which identify three support points, instead of "
        "the scheme of the thesis.",
        "--eight-push",
    ),
    simulate: bool = option(
        False, "Simulate every experiment and check that the object touches a fixel.", "--simulate"
    ),
) -> None:
    """Create a plan of experiments and report its problems."""
    from fixel.workflows.sampling import sample as sample_plan

    if eight_push and plan is not None:
        raise InvalidInput(
            "--eight-push", found="a plan file and --eight-push", expected="one of them"
        )
    answer = sample_plan(plan, eight_push=eight_push, output=output, plot=plot, simulate=simulate)
    print_answer(as_json, answer.summary, lambda: _lines(answer, plan, eight_push))


def _lines(answer: "SampleAnswer", path: Path | None, eight_push: bool) -> list[str]:
    """About a screen of text: counts, problems, files, the next command."""
    return paragraphs(
        _counts(answer),
        _problems(answer),
        wrote(answer.files.values()),
        [f"Next: {_next(answer, path, eight_push)}"],
    )


def _counts(answer: "SampleAnswer") -> list[str]:
    plan = answer.plan
    n_layouts, n = len(plan.layouts), len(plan.layouts) * plan.configurations * plan.repetitions
    rows: list[tuple[str | int, ...]] = [
        (shape.name, n_layouts, plan.configurations, plan.repetitions, n) for shape in plan.shapes
    ]
    rows.append((f"{len(plan.shapes)} in all", "", "", "", plan.total))
    numbered = [layout.title for layout in plan.layouts if layout.number is not None]
    listed = "layouts: " + ", ".join(numbered) if numbered else ""
    hours = plan.total * plan.rig.duration / 3600.0
    return [
        f"plan {plan.name}",
        *Table(("shape", "layouts", "configurations", "repetitions", "experiments"), rows).lines(),
        *textwrap.wrap(listed, 100, break_on_hyphens=False),
        f"{plan.rig.duration:.3g} s per push, {hours:.2g} h in total",
    ]


def _problems(answer: "SampleAnswer") -> list[str]:
    how = "by geometry and simulation" if answer.rehearsed else "by geometry"
    n = len(answer.problems)
    if not n:
        return [f"No problems, checked {how}."]
    shown = [f"  {p.name}: {p.sentence}" for p in answer.problems[:MAX_PROBLEMS]]
    return [f"{n} problem{'s' * (n != 1)}, checked {how}", *shortened(shown, n, "  ")]


def _next(answer: "SampleAnswer", path: Path | None, eight_push: bool) -> str:
    """Return the command that most users need next."""
    plan = answer.files.get("output", path)
    if plan is None:
        design = ["--eight-push"] if eight_push else []
        return command_of("sample", *design, "--output", "plan.yaml")
    if not any(layout.pegs for layout in answer.plan.layouts):  # the testbed is for grasps
        return command_of("sample", plan, "--simulate")
    return command_of("testbed", "run", plan)
