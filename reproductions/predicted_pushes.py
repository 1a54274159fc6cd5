"""Predicted and measured motions of real pushes, by the belief with which fixel plans.

`fixel.calibrate` fits a few usual parameters to some pushes of a plate. Its `predictive` parameter
sets and error of ends predict the other pushes: what `fixel.plan` assumes for a calibration.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

import fixel
from fixel.calibration.target import Target, target_of
from fixel.model.trajectory import pose_difference
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.predictive import EndError, end_residuals, motion_of, spread_of
from reproductions.protocols import BenchmarkData
from reproductions.pushes import Key
from reproductions.residuals import Split, few_of, in_object

TRAIN: Final = 60  # pushes of a group that are calibrated to, at most
DRAWS: Final = 64  # parameter sets simulated for every push
REPEATS: Final = 4  # of each, with other errors of the end
LEVEL: Final = 0.9
TAILS: Final = (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)
PARAMETERS: Final = {
    "mu_pusher": (0.0, 1.0),
    "pressure_spread": (0.4, 1.8),
    "friction_centre_x": (-15e-3, 15e-3),
    "friction_centre_y": (-15e-3, 15e-3),
    "registration_x": (-3e-3, 3e-3),
    "registration_y": (-3e-3, 3e-3),
    "contact_offset": (-1e-3, 1e-3),
}


class PredictedPushes(NamedTuple):
    """Motions of m pushes of one group, in the frame of the object at its start [m, m, rad]."""

    key: Key
    rows: IntArray  # (m,) members of the group
    predicted: FloatArray  # (m, 3)
    measured: FloatArray  # (m, 3)
    draws: FloatArray  # (m, n, 3) motions by the belief

    @property
    def moved(self) -> FloatArray:
        """Predicted displacements (m,) [m]."""
        return np.asarray(np.hypot(*self.predicted[:, :2].T))

    @property
    def turned(self) -> FloatArray:
        """Predicted rotations (m,) [rad]."""
        return np.asarray(np.abs(self.predicted[:, 2]))

    def inside(self) -> np.ndarray:
        """Return whether the 90 % interval of each coordinate contains the measurement, (m, 3)."""
        low, high = np.quantile(self.draws, TAILS, axis=1)
        return np.asarray((low <= self.measured) & (self.measured <= high))

    def half_widths(self) -> FloatArray:
        """Return half the widths (m, 3) of the 90 % intervals [m, m, rad]."""
        low, high = np.quantile(self.draws, TAILS, axis=1)
        return np.asarray(0.5 * (high - low))


class GroupPrediction(NamedTuple):
    """Predictions of one group with one split: training and held-out pushes."""

    train: PredictedPushes
    held_out: PredictedPushes


def predict_group(
    bench: BenchmarkData, key: Key, split: Split, seed: int, draws: int = DRAWS
) -> GroupPrediction:
    """Calibrate on some training pushes of a group, and predict its others."""
    group = bench.group(key)
    few = few_of(split, 8 if bench.request.quick else TRAIN, seed)
    experiments = [bench.data.experiments[row] for row in group.rows.tolist()]
    fit = fixel.calibrate(
        [experiments[k] for k in few.train.tolist()], PARAMETERS, motion="quasistatic",
        threads=bench.request.threads, progress=False,
    )  # fmt: skip
    belief, rng = fit.predictive, np.random.default_rng(seed)
    drawn = belief.points[np.resize(rng.permutation(len(belief.points)), draws)]
    points = np.vstack((fit.found.point, drawn))
    arm = math.sqrt(group.shape.unit_inertia)
    size = np.array([1.0, 1.0, arm])
    found = []
    for which in (few.train, few.held_out):
        targets = [target_of(experiments[k]) for k in which.tolist()]
        off = end_residuals([_end_of(t) for t in targets], fit.space, fit.motion, points) / size
        off = in_object(group, np.repeat(which, len(points)), off.reshape(-1, 3)).reshape(off.shape)
        measured = in_object(group, which, pose_difference(group.end[which], group.start[which]))
        motion = measured[:, None] + off
        moved = motion_of(np.zeros((1, 3)), motion[:, 1:].reshape(-1, 3), arm)
        wide = np.repeat(spread_of(motion[:, 1:] * size), draws)
        error = belief.error.deviation(moved, wide).reshape(len(which), draws, 1) / size
        ends, error = (np.repeat(own, REPEATS, axis=1) for own in (motion[:, 1:], error))
        ends = ends + error * EndError.draws(rng, ends.shape[:2])
        found.append(PredictedPushes(key, which, motion[:, 0], measured, ends))
    return GroupPrediction(*found)


def _end_of(target: Target) -> Target:
    case = target.case._replace(times=target.case.times[-1:])
    return target._replace(case=case, pose=target.pose[-1:])
