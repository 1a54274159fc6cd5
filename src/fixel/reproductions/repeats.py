"""Real repetitions: comparison of the predicted spread of ends with the measured one.

Source: logs of repeated two-finger pushes (CMU 2017), and trials of RPI's 2dgad database with
nearly equal starts.
"""

from __future__ import annotations

import math
import time as clock
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.datasets.rpi_2dgad import Rpi2dgad
from fixel.errors import DatasetMissing
from fixel.model.trajectory import wrapped
from fixel.reproductions.alike_starts import HEAD_PLACE, alike_group
from fixel.reproductions.charts.repeats import RepeatPicture, RepeatPoint
from fixel.reproductions.reproduction import Reproduction, Row
from fixel.reproductions.two_point_groups import RepeatGroup, group_scene, read_groups, rig_noise
from fixel.simulation import StewartTrinkle
from fixel.typing import FloatArray, Progress
from fixel.uncertainty.start_ensemble import simulate_starts
from fixel.uncertainty.starts import StartError, even_points

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


def run(folder: Path | None, progress: Progress, *, quick: bool = False) -> Reproduction:
    """Predict the spread of every group from the starts of other groups, and compare.

    Parameters
    ----------
    folder : Path or None
        Folder of the two-finger pushes; RPI's trials are searched next to it.
    progress : callable
    quick : bool
        Draw few rigs.
    """
    begun = clock.perf_counter()
    if folder is None:
        raise DatasetMissing(Path("cmu_two_point_push"), "cmu_two_point_push")
    worlds = 20 if quick else WORLDS
    groups = read_groups(folder)
    noise = rig_noise(groups)
    judged = []
    for k, group in enumerate(groups):
        judged.append(_two_point(group, groups, worlds))
        progress(k + 1, len(groups) + 1, group.name)
    beside = folder.parent / "rpi_2dgad"
    if Rpi2dgad().recognised(beside):
        judged.append(_alike(beside, worlds))
    progress(len(groups) + 1, len(groups) + 1, "trials that start alike")
    return Reproduction(
        name="repeats",
        tables={"groups": [_row(one) for one in judged]},
        conclusions=_conclusions(judged, noise),
        settings={
            "ranges": {name: list(interval) for name, interval in RANGES.items()},
            "worlds": worlds,
            "step_s": STEP,
            "quantile": QUANTILE,
            "noise_mm": round(1e3 * float(noise[0]), 3),
            "noise_deg": round(math.degrees(float(noise[1])), 3),
            "head_place_m": list(HEAD_PLACE),
            "quick": quick,
        },
        picture=RepeatPicture(
            [RepeatPoint(j.name, j.kind, j.end, j.median, j.least, j.limit) for j in judged]
        ),
        seconds=clock.perf_counter() - begun,
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
    return _judged(group.name, "two fingers", group.start, group.end, seen, fan.ended, n)


def _alike(folder: Path, worlds: int) -> GroupPrediction:
    group = alike_group(folder)
    n = len(group.end)
    seen, ended = group.predicted(worlds * n)
    return _judged(group.name, "starts alike", group.start, group.end, seen, ended, n)


def _judged(
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


def _conclusions(judged: list[GroupPrediction], noise: FloatArray) -> list[str]:
    real = [one for one in judged if one.kind == "two fingers"]
    covered = sum(one.covered for one in real)
    end, median, limit, start = (
        np.median([getattr(one, name) for one in real], axis=0)
        for name in ("end", "median", "limit", "start")
    )
    below = sum(bool((one.end < one.least).any()) for one in real)
    verdict = "at least" if covered >= WANTED * len(real) else "fewer than"
    said = [
        f"{covered} of {len(real)} groups of two-finger pushes ({covered / len(real):.0%}) end no"
        f" farther apart than predicted: {verdict} the 90 % wanted.",
        f"Size, medians over groups: starts {_size(start)}, ends measured {_size(end)}, predicted"
        f" {_size(median)}, at most {_size(limit)}.",
        f"In {below} groups the ends lie closer together, in position or angle, than 97.5 % of the"
        " predicted ones.",
        f"Noise of a measured end, from where two fingers leave a block no freedom:"
        f" {1e3 * noise[0]:.2f} mm along each axis and {math.degrees(noise[1]):.2f} deg.",
    ]
    for one in judged:
        if one.kind != "two fingers":
            holds = "holds" if one.covered else "does not hold"
            said.append(
                f"{one.name}: measured {_size(one.end)}; predicted {_size(one.median)}, at most"
                f" {_size(one.limit)}, which {holds} it. The place of the head was not kept, so"
                " the fan is as wide as all places it can push from."
            )
    return said


def _size(pair: FloatArray) -> str:
    return f"{1e3 * pair[0]:.2f} mm and {math.degrees(pair[1]):.2f} deg"
