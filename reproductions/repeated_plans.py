"""Real open-loop plans that were repeated: regions of their final poses, from other repetitions.

Source: logs of repeated two-finger pushes (CMU 2017). The rig of a plan is not known: friction of
the fingers, centre of the load, place of the fingers in the robot's frame. It is calibrated to the
other repetitions of the plan, and the last push of the left-out repetition is simulated with the
belief by which `fixel.plan` judges pushes after a calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

import fixel
from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, legend_below, sheet
from fixel.model import Experiment, Provenance, Trajectory
from fixel.model.trajectory import pose_difference
from fixel.planning.belief import Belief
from fixel.planning.rollout import FLUSH, flush_normals, guided, registration, spreads
from fixel.replay.base import Row
from fixel.simulation.vary import composed
from fixel.typing import FloatArray
from fixel.uncertainty.predictive import motion_of
from fixel.uncertainty.run_to_run import arm_of
from fixel.uncertainty.start_ensemble import simulate_starts
from reproductions.repeat_groups import RepeatGroup, group_scene, read_groups
from reproductions.repeats import RANGES, pooled
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUNS: Final = 512  # simulated for every repetition
LEVEL: Final = 0.9
HALF: Final = 0.5
ARM: Final = 35e-3  # [m/rad], by which angles count as lengths
# The frame of the fingers is off by millimetres, another offset in each push [m].
OFFSET: Final = 3e-3
PARAMETERS: Final = {**RANGES, **{f"registration_{axis}": (-OFFSET, OFFSET) for axis in "xy"}}


class RunPrediction(NamedTuple):
    """Predicted and measured end of one repetition, in the frame of the mean of the others."""

    plan: str
    draws: FloatArray  # (n, 3) ends [m, m, rad]
    end: FloatArray  # (3,)

    @property
    def level(self) -> float:
        """Level of the smallest region that contains the end."""
        size = np.array([1.0, 1.0, 1.0 / ARM])
        table = np.vstack((self.draws, self.end)) / size
        near = np.arange(len(self.draws))
        # Runs that slip off lie far outside: they count, but do not shape the region.
        for _ in range(3):
            centre = np.median(table[near], axis=0)
            inverse = np.linalg.inv(np.cov(table[near].T) + 1e-12 * np.eye(3))
            distance = np.einsum("ki,ij,kj->k", table - centre, inverse, table - centre)
            near = np.argsort(distance[:-1])[: int(LEVEL * len(self.draws))]
        return float(np.mean(distance[:-1] < distance[-1]))


def run(options: RunOptions) -> Reproduction:
    """Predict the final pose of every repetition from the other repetitions of its plan.

    With `quick`, it predicts one plan.
    """
    groups = read_groups(options.folder)
    last = {group.start_pose: group for group in groups}
    chosen = list(last.values())[: 1 if options.quick else None]
    total = sum(group.runs for group in chosen)
    found: list[RunPrediction] = []
    for group in chosen:
        others = [other for other in groups if other.start_pose != group.start_pose]
        for k in range(group.runs):
            found.append(left_out(group, k, others))
            options.progress(len(found), total, group.name)
    return Reproduction(
        tables={"runs": [_row(one, k) for k, one in enumerate(found)]},
        conclusions=[_conclusion(found)],
        settings={
            "runs": RUNS,
            "level": LEVEL,
            "ranges": {name: list(ends) for name, ends in PARAMETERS.items()},
            "quick": options.quick,
        },
        figure=_figure(found),
    )


def left_out(group: RepeatGroup, k: int, others: Sequence[RepeatGroup]) -> RunPrediction:
    """Predict repetition k of a push from its other repetitions.

    The error of the start is that of groups of other plans.
    """
    kept = np.delete(np.arange(group.runs), k)
    own = group._replace(start=group.start[kept], end=group.end[kept])
    fit = fixel.calibrate(
        [_experiment(group, j) for j in kept.tolist()], PARAMETERS, motion="quasistatic",
        progress=False,
    )  # fmt: skip
    error = pooled([other for other in others if other.by_hand == group.by_hand])
    belief, scene = Belief(parameters=fit, start=error), group_scene(own)
    drawn = belief.scenarios(scene, worlds=RUNS, runs=1, seed=13)
    runs = simulate_starts(
        scene, error, drawn=drawn.start, values=drawn.values, times=[group.duration],
        motion=fit.motion,
    )  # fmt: skip
    assert drawn.end_error is not None
    ends, start = runs.pose[runs.ended, -1], scene.bodies[0].pose + drawn.start[runs.ended]
    arm, good = arm_of(scene), np.ones(len(ends), bool)
    spread = spreads(np.zeros(len(ends), np.int64), start, ends, good, arm)
    size = drawn.end_error.deviation(motion_of(start, ends, arm), spread)
    placed = registration(drawn.values, RUNS)[runs.ended]
    fingers = composed(placed, group.path[-1, 1:])
    normal = flush_normals(scene.bodies[0].shape, ends, scene.pushers[0].shape, fingers)
    share = FLUSH * drawn.end_error.size / size
    ends = ends + guided(size[:, None] * drawn.misfit[runs.ended], share, normal)
    centre = _mean(own.end)
    return RunPrediction(group.start_pose, _off(ends, centre), _off(group.end[k][None], centre)[0])


def _experiment(group: RepeatGroup, k: int) -> Experiment:
    """Return repetition k as an experiment with its start and its end."""
    own = group._replace(start=group.start[k : k + 1], end=group.end[k : k + 1])
    scene, time = group_scene(own), np.array([0.0, group.duration])
    poses = np.stack((scene.bodies[0].pose, group.end[k]))
    return Experiment(
        dataset="cmu_two_point_push", name=f"{group.name} {k + 1}", real=True,
        provenance=Provenance(version=fixel.__version__, command="read_groups"),
        trajectory=Trajectory(time=time, pose=poses), object_name=scene.bodies[0].name,
        scene=scene, effective=(0.0, group.duration),
    )  # fmt: skip


def _mean(poses: FloatArray) -> FloatArray:
    return np.asarray(poses[0] + _off(poses, poses[0]).mean(axis=0))


def _off(poses: FloatArray, centre: FloatArray) -> FloatArray:
    return pose_difference(poses, np.broadcast_to(centre, poses.shape))


# --- tables and figure ----------------------------------------------------------------------------


def _row(one: RunPrediction, k: int) -> Row:
    spread = _spread(one)
    return {
        "plan": one.plan,
        "run": k,
        "end_mm": round(1e3 * float(np.hypot(*one.end[:2])), 3),
        "end_deg": round(math.degrees(float(abs(one.end[2]))), 3),
        "spread_mm": round(1e3 * float(np.hypot(*spread[:2])), 3),
        "spread_deg": round(math.degrees(float(spread[2])), 3),
        "level": round(one.level, 4),
        "inside": one.level <= LEVEL,
    }


def _spread(one: RunPrediction) -> FloatArray:
    """Return half the ranges (3,) of the central 68 % of the draws [m, m, rad]."""
    low, high = np.quantile(one.draws, (0.16, 0.84), axis=0)
    return np.asarray(0.5 * (high - low))


def _conclusion(found: Sequence[RunPrediction]) -> str:
    inside, half = (sum(one.level <= level for one in found) for level in (LEVEL, HALF))
    spread = np.median([np.hypot(*_spread(one)[:2]) for one in found])
    turned = np.median([_spread(one)[2] for one in found])
    return (
        f"The 90 % region of the final pose contains {inside} of {len(found)} repetitions, the 50 %"
        f" region {half}; half the central 68 % of draws is {1e3 * spread:.2f} mm and"
        f" {math.degrees(turned):.2f} deg (median)."
    )


def _figure(found: Sequence[RunPrediction]) -> Callable[[], Figure]:
    return partial(repeated_plans_figure, found)


def repeated_plans_figure(found: Sequence[RunPrediction]) -> Figure:
    """Draw the final positions of each plan, from the mean of the other repetitions."""
    plans = list(dict.fromkeys(one.plan for one in found))
    columns = 5
    figure = sheet(WIDE, 1.6 * math.ceil(len(plans) / columns) + 0.4)
    panels = figure.subplots(math.ceil(len(plans) / columns), columns, squeeze=False).ravel()
    for axes, plan in zip(panels.tolist(), plans, strict=False):
        own = [one for one in found if one.plan == plan]
        axes.plot(*(1e3 * own[0].draws[:, :2].T), ".", color=palette.TRAIL, markersize=1.5,
                  label="predicted")  # fmt: skip
        for one in own:
            inside = one.level <= LEVEL
            axes.plot(*(1e3 * one.end[:2]), "o" if inside else "X", markersize=4,
                      color=palette.TOUCHED if inside else palette.FORCE,
                      label="measured, inside" if inside else "measured, outside")  # fmt: skip
        axes.set(xlim=(-6, 6), ylim=(-6, 6))
        axes.set_title(plan.replace("bigrect_", ""), fontsize=palette.FONT_SIZE)
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]")
        clean(axes)
    for axes in panels[len(plans) :].tolist():
        axes.set_axis_off()
    for axes in panels[::columns].tolist():
        axes.set_ylabel("y [mm]")
    legend_below(figure, panels[: len(plans)].tolist(), 3)
    return figure
