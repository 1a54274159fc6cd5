"""Parameter sets and errors of ends with which a calibration predicts fresh pushes."""

import numpy as np
import pytest

import fixel
from fixel.planning.belief import Belief
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.uncertainty.predictive import EndError, predictive_of
from fixel.units import mm


@pytest.fixture(scope="module")
def recorded():
    return example_pushes(5, duration=0.8)


@pytest.fixture(scope="module")
def fit(recorded):
    space = {"mu_pusher": (0.0, 1.0), "tripod_radius": (10 * mm, 60 * mm)}
    return fixel.calibrate(recorded, space, motion="quasistatic", progress=False)


def test_the_error_of_ends_is_that_of_the_residuals_of_the_best_fit(fit, recorded):
    """The residuals come from `Calibration.residuals`, which simulates whole tracks."""
    arm = np.sqrt(recorded[0].scene.bodies[0].shape.unit_inertia)
    ends = np.array([fit.residuals(own)[-1] for own in recorded]) * (1.0, 1.0, arm)
    expected = np.sqrt((ends**2).sum() / (3 * len(recorded) - 2))
    assert fit.predictive.error.size == pytest.approx(expected, rel=1e-3)


def test_the_error_grows_with_the_motion_within_limits():
    error = EndError(size=1 * mm, motion=40 * mm)
    found = error.deviation(np.array([0.0, 40 * mm, 80 * mm, 1.0]))
    assert found / mm == pytest.approx([0.2, 1.0, 2.0, 3.0])


def test_parameter_sets_are_nearer_to_the_values_than_samples_are(fit):
    wide = fit.samples(512, 0)
    drawn = fit.predictive.samples(512, 0, {})
    for name, estimate in fit.estimates.items():
        spread = np.sqrt(np.mean((wide[name] - estimate.value) ** 2))
        assert np.sqrt(np.mean((drawn[name] - estimate.value) ** 2)) < 0.85 * spread


def test_sets_that_reproduce_the_recorded_ends_come_more_often(fit):
    """Parameter sets near the values of the twin come more often than others of the space."""
    space, best = fit.space, fit.found.point
    points = np.random.default_rng(0).uniform(space.low, space.high, (512, 2))
    found = predictive_of(fit.targets, space, fit.motion, best, best, points)
    shrunk = best + 0.7 * (points - best)
    off, usual = (np.abs(own - best).mean(axis=0) for own in (found.points, shrunk))
    assert (off < 0.97 * usual).all()


def test_a_belief_takes_the_error_of_the_calibration_unless_scatter_is_given(fit):
    scene = pushed_square()
    own = Belief(parameters=fit).scenarios(scene, worlds=8, runs=4)
    assert own.end_error == fit.predictive.error
    assert own.misfit.std() > 0.0
    scattered = Belief(parameters=fit, run_to_run=fixel.RunToRun())
    assert scattered.scenarios(scene, worlds=8, runs=4).end_error is None
