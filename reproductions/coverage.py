"""Coverage of bounds on the end poses of real pushes, for held-out pushes of the MIT dataset.

For each plate and surface, 60 % of the pushes calibrate the physics (protocol `calibrated`). The
same pushes determine the uncertainty of its parameters and the model error. Bounds on the final
position and angle of the other pushes follow from these alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.drawing.chart import Chart
from fixel.drawing.uncertainty import coverage_chart
from fixel.model import wrapped
from fixel.replay.base import Row
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.prediction import CURVE_LEVELS, CoverageCurve, coverage_curve
from reproductions.fitting import ARM, Belief, FittedPushes
from reproductions.linear import LinearPredictive, Outcomes, Spreads, fit_predictive
from reproductions.protocols import calibrated_bench, full_beliefs, full_fit
from reproductions.pushes import Key, PushGroup
from reproductions.residuals import Split
from reproductions.result import Reproduction, RunOptions

# Step of the differences, in standard deviations of the priors; as in the fits.
STEP: Final = 0.15
# Standard deviations of the measured first pose, up to a factor estimated from the data
# [m, m, rad].
START: Final = {"start_x": 0.5e-3, "start_y": 0.5e-3, "start_theta": 0.01}
POSITION, ANGLE = (0, 1), (2,)


class HeldOutPushes(NamedTuple):
    """Bounds on the held-out pushes of one group and split."""

    key: Key
    levels: FloatArray  # (k, 2) level of the smallest bound that includes each: position, angle
    spreads: Spreads  # covariances of (along, across, ARM angle) [m^2]
    predictive: LinearPredictive


def run(options: RunOptions) -> Reproduction:
    """Measure the coverage of bounds on held-out pushes.

    With `quick`, it uses three plates with 60 pushes each, and rough fits.
    """
    bench = calibrated_bench(options)
    total = len(bench.rows) * bench.request.seeds
    held: list[HeldOutPushes] = []
    for key in bench.rows:
        group = bench.group(key)
        for k, split in enumerate(bench.splits(key)):
            held.append(predict_held_out(group, split, full_fit(bench, group, k, split)))
            options.progress(len(held), total, " ".join(key))
    overall = [_curve(held, own) for own in (0, 1)]
    return Reproduction(
        tables={
            "curve": _curve_rows(overall),
            "groups": _group_rows(held),
            "parts": _part_rows(held),
        },
        conclusions=_conclusions(overall, held),
        settings={
            "seeds": bench.request.seeds,
            "quick": options.quick,
            "pushes_held_out": overall[0].outcomes,
        },
        figure=_chart(overall, held).figure,
    )


def predict_held_out(group: PushGroup, split: Split, found: FittedPushes) -> HeldOutPushes:
    """Compute bounds on the held-out pushes of a group from its training pushes."""
    beliefs = full_beliefs(group, split.train)
    outcomes = outcomes_of(group, found, beliefs)
    good = np.asarray(np.isfinite(outcomes.residual).all(axis=1))
    train, other = split.train[good[split.train]], split.held_out[good[split.held_out]]
    sd = np.array([belief.sd for belief in beliefs])
    predictive = fit_predictive(_rows(outcomes, train), sd, (POSITION, ANGLE))
    own = _rows(outcomes, other)
    # A push that cannot be simulated has no bounds and counts as outside all of them.
    missing = np.ones((len(split.held_out) - len(other), 2))
    levels = np.concatenate((predictive.levels_of(own), missing))
    return HeldOutPushes(group.key, levels, predictive.spreads(own), predictive)


def outcomes_of(group: PushGroup, found: FittedPushes, beliefs: Sequence[Belief]) -> Outcomes:
    """End poses of all pushes of a group: along and across the push, and ARM times the angle [m].

    Residuals of pushes that could not be simulated are NaN.
    """
    everyone = np.arange(len(group))
    base = group.ends(everyone, found.values)
    columns = []
    for belief in beliefs:
        value = found.values[belief.name]
        step = STEP * belief.sd * (1.0 if value + STEP * belief.sd <= belief.high else -1.0)
        moved = group.ends(everyone, found.values | {belief.name: value + step})
        columns.append(_between(group, base, moved) / step)
    starts = []
    for name, sd in START.items():
        ends = [group.ends(everyone, found.values | {name: way * sd}) for way in (-1.0, 1.0)]
        starts.append(0.5 * _between(group, *ends))
    residual = _between(group, base, group.end)
    return Outcomes(
        residual,
        np.nan_to_num(np.stack(columns, axis=2)),
        np.nan_to_num(np.stack(starts, axis=2)),
    )


def _between(group: PushGroup, first: FloatArray, last: FloatArray) -> FloatArray:
    """Differences (k, 3) of poses: along and across the push, ARM times the angle [m]."""
    heading = group.tip_end - group.tip_start
    along = heading / np.hypot(*heading.T)[:, None]
    away = last - first
    return np.column_stack(
        (
            np.sum(away[:, :2] * along, axis=1),
            along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0],
            ARM * wrapped(away[:, 2]),
        )
    )


def _rows(outcomes: Outcomes, which: IntArray) -> Outcomes:
    return Outcomes(*(table[which] for table in outcomes))


# --- tables and sentences -------------------------------------------------------------------------


def _curve(held: Sequence[HeldOutPushes], own: int) -> CoverageCurve:
    return coverage_curve(np.concatenate([one.levels[:, own] for one in held]))


def _curve_rows(curves: Sequence[CoverageCurve]) -> list[Row]:
    return [
        {
            "level": level,
            "position_held": round(float(curves[0].held[k]), 4),
            "angle_held": round(float(curves[1].held[k]), 4),
            "true_levels_from": round(float(curves[0].low[k]), 4),
            "true_levels_to": round(float(curves[0].high[k]), 4),
        }
        for k, level in enumerate(CURVE_LEVELS)
    ]


def _group_rows(held: Sequence[HeldOutPushes]) -> list[Row]:
    rows = []
    for key in dict.fromkeys(one.key for one in held):
        own = [one for one in held if one.key == key]
        row: Row = {"surface": key[0], "shape": key[1]}
        for k, name in enumerate(("position", "angle")):
            curve = _curve(own, k)
            row["held_out"] = curve.outcomes
            for level in (0.5, 0.9):
                at = CURVE_LEVELS.index(level)
                row[f"{name}_held_{100 * level:.0f}"] = round(float(curve.held[at]), 4)
        rows.append(row)
    return rows


def _part_rows(held: Sequence[HeldOutPushes]) -> list[Row]:
    """Rows with the RMS over held-out pushes of each part's standard deviation."""
    rows: list[Row] = []
    for part in ("parameters", "start", "model", "total"):
        table = np.concatenate([getattr(one.spreads, part) for one in held])
        along, across, turned = np.sqrt(np.mean(np.einsum("kii->ki", table), axis=0))
        rows.append(
            {
                "part": part,
                "along_mm": round(1e3 * float(along), 3),
                "across_mm": round(1e3 * float(across), 3),
                "angle_deg": round(float(np.degrees(turned / ARM)), 3),
            }
        )
    return rows


def _conclusions(curves: Sequence[CoverageCurve], held: Sequence[HeldOutPushes]) -> list[str]:
    sentences = []
    for name, curve in zip(("position", "angle"), curves, strict=True):
        at = [CURVE_LEVELS.index(level) for level in (0.5, 0.9, 0.95)]
        shares = ", ".join(
            f"{100 * curve.held[k]:.1f} % at {100 * CURVE_LEVELS[k]:.0f} %" for k in at
        )
        gap = np.abs(curve.held - curve.levels).max()
        sentences.append(
            f"Bounds on the final {name} of {curve.outcomes} held-out pushes hold {shares}; the"
            f" largest gap over levels from 10 to 95 % is {100 * gap:.1f} points."
        )
    parts = {row["part"]: row for row in _part_rows(held)}
    sentences.append(
        "Standard deviations of the bounds (scale of Student's t), across the push:"
        f" {parts['model']['across_mm']:.2f} mm model error, {parts['start']['across_mm']:.2f} mm"
        f" from the start, {parts['parameters']['across_mm']:.2f} mm from parameters."
    )
    freedom = [one.predictive.freedom for one in held]
    sentences.append(
        f"Tails are heavy: {min(freedom):.1f} to {max(freedom):.1f} degrees of freedom of Student's"
        " t describe the training pushes best."
    )
    return sentences


def _chart(curves: Sequence[CoverageCurve], held: Sequence[HeldOutPushes]) -> Chart:
    keys = list(dict.fromkeys(one.key for one in held))
    names = ("final position", "final angle")
    groups = {
        name: [_curve([one for one in held if one.key == key], k).held for key in keys]
        for k, name in enumerate(names)
    }
    return coverage_chart(dict(zip(names, curves, strict=True)), groups=groups)
