"""Scene of the page of plans, and trials of a stored plan."""

from __future__ import annotations

import math
from pathlib import Path

from pydantic import BaseModel

from fixel.errors import FixelError, InvalidInput
from fixel.model import Scene, placed
from fixel.workflows.planning.report import FILE
from fixel.workflows.planning.stored import load_plan, load_trials

Rows = list[list[float]]


class PlanFixel(BaseModel):
    """Outline of a fixel in the world [mm]."""

    name: str
    outline: Rows


class PlanScene(BaseModel):
    """Part, start and fixels on which a goal is drawn [mm, deg]."""

    outline: Rows  # of the part, in its own frame
    start: list[float]  # x, y, angle
    fixels: list[PlanFixel]
    round: bool  # whether the part is a disk


def plan_scene(scene: Scene | None) -> PlanScene:
    """Return the drawing of a scene with one part."""
    if scene is None or len(scene.bodies) != 1:
        raise InvalidInput(
            "experiment", found="no scene with one part", expected="an experiment of one part"
        )
    body = scene.bodies[0]
    x, y, angle = body.pose.tolist()
    return PlanScene(
        outline=(1e3 * body.shape.outline).tolist(),
        start=[1e3 * x, 1e3 * y, math.degrees(angle)],
        fixels=[
            PlanFixel(name=own.name, outline=(1e3 * placed(own.shape.outline, own.pose)).tolist())
            for own in scene.fixels
        ],
        round=hasattr(body.shape, "radius") and not hasattr(body.shape, "vertices"),
    )


def trials_of(folder: Path) -> list[str]:
    """Return the trials of a stored plan as lines of text; none without a plan file."""
    path = folder / FILE
    if not path.is_file():
        return []
    try:
        trials = load_trials(path, load_plan(path))
    except FixelError as problem:
        return [str(problem)]
    return str(trials).splitlines() if trials.n else []
