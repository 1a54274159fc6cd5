"""Noise from repetitions and residuals; correlation; dispersions and thresholds."""

import math

import numpy as np
import pytest
from scipy import stats
from tests.calibration.toys import TIMES, TRUTH, box, calibrated, decay
from tests.fixtures import refused

from fixel import Noise
from fixel.calibration.noise import (
    MIN_SCATTER,
    Dispersion,
    correlation_time,
    dispersion_of,
    estimated_dispersion,
    noise_from_repetitions,
    noise_from_residuals,
)

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
