"""Real repetitions: comparison of the predicted spread of ends with the measured one.

Source: logs of repeated two-finger pushes (CMU 2017), and trials of RPI's 2dgad database with
nearly equal starts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.drawing import palette
from fixel.drawing.chart import clean, legend_below, log_scale, sheet
from fixel.model.trajectory import wrapped
from fixel.replay.base import WIDE, Row
from fixel.simulation import StewartTrinkle
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import StartError, even_points
from fixel.uncertainty.start_ensemble import simulate_starts
from reproductions.repeat_groups import (
    HEAD_PLACE,
    RepeatGroup,
    alike_group,
    group_scene,
    read_groups,
    rig_noise,
)
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RANGES: Final = {
    # Unknown parameters of a rig, equal in all runs of a group: friction of steel or aluminium
    # fingers, centre of a block's load [m], place of the fingers in the robot's frame [m].
    "mu_pusher": (0.15, 0.5),
    "friction_centre_x": (-3e-3, 3e-3),
    "friction_centre_y": (-3e-3, 3e-3),
    "registration_x": (-1.5e-3, 1.5e-3),
    "registration_y": (-1.5e-3, 1.5e-3),
}

STEP: Final = 0.05  # [s], 1 to 2 mm of motion of the fingers
WORLDS: Final = 300  # number of rigs drawn from the ranges, each with the group's number of runs

# Position and angle have limits of 97.5 % each, so that both are met with 95 %.
QUANTILE: Final = 0.975
WANTED: Final = 0.9


class GroupPrediction(NamedTuple):
    """Predicted and measured standard deviations of a group: position [m] and angle [rad]."""

    name: str
    kind: str
    n: int
    start: FloatArray  # (2,) measured, of the starts
    end: FloatArray  # (2,) measured, of the ends
    median: FloatArray  # (2,) predicted for the same number of runs
    limit: FloatArray  # (2,) 97.5 % quantile of the predicted ones
    least: FloatArray  # (2,) 2.5 % quantile
    failed: int

    @property
    def covered(self) -> bool:
        """Whether both measured spreads of the ends are within their limits."""
        return bool((self.end <= self.limit).all())


def run(options: RunOptions) -> Reproduction:
    """Predict the spread of every group from the starts of other groups, and compare.

    RPI's trials are searched next to the folder. With `quick`, it draws few rigs.
    """
    worlds = 20 if options.quick else WORLDS
    groups = read_groups(options.folder)
    noise = rig_noise(groups)
    predictions = []
    for k, group in enumerate(groups):
        predictions.append(_two_point(group, groups, worlds))
        options.progress(k + 1, len(groups) + 1, group.name)
    other = options.folder.parent / "rpi_2dgad"
    if Rpi2dgad().recognised(other):
        predictions.append(_alike(other, worlds))
    options.progress(len(groups) + 1, len(groups) + 1, "trials that start alike")
    return Reproduction(
        tables={"groups": [_row(one) for one in predictions]},
        conclusions=_conclusions(predictions, noise),
        settings={
            "ranges": {name: list(interval) for name, interval in RANGES.items()},
            "worlds": worlds,
            "step_s": STEP,
            "quantile": QUANTILE,
            "noise_mm": round(1e3 * float(noise[0]), 3),
            "noise_deg": round(math.degrees(float(noise[1])), 3),
            "head_place_m": list(HEAD_PLACE),
            "quick": options.quick,
        },
        figure=partial(repeats_figure, predictions),
    )


def _two_point(group: RepeatGroup, groups: list[RepeatGroup], worlds: int) -> GroupPrediction:
    """Predict a group with the start and measurement errors of groups with other start poses. Of
    the group's own runs, only their mean start is used."""
    others = [other for other in groups if other.start_pose != group.start_pose]
    error = pooled([other for other in others if other.by_hand == group.by_hand])
    noise = rig_noise(others)[[0, 0, 1]]
    n = group.runs
    values = _rigs(worlds, n)
    drawn = np.random.default_rng(7).standard_normal((worlds * n, 3)) * error.size
    fan = simulate_starts(
        group_scene(group),
        error,
        drawn=drawn,
        values=values,
        times=[group.duration],
        stepper=StewartTrinkle(step=STEP),
    )
    seen = fan.pose[:, -1] + np.random.default_rng(8).standard_normal(drawn.shape) * noise
    return _predicted(group.name, "two fingers", group.start, group.end, seen, fan.ended, n)


def _alike(folder: Path, worlds: int) -> GroupPrediction:
    group = alike_group(folder)
    n = len(group.end)
    seen, ended = group.predicted(worlds * n)
    return _predicted(group.name, "starts alike", group.start, group.end, seen, ended, n)


def _predicted(
    name: str,
    kind: str,
    start: FloatArray,
    end: FloatArray,
    seen: FloatArray,
    ended: np.ndarray,
    n: int,
) -> GroupPrediction:
    whole = ended.reshape(-1, n).all(axis=1)
    spreads = np.array([scatter(own) for own in seen.reshape(-1, n, 3)[whole]])
    least, median, limit = np.quantile(spreads, (1.0 - QUANTILE, 0.5, QUANTILE), axis=0)
    failed = int((~ended).sum())
    return GroupPrediction(
        name, kind, n, scatter(start), scatter(end), median, limit, least, failed
    )


def scatter(poses: FloatArray) -> FloatArray:
    """Standard deviations (2,) of poses (n, 3): position, both axes together [m], angle [rad]."""
    angle = poses[0, 2] + wrapped(poses[:, 2] - poses[0, 2])
    off = np.column_stack((poses[:, :2], angle))
    square = ((off - off.mean(axis=0)) ** 2).sum(axis=0) / (len(poses) - 1)
    return np.sqrt([square[0] + square[1], square[2]])


def pooled(groups: list[RepeatGroup]) -> StartError:
    """Pool the standard deviations of starts about the means of their groups."""
    square, freedom = np.zeros(3), 0
    for group in groups:
        off = group.start - group.start.mean(axis=0)
        square += (off**2).sum(axis=0)
        freedom += len(off) - 1
    x, y, theta = np.sqrt(square / freedom)
    place = math.sqrt(0.5 * (x**2 + y**2))
    return StartError(x=place, y=place, theta=float(theta), kind="normal")


def _rigs(worlds: int, n: int) -> dict[str, FloatArray]:
    """Draw parameters (worlds * n,) of rigs, equal for the n runs of a rig."""
    shares = even_points(worlds, len(RANGES), seed=5)
    return {
        name: np.repeat(low + (high - low) * shares[:, k], n)
        for k, (name, (low, high)) in enumerate(RANGES.items())
    }


# --- tables and sentences -------------------------------------------------------------------


def _row(one: GroupPrediction) -> Row:
    row: Row = {"group": one.name, "kind": one.kind, "runs": one.n}
    for name, pair in (
        ("start", one.start),
        ("end", one.end),
        ("predicted_median", one.median),
        ("predicted_limit", one.limit),
    ):
        row[f"{name}_mm"] = round(1e3 * float(pair[0]), 3)
        row[f"{name}_deg"] = round(math.degrees(float(pair[1])), 3)
    return row | {"covered": one.covered, "failed": one.failed}


def _conclusions(predictions: list[GroupPrediction], noise: FloatArray) -> list[str]:
    real = [one for one in predictions if one.kind == "two fingers"]
    covered = sum(one.covered for one in real)
    end, median, limit, start = (
        np.median([getattr(one, name) for one in real], axis=0)
        for name in ("end", "median", "limit", "start")
    )
    below = sum(bool((one.end < one.least).any()) for one in real)
    verdict = "at least" if covered >= WANTED * len(real) else "fewer than"
    sentences = [
        f"{covered} of {len(real)} groups of two-finger pushes ({covered / len(real):.0%}) end no"
        f" farther apart than predicted: {verdict} the 90 % wanted.",
        f"Size, medians over groups: starts {_size(start)}, ends measured {_size(end)}, predicted"
        f" {_size(median)}, at most {_size(limit)}.",
        f"In {below} groups the ends lie closer together, in position or angle, than 97.5 % of the"
        " predicted ones.",
        f"Noise of a measured end, from where two fingers leave a block no freedom:"
        f" {1e3 * noise[0]:.2f} mm along each axis and {math.degrees(noise[1]):.2f} deg.",
    ]
    for one in predictions:
        if one.kind != "two fingers":
            holds = "holds" if one.covered else "does not hold"
            sentences.append(
                f"{one.name}: measured {_size(one.end)}; predicted {_size(one.median)}, at most"
                f" {_size(one.limit)}, which {holds} it. The place of the head was not kept, so"
                " the fan is as wide as all places it can push from."
            )
    return sentences


def _size(pair: FloatArray) -> str:
    return f"{1e3 * pair[0]:.2f} mm and {math.degrees(pair[1]):.2f} deg"


# --- figure -------------------------------------------------------------------------------------


def repeats_figure(groups: Sequence[GroupPrediction]) -> Figure:
    """Draw predicted ranges and measured spreads of repeated pushes, one row per group."""
    figure = sheet(WIDE, 0.7 + 0.145 * len(groups))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, k, label, factor in (
        (left, 0, "spread of end positions [mm]", 1e3),
        (right, 1, "spread of end angles [deg]", math.degrees(1.0)),
    ):
        _spreads(axes, groups, k, factor)
        axes.set_xlabel(label)
    left.set_yticks(range(len(groups)), [group.name for group in groups])
    left.invert_yaxis()
    legend_below(figure, [left])
    return figure


def _spreads(axes: Axes, groups: Sequence[GroupPrediction], k: int, factor: float) -> None:
    place = np.arange(len(groups))
    least, median, limit, measured = (
        factor * np.array([getattr(group, name)[k] for group in groups])
        for name in ("least", "median", "limit", "end")
    )
    inside = measured <= limit
    bar = "predicted, 95 %"
    axes.hlines(place, least, limit, color=palette.TRAIL, linewidth=4.0, alpha=0.6, label=bar)
    axes.plot(median, place, "|", color=palette.BODY, markersize=6.0, label="its median")
    axes.plot(
        measured[inside], place[inside], "o", color=palette.INK, markersize=3.5, label="measured"
    )
    if not inside.all():
        axes.plot(
            measured[~inside], place[~inside], "X", color=palette.FORCE, markersize=5.0,
            label="measured, wider than predicted",
        )  # fmt: skip
    log_scale(axes, "x", np.concatenate((least, limit, measured)))
    clean(axes)
