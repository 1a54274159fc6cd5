"""Repetitions: experiments under the same conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.calibration.target import Target
from fixel.typing import FloatArray

# Conditions that may differ between repetitions of an experiment.
_OWN: Final = ("experiment", "repetition")
_TRUTH: Final = "truth_"


def same_configuration(target: Target) -> str:
    """Return a label that repetitions of an experiment share; its key if it is no repetition."""
    if "repetition" not in target.conditions:
        return target.key
    kept = {
        name: value
        for name, value in target.conditions.items()
        if name not in _OWN and not name.startswith(_TRUTH)
    }
    return repr(sorted(kept.items()))


def repetitions(targets: Sequence[Target], *, ends: bool = False) -> list[FloatArray]:
    """Return poses (n_repetition, n_frame, 3) of each repeated experiment, at common instants.

    A camera loses different frames each time, so the k-th frames of repetitions do not correspond.
    Poses are interpolated between frames, over the time that all repetitions cover.

    Parameters
    ----------
    targets : sequence of Target
    ends : bool
        Return only the last pose of each, if nothing else is compared.
    """
    groups: dict[str, list[Target]] = {}
    for target in targets:
        groups.setdefault(same_configuration(target), []).append(target)
    repeated = [group for group in groups.values() if len(group) > 1]
    if ends:
        return [np.array([target.pose[-1:] for target in group]) for group in repeated]
    found = [_at_the_same_instants(group) for group in repeated]
    return [rows for rows in found if rows.size]


def _at_the_same_instants(group: Sequence[Target]) -> FloatArray:
    clocks = [target.case.times for target in group]
    first, last = max(clock[0] for clock in clocks), min(clock[-1] for clock in clocks)
    instants = clocks[0][(clocks[0] >= first) & (clocks[0] <= last)]
    rows = []
    for clock, target in zip(clocks, group, strict=True):
        pose = np.column_stack((target.pose[:, :2], np.unwrap(target.pose[:, 2])))
        rows.append(np.column_stack([np.interp(instants, clock, column) for column in pose.T]))
    return np.array(rows)
