"""Noise from repetitions and residuals; correlation; dispersions and thresholds.
Noise estimated from measured poses, compared with residuals.
"""

import math

import numpy as np
import pytest
from scipy import stats
from tests.calibration.toys import TIMES, TRUTH, box, calibrated, decay
from tests.fixtures import refused

from fixel import Noise, Tripod
from fixel.calibration.noise import (
    MIN_SCATTER,
    Dispersion,
    correlation_time,
    counting_frames,
    dispersion_of,
    estimated_dispersion,
    misfit_of,
    noise_from_differences,
    noise_from_repetitions,
    noise_from_residuals,
)
from fixel.calibration.target import Target
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import free_push

SD = np.array([1e-3, 1e-3, 1e-2])


def autoregressive(rng, a, shape):
    """Series of unit variance along the first axis, with correlation a from one to the next."""
    from scipy.signal import lfilter

    shocks = rng.normal(size=shape) * math.sqrt(1.0 - a * a)
    shocks[0] /= math.sqrt(1.0 - a * a)
    return lfilter([1.0], [1.0, -a], shocks, axis=0)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_correlation_time_of_an_autoregressive_series(a):
    rng = np.random.default_rng(7)
    values = [
        correlation_time([autoregressive(rng, a, (330, 3)) for _ in range(8)]) for _ in range(10)
    ]
    assert np.mean(values) == pytest.approx((1.0 + a) / (1.0 - a), rel=0.15)


def test_correlation_time_at_its_ends():
    assert correlation_time([np.ones((330, 3))]) == pytest.approx(330.0)
    assert correlation_time([np.tile([1.0, -1.0], 50)]) == 1.0
    assert correlation_time([np.zeros(10)]) == 1.0
    assert correlation_time([np.ones(1)]) == 1.0
    refused(correlation_time, [], match="series")


def test_repetitions_give_the_scatter_without_bias():
    rng = np.random.default_rng(3)
    path = np.stack((np.linspace(0, 0.1, 20), np.zeros(20), np.linspace(0, 7.0, 20)), axis=1)
    values = []
    for _ in range(200):
        groups = [path + SD * rng.normal(size=(r, 20, 3)) for r in (2, 3, 5, 1)]
        noise = noise_from_repetitions(groups)
        values.append((noise.position_m, noise.angle_rad))
    variance = np.mean(np.square(values), axis=0)
    np.testing.assert_allclose(variance, SD[[0, 2]] ** 2, rtol=0.02)
    assert noise.source == "repetitions"
    # 1 + 2 + 4 free repetitions of 20 frames, x and y.
    assert noise.freedom * noise.correlation == pytest.approx(2 * 7 * 20)


def test_angles_a_turn_apart_are_the_same():
    rng = np.random.default_rng(3)
    group = SD * rng.normal(size=(4, 20, 3)) + [0.0, 0.0, math.pi]
    turned = group.copy()
    turned[::2, :, 2] -= 2.0 * math.pi
    assert noise_from_repetitions([turned]).angle_rad == pytest.approx(
        noise_from_repetitions([group]).angle_rad
    )


def test_residuals_give_the_noise_and_what_is_left_of_their_count():
    rng = np.random.default_rng(5)
    series = [SD * autoregressive(rng, 0.9, (330, 3)) for _ in range(8)]
    noise = noise_from_residuals(series, unknowns=4)
    assert noise.position_m == pytest.approx(1e-3, rel=0.1)
    assert noise.angle_rad == pytest.approx(1e-2, rel=0.1)
    assert noise.freedom == pytest.approx(8 * 330 * 3 / noise.correlation - 4)
    assert 13.0 < noise.correlation < 26.0
    np.testing.assert_array_equal(
        noise.standard_deviations, [noise.position_m, noise.position_m, noise.angle_rad]
    )


def test_a_fit_that_leaves_nothing_has_the_smallest_noise():
    noise = noise_from_residuals([np.zeros((20, 3))], unknowns=2)
    assert 0.0 < noise.position_m == noise.angle_rad < 1e-5


def test_thresholds_are_the_quantiles_of_chi_squared_and_f():
    assert Dispersion(value=1.0).threshold() == pytest.approx(stats.chi2.ppf(0.95, 1))
    assert Dispersion(value=3.0).threshold(0.9) == pytest.approx(3 * stats.chi2.ppf(0.9, 1))
    few = Dispersion(value=1.0, freedom=7.0)
    assert few.threshold() == pytest.approx(stats.f.ppf(0.95, 1, 7))


def test_known_noise_is_believed_until_the_fit_is_too_bad():
    noise = Noise(position_m=1e-3, angle_rad=0.01, correlation=4.0)
    assert dispersion_of(noise, deviance=420.0, count=400, unknowns=4).value == 4.0
    bad = dispersion_of(noise, deviance=800.0, count=400, unknowns=4)
    assert bad.value == pytest.approx(800.0 / 96.0)
    assert bad.source == "residuals"
    assert dispersion_of(noise, deviance=10.0, count=400, unknowns=4).value == 4.0
    fitted = Noise(position_m=1e-3, angle_rad=0.01, source="residuals")
    assert dispersion_of(fitted, 10.0, 400, 4) == estimated_dispersion(10.0, 400, 4)


def test_too_few_residuals_are_a_wide_answer_and_not_an_exception():
    values = estimated_dispersion(deviance=3.0, count=30, unknowns=4, correlation=20.0)
    assert values.freedom == 1.0
    assert values.threshold() > 100.0
    assert estimated_dispersion(0.0, 30, 4).value > 0.0


def test_coverage_with_correlated_noise():
    # Intervals that took 60 correlated residuals for 60 would hold the truth in half of the sets.
    rng = np.random.default_rng(11)
    inside = []
    for _ in range(60):
        noise = 0.05 * autoregressive(rng, 0.7, (len(TIMES), 4)).T
        data = decay(TRUTH[None]) + noise

        def residuals(points, data=data):
            return ((decay(points)[:, None] - data) / 0.05).reshape(len(points), -1)

        where = box([0, 0, -1], [5, 5, 1], TRUTH)
        left = (data - decay(TRUTH[None])) / 0.05
        time = correlation_time(list(left))
        threshold = estimated_dispersion(float((left**2).sum()), left.size, 3, time).threshold()
        _, found = calibrated(residuals, where, threshold, scan=0)
        inside.append([p.low <= t <= p.high for p, t in zip(found.profiles, TRUTH, strict=True)])
    # Standard error 3 %. Where the sensitivities change as fast as the noise, the correlation time
    # of the noise is the worst case, so it may cover more.
    assert (np.mean(inside, axis=0) >= 0.88).all(), np.mean(inside, axis=0)


def test_exact_copies_scatter_by_what_simulations_are_exact_to():
    copies = noise_from_repetitions([np.zeros((2, 5, 3))])
    assert (copies.position_m, copies.angle_rad) == (MIN_SCATTER, MIN_SCATTER)


def test_refusals():
    refused(Noise, position_m=0.0, angle_rad=0.01, match=r"noise\.position_m")
    refused(Noise, position_m=1.0, angle_rad=0.01, correlation=0.5, match=r"noise\.correlation")
    refused(Noise, position_m=1.0, angle_rad=0.01, source="guess", match=r"noise\.source")
    refused(noise_from_repetitions, [np.zeros((1, 5, 3))], match="repeated")
    refused(noise_from_repetitions, [np.zeros((2, 5))], match=r"groups\[0\]")
    refused(Dispersion(value=1.0).threshold, 1.0, match="level")


SCENE = free_push(Tripod(radius=0.03, friction=0.3))
NOISE = Noise(position_m=8e-5, angle_rad=3e-3)


def _track(seed, *, noise=True, lost=0.1, smooth=False, frames=200):
    """A curved motion with a jolt in the middle, seen by a camera that loses frames."""
    draw = np.random.default_rng(seed)
    t = np.arange(1, frames + 1) / 30.0
    pose = np.column_stack((0.0135 * t, 1e-3 * np.sin(t), 0.3 * np.sin(0.7 * t)))
    pose[frames // 2 :] += [1e-3, 0.0, 0.05]
    if noise:
        pose += NOISE.standard_deviations * draw.standard_normal(pose.shape)
    if smooth:
        kernel = np.ones(5) / 5.0
        pose = np.column_stack([np.convolve(column, kernel, "same") for column in pose.T])[5:-5]
        t = t[5:-5]
    seen = draw.random(len(t)) >= lost
    return Target("a/b", {}, RolloutCase(SCENE, t[seen]), pose[seen])


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_read_off_without_a_model(seed):
    found = noise_from_differences([_track(seed), _track(seed + 100)])
    assert found.source == "differences"
    # Of 600 second differences, correlated, a median absolute deviation is good to 5 %.
    assert found.position_m == pytest.approx(NOISE.position_m, rel=0.15)
    assert found.angle_rad == pytest.approx(NOISE.angle_rad, rel=0.15)


def test_noise_of_smoothed_poses_and_of_few_is_not_known():
    assert noise_from_differences([_track(0, smooth=True, lost=0.0)]) is None
    assert noise_from_differences([_track(0, noise=False)]) is None
    assert noise_from_differences([_track(0, frames=4)]) is None


def _residuals(scale, seed=0, n=6):
    draw = np.random.default_rng(seed)
    sizes = scale * NOISE.standard_deviations * [1.0, 1.0, 0.9]
    return [sizes * draw.standard_normal((300, 3)) for _ in range(n)]


def test_a_wrong_one_is_with_its_size_first():
    found = misfit_of(_residuals(30.0), list("abcdef"), NOISE)
    assert found.warned
    assert found.sentences[0].startswith("model misfit: residuals of 2.4 mm are 30 times the noise")
    huge = misfit_of(_residuals(460.0), list("abcdef"), NOISE)
    assert f" are {huge.ratio:.0f} times the noise" in huge.sentences[0]
    slight = misfit_of(_residuals(2.0), list("abcdef"), NOISE)
    assert slight.noted
    assert not slight.warned
    assert slight.sentences[0].startswith("slight model misfit")


def test_experiments_that_fit_far_worse_are_named():
    residuals = _residuals(5.0)
    residuals[2] *= 10.0
    found = misfit_of(residuals, list("abcdef"), NOISE)
    assert found.worst == ("c",)
    assert found.share == pytest.approx(100.0 / 105.0, abs=0.02)
    assert found.sentences[1].endswith("come from 1 of 6 experiments: c.")


def test_short_experiments_have_a_small_share_of_the_squared_residuals():
    residuals = _residuals(5.0)
    residuals[2] = 10.0 * residuals[2][:30]
    found = misfit_of(residuals, list("abcdef"), NOISE)
    squares = [np.square(one / NOISE.standard_deviations).sum() for one in residuals]
    assert found.worst == ("c",)
    assert found.share == pytest.approx(squares[2] / sum(squares))  # two thirds, not 95 %


def test_of_one_experiment_the_variation_between_experiments_cannot_be_seen():
    assert "only one experiment" in misfit_of(_residuals(5.0, n=1), ["a"], NOISE).sentences[1]


def test_residuals_are_compared_with_the_noise_of_the_start_as_well():
    """Ten errors of starts, each common to 300 frames and growing along the way."""
    rng = np.random.default_rng(3)
    growth = np.linspace(1.0, 3.0, 300)[:, None] * NOISE.standard_deviations
    residuals = [one + growth * rng.standard_normal(3) for one in _residuals(1.0, n=10)]
    keys = list("abcdefghij")
    assert misfit_of(residuals, keys, NOISE).ratio > 1.5
    found = misfit_of(residuals, keys, NOISE, [growth] * 10)
    assert found.ratio == pytest.approx(1.0, abs=0.3)
    assert found.sentences == ()
    wrong = misfit_of([10.0 * one for one in residuals], keys, NOISE, [growth] * 10)
    assert wrong.warned
    assert "(as stated, with noise of the start poses)" in wrong.sentences[0]


def test_of_unknown_noise_the_warning_states_that_and_no_ratio():
    noise = Noise(position_m=1e-4, angle_rad=1e-3, source="residuals")
    found = misfit_of(_residuals(1.0), list("abcdef"), noise)
    assert np.isnan(found.ratio)
    assert found.warned
    assert found.sentences[0].startswith("noise unknown")


def test_frames_before_the_first_motion_do_not_count_unless_a_push_is_missed():
    start = np.array(SCENE.bodies[0].pose)
    rng = np.random.default_rng(4)
    simulated = start + np.maximum(0.0, np.arange(-10, 20))[:, None] * [1e-3, 0.0, 1e-2]
    simulated[:, 2] += 2.0 * np.pi  # the same pose
    noise = [rng.normal(size=(30, 3)) * NOISE.standard_deviations for _ in range(3)]
    case = RolloutCase(SCENE, np.arange(1.0, 31.0))
    moving = Target("a", {}, case, simulated - noise[0])
    still = Target("b", {}, case, start - noise[1])
    missed = Target("c", {}, case, simulated - noise[2])
    residuals = [noise[0], noise[1], noise[2] + start - simulated]
    frames = [np.arange(30)] * 3
    first, second, third = counting_frames([moving, still, missed], frames, residuals)
    assert first.tolist() == [False] * 11 + [True] * 19
    assert not second.any()
    assert third.all()
    assert counting_frames([still], frames[:1], residuals[1:2])[0].all()
