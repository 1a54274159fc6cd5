"""Grasps of the thesis, planned and carried out on the simulated laboratory.

The thesis moves a part with a head on one straight axis towards three fixels, and asks how small
changes affect the success of a grasp. Here, the placement of the part is chosen for each of its ten
layouts and two shapes, so that the part is seated on as many fixels as can be. Success is stated
before, and compared with 1000 executions in the simulated laboratory, which is another model:
uneven pressure, a rough plate, and frictions that the planner does not know.

Source: RPI thesis (2011), sections 1.3, 4.2 and 5.3; peg coordinates are those of `thesis_plan`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from math import pi
from typing import Final

import numpy as np

import fixel
from fixel.model import PlannedExperiment, Scene
from fixel.model.goals import BodyTrack, Seated, touching
from fixel.planning.belief import Belief
from fixel.planning.pushes import RigPushes
from fixel.replay.base import Row
from fixel.sampling.published import thesis_plan
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testbed.simulated import SimulatedTestbed, repeat_pushes
from fixel.uncertainty.error_terms import RPI_CAMERA, StartError
from fixel.units import deg, mm
from reproductions.charts.assembly import grasps_figure
from reproductions.result import Reproduction, RunOptions

RUNS: Final = 1000  # executions of a plan
SEED: Final = 2011
Y, THETA = 30 * mm, 45 * deg  # placements that may be chosen, either way
START: Final = StartError(x=1 * mm, y=1 * mm, theta=2 * deg, kind="normal")
# What is stated about the laboratory: frictions, radius of the support, centre of pressure.
BELIEF: Final = {
    "mu_pusher": (0.12, 0.32),
    "mu_fixel": (0.12, 0.28),
    "friction_centre_x": (-6 * mm, 6 * mm),
    "friction_centre_y": (-6 * mm, 6 * mm),
}


def run(options: RunOptions) -> Reproduction:
    """Plan a grasp for every shape and layout, and carry it out."""
    scenes = grasp_scenes()[: 2 if options.quick else None]
    runs, rollouts = (20, 1_000) if options.quick else (RUNS, 2_000)
    rows: list[Row] = []
    for k, own in enumerate(scenes):
        options.progress(k, len(scenes), own.name)
        rows.append(grasp_row(own, runs, rollouts))
    options.progress(len(scenes), len(scenes), "grasps")
    return Reproduction(
        tables={"grasps": rows},
        conclusions=_conclusions(rows),
        settings={
            "runs": runs, "rollouts": rollouts, "start": str(START), "seed": SEED,
            "belief": {name: list(pair) for name, pair in BELIEF.items()}, "quick": options.quick,
        },
        figure=partial(grasps_figure, rows),
    )  # fmt: skip


def grasp_scenes() -> list[PlannedExperiment]:
    """First experiment of every shape and layout of the thesis."""
    found: dict[tuple[object, object], PlannedExperiment] = {}
    for one in thesis_plan().experiments:
        found.setdefault((one.conditions["shape"], one.conditions["layout"]), one)
    return list(found.values())


def seating_modes(scene: Scene, n: int = 400, seed: int = SEED) -> Iterator[tuple[str, ...]]:
    """Names of the fixels of contact modes that 1 % of random placements reach, most first."""
    rng = np.random.default_rng(seed)
    case = RolloutCase(scene, np.array([scene.duration]))
    placed = {"start_y": rng.uniform(-Y, Y, n), "start_theta": rng.uniform(-pi / 4, pi / 4, n)}
    done = Ensemble([case]).simulate(np.zeros(n, np.int64), placed)
    touched = touching(scene, scene.bodies[0], done.pose[:, -1]) & done.stalled[:, None]
    modes, counts = np.unique(touched, axis=0, return_counts=True)
    common = modes[(counts >= n / 100) & modes.any(axis=1)]
    for mode in common[np.argsort(-common.sum(axis=1), kind="stable")]:
        yield tuple(f.name for f, own in zip(scene.fixels, mode, strict=True) if own)


def grasp_row(own: PlannedExperiment, runs: int, rollouts: int) -> Row:
    """Plan a grasp of one shape and layout, and carry it out, blind and with a look.

    After a look before the stroke the part is placed again, so that only the camera's error is
    left of the error of the start.
    """
    mode = next(seating_modes(own.scene))
    row: Row = {
        "shape": own.conditions["shape"], "layout": own.conditions["layout"],
        "mode": "".join(str(int(f.name in mode)) for f in own.scene.fixels), "runs": runs,
    }  # fmt: skip
    for prefix, start in (("", START), ("look_", RPI_CAMERA)):
        plan, held = carried_out(own, mode, start, runs, rollouts)
        placed = plan.scenes[0].bodies[0].pose - own.scene.bodies[0].pose
        found = {
            "y_mm": float(placed[1] / mm), "theta_deg": float(placed[2] / deg),
            "mean": plan.success.mean, "least": plan.success.least,
            "nominal_mean": plan.nominal_success.mean, "held": held,
        }  # fmt: skip
        row |= {prefix + name: value for name, value in found.items()}
    return row


def carried_out(
    own: PlannedExperiment, mode: tuple[str, ...], start: StartError, runs: int, rollouts: int
) -> tuple[fixel.PushPlan, float]:
    """Plan a grasp with an error of the start; return the share of executions that held, too."""
    goal, choose = Seated(*mode), RigPushes(y=(-Y, Y), theta=(-THETA, THETA))
    plan = fixel.plan(
        own.scene, goal, choose, Belief(parameters=BELIEF, start=start), rollouts=rollouts,
        seed=SEED, progress=False,
    )  # fmt: skip
    rng = np.random.default_rng([SEED, runs])
    starts = plan.scenes[0].bodies[0].pose + rng.standard_normal((runs, 3)) * start.deviation
    done = repeat_pushes(SimulatedTestbed(seed=SEED), plan.scenes, starts, name=own.name)
    met = goal.met(done.scene, BodyTrack(done.pose[:, 1:], done.stalled, done.force))
    return plan, float((met & np.equal(done.failure, "")).mean())


def _conclusions(rows: Sequence[Row]) -> list[str]:
    mean, least, held, looked, look_held = (
        np.array([row[name] for row in rows])
        for name in ("mean", "least", "held", "look_mean", "look_held")
    )
    return [
        f"{len(rows)} grasps: mean success {mean.mean():.3f}, held {held.mean():.3f}; they differ"
        f" by {100.0 * np.abs(mean - held).mean():.1f} points on average.",
        f"The rate that 95 % of the parameters exceed held in"
        f" {int((held >= least).sum())} of {len(rows)}.",
        f"{int((held >= 0.95).sum())} grasps succeed in 95 % of their executions or more.",
        f"With a look before the stroke: mean success {looked.mean():.3f}, held"
        f" {look_held.mean():.3f}; {int((look_held >= 0.95).sum())} succeed in 95 % or more.",
    ]
