"""Noise of measurements, significant rises of the deviance, and residuals compared with the noise.

Without repetitions or models, the noise is estimated from second differences of measured poses, in
which smooth motion and model errors nearly cancel, but white noise of the camera does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.calibration.target import Target
from fixel.errors import InvalidInput, check_name
from fixel.model.fields import finite, inner_share, instance, positive, settle
from fixel.model.trajectory import pose_difference
from fixel.typing import BoolArray, FloatArray, IntArray

NoiseSource = Literal["stated", "repetitions", "residuals", "differences"]

ORIGINS: Final[dict[NoiseSource, str]] = {
    "stated": "as stated",
    "repetitions": "scatter of repetitions",
    "residuals": "residuals of the fit, including model error",
    "differences": "second differences of the measured poses",
}

# Probability of a fit under the stated noise below which the model or the noise is wrong, and the
# scatter of the residuals is used instead. Usual: 0.01; 0.05 rejects one good fit in twenty.
IMPROBABLE: Final = 0.01
# Minimum degrees of freedom of an estimate. With one, the 95 % threshold is 42 times that of known
# noise: very uncertain, but finite.
MIN_FREEDOM: Final = 1.0
# Minimum scatter of poses, the accuracy of simulations [m or rad].
MIN_SCATTER: Final = 1e-6


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Noise of measured poses.

    Parameters
    ----------
    position_m : float
        Standard deviation along x and along y [m].
    angle_rad : float
        Standard deviation of the angle [rad].
    source : str
        Origin: `stated` by the user, scatter of `repetitions`, `residuals` of the fit itself, or
        second `differences` of measured poses.
    correlation : float
        Integrated autocorrelation time: frames that count as one independent frame [frames].
    freedom : float
        Degrees of freedom of the standard deviations; inf if they are known.

    Examples
    --------
    >>> from fixel.units import deg, mm
    >>> Noise(position_m=0.2 * mm, angle_rad=0.1 * deg, source="stated").position_m
    0.0002
    """

    position_m: float
    angle_rad: float
    source: NoiseSource = "stated"
    correlation: float = 1.0
    freedom: float = math.inf

    def __post_init__(self) -> None:
        settle(
            self,
            position_m=positive(self.position_m, "noise.position_m", "m"),
            angle_rad=positive(self.angle_rad, "noise.angle_rad", "rad"),
            correlation=_at_least_one(self.correlation, "noise.correlation"),
        )
        check_name("noise.source", self.source, ORIGINS)
        if str(self.freedom) != "inf":
            positive(self.freedom, "noise.freedom")

    @classmethod
    def of(cls, position: float, angle: float, source: NoiseSource, **more: float) -> Noise:
        """Return noise with estimated standard deviations, at least the accuracy of simulations."""
        own = max(MIN_SCATTER, position), max(MIN_SCATTER, angle)
        return cls(position_m=own[0], angle_rad=own[1], source=source, **more)

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (3,) of x, y, theta, by which residuals are divided [m, m, rad]."""
        return np.array([self.position_m, self.position_m, self.angle_rad])

    @property
    def text(self) -> str:
        """Size and origin in words."""
        how = ORIGINS[self.source]
        if self.correlation > 1.5:
            how += f"; {self.correlation:.0f} correlated frames count as one"
        return f"noise {1e3 * self.position_m:.3g} mm, {1e3 * self.angle_rad:.3g} mrad ({how})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Dispersion:
    """Mean deviance of one independent measurement, with its degrees of freedom."""

    # Dispersion: 1 for independent measurements of known noise, else their correlation time.
    value: float
    freedom: float = math.inf  # degrees of freedom of the dispersion; inf if it is known
    source: NoiseSource = "stated"  # origin, as in `Noise`

    def threshold(self, level: float = 0.95) -> float:
        """Return the rise of the deviance at the ends of an interval for one parameter.

        It is a quantile of chi-squared with one degree of freedom if the noise is known, and of
        F(1, freedom), the square of Student's t, if it was estimated.
        """
        from scipy.special import ndtri, stdtrit

        inner_share(level, "level")
        tail = 0.5 * (1.0 + level)
        z = ndtri(tail) if math.isinf(self.freedom) else stdtrit(self.freedom, tail)
        return float(self.value * z * z)


def check_noise(noise: object) -> None:
    """Raise for what is neither a `Noise` nor None."""
    instance(noise, Noise | None, "noise of poses", "a fixel.Noise, or none")


def noise_from_repetitions(groups: Sequence[ArrayLike]) -> Noise:
    """Estimate the noise from the pooled scatter of repeated experiments about their mean.

    Repetitions scatter by more than the noise of the camera, since placement and sliding of the
    part vary. A simulation cannot predict these variations, so they are included.

    Groups are poses (n_repetition, n_frame, 3) at the same times [m, m, rad], and may differ in
    size; those of one repetition are ignored. The freedom allows for the correlation along a
    trajectory.
    """
    deviations: list[FloatArray] = []
    frames = 0.0  # without those lost to the subtracted means
    for number, group in enumerate(groups):
        rows = _poses(group, f"groups[{number}]")
        if len(rows) >= 2:
            # Corrects for the scatter of the mean, so that the pooled variance is unbiased.
            share = len(rows) / (len(rows) - 1)
            deviations.extend(math.sqrt(share) * _about_mean(rows))
            frames += rows.shape[0] / share * rows.shape[1]
    if not deviations:
        raise InvalidInput(
            "groups",
            found="no repeated experiment",
            expected="two or more repetitions of at least one experiment",
            hint="state the noise instead: Noise(position_m=..., angle_rad=...)",
        )
    variance = np.mean(np.concatenate(deviations) ** 2, axis=0)
    correlation = correlation_time(deviations)
    freedom = max(MIN_FREEDOM, 2.0 * frames / correlation)
    position, angle = math.sqrt(variance[:2].mean()), math.sqrt(variance[2])
    return Noise.of(position, angle, "repetitions", correlation=correlation, freedom=freedom)


def noise_from_residuals(series: Sequence[ArrayLike], unknowns: int) -> Noise:
    """Estimate the noise from the residuals of a fit, (n_frame, 3) of each experiment [m, m, rad].

    It includes all model error; repetitions give a better estimate.
    """
    rows = [np.asarray(one, np.float64) for one in series]
    correlation = correlation_time(rows)
    table = np.concatenate(rows)
    freedom = _freedom(table.size, unknowns, correlation)
    # The freedom lost to the unknowns is shared by the channels.
    spread = table.size / correlation / freedom
    variance = np.mean(table**2, axis=0) * spread
    position, angle = math.sqrt(variance[:2].mean()), math.sqrt(variance[2])
    return Noise.of(position, angle, "residuals", correlation=correlation, freedom=freedom)


def correlation_time(series: Sequence[ArrayLike]) -> float:
    """Compute the integrated autocorrelation time of residuals, pooled over series [frames].

    It is 1 for white noise and the whole length for constant series. No mean is subtracted:
    residuals of one sign throughout a push are strongly correlated. Of an array (n_frame, c) each
    channel is a series.

    Source
    ------
    Geyer (1992), section 3.3, the initial positive sequence: sums of two neighbouring lags are
    added while they are positive.
    """
    columns = _standardised([np.atleast_2d(np.asarray(one, np.float64).T) for one in series])
    length = max((len(column) for column in columns), default=0)
    if length == 0:
        raise InvalidInput("series", found="no residuals", expected="at least one series")
    sums = np.zeros(length)
    for column in columns:
        sums[: len(column)] += _lagged(column)
    if not sums[0] > 0.0:
        return 1.0
    rho = np.append(sums / sums[0], 0.0)
    pairs = rho[: 2 * (len(rho) // 2)].reshape(-1, 2).sum(axis=1)
    below = np.flatnonzero(pairs <= 0.0)
    kept = pairs[: below[0]] if len(below) else pairs
    return float(max(1.0, 2.0 * kept.sum() - 1.0))


def estimated_dispersion(
    deviance: float, count: int, unknowns: int, correlation: float = 1.0
) -> Dispersion:
    """Estimate the dispersion from the fit itself: deviance over (effective count - unknowns).

    The effective count is that of the residuals over their `correlation_time`.
    """
    freedom = _freedom(count, unknowns, _at_least_one(correlation, "correlation"))
    value = max(finite(deviance, "deviance") / freedom, float(np.finfo(np.float64).tiny))
    return Dispersion(value=value, freedom=freedom, source="residuals")


def dispersion_of(noise: Noise, deviance: float, count: int, unknowns: int) -> Dispersion:
    """Return the dispersion of residuals that were divided by a noise, from the least deviance.

    Known noise is used unless the fit is worse than it allows (`IMPROBABLE`): then the model error
    exceeds the noise, and intervals that ignore it would be far too narrow.
    """
    from scipy.special import fdtrc

    estimated = estimated_dispersion(deviance, count, unknowns, noise.correlation)
    if noise.source == "residuals":
        return estimated
    known = Dispersion(value=noise.correlation, freedom=noise.freedom, source=noise.source)
    ratio = estimated.value / known.value
    # With an infinite second freedom, F is the distribution of chi-squared over its freedom.
    chance = fdtrc(estimated.freedom, min(noise.freedom, 1e9), ratio)
    return estimated if chance < IMPROBABLE else known


def _freedom(count: int, unknowns: int, correlation: float) -> float:
    return max(MIN_FREEDOM, count / correlation - unknowns)


def _lagged(column: FloatArray) -> FloatArray:
    """Return the sums (n,) of products at lags 0 to n - 1."""
    n = len(column)
    spectrum = np.fft.rfft(column, 2 * n)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n])


def _standardised(series: list[FloatArray]) -> list[FloatArray]:
    """Return every channel (n,) of series (c, n), divided by the scatter of the channel."""
    found: list[FloatArray] = []
    for channel in range(max((len(one) for one in series), default=0)):
        rows = [one[channel] for one in series if channel < len(one)]
        total = math.sqrt(sum(float(row @ row) for row in rows))
        found += [row / total if total > 0.0 else row for row in rows]
    return found


def _about_mean(rows: FloatArray) -> FloatArray:
    """Return deviations (r, n, 3) from the mean of the repetitions, with unwrapped angles."""
    turned = rows.copy()
    apart = rows[:, :, 2] - rows[:1, :, 2]
    turned[:, :, 2] = apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi))
    return np.asarray(turned - turned.mean(axis=0))


def _poses(value: ArrayLike, where: str) -> FloatArray:
    rows = np.asarray(value, np.float64)
    if rows.ndim != 3 or rows.shape[2] != 3 or rows.shape[1] == 0:
        expected = "(n_repetition, n_frame, 3) poses"
        raise InvalidInput(where, found=f"an array of shape {rows.shape}", expected=expected)
    if not np.isfinite(rows).all():
        raise InvalidInput(where, found="numbers that are not finite", expected="measured poses")
    return rows


def _at_least_one(value: float, where: str) -> float:
    number = finite(value, where)
    if number < 1.0:
        raise InvalidInput(where, found=number, expected="at least 1")
    return number


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
