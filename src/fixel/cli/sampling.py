"""`fixel sample [PLAN.yaml]`: plan experiments."""

import json
import shlex
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.sampling.run import SampleAnswer

MAX_PROBLEMS = 20


def sample(
    plan: Annotated[
        Path | None,
        typer.Argument(
            help="Plan file, YAML or JSON; left out, the thesis's scheme of 420 experiments.",
            metavar="PLAN",
            exists=True,
            dir_okay=False,
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the plan: .png, .svg or .pdf.", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
    output: Annotated[
        Path | None, typer.Option(help="Write the plan to this file: .yaml.", metavar="FILE")
    ] = None,
    eight_push: Annotated[
        bool,
        typer.Option(
            "--eight-push",
            help="Instead of the thesis's scheme, the eight pushes of the ASME paper with which"
            " three support points are identified.",
        ),
    ] = False,
    simulate: Annotated[
        bool,
        typer.Option("--simulate", help="Simulate every experiment: does it touch a fixel?"),
    ] = False,
) -> None:
    """Lay out a plan of experiments, and report its problems."""
    from fixel.cli.screen import notify
    from fixel.workflows.sampling.run import sample as sample_plan

    if eight_push and plan is not None:
        raise InvalidInput("--eight-push", found="a plan file too", expected="one of them")
    answer = sample_plan(
        plan,
        eight_push=eight_push,
        output=output,
        plot=plot,
        simulate=simulate,
        notify=notify if sys.stderr.isatty() or not as_json else None,
    )
    if as_json:
        typer.echo(json.dumps(answer.summary(), allow_nan=False))
    else:
        typer.echo(written(answer, plan, "--eight-push" if eight_push else ""))


def written(answer: "SampleAnswer", path: Path | None, design: str = "") -> str:
    """Return about a screen of text: counts, problems, files, the next command."""
    blocks = [
        _counts(answer),
        _problems(answer),
        [f"wrote {file}" for file in answer.files.values()],
        [f"Next: {_next(answer, path, design)}"],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _counts(answer: "SampleAnswer") -> list[str]:
    from fixel.cli.screen import table

    plan = answer.plan
    layouts, configurations = str(len(plan.layouts)), str(plan.configurations)
    each = len(plan.layouts) * plan.configurations * plan.repetitions
    rows = [
        (shape.name, layouts, configurations, str(plan.repetitions), str(each))
        for shape in plan.shapes
    ]
    rows.append((f"{len(plan.shapes)} in all", "", "", "", str(plan.total)))
    numbered = [layout.title for layout in plan.layouts if layout.number is not None]
    head = ("shape", "layouts", "configurations", "repetitions", "experiments")
    hours = plan.total * plan.rig.duration / 3600.0
    return [
        f"plan {plan.name}",
        *table(head, rows),
        *textwrap.wrap(
            "layouts: " + ", ".join(numbered) if numbered else "", 100, break_on_hyphens=False
        ),
        f"each pushes for {plan.rig.duration:.3g} s, all together {hours:.2g} h",
    ]


def _problems(answer: "SampleAnswer") -> list[str]:
    how = "by geometry and simulation" if answer.rehearsed else "by geometry"
    if not answer.problems:
        return [f"No problems, checked {how}."]
    shown = [f"  {p.name}: {p.sentence}" for p in answer.problems[:MAX_PROBLEMS]]
    left_out = len(answer.problems) - len(shown)
    more = [f"  ... and {left_out} more; --json has them all"] if left_out else []
    plural = "" if len(answer.problems) == 1 else "s"
    return [f"{len(answer.problems)} problem{plural}, checked {how}", *shown, *more]


def _next(answer: "SampleAnswer", path: Path | None, design: str) -> str:
    """Return the command that most users need next."""
    plan = answer.files.get("output", path)
    if plan is None:
        return " ".join(("fixel sample", design, "--output plan.yaml")).replace("  ", " ")
    if not any(layout.pegs for layout in answer.plan.layouts):  # the testbed is for grasps
        return f"fixel sample {shlex.quote(str(plan))} --simulate"
    return f"fixel testbed run {shlex.quote(str(plan))}"
