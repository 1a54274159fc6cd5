"""Noise of measured start poses: its effect on residuals and on intervals.

A simulation begins at the first measured pose. The noise of that pose moves the whole simulated
trajectory, by the derivative of the trajectory with respect to the start: one error common to all
frames of an experiment. The residuals of a right model therefore have the covariance

    V = white + S S',

where the columns of S are the changes that one standard deviation of x, y and theta of the start
causes. See `docs/theory/misfit.md`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.honest import MM, Probes, ShiftModel, probe_rollouts
from fixel.calibration.noise import Noise
from fixel.typing import FloatArray, IntArray

STARTS: Final = ("start_x", "start_y", "start_theta")
# Smallest eigenvalue of the information, as a share of the largest, that counts as information.
MIN_INFORMATION: Final = 1e-9


class StartSensitivity(NamedTuple):
    """Changes of one experiment's simulated poses."""

    instants: IntArray  # (m,) frames of the experiment at which the changes are known
    # (m, 3, n_free) Change of x, y, theta per scale of each parameter [m, m, rad].
    common: FloatArray
    # (m, 3, 3) Change that one standard deviation of x, y, theta of the start pose causes.
    start: FloatArray

    @property
    def at_end(self) -> StartSensitivity:
        """Changes of the last pose only."""
        return StartSensitivity(self.instants[-1:], self.common[-1:], self.start[-1:])

    def deviations(self, frames: IntArray) -> FloatArray:
        """Return standard deviations (n, 3) of the poses at frames (n,), by the start's noise."""
        own = np.sqrt((self.start**2).sum(axis=2))
        return np.column_stack([np.interp(frames, self.instants, column) for column in own.T])


def start_study(
    shifted: ShiftModel, members: Sequence[int], point: FloatArray, camera: Noise
) -> Generator[FloatArray, FloatArray, list[StartSensitivity]]:
    """Compute the sensitivities of experiments; yields rows, is sent `ShiftModel.differences`.

    An experiment whose scene begins elsewhere than at the first measured pose, such as at a planned
    one, has no noise of the start. Steps of the start are standard deviations of its noise, that of
    one measured pose, so that the changes are those which this noise makes on a rough surface.
    """
    sd = camera.standard_deviations
    steps = dict(zip(STARTS, sd.tolist(), strict=True))
    probes = [Probes(shifted, m, STARTS, point, np.zeros(3), steps) for m in members]
    parts = yield from probe_rollouts(probes)
    found = []
    for one, part in zip(probes, parts, strict=True):
        instants = shifted.instants[one.member]
        own = sd * shifted.targets[one.member].starts_measured
        slopes = one.slopes(part[:, :, : len(instants)], shifted.searched.scale, own)
        common, start = (np.swapaxes(table, 0, 1) / MM[:, None] for table in slopes)
        found.append(StartSensitivity(instants, common, start))
    return found


def start_dispersion(
    sensitivities: Sequence[StartSensitivity], frames: Sequence[int], noise: Noise, camera: Noise
) -> float:
    """Compute the dispersion of a right model whose start poses have noise.

    Least squares weights residuals by 1/W of `noise`. Its estimate has the covariance H^-1 J' W^-1
    V W^-1 J H^-1 with H = J' W^-1 J, where independent residuals of variance W would have H^-1. The
    dispersion is the largest ratio of the two variances of a parameter. `frames` are the numbers of
    frames that count; `camera` is the noise of one measured pose.
    """
    n = sensitivities[0].common.shape[2]
    information, middle = np.zeros((n, n)), np.zeros((n, n))
    white = (camera.standard_deviations / noise.standard_deviations) ** 2
    for one, count in zip(sensitivities, frames, strict=True):
        share = count / len(one.instants)  # of the frames that one instant represents
        slopes = one.common / noise.standard_deviations[:, None]
        start = one.start / noise.standard_deviations[:, None]
        carried = share * np.einsum("mcp,mcs->ps", slopes, start)
        information += share * np.einsum("mcp,mcr->pr", slopes, slopes)
        middle += carried @ carried.T
        middle += share * np.einsum("mcp,c,mcr->pr", slopes, white, slopes)
    inverse = np.linalg.pinv(information, rcond=MIN_INFORMATION, hermitian=True)
    alone = np.diag(inverse)
    ratio = np.diag(inverse @ middle @ inverse)[alone > 0.0] / alone[alone > 0.0]
    return float(ratio.max(initial=0.0))
