"""Real open-loop plans that were repeated: regions of their final poses, from other repetitions.

Source: logs of repeated two-finger pushes (CMU 2017). The rig of a plan is not known: friction of
the fingers, centre of the load, place of the fingers in the robot's frame. Rigs are drawn, weighted
by the ends of all other repetitions of the plan, and the last push of the left-out repetition is
simulated with the scatter between runs learned from other pushes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, clean, legend_below, sheet
from fixel.model.trajectory import wrapped
from fixel.replay.base import Row
from fixel.simulation import StewartTrinkle
from fixel.typing import FloatArray
from fixel.uncertainty.run_to_run import (
    CENTRE,
    FAR,
    FRICTION,
    START,
    RunEffects,
    RunToRun,
    arm_of,
    rest_at,
)
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.uncertainty.starts import StartError, even_points
from reproductions.repeat_groups import RepeatGroup, group_scene, read_groups, rig_noise
from reproductions.repeats import RANGES, STEP, pooled
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIGS: Final = 2048  # drawn from the ranges
RUNS: Final = 512  # simulated with scatter, of rigs drawn by their weights
LEVEL: Final = 0.9
ARM: Final = 35e-3  # [m/rad], by which angles count as lengths
LEARNED, DEFAULT, NONE = "learned from other plans", "default scatter", "no scatter"
# The frame of the fingers is off by millimetres, another offset in each push [m].
OFFSET: Final = 3e-3


class RunPrediction(NamedTuple):
    """Predicted and measured end of one repetition, in the frame of the mean of the others."""

    plan: str
    draws: FloatArray  # (n, 3) ends [m, m, rad]
    end: FloatArray  # (3,)
    rigs: float  # effective number of rigs

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

    With `quick`, it draws few rigs.
    """
    groups = read_groups(options.folder)
    last = {group.start_pose: group for group in groups}
    total = sum(group.runs for group in last.values())
    kinds = (LEARNED, DEFAULT, NONE)
    effects = [_effects(group) for group in groups]
    found: dict[str, list[RunPrediction]] = {name: [] for name in kinds}
    for group in last.values():
        others = [other for other in groups if other.start_pose != group.start_pose]
        known = [e for e, g in zip(effects, groups, strict=True) if any(g is o for o in others)]
        scatters = {LEARNED: RunToRun.learned(_joined(known)), DEFAULT: RunToRun(), NONE: None}
        for k in range(group.runs):
            for name, scatter in scatters.items():
                n = 256 if options.quick else RIGS
                found[name].append(_left_out(group, k, others, scatter, n))
            options.progress(len(found[LEARNED]), total, group.name)
    rows = [_row(name, one, k) for name, own in found.items() for k, one in enumerate(own)]
    return Reproduction(
        tables={"runs": rows},
        conclusions=[_conclusion(name, own) for name, own in found.items()],
        settings={
            "rigs": RIGS,
            "runs": RUNS,
            "level": LEVEL,
            "ranges": {name: list(ends) for name, ends in _ranges().items()},
            "quick": options.quick,
        },
        figure=_figure(found[LEARNED]),
    )


def _ranges() -> Mapping[str, tuple[float, float]]:
    offset = {f"registration_{axis}": (-OFFSET, OFFSET) for axis in "xy"}
    return {**RANGES, **offset}


def _left_out(
    group: RepeatGroup,
    k: int,
    others: Sequence[RepeatGroup],
    scatter: RunToRun | None,
    n: int,
) -> RunPrediction:
    """Predict repetition k of a push from the other repetitions, and groups of other plans."""
    kept = np.delete(np.arange(group.runs), k)
    own = group._replace(start=group.start[kept], end=group.end[kept])
    error = pooled([other for other in others if other.by_hand == group.by_hand])
    shares = even_points(n, len(_ranges()), seed=11)
    rigs = {
        name: low + (high - low) * shares[:, j]
        for j, (name, (low, high)) in enumerate(_ranges().items())
    }
    centre = _mean(own.end)
    plain, _ = _ends(own, np.zeros((n, 3)), rigs, error)
    weight = _weights(_off(plain, centre), others, len(kept))
    rng = np.random.default_rng(12)
    chosen = rng.choice(n, RUNS, p=weight)
    values = {name: column[chosen] for name, column in rigs.items()}
    start = error.size * rng.standard_normal((RUNS, 3))
    rest = np.zeros((RUNS, 3))
    scene = group_scene(own)
    if scatter is not None:
        changes = scatter.drawn(RUNS, seed=13, scene=scene, values=values)
        values, start, rest = changes.values, start + changes.start, changes.rest
    ends, turned = _ends(own, start, values, error)
    noise = rig_noise(others)[[0, 0, 1]]
    ends = ends + rest_at(rest, turned) + noise * rng.standard_normal((RUNS, 3))
    good = np.isfinite(ends).all(axis=1)
    return RunPrediction(
        group.start_pose,
        _off(ends[good], centre),
        _off(group.end[k][None], centre)[0],
        float(1.0 / np.sum(weight**2)),
    )


def _effects(group: RepeatGroup) -> RunEffects:
    """Return deviations of the ends of repetitions from their mean, and effects of the scatter."""
    scene, n = group_scene(group), 7
    arm = arm_of(scene)
    size = np.array([arm, arm, 1.0])
    names = ("start", "start", "start", "friction_centre_x", "friction_centre_y", "mu_pusher")
    drawn = np.zeros((2 * n, 3))
    middle = {"friction_centre_x": 0.0, "friction_centre_y": 0.0, "mu_pusher": 0.3}
    values = {name: np.full(2 * n, x) for name, x in middle.items()}
    for k, name in enumerate(names):
        for row, way in ((2 * k, -FAR), (2 * k + 1, FAR)):
            if name == "start":
                drawn[row, k] = way * START * size[k]
            elif name == "mu_pusher":
                values[name][row] *= math.exp(way * FRICTION)
            else:
                values[name][row] = way * CENTRE * arm
    error = StartError(x=1e-3, y=1e-3, theta=0.02, kind="uniform")
    ends, turned = _ends(group, drawn, values, error)
    change = np.nan_to_num(_off(ends[1::2], ends[0::2]) / (2.0 * FAR * size)).T
    runs = group.runs
    left = _off(group.end, _mean(group.end)) / size * math.sqrt(runs / (runs - 1.0))
    start, centre, friction = (
        np.repeat(column[None], runs, axis=0) for column in np.split(change, (3, 5), axis=1)
    )
    return RunEffects(left, start, centre, friction, np.full(runs, abs(turned[-1])))


def _joined(effects: Sequence[RunEffects]) -> RunEffects:
    columns = zip(*(own[:-1] for own in effects), strict=True)
    return RunEffects(*(np.concatenate(parts) for parts in columns))


def _ends(
    group: RepeatGroup, drawn: FloatArray, values: Mapping[str, FloatArray], error: StartError
) -> tuple[FloatArray, FloatArray]:
    """Return ends (n, 3) of a push from starts with errors, NaN of failed ones, and rotations."""
    scene = group_scene(group)
    found = simulate_starts(
        scene,
        error,
        drawn=drawn,
        values=values,
        times=[group.duration],
        stepper=StewartTrinkle(step=STEP),
    )
    ends = np.where(found.ended[:, None], found.pose[:, -1], np.nan)
    return ends, np.nan_to_num(wrapped(ends[:, 2] - scene.bodies[0].pose[2]))


def _weights(off: FloatArray, others: Sequence[RepeatGroup], n: int) -> FloatArray:
    """Return weights (k,) of rigs by their distance (k, 3) from the mean of n measured ends."""
    square, freedom = np.zeros(3), 0
    for other in others:
        square += (_off(other.end, _mean(other.end)) ** 2).sum(axis=0)
        freedom += other.runs - 1
    # The nominal end of a rig differs from the mean of its runs by their scatter over the root of
    # their number, and by that of the mean start.
    spread = np.sqrt(square / freedom) * math.sqrt(1.0 / n + 1.0)
    score = -0.5 * np.sum((off / spread) ** 2, axis=1)
    score = np.where(np.isfinite(score), score, -np.inf)
    weight = np.exp(score - score.max())
    return np.asarray(weight / weight.sum())


def _mean(poses: FloatArray) -> FloatArray:
    return np.asarray(poses[0] + _off(poses, poses[0]).mean(axis=0))


def _off(poses: FloatArray, centre: FloatArray) -> FloatArray:
    off = poses - centre
    return np.column_stack((off[:, :2], wrapped(off[:, 2])))


# --- tables and figure ----------------------------------------------------------------------------


def _row(kind: str, one: RunPrediction, k: int) -> Row:
    spread = _spread(one)
    return {
        "scatter": kind,
        "plan": one.plan,
        "run": k,
        "end_mm": round(1e3 * float(np.hypot(*one.end[:2])), 3),
        "end_deg": round(math.degrees(float(abs(one.end[2]))), 3),
        "spread_mm": round(1e3 * float(np.hypot(*spread[:2])), 3),
        "spread_deg": round(math.degrees(float(spread[2])), 3),
        "effective_rigs": round(one.rigs, 1),
        "level": round(one.level, 4),
        "inside": one.level <= LEVEL,
    }


def _spread(one: RunPrediction) -> FloatArray:
    """Return half the ranges (3,) of the central 68 % of the draws [m, m, rad]."""
    low, high = np.quantile(one.draws, (0.16, 0.84), axis=0)
    return np.asarray(0.5 * (high - low))


def _conclusion(kind: str, found: Sequence[RunPrediction]) -> str:
    inside = sum(one.level <= LEVEL for one in found)
    spread = np.median([np.hypot(*_spread(one)[:2]) for one in found])
    turned = np.median([_spread(one)[2] for one in found])
    return (
        f"{kind.capitalize()}: the 90 % region of the final pose contains {inside} of {len(found)}"
        f" repetitions; half the central 68 % of draws is {1e3 * spread:.2f} mm and"
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
