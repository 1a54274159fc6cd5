"""Residuals of the physics, learned from training pushes."""

from __future__ import annotations

import numpy as np

from fixel.calibration.learned import NINETY, ResidualProcess
from fixel.model import wrapped
from fixel.reproductions.pushes import PushGroup
from fixel.reproductions.splits import Split
from fixel.typing import BoolArray, FloatArray, IntArray


def learned_ends(
    group: PushGroup, split: Split, physics: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predict ends (n, 3) of held-out members, and their standard deviations along the object's
    axes at the start.

    Parameters
    ----------
    physics : (m, 3) float64
        Ends of all members by the physics. Of the measured ends only those for training are used.
    """
    features = _features(group, physics, speed)
    good: BoolArray = np.asarray(np.isfinite(physics).all(axis=1))
    train = split.train[good[split.train]]
    residual = in_object(group, train, group.end[train] - physics[train])
    process = ResidualProcess(features[train], residual)
    held = split.held_out
    more, sd = process.predict(np.nan_to_num(features[held]))
    end = physics[held] + in_world(group, held, more)
    return end, sd


def _features(group: PushGroup, physics: FloatArray, speed: FloatArray) -> FloatArray:
    """Features known before a push: tip and direction in the object's frame, pose of the object,
    speed, and motion predicted by the physics."""
    everyone = np.arange(len(group))
    heading = group.tip_end - group.tip_start
    heading = heading / np.hypot(*heading.T)[:, None]
    flat = np.zeros(len(group))
    tip = in_object(group, everyone, np.column_stack((group.tip_start - group.start[:, :2], flat)))
    along = in_object(group, everyone, np.column_stack((heading, flat)))
    angle = group.start[:, 2]
    moved = in_object(group, everyone, physics - group.start)
    return np.column_stack(
        (tip[:, :2], along[:, :2], np.cos(angle), np.sin(angle), group.start[:, :2], speed, moved)
    )


def in_object(group: PushGroup, which: IntArray, moves: FloatArray) -> FloatArray:
    """Rotate small motions (n, 3) to the axes of the object at the start."""
    return _turned(moves, -group.start[which, 2])


def in_world(group: PushGroup, which: IntArray, moves: FloatArray) -> FloatArray:
    return _turned(moves, group.start[which, 2])


def _turned(moves: FloatArray, angle: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    x, y = moves[:, 0], moves[:, 1]
    return np.column_stack((c * x - s * y, s * x + c * y, wrapped(moves[:, 2])))


def inside_ninety(group: PushGroup, which: IntArray, end: FloatArray, sd: FloatArray) -> BoolArray:
    off = in_object(group, which, group.end[which] - end)
    return np.asarray(np.abs(off) <= NINETY * sd)
