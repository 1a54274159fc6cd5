"""Report of a plan, to store: sentences, tables and pictures."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fixel.drawing.planning import capture_chart, causes_chart, looks_chart, paths_chart
from fixel.io.atomic import written_whole
from fixel.io.document import yaml_text
from fixel.planning.plan import PushPlan
from fixel.workflows.analysis import Analysis, AnalysisReport, Picture
from fixel.workflows.planning.request import FoundPlan, PlanAnswer, goal_text, save_plan

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnswer
JSON: Final = ("files",)  # what `--json` has besides numbers
# Files in the folder of the analysis.
FILE: Final = "plan.plan"
GOAL: Final = "goal.yaml"


def report_of(answer: PlanAnswer) -> AnalysisReport:
    """Return sentences, tables, numbers and pictures of a plan, and its file."""
    files = {} if answer.file is None else {"out": answer.file}
    plan = answer.found.plan
    return AnalysisReport(analysis_of(answer.found), pictures_of(plan), files=files)


def analysis_of(found: FoundPlan) -> Analysis:
    """Return sentences, tables and numbers of a plan."""
    plan = found.plan
    explained = plan.explain()
    causes = (causes_chart(explained).table(),) if explained.success < 1.0 else ()
    return Analysis(
        kind="plan",
        title=f"Plan: {plan.goal}",
        question={"goal": goal_text(found.request)},
        headline=tuple(_headline(found)),
        warnings=found.warnings,
        tables=(plan.push_table("Pushes"), plan.success_table("Success probability"), *causes),
        notes=explained.sentences,
        methods=(_methods(plan),),
        numbers=numbers_of(found),
        calibrations=() if found.calibration is None else (found.calibration,),
    )


def pictures_of(plan: PushPlan) -> Iterator[Picture]:
    """Yield motions, looks, capture regions and, if there are any, causes of failures of a plan."""
    caption = "Simulated motions of the part in samples of what is unknown; failures in colour."
    if plan.looks:
        caption += " Corrections after looks are drawn as straight lines to the end."
    yield Picture("paths", paths_chart(plan), "", caption)
    if plan.looks:
        caption = (
            "Simulated poses at the first look, by the correction that follows, and its success"
            " probability without another look."
        )
        yield Picture("looks", looks_chart(plan), "", caption)
    if plan.pushes:
        caption = (
            "Success of the rest of the plan from poses before each push, with the poses in"
            " samples of what is unknown before and after it."
        )
        caption += " Looks are left out." if plan.looks else ""
        yield Picture("capture", capture_chart(plan), "", caption)
    explained = plan.explain()
    if explained.success < 1.0:
        caption = (
            "Share of the failures that each unknown explains alone, and the success gained by"
            " measuring it before choosing among the best plans."
        )
        yield Picture("causes", causes_chart(explained), "", caption)


def add_files(answer: PlanAnswer, folder: Path) -> None:
    """Write the plan and its goal into the folder of the stored analysis."""
    save_plan(answer.found, folder / FILE)
    with written_whole(folder / GOAL) as path:
        path.write_text(yaml_text(dict(answer.found.request["goal"])), encoding="utf-8")


def next_words(done: StoredAnswer) -> list[object]:
    """Return the words of the command that carries out the plan, if it has pushes of one part."""
    file = done.result.file or (done.folder and done.folder / FILE)
    plan = done.result.found.plan
    able = (plan.pushes or plan.looks) and len(plan.scene.bodies) == 1
    return ["plan", "run", file] if file and able else []


def _headline(found: FoundPlan) -> list[str]:
    """Return the main results of a plan in sentences."""
    plan = found.plan
    lines = [f"A plan for {plan.goal} needs {plan.count}: {plan.success.sentence}."]
    lines += plan.looks.sentences if plan.looks else []
    lines.append(f"The plan that is best without any error: {plan.nominal_success.sentence}.")
    own = plan.belief
    for text in filter(None, (plan.other_parts, own.error_text, own.start_text)):
        lines.append(f"{text[0].upper()}{text[1:]}.")
    if plan.failures:
        kinds = (f"{100.0 * share:.1f} % {why}" for why, share in plan.failures.items())
        lines.append(f"Failures: {', '.join(kinds)}.")
    return lines


def _methods(plan: PushPlan) -> str:
    """Return a sentence for the methods section of a paper."""
    own = plan.success
    draws = f", and its range from {len(own.rates)} further samples with {own.n_runs} runs each"
    text = (
        f"Open-loop pushes were planned with {plan.rollouts} simulated pushes (seed {plan.seed});"
        f" the success probability was computed from {own.n} scenarios that the search had not"
        f" used, each with its own sample of the parameters{'' if own.worst is None else draws}."
    )
    if plan.looks is None:
        return text
    return (
        f"{text} It is that of these pushes with up to {plan.looks.most} looks at the part, each"
        f" with a correction from a table of {len(plan.looks.table.numbers)} pushes."
    )


def numbers_of(found: FoundPlan) -> dict[str, Any]:
    """Return a plan as plain values in SI units, for `--json` and the page."""
    plan, own = found.plan, found.plan.success
    body = plan.scene.bodies[0]
    return {
        "goal": str(plan.goal),
        "pushes": [str(push) for push in plan.pushes],
        "success": {
            "stated": own.stated,
            "mean": own.mean,
            "bound": own.low,
            "high": own.high,
            "quantile": own.worst,
            "quantile_high": own.best,
            "margin": own.margin,
            "wanted": found.wanted,
        },
        "nominal_success": {"stated": plan.nominal_success.stated},
        "failures": dict(plan.failures),
        "start_error": plan.belief.start_text,
        "model_error": plan.belief.error_text,
        "looks": None
        if (looks := plan.looks) is None
        else {
            "most": looks.most,
            "success": [own.mean for own in looks.worth],
            "pushes": looks.pushes,
            "no_push_after_first": looks.stops,
            "camera_m_rad": looks.camera.deviation.tolist(),
            "lost_views": looks.lost_views,
        },
        "why": list(plan.explain().sentences),
        "unseen": list(plan.unseen),
        "start_m_rad": plan.start.tolist(),
        "end_m_rad": plan.end.tolist(),
        "waypoints_s_m_rad": plan.path.tolist(),
        "fixels_m_rad": None if plan.fixels is None else plan.fixels.tolist(),
        "outline_m": body.shape.outline.tolist(),
        "calibration": found.calibration,
        "rollouts": plan.rollouts,
    }


def waypoints_text(plan: PushPlan, path: Path) -> str:
    """Return the motion of the tool as CSV, or as JSON for a name that ends in `.json`."""
    table = plan.waypoints()
    if path.suffix.lower() != ".json":
        return table.csv()
    return json.dumps({"units": "s, m, rad", "waypoints": table.records()}, indent=1) + "\n"
