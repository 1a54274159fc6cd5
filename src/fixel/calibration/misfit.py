"""Misfit: residuals of a calibration compared with the noise of the measurements.

The noise is estimated from second differences of measured poses, in which smooth motion and model
errors nearly cancel, but white noise of the camera does not. No repetitions or models are needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.noise import MIN_SCATTER, ORIGINS, Noise
from fixel.calibration.target import Target
from fixel.model.trajectory import pose_difference
from fixel.typing import BoolArray, FloatArray, IntArray

NOTED: Final = 1.5  # residuals over noise from which intervals allow for misfit...
WARNED: Final = 3.0  # ... and from which results are headed by a warning
# Minimum number of second differences in all.
MIN_COUNT: Final = 20
# Neighbouring second differences of white noise have a correlation of -2/3. For smoothed poses, or
# motion without noise, it is positive: the noise cannot be estimated.
WHITE: Final = -0.4
EVEN: Final = 0.1  # largest relative difference of the intervals between frames
NAMED: Final = 3  # number of them that are named
OUTLYING: Final = 4.0  # squared residuals over the median's that name an experiment


class Misfit(NamedTuple):
    """Residuals of a calibration and the noise of its measurements."""

    # Root mean square of the residuals.
    position_m: float
    angle_rad: float
    # Noise that they are compared with; if its source is the residuals, the noise of the
    # measurements is unknown.
    noise: Noise
    # Experiments with more than `OUTLYING` times the median squared residual, the worst first.
    worst: tuple[str, ...] = ()
    share: float = 0.0  # their share of all squared residuals, in units of the noise
    experiments: int = 0  # number of experiments
    # Root mean square of the residuals over their own noise, which includes that of the start pose
    # if it is known.
    position_ratio: float = math.nan
    angle_ratio: float = math.nan

    @property
    def ratio(self) -> float:
        """Ratio of residual to noise, the larger of two; nan if the noise is unknown."""
        if self.noise.source == "residuals":
            return math.nan
        return max(self.position_ratio, self.angle_ratio)

    @property
    def noted(self) -> bool:
        """Whether intervals must allow for misfit: there is one, or the noise is unknown."""
        return not self.ratio < NOTED

    @property
    def warned(self) -> bool:
        """Whether results must begin with a warning."""
        return not self.ratio < WARNED

    @property
    def sentences(self) -> tuple[str, ...]:
        """Warning in sentences, with the size first; empty without a misfit."""
        if not self.noted:
            return ()
        residual, camera, unit = 1e3 * self.position_m, 1e3 * self.noise.position_m, "mm"
        if self.angle_ratio > self.position_ratio:
            residual, camera, unit = 1e3 * self.angle_rad, 1e3 * self.noise.angle_rad, "mrad"
        noise = residual / self.ratio
        start = ", with noise of the start poses" if noise > 1.001 * camera else ""
        first = (
            f"{'model misfit' if self.warned else 'slight model misfit'}: residuals of "
            f"{residual:.2g} {unit} are {shown_ratio(self.ratio)} times the noise of "
            f"{noise:.2g} {unit} ({ORIGINS[self.noise.source]}{start})."
        )
        if math.isnan(self.ratio):
            first = (
                "noise unknown: the poses were smoothed, have no noise, or are too few. State the "
                "noise if you know it. Without it, misfit cannot be measured."
            )
        first += (
            " Intervals include it as far as these experiments show it; an error common to all of "
            "them cannot be detected."
        )
        more = []
        if self.experiments == 1:
            more.append(
                "There is only one experiment, so the variation between experiments is unknown "
                "and the intervals do not apply to other experiments."
            )
        elif self.worst:
            n = len(self.worst)
            names = ", ".join(self.worst[:NAMED]) + (", ..." if n > NAMED else "")
            more.append(
                f"{100.0 * self.share:.0f} % of the squared residuals come from {n} of"
                f" {self.experiments} experiments: {names}."
            )
        return first, *more


def shown_ratio(ratio: float) -> str:
    """Return residual over noise in words: two digits, or a whole number."""
    if math.isnan(ratio):
        return "an unknown number of"
    return f"{ratio:.2g}" if ratio < 10.0 else f"{ratio:.0f}"


def noise_from_differences(targets: Sequence[Target]) -> Noise | None:
    """Estimate the white noise of measured poses; None for too few or smoothed frames.

    1.4826 median |p(t+1) - 2 p(t) + p(t-1)| / sqrt(6), over all experiments, x and y together.
    """
    found = [second_differences(target.case.times, target.pose) for target in targets]
    position = [column for one in found for series in one for column in series[:, :2].T]
    angle = [series[:, 2] for one in found for series in one]
    if sum(map(len, angle)) < MIN_COUNT or not (_white(position) and _white(angle)):
        return None
    scale = 1.4826 / math.sqrt(6.0)
    sizes = [scale * float(np.median(np.abs(np.concatenate(own)))) for own in (position, angle)]
    return Noise.of(sizes[0], sizes[1], "differences")


def counting_frames(
    targets: Sequence[Target], frames: Sequence[IntArray], residuals: Sequence[FloatArray]
) -> list[BoolArray]:
    """Return masks (n,) of the frames (n,) whose residuals (n, 3) show how well a model fits.

    As long as the simulated body is still at its start, no parameter and hardly an error of the
    model moves it. Such frames count only in experiments that they fit far worse than the others
    do, such as one whose push the simulation misses, or if there are no others.
    """
    moved: list[BoolArray] = []
    for target, own, left in zip(targets, frames, residuals, strict=True):
        away = pose_difference(target.pose[own] + left, target.case.scene.bodies[0].pose)
        moved.append(np.asarray((np.abs(away) > MIN_SCATTER).any(axis=1)))
    squares = [left**2 for left in residuals]
    others = np.concatenate([one[own] for one, own in zip(squares, moved, strict=True)])
    if len(others) == 0:
        return [~own for own in moved]
    far = OUTLYING * np.maximum(others.mean(axis=0), MIN_SCATTER**2)
    masks = []
    for square, moving in zip(squares, moved, strict=True):
        missed = (square[~moving].sum(axis=0) > far * np.sum(~moving)).any()
        masks.append(np.asarray(moving | missed))
    return masks


def misfit_of(
    residuals: Sequence[FloatArray],
    keys: Sequence[str],
    noise: Noise,
    by_start: Sequence[FloatArray] = (),
) -> Misfit:
    """Return the misfit of residuals of experiments, (n_frame, 3) of x, y, theta [m, m, rad] each.

    `by_start` are the standard deviations that noise of the start pose adds to each residual.
    """
    table = np.concatenate(residuals)
    squares = np.mean(table**2, axis=0)
    white = noise.standard_deviations**2
    variances = [white + own**2 for own in by_start] or [white] * len(residuals)
    scaled = [one**2 / own for one, own in zip(residuals, variances, strict=True)]
    ratios = np.mean(np.concatenate(scaled), axis=0)
    sizes = [float(np.mean(one)) for one in scaled]
    middle, sums = float(np.median(sizes)), [float(np.sum(one)) for one in scaled]
    order = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    worst = [k for k in order if sizes[k] > OUTLYING * middle]
    return Misfit(
        position_m=math.sqrt(squares[:2].mean()),
        angle_rad=math.sqrt(squares[2]),
        noise=noise,
        worst=tuple(keys[k] for k in worst),
        share=sum(sums[k] for k in worst) / (sum(sums) or 1.0),
        experiments=len(sizes),
        position_ratio=math.sqrt(ratios[:2].mean()),
        angle_ratio=math.sqrt(ratios[2]),
    )


def second_differences(times: FloatArray, poses: FloatArray) -> list[FloatArray]:
    """Return second differences (k, 3) of every sequence of frames at equal intervals."""
    if len(times) < 3:
        return []
    pose = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    gaps = np.diff(times)
    usual = float(np.median(gaps))
    even = np.abs(gaps - usual) <= EVEN * usual
    edges = np.flatnonzero(np.diff(np.concatenate(([False], even, [False])).astype(int)))
    stretches = [pose[a : b + 1] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [np.diff(one, n=2, axis=0) for one in stretches if len(one) >= 3]


def _white(series: Sequence[FloatArray]) -> bool:
    """Whether neighbours are correlated as for white noise, by their signs: jumps hardly count."""
    pairs = sum(float(np.sign(one[1:]) @ np.sign(one[:-1])) for one in series)
    count = sum(int(np.count_nonzero(one[1:] * one[:-1])) for one in series)
    # Signs of normal variables agree with the correlation 2/pi asin(rho).
    return count > 0 and pairs / count < 2.0 / math.pi * math.asin(WHITE)
