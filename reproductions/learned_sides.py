"""Learned residuals on sides that were never pushed, on real pushes.

Every side of every plate is held out once, and every contiguous quarter of its contacts. The
calibration and the process on its residuals are fitted to three quarters of the plate's other
pushes. Among its examples a process should gain, and beyond them predict what physics predicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from fixel.calibration.known_pushes import contacts_of
from fixel.replay.base import Row, errors_in_mm_and_deg
from fixel.typing import FloatArray, IntArray
from reproductions.charts.error_bounds import learned_sides_figure
from reproductions.new_sides import FIRST_SEED, SIDE, side_labels
from reproductions.protocols import BenchmarkData, calibrated_bench, full_fit
from reproductions.pushes import Key, PushGroup
from reproductions.residuals import configurations_of, inside_ninety, split_without
from reproductions.result import Reproduction, RunOptions

QUARTER: Final = "quarter"
MAX_LOSS: Final = {"mm": 0.05, "deg": 0.15}
"""Largest error of a group above that of physics that counts as noise."""
_UNITS: Final = tuple(MAX_LOSS)


def quarter_labels(group: PushGroup) -> IntArray:
    """Return the quarter of the contacts, in their order around the centroid, of each push (n,)."""
    contact = contacts_of(configurations_of(group), np.ones(len(group)))
    order = np.argsort(np.arctan2(contact.place[:, 1], contact.place[:, 0]), kind="stable")
    rank = np.empty(len(group), np.int64)
    rank[order] = np.arange(len(group))
    return 4 * rank // len(group)


def run(options: RunOptions) -> Reproduction:
    """Measure errors on new sides of physics, and of physics with a process on its residuals.

    With `quick`, it uses three plates and few pushes.
    """
    bench = calibrated_bench(options)
    labels = {
        (kind, key): label
        for kind, of in ((SIDE, side_labels), (QUARTER, quarter_labels))
        for key in bench.rows
        for label in [of(bench.group(key))]
        if label.max() > 0  # few pushes can be of one side
    }
    bench.total = sum(int(own.max()) + 1 for own in labels.values())
    groups = [_group(bench, kind, key, own) for (kind, key), own in labels.items()]
    overall = [_overall(kind, groups) for kind in dict.fromkeys(kind for kind, _ in labels)]
    return Reproduction(
        tables={"overall": overall, "groups": groups},
        conclusions=[_conclusion(row) for row in overall],
        settings={"max_loss": dict(MAX_LOSS), "quick": options.quick},
        figure=partial(learned_sides_figure, groups, dict(MAX_LOSS)),
    )


def _group(bench: BenchmarkData, kind: str, key: Key, label: IntArray) -> Row:
    """Errors of one plate on one surface, with every push held out with its side."""
    group = bench.group(key)
    parts: list[FloatArray] = []
    for side in range(int(label.max()) + 1):
        parts.append(_left_out(bench, kind, key, label, side))
        bench.advance(f"without {kind} {side + 1} {' '.join(key)}")
    errors = np.concatenate(parts)
    errors = errors[np.isfinite(errors).all(axis=1)]
    row: Row = {"left_out": kind, "group": " ".join(group.key), "pushes": len(errors)}
    means = errors.mean(axis=0)
    for k, unit in enumerate(_UNITS):
        row[f"physics_{unit}"], row[f"learned_{unit}"] = float(means[k]), float(means[2 + k])
        row[f"change_{unit}"] = row[f"learned_{unit}"] - row[f"physics_{unit}"]
    row["inside_90"] = float(means[4])
    return row


def _left_out(bench: BenchmarkData, kind: str, key: Key, label: IntArray, side: int) -> FloatArray:
    """Errors (m, 5) of the pushes of one side under models without it: of physics [mm, deg], with
    the process [mm, deg], and the share of coordinates within 90 % intervals."""
    group = bench.group(key)
    split = split_without(label, side, FIRST_SEED + side)
    physics = full_fit(bench, group, f"{kind}_{side}", split).predict(group, np.arange(len(group)))
    end, sd = bench.learned(f"{kind}_{side}", group, split, physics)
    held = split.held_out
    new = label[held] == side
    errors = (
        *errors_in_mm_and_deg(physics[held], group.end[held]),
        *errors_in_mm_and_deg(end, group.end[held]),
        inside_ninety(group, held, end, sd).mean(axis=1),
    )
    return np.asarray(np.column_stack(errors)[new])


def _overall(kind: str, groups: Sequence[Row]) -> Row:
    """Mean errors of all pushes, and the group in which the process does most harm."""
    own = [row for row in groups if row["left_out"] == kind]
    pushes = np.array([row["pushes"] for row in own], np.float64)
    total: Row = {"left_out": kind, "pushes": int(pushes.sum())}
    for unit in _UNITS:
        for name in ("physics", "learned"):
            column = np.array([row[f"{name}_{unit}"] for row in own])
            total[f"{name}_{unit}"] = float(pushes @ column / pushes.sum())
        worst = max(own, key=lambda row: float(row[f"change_{unit}"]))
        total[f"worst_change_{unit}"] = worst[f"change_{unit}"]
        total[f"worst_group_{unit}"] = worst["group"]
    total["inside_90"] = float(pushes @ np.array([row["inside_90"] for row in own]) / pushes.sum())
    return total


def _conclusion(row: Row) -> str:
    mm, deg = (
        f"{row[f'worst_change_{unit}']:+.3f} {unit} ({row[f'worst_group_{unit}']})"
        for unit in _UNITS
    )
    return (
        f"A {row['left_out']} never pushed ({row['pushes']} pushes): physics"
        f" {row['physics_mm']:.2f} mm, {row['physics_deg']:.2f} deg; with the process"
        f" {row['learned_mm']:.2f} mm, {row['learned_deg']:.2f} deg; in the worst groups {mm} and"
        f" {deg}; its 90 % intervals contain {100 * row['inside_90']:.1f} %."
    )
