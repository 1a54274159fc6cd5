"""Correlations of calibrated parameters, and draws from them."""

import numpy as np
import pytest

import fixel
from fixel.calibration.joint import draw_joint, linear_fit
from fixel.calibration.objective import Comparer
from fixel.testing.pushes import example_pushes


@pytest.fixture(scope="module")
def fit():
    space = {"mu_pusher": (0.0, 1.0), "tripod_radius": (0.02, 0.06)}
    return fixel.calibrate(example_pushes(3), space, verdicts=False, progress=False)


def test_correlation_is_that_of_the_curvature_of_the_error(fit):
    """Second differences of the summed error, computed without any derivative of the motion."""
    comparer = Comparer(fit.targets, fit.space, None, fit.motion)
    step = 0.1 * fit.space.scale
    best = fit.found.point

    def error(a, b):
        point = best + np.array([a, b]) * step
        which = np.arange(len(fit.targets))
        return comparer.errors(which, np.tile(point, (len(which), 1))).error.sum()

    xx = error(1, 0) - 2 * error(0, 0) + error(-1, 0)
    yy = error(0, 1) - 2 * error(0, 0) + error(0, -1)
    xy = (error(1, 1) - error(1, -1) - error(-1, 1) + error(-1, -1)) / 4
    expected = -xy / np.sqrt(xx * yy)
    assert fit.correlation[0, 1] == pytest.approx(expected, abs=0.03)


def test_draws_have_the_given_spread_and_correlation():
    wide = np.array([-100.0, -100.0])
    correlation = np.array([[1.0, -0.8], [-0.8, 1.0]])
    drawn = draw_joint(np.zeros(2), wide, -wide, np.array([1.0, 2.0]), correlation, 20_000, 0)
    assert np.allclose(drawn.std(axis=0), [1.0, 2.0], rtol=0.02)
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(-0.8, abs=0.02)


def test_draws_stay_within_bounds_and_open_ones_fill_them():
    low, high = np.array([0.0, 0.0]), np.array([1.0, 1.0])
    drawn = draw_joint(
        np.array([0.0, 0.3]), low, high, np.array([0.5, np.inf]), np.eye(2), 4_000, 0
    )
    assert (drawn >= 0.0).all()
    assert (drawn <= 1.0).all()
    assert np.quantile(drawn[:, 1], [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.02)
    assert np.quantile(drawn[:, 0], 0.5) == pytest.approx(0.3, abs=0.03)  # half a normal, cut at 1


def test_samples_of_a_frozen_parameter_are_its_value(fit):
    drawn = fit.samples(10)
    assert set(drawn) == {"mu_pusher", "tripod_radius"}
    assert len(drawn["mu_pusher"]) == 10


def test_the_fit_moves_as_it_does_when_an_experiment_is_left_out():
    """The other experiments are calibrated again, by the search of calibrations."""
    pushes = example_pushes(6)
    space = {"mu_pusher": (0.0, 1.0), "tripod_radius": (0.02, 0.06)}

    def best(own):
        return fixel.calibrate(own, space, verdicts=False, progress=False).found.point

    fit = fixel.calibrate(pushes, space, verdicts=False, progress=False)
    comparer = Comparer(fit.targets, fit.space, None, fit.motion)
    found = linear_fit(comparer, fit.found.point).left_out()
    moved = np.array([best(pushes[:k] + pushes[k + 1 :]) for k in range(6)]) - fit.found.point
    assert (np.abs(found - moved).max(axis=0) < 0.5 * np.abs(moved).max(axis=0)).all()
    assert np.corrcoef(found.T, moved.T)[[0, 1], [2, 3]] == pytest.approx(1.0, abs=0.1)
