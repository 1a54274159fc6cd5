"""Load or create a sampling plan, check, save and draw it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from fixel.drawing.chart import PICTURE_ENDINGS, refuse_ending
from fixel.errors import InvalidInput
from fixel.formats.plan_file import load_plan, plan_text
from fixel.io.atomic import refuse_unwritable, written_whole
from fixel.sampling import Plan, PlanProblem, eight_push_plan, rehearse, thesis_plan
from fixel.workflows.compilation import get_ready

PLAN_ENDINGS = (".yaml", ".yml")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SampleAnswer:
    """Sampling plan with its problems and files.

    Attributes
    ----------
    plan : Plan
    problems : tuple of PlanProblem
        In order of the plan.
    rehearsed : bool
        Whether problems were also searched for by simulation.
    files : dict from kind to Path
        ``output``, ``plot``.
    """

    plan: Plan
    problems: tuple[PlanProblem, ...]
    rehearsed: bool
    files: dict[str, Path]

    def summary(self) -> dict[str, Any]:
        """Return counts, problems, files and every experiment, as plain values."""
        plan = self.plan
        return {
            "plan": plan.name,
            "shapes": len(plan.shapes),
            "layouts": len(plan.layouts),
            "configurations": plan.configurations,
            "repetitions": plan.repetitions,
            "total": plan.total,
            "layout_numbers": {x.name: x.number for x in plan.layouts if x.number is not None},
            "duration_s": plan.rig.duration,
            "rehearsed": self.rehearsed,
            "problems": [problem._asdict() for problem in self.problems],
            "experiments": [
                {"name": experiment.name, **experiment.conditions}
                for experiment in plan.experiments
            ],
            "files": {kind: str(path) for kind, path in self.files.items()},
        }


def sample(
    path: Path | None = None,
    *,
    output: Path | None = None,
    plot: Path | None = None,
    simulate: bool = False,
    eight_push: bool = False,
) -> SampleAnswer:
    """Load a plan and check it; save and draw it if requested.

    Parameters
    ----------
    path : Path, optional
        Plan file; by default the thesis's plan.
    output : Path, optional
        Plan file to write: `.yaml`.
    plot : Path, optional
        Drawing to write: `.png`, `.svg` or `.pdf`.
    eight_push : bool
        Whether to use the ASME paper's plan instead of the thesis's, if no file is given.
    simulate : bool
        Whether to simulate every experiment, to check that the object touches a fixel.

    Raises
    ------
    InvalidInput
        A file that cannot be read or written, or an invalid plan.
    """
    files = {kind: file for kind, file in (("output", output), ("plot", plot)) if file is not None}
    _refuse_files(path, files)
    if path is not None:
        plan = load_plan(path)
    else:
        plan = eight_push_plan() if eight_push else thesis_plan()
    problems = plan.check()
    if simulate and plan.experiments:
        get_ready(plan.experiments[0].scene)
        problems = tuple(sorted([*problems, *rehearse(plan).problems]))
    if output is not None:
        with written_whole(output) as unfinished:
            unfinished.write_text(plan_text(plan), encoding="utf-8")
    if plot is not None:
        _draw(plan, plot)
    return SampleAnswer(plan=plan, problems=problems, rehearsed=simulate, files=files)


def _draw(plan: Plan, path: Path) -> None:
    from fixel.drawing.plan import draw_plan

    with written_whole(path) as unfinished:
        draw_plan(plan, unfinished)


def _refuse_files(path: Path | None, files: dict[str, Path]) -> None:
    """Reject files that cannot be written, before any work."""
    if "output" in files:
        refuse_ending(files["output"], PLAN_ENDINGS, "plan")
    if "plot" in files:
        refuse_ending(files["plot"], PICTURE_ENDINGS, "picture")
    for file in files.values():
        refuse_unwritable(file)
        if path is not None and file.resolve() == path.resolve():
            raise InvalidInput(
                str(file), found="the plan file itself", expected="another file to write"
            )
