"""Profile intervals against closed forms and brute force; coverage; better optima; roughness."""

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares
from tests.calibration.toys import (
    DECAY_BOX,
    THRESHOLD,
    TRUTH,
    box,
    calibrated,
    decay_residuals,
    linear,
    rough,
    run_profiles,
)
from tests.fixtures import refused

from fixel.calibration.least_squares import LeastSquares, NormalPrior
from fixel.calibration.profile import ProfileLikelihood
from fixel.errors import InvalidInput


def intervals(found):
    return np.array([(p.low, p.high) for p in found.profiles], np.float64)


def test_linear_model_has_the_textbook_interval():
    residuals, matrix, exact = linear()
    _, found = calibrated(residuals, box([0] * 3, [1] * 3))
    half = np.sqrt(THRESHOLD * np.diag(np.linalg.inv(matrix.T @ matrix)))
    # The root of the rise is a straight line here, so interpolation adds nothing; what is left is
    # where the calibration ends.
    np.testing.assert_allclose(
        intervals(found), np.c_[exact - half, exact + half], atol=2e-3 * half[0]
    )
    alone = np.sqrt(THRESHOLD / np.diag(matrix.T @ matrix))
    slices = np.array([(p.slice.low, p.slice.high) for p in found.profiles])
    np.testing.assert_allclose(slices, np.c_[exact - alone, exact + alone], atol=0.02 * half[0])
    np.testing.assert_allclose(found.hessian, matrix.T @ matrix, rtol=1e-4)


def test_prior_narrows_a_linear_interval_exactly():
    residuals, matrix, _ = linear()
    sd = np.array([0.02, np.inf, np.inf])
    prior = NormalPrior(mean=np.array([0.3, 0.5, 0.5]), sd=sd)
    _, found = calibrated(residuals, box([0] * 3, [1] * 3), prior=prior)
    half = np.sqrt(THRESHOLD * np.diag(np.linalg.inv(matrix.T @ matrix + np.diag(sd**-2.0))))
    np.testing.assert_allclose(np.ptp(intervals(found), axis=1), 2 * half, rtol=5e-3)


def brute_force(residuals, j, best, deviance):
    """Crossings of the profile of parameter j, by SciPy's roots of SciPy's fits."""
    others = [k for k in range(3) if k != j]

    def rise(value):
        def of(rest):
            point = np.empty(3)
            point[j], point[others] = value, rest
            return residuals(point[None])[0]

        found = least_squares(of, best[others])
        return 2.0 * found.cost - deviance - THRESHOLD

    return brentq(rise, best[j] - 0.5, best[j]), brentq(rise, best[j], best[j] + 0.5)


def test_nonlinear_intervals_are_those_of_brute_force():
    residuals = decay_residuals(1, sd=0.15)
    fitted, found = calibrated(residuals, DECAY_BOX)
    for j, ours in enumerate(intervals(found)):
        theirs = brute_force(residuals, j, fitted.point, fitted.deviance)
        np.testing.assert_allclose(ours, theirs, atol=0.02 * (theirs[1] - theirs[0]))


def test_intervals_along_a_bent_valley_are_those_of_a_grid():
    """Brute force: the least deviance on a dense grid of the other unknown."""

    def bent(points):
        x, y = points[:, 0], points[:, 1]
        return np.c_[(y - 4.0 * (x - 0.5) ** 2 - 0.3) / 0.05, (x - 0.55) / 0.08, (y - 0.35) / 0.2]

    _, found = calibrated(bent, box([0, 0], [1, 1]))
    grid = np.linspace(0.0, 1.0, 2001)
    table = np.stack([np.sum(bent(np.c_[np.full(len(grid), x), grid]) ** 2, axis=1) for x in grid])
    for profile, least in zip(found.profiles, (table.min(axis=1), table.min(axis=0)), strict=True):
        inside = grid[least <= table.min() + THRESHOLD]
        half = 0.5 * np.ptp(inside)
        assert profile.low == pytest.approx(inside[0], abs=0.03 * half + 5e-4)
        assert profile.high == pytest.approx(inside[-1], abs=0.03 * half + 5e-4)


def test_an_interval_contains_what_the_profile_of_another_parameter_met():
    """Descents over y stay in one of its dents; the profile of y shows that x reaches further.

    The reference is the least deviance on a grid.
    """

    def dented(points):
        x, y = points[:, 0], points[:, 1]
        return np.c_[(y - x) / 0.1, (x - 0.5) / 0.15, np.sin(np.pi * (y - 0.5) / 0.05)]

    _, found = calibrated(dented, box([0, 0], [1, 1]))
    grid = np.linspace(0.0, 1.0, 1001)
    least = [np.sum(dented(np.c_[np.full(len(grid), x), grid]) ** 2, axis=1).min() for x in grid]
    inside = grid[np.array(least) <= found.limit]
    assert inside[[0, -1]] == pytest.approx([0.206, 0.794])
    assert intervals(found)[0] == pytest.approx(inside[[0, -1]], abs=0.01)


def test_an_interval_contains_what_the_look_at_the_bounds_met():
    """At both bounds of x the deviance is low again, and y is far from the best there."""

    def twisted(points):
        x, y = points[:, 0], points[:, 1]
        return np.c_[3.0 * np.sin(np.pi * x) + 0.5 * x, (y - 0.7 * x**8) / 0.1]

    _, found = calibrated(twisted, box([-1, -1], [1, 1]))
    assert intervals(found)[0] == pytest.approx([np.nan, np.nan], nan_ok=True)  # open
    low, high = intervals(found)[1]
    assert low == pytest.approx(-0.1 * np.sqrt(found.limit), abs=0.01)
    # At x = 1, where the first residual is 0.5.
    assert high == pytest.approx(0.7 + 0.1 * np.sqrt(found.limit - 0.25), abs=0.02)
    for profile in found.profiles:
        assert (np.diff(profile.values) > 0.0).all()


@pytest.mark.parametrize("n", [2, 6])
def test_profiles_of_a_parabola_cost_few_evaluations(n):
    """Before: 150 an unknown, ten times as many as a search by least squares."""
    truth = np.linspace(0.3, 0.6, n)
    residuals, matrix, exact = linear(truth=tuple(truth), sd=0.1)
    _, found = calibrated(residuals, box([0] * n, [1] * n))
    half = np.sqrt(THRESHOLD * np.diag(np.linalg.inv(matrix.T @ matrix)))
    np.testing.assert_allclose(
        intervals(found), np.c_[exact - half, exact + half], atol=0.01 * half.max()
    )
    assert found.evaluations < 25 * n


def test_profile_lists_what_a_plot_needs():
    _, found = calibrated(decay_residuals(1), DECAY_BOX)
    for j, profile in enumerate(found.profiles):
        assert profile.unknown == j
        assert (np.diff(profile.values) > 0.0).all()
        assert np.array_equal(profile.points[:, j], profile.values)
        assert profile.deviances.min() == pytest.approx(found.best.error, abs=0.1)
        # Scanned up to the bounds.
        assert profile.values[[0, -1]].tolist() == [DECAY_BOX.low[j], DECAY_BOX.high[j]]
        assert profile.slice.low > profile.low
        assert profile.slice.high < profile.high


def test_flat_direction_is_open_and_so_is_a_sum():
    def of_sum(points):
        total = points[:, :1] + points[:, 1:2]
        return np.c_[total - 1.0, total - 0.9, points[:, 2:3] - 0.4, 0.0 * points[:, 3:]] / 0.01

    _, found = calibrated(of_sum, box([0] * 4, [1] * 4))
    assert [p.low is None for p in found.profiles] == [True, True, False, True]
    # The other summand meets its own bound, so one end is closed.
    assert found.profiles[0].high == pytest.approx(0.95 + 0.0139, abs=2e-3)
    assert found.profiles[3].high is None
    assert found.profiles[0].slice.low > 0.4
    assert found.profiles[0].rise[1] > 100.0
    assert found.profiles[0].moved[1] > 4.0
    assert found.profiles[0].rise[[0, 2, 3]].max() < 0.1
    assert found.profiles[3].moved.max() < 1e-6


def test_better_optimum_is_reported_and_the_profiles_are_about_it():
    def two(points):
        a = points[:, :1]
        return np.concatenate(((a - 0.2) * (a - 0.7) / 0.1, 1.5 * (a - 0.7), points[:, 1:]), 1)

    where = box([0, 0], [1, 1], [0.2, 0.5])
    fitted, found = calibrated(two, where)
    assert fitted.point[0] == pytest.approx(0.25, abs=0.01)
    assert found.best.point[0] == pytest.approx(0.7, abs=0.01)  # 3 % of the half-width
    assert found.best.error < fitted.deviance - 0.5
    # The rise beyond 0.7 counts from there.
    high = found.profiles[0].high
    above = two(np.array([[high, 0.0]]))[0]
    assert np.sum(above**2) == pytest.approx(THRESHOLD, rel=0.02)


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_roughness_and_jumps_change_an_interval_little(size):
    smooth = decay_residuals(2)
    _, clean = calibrated(smooth, DECAY_BOX)
    _, found = calibrated(rough(smooth, size), DECAY_BOX)
    width = np.ptp(intervals(clean), axis=1)
    change = np.abs(intervals(found) - intervals(clean)).max(axis=1)
    assert (change < 0.2 * width).all()
    assert found.evaluations < 2.5 * clean.evaluations


def test_bumps_as_high_as_the_threshold_widen_an_interval():
    smooth = decay_residuals(2)
    bumpy = rough(smooth, size=0.5, jump=0.0)
    _, clean = calibrated(smooth, DECAY_BOX)
    _, found = calibrated(bumpy, DECAY_BOX)
    assert clean.roughness < 0.02 * THRESHOLD
    assert THRESHOLD < found.roughness < 10.0 * THRESHOLD
    assert found.limit == found.threshold + found.roughness
    ends = intervals(found)
    assert (np.ptp(ends, axis=1) > 0.9 * np.ptp(intervals(clean), axis=1)).all()
    assert ((ends[:, 0] < TRUTH) & (ends[:, 1] > TRUTH)).all()


@pytest.mark.system
def test_coverage():
    # T9: 95 % intervals hold the truth in 90-99 % of data sets. 200 data sets, three parameters;
    # each rate has a standard error of 1.5 %.
    inside = []
    for seed in range(200):
        residuals = decay_residuals(1000 + seed, sd=0.1)
        start = box(DECAY_BOX.low, DECAY_BOX.high, TRUTH)
        _, found = calibrated(residuals, start, scan=0)
        ends = intervals(found)
        inside.append((ends[:, 0] <= TRUTH) & (ends[:, 1] >= TRUTH))
    rate = np.mean(inside, axis=0)
    assert ((rate >= 0.90) & (rate <= 0.99)).all(), rate


def test_failing_region_is_a_bound():
    def halved(points):
        values = np.stack((points[:, 0] - 0.48, points[:, 1] - points[:, 0]), axis=1) / 0.02
        values[points[:, 0] > 0.5] = np.inf
        return values

    _, found = calibrated(halved, box([0, 0], [1, 1], [0.4, 0.4]))
    assert found.profiles[0].high is None
    assert found.profiles[0].low == pytest.approx(0.48 - 0.02 * THRESHOLD**0.5, abs=1e-3)
    assert found.profiles[1].low == pytest.approx(0.48 - 0.02 * (2 * THRESHOLD) ** 0.5, abs=2e-3)


def test_all_failing_ends_with_a_reason():
    search = ProfileLikelihood().start(DECAY_BOX, DECAY_BOX.start, THRESHOLD)
    found = run_profiles(search, lambda points: np.full((len(points), 5), np.inf))
    assert search.reason
    assert found.profiles == ()
    assert search.ask().shape == (0, 3)


def test_one_unknown_and_a_best_on_a_bound():
    _, found = calibrated(lambda points: (points - 1.2) / 0.1, box([0], [1]))
    (only,) = found.profiles
    assert only.high is None
    assert only.low == pytest.approx(1.2 - 0.1 * (4.0 + THRESHOLD) ** 0.5, abs=1e-3)
    assert only.slice.low == pytest.approx(only.low, abs=1e-3)
    assert only.rise.tolist() == [0.0]


def test_replay_and_size_of_batches():
    residuals = rough(decay_residuals(6))
    start = np.array([2.0, 1.3, 0.5])
    first, journal = ProfileLikelihood().start(DECAY_BOX, start, THRESHOLD), []
    while not first.done:
        journal.append((first.ask(), residuals(first.ask())))
        first.tell(journal[-1][1])
    second = ProfileLikelihood().start(DECAY_BOX, start, THRESHOLD)
    for points, values in journal:
        assert np.array_equal(second.ask(), points)
        second.tell(values)
        assert ((points >= DECAY_BOX.low) & (points <= DECAY_BOX.high)).all()
    assert np.array_equal(intervals(second.profiles), intervals(first.profiles))
    # Six sides run side by side: few batches, many points in each.
    assert len(journal) < 80
    assert np.mean([len(points) for points, _ in journal]) > 5
    # One at a time they take longer and find the same.
    third = ProfileLikelihood(batch=1).start(DECAY_BOX, start, THRESHOLD)
    assert np.array_equal(intervals(run_profiles(third, residuals)), intervals(first.profiles))


def test_refusals():
    refused(ProfileLikelihood().start, DECAY_BOX, DECAY_BOX.start, 0.0, match="threshold")
    refused(ProfileLikelihood().start, DECAY_BOX, np.zeros(2), 1.0, match="point")
    refused(ProfileLikelihood, descent=LeastSquares(), batch=0, match="batch")
    with pytest.raises(InvalidInput, match="residuals"):
        ProfileLikelihood().start(DECAY_BOX, DECAY_BOX.start, 1.0).tell(np.zeros((1, 2)))


@pytest.mark.parametrize("best", [(0.3, 0.6), (0.3, 1.2), (0.9, 0.05)])
def test_profiles_and_slices_share_their_points(best):
    """Also where a best lies on a bound, or an interval reaches one."""
    search = ProfileLikelihood().start(box([0, 0], [1, 1]), np.clip(best, 0.0, 1.0), THRESHOLD)
    met = set()
    while not search.done:
        points = search.ask()
        if search.phase != "best fit":
            assert not met & set(map(tuple, points))
        met |= set(map(tuple, points))
        search.tell((points - best) @ np.array([[1.0, 0.4], [0.4, 1.0]]) / 0.1)
    assert len(met) > 20
