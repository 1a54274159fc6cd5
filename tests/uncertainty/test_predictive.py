"""Parameter sets and errors of ends with which a calibration predicts fresh pushes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from tests.fixtures import project_of

import fixel
from fixel import Belief, Disk, Fixel
from fixel.testing.pushes import example_pushes
from fixel.testing.scenes import pushed_square
from fixel.uncertainty.predictive import EndError, check_predictions, predictive_of
from fixel.units import mm
from fixel.workflows.calibration.stored import stored_calibration

_SPACE = {"mu_pusher": (0.0, 1.0), "tripod_radius": (10 * mm, 60 * mm)}


@pytest.fixture(scope="module")
def recorded():
    return example_pushes(5, duration=0.8)


@pytest.fixture(scope="module")
def fit(recorded):
    return fixel.calibrate(recorded, _SPACE, motion="quasistatic", progress=False)


def test_the_error_of_ends_is_that_of_the_residuals_of_the_best_fit(fit, recorded):
    """The residuals come from `Calibration.residuals`, which simulates whole tracks."""
    arm = np.sqrt(recorded[0].scene.bodies[0].shape.unit_inertia)
    ends = np.array([fit.residuals(own)[-1] for own in recorded]) * (1.0, 1.0, arm)
    expected = 0.6 * np.sqrt((ends**2).sum() / (3 * len(recorded) - 2))
    assert fit.predictive.error.size == pytest.approx(expected, rel=1e-3)


def test_the_error_grows_with_the_motion_within_limits():
    error = EndError(size=1 * mm, motion=40 * mm)
    found = error.deviation(np.array([0.0, 40 * mm, 80 * mm, 1.0]))
    assert found / mm == pytest.approx([0.2, 1.0, 2.0, 3.0])


def test_the_error_grows_with_the_root_of_motion_times_spread():
    error = EndError(size=1 * mm, motion=40 * mm, spread=0.5 * mm)
    spread = np.array([2.0, 0.5, 0.125, np.nan, 9.0]) * mm
    found = error.deviation(np.array([80, 40, 40, 80, 1]) * mm, spread)
    assert found / mm == pytest.approx([6.0**0.5, 1.0, 0.5, 2.0, 0.6**0.5])
    assert EndError(1 * mm, 40 * mm).deviation(80 * mm, 2 * mm) == 2 * mm  # no spread is known


def test_the_usual_spread_is_that_of_recorded_ends_in_simulations(fit, recorded):
    """Ends with each parameter set, simulated alone; turns count at the radius of gyration."""
    drawn, spreads = fit.predictive.samples(200, 0, {}), []
    for own in recorded:
        runs = fixel.simulate_batch(
            own.scene, drawn, motion="quasistatic", duration=float(own.trajectory.time[-1])
        )
        arm = np.sqrt(own.scene.bodies[0].shape.unit_inertia)
        end = runs["part"].final
        deviation = np.std([end.x, end.y, arm * end.theta], axis=1)
        spreads.append(np.sqrt(np.mean(deviation**2)))
    assert fit.predictive.error.spread == pytest.approx(np.mean(spreads), rel=0.2)


def test_drawn_errors_have_the_distribution_of_student_with_two_degrees_of_freedom():
    """Each coordinate by SciPy's; the sum of squares over 3 by the F distribution (3, 2)."""
    drawn = EndError.draws(np.random.default_rng(1), (40, 500)).reshape(-1, 3)
    for column in drawn.T:
        assert stats.kstest(column, stats.t(2).cdf).pvalue > 1e-3
    assert stats.kstest((drawn**2).sum(axis=1) / 3, stats.f(3, 2).cdf).pvalue > 1e-3


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
    far = np.ones((5, 2)) * (0.5, 20 * mm)  # so that no sample misses more than left-out pushes
    found = predictive_of(fit.targets, space, fit.motion, best, best, points, far)
    shrunk = best + 0.7 * (points - best)
    off, usual = (np.abs(own - best).mean(axis=0) for own in (found.points, shrunk))
    assert (off < 0.97 * usual).all()


def _misses(recorded, points):
    """Sum over pushes of squared misses of ends (n,) at points (n, 2), by single simulations."""
    total = np.zeros(len(points))
    for own in recorded:
        arm = np.sqrt(own.scene.bodies[0].shape.unit_inertia)
        for k, point in enumerate(points):
            values = dict(zip(_SPACE, point.tolist(), strict=True))
            end = fixel.simulate(own.scene, values).pose["part"][-1]
            off = (end - own.trajectory.pose[-1]) * (1.0, 1.0, arm)
            total[k] += (off**2).sum()
    return total


@pytest.fixture(scope="module")
def wide_samples(fit):
    """Wide samples of the parameters, and how far the fit moves without one push."""
    rng = np.random.default_rng(3)
    moved = rng.choice((-1.0, 1.0), (5, 2)) * (0.06, 3 * mm)
    points = fit.found.point + rng.standard_normal((256, 2)) * (0.18, 8 * mm)
    return np.clip(points, fit.space.low, fit.space.high), moved


def test_samples_miss_recorded_ends_as_far_as_fits_without_them_do(fit, recorded, wide_samples):
    points, moved = wide_samples
    best = fit.found.point
    found = predictive_of(fit.targets, fit.space, fit.motion, best, best, points, moved)
    left_out = sum(
        _misses([own], best + step[None])[0] for own, step in zip(recorded, moved, strict=True)
    )
    assert np.median(_misses(recorded, best + 0.7 * (points[:64] - best))) > 1.3 * left_out
    usual = np.median(_misses(recorded, found.points[::4]))
    assert 0.4 * left_out < usual < 1.1 * left_out  # likelier sets come more often
    assert (np.abs(found.points - best) < 0.7 * np.abs(points - best).max(axis=0)).all()


def test_samples_keep_some_distance_from_the_values(fit, wide_samples):
    """Samples keep 0.3 of their distance, even where fits without a push do not move."""
    points, moved = wide_samples
    best = fit.found.point
    found = predictive_of(fit.targets, fit.space, fit.motion, best, best, points, 0.0 * moved)
    allowed = best + 0.3 * (points - best)
    assert all(np.isclose(allowed, own, rtol=1e-9).all(axis=1).any() for own in found.points)


def test_ends_among_fixels_do_not_move_samples(fit, wide_samples):
    points, moved = wide_samples
    best = fit.found.point
    pin = Fixel("pin", Disk(5 * mm), pose=(1.0, 1.0, 0.0), friction=0.2)
    targets = [
        own._replace(case=own.case._replace(scene=replace(own.case.scene, fixels=(pin,))))
        for own in fit.targets
    ]
    found = predictive_of(targets, fit.space, fit.motion, best, best, points, 0.0 * moved)
    allowed = best + 0.7 * (points - best)
    assert all(np.isclose(allowed, own, rtol=1e-9).all(axis=1).any() for own in found.points)
    assert found.error.spread == 0.0  # nor do they have a spread


def test_a_belief_takes_the_error_of_the_calibration_unless_scatter_is_given(fit):
    scene = pushed_square()
    own = Belief(parameters=fit).scenarios(scene, worlds=8, runs=4)
    assert own.end_error == fit.predictive.error
    assert own.misfit.std() > 0.0
    scattered = Belief(parameters=fit, run_to_run=fixel.RunToRun())
    assert scattered.scenarios(scene, worlds=8, runs=4).end_error is None


@pytest.mark.system
def test_ends_are_checked_against_predictions_of_the_other_pushes(fit, recorded):
    """The others are calibrated again; regions are the nearest 90 % of predicted ends."""
    inside = 0
    for k, own in enumerate(recorded):
        rest = recorded[:k] + recorded[k + 1 :]
        others = fixel.calibrate(rest, _SPACE, motion="quasistatic", progress=False)
        inside += _predicts(others, own)
    assert fit.prediction_check == (inside, len(recorded), 0.9)


def test_an_end_far_from_all_predictions_is_not_held(recorded):
    pose = recorded[2].trajectory.pose.copy()
    pose[1:] += np.linspace(0.0, 1.0, len(pose))[1:, None] * (0.0, 20 * mm, 0.0)
    off = replace(recorded[2], trajectory=replace(recorded[2].trajectory, pose=pose))
    pushes = [*recorded[:2], off, *recorded[3:]]
    fit = fixel.calibrate(pushes, _SPACE, motion="quasistatic", progress=False)
    assert fit.prediction_check == (4, 5, 0.9)


def test_the_check_is_stored_with_the_calibration(recorded, tmp_path):
    project = project_of(tmp_path / "lab", recorded)
    options = {"motion": "quasistatic", "store": project, "progress": False}
    own = fixel.calibrate(project.experiments(), _SPACE, **options)
    assert own.prediction_check.of == 5
    stored = stored_calibration(project, own.run.ids[0])
    assert stored.prediction_check == own.prediction_check
    assert repr(stored) == repr(own)


def test_few_pushes_are_not_checked(recorded):
    fit = fixel.calibrate(recorded[:3], _SPACE, motion="quasistatic", progress=False)
    assert fit.prediction_check == (0, 0, 0.9)
    assert "predictions not checked: that takes 4 experiments" in str(fit)


def test_recordings_in_which_nothing_moves_are_not_checked(recorded):
    still = []
    for k, own in enumerate(recorded[:3]):
        pose = np.tile(own.scene.bodies[0].pose, (len(own.trajectory.time), 1))
        pose += np.random.default_rng(k).normal(size=pose.shape) * (0.1 * mm, 0.1 * mm, 1e-3)
        drive = replace(own.scene.pushers[0].drive, travel=0.0)
        scene = replace(own.scene, pushers=(replace(own.scene.pushers[0], drive=drive),))
        trajectory = replace(own.trajectory, pose=pose)
        still.append(replace(own, name=f"still-{k}", scene=scene, trajectory=trajectory))
    fit = fixel.calibrate([*recorded, *still], _SPACE, motion="quasistatic", progress=False)
    assert fit.prediction_check.of == len(recorded)


def test_pushes_among_fixels_are_not_checked(fit):
    fixel_far_away = Fixel("pin", Disk(5 * mm), pose=(1.0, 1.0, 0.0), friction=0.2)
    targets = [
        own._replace(
            case=own.case._replace(scene=replace(own.case.scene, fixels=(fixel_far_away,)))
        )
        for own in fit.targets
    ]
    best, moved = fit.found.point, np.zeros((len(targets), 2))
    assert check_predictions(fit.predictive, targets, fit.motion, best, moved) == (0, 0)


def _predicts(fit, experiment):
    """Whether a recorded end is among the 90 % of drawn ends that are nearest to their mean."""
    scene, rng = experiment.scene, np.random.default_rng(0)
    arm = np.sqrt(scene.bodies[0].shape.unit_inertia)
    drawn = fit.predictive.samples(64, 0, {})
    ends = []
    for k in range(64):
        values = {name: column[k] for name, column in drawn.items()}
        duration = float(experiment.trajectory.time[-1])
        run = fixel.simulate(scene, values, motion="quasistatic", duration=duration)
        ends.append(run.pose["part"][-1] * (1.0, 1.0, arm))
    ends = np.array(ends)
    motion = np.hypot(*ends.T[:2]) + np.abs(ends[:, 2])  # the part starts at the origin
    size = fit.predictive.error.deviation(motion, np.sqrt(np.var(ends, axis=0).mean()))
    drawn = rng.standard_normal((64, 400, 3)) / rng.chisquare(2, (64, 400, 1)) ** 0.5
    errors = np.sqrt(2.0) * size[:, None, None] * drawn
    inverse = np.linalg.inv(np.cov(ends.T) + np.median(errors**2) / 0.667 * np.eye(3))

    def distance(to):
        off = to - ends.mean(axis=0)
        return np.einsum("...i,ij,...j->...", off, inverse, off)

    measured = experiment.trajectory.pose[-1] * (1.0, 1.0, arm)
    return np.mean(distance(ends[:, None] + errors) < distance(measured)) < 0.9
