"""Levenberg-Marquardt compared with SciPy's; priors, roughness, failures, replay."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.calibration.toys import DECAY_BOX, box, decay_residuals, each, linear, rough
from tests.fixtures import refused
from tests.reference.more_wild import powell_singular, rosenbrock

from fixel.calibration.least_squares import STUCK, Cost, LeastSquares, NormalPrior, fit
from fixel.errors import InvalidInput

T = np.linspace(0.0, 4.0, 40)
WAVY = 2.0 * np.exp(-1.3 * T) + 0.5 + 0.1 * np.sin(9.0 * T)


def exponential(p):
    return p[0] * np.exp(-p[1] * T) + p[2] - WAVY


def outlying(p):
    return exponential(p) + np.where(np.arange(len(T)) % 9 == 4, 3.0, 0.0)


PROBLEMS = {
    "rosenbrock": (rosenbrock, box([-2, -2], [2, 2], [-1.2, 1.0])),
    "rosenbrock at a bound": (rosenbrock, box([-2, 1.5], [2, 2], [-1.2, 1.7])),
    "powell's singular": (powell_singular, box([-4] * 4, [4] * 4, [3, -1, 0, 1])),
    "exponential": (exponential, box([0, 0, -1], [5, 5, 1], [1, 0.3, 0])),
    "exponential at a bound": (exponential, box([0, 0, -1], [5, 1, 1], [1, 0.3, 0])),
    "exponential with outliers": (outlying, box([0, 0, -1], [5, 5, 1], [1, 0.3, 0])),
}


@pytest.mark.parametrize("loss", ["squares", "soft_l1", "huber"])
@pytest.mark.parametrize("name", PROBLEMS)
def test_same_minimum_as_scipy(name, loss):
    residuals, where = PROBLEMS[name]
    ours = LeastSquares(loss=loss, width=0.1, roughness=0.0, difference=1e-5, tolerance=1e-11)
    found = fit(ours.start(where), each(residuals))
    theirs = least_squares(
        residuals, where.start, bounds=(where.low, where.high),
        loss="linear" if loss == "squares" else loss, f_scale=0.1, xtol=1e-12, ftol=1e-12,
        gtol=1e-12,
    )  # fmt: skip
    # Theirs is half the sum of losses. At Powell's minimum the derivatives have rank 2 and both
    # stop at points whose deviance, not place, is near zero.
    assert found.deviance == pytest.approx(2.0 * theirs.cost, rel=1e-6, abs=1e-7)
    if "powell" not in name:
        np.testing.assert_allclose(found.point, theirs.x, atol=2e-4)


def test_evaluations_are_within_a_few_times_those_of_scipy():
    residuals, where = PROBLEMS["exponential"]
    found = fit(LeastSquares(roughness=0.0).start(where), each(residuals))
    theirs = least_squares(residuals, where.start, bounds=(where.low, where.high))
    assert found.evaluations <= 3 * theirs.nfev * (1 + where.n)


def test_prior_is_a_ridge():
    residuals, matrix, _ = linear()
    mean, sd = np.array([0.5, 0.5, 0.5]), np.array([0.01, np.inf, 0.05])
    where = box([0] * 3, [1] * 3)
    found = fit(LeastSquares().start(where, prior=NormalPrior(mean=mean, sd=sd)), residuals)
    weight = np.diag(1.0 / sd**2)
    data = matrix.T @ -residuals(np.zeros((1, 3)))[0]
    expected = np.linalg.solve(matrix.T @ matrix + weight, data + weight @ mean)
    np.testing.assert_allclose(found.point, expected, atol=1e-4)
    np.testing.assert_allclose(found.hessian, matrix.T @ matrix + weight, rtol=1e-5)
    apart = np.sum(((found.point - mean) / sd) ** 2)
    assert found.deviance == pytest.approx(np.sum(residuals(found.point[None]) ** 2) + apart)


def test_weighted_prior_keeps_its_weight_with_dispersed_residuals():
    prior = NormalPrior(mean=np.zeros(1), sd=np.ones(1))
    assert prior.weighted(4.0).deviance([[1.0]]) / 4.0 == pytest.approx(prior.deviance([[1.0]]))


def test_robust_loss_is_not_pulled_by_a_wrong_measurement():
    def line(p):
        return np.append(p[0] - np.array([0.48, 0.5, 0.51, 0.49]), p[0] - 9.0) / 0.01

    where = box([0], [10])
    assert fit(LeastSquares().start(where), each(line)).point[0] > 2.0
    for loss in ("soft_l1", "huber"):
        found = fit(LeastSquares(loss=loss).start(where), each(line))
        assert found.point[0] == pytest.approx(0.5, abs=0.011)


@pytest.mark.parametrize("size", [1e-4, 1e-3, 1e-2])
def test_roughness_moves_the_fit_by_less_than_the_noise_does(size):
    smooth, where = decay_residuals(3), DECAY_BOX
    clean = fit(LeastSquares().start(where), smooth)
    spread = np.sqrt(np.diag(np.linalg.inv(clean.hessian)))
    # One path depends on the last bits of this machine; many phases of the roughness do not.
    found = [
        fit(LeastSquares(roughness=size).start(where), rough(smooth, size, offset=offset))
        for offset in np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ]
    moved = np.array([(np.abs(one.point - clean.point) / spread).max() for one in found])
    worse = np.array([one.deviance - clean.deviance for one in found])
    # The jumps alone change the deviance by 2 . 0.05 . |residuals| / sqrt(2), about 0.5.
    assert np.median(moved) < 0.5
    assert moved.max() < 1.0
    assert np.median(worse) < 0.3
    assert worse.max() < 1.5
    assert max(one.evaluations for one in found) < 400


def test_failed_points_are_stepped_around():
    smooth = decay_residuals(3)

    def holed(points):
        values = smooth(points)
        values[(points[:, 1] > 1.0) & (points[:, 1] < 1.1) & (points[:, 0] < 1.9)] = np.inf
        values[points[:, 2] < -0.1] = np.inf
        return values

    found = fit(LeastSquares().start(DECAY_BOX), holed)
    clean = fit(LeastSquares().start(DECAY_BOX), smooth)
    np.testing.assert_allclose(found.point, clean.point, atol=1e-3)


def test_neighbours_that_fail_leave_a_parameter_where_it_is():
    def narrow(points):
        values = np.stack((points[:, 0] - 0.3, points[:, 1] - 0.4), axis=1)
        values[points[:, 1] != 0.5] = np.inf
        return values / 0.01

    found = fit(LeastSquares().start(box([0, 0], [1, 1])), narrow)
    np.testing.assert_allclose(found.point, [0.3, 0.5], atol=1e-5)


def test_all_failing_ends_with_a_reason():
    search = LeastSquares(starts=3).start(DECAY_BOX)
    found = fit(search, lambda points: np.full((len(points), 5), np.inf))
    assert found.deviance == np.inf
    assert "could be evaluated" in search.reason
    assert np.isfinite(found.point).all()
    assert np.isfinite(found.hessian).all()
    assert search.ask().shape == (0, 3)


def test_nothing_that_answers_ends_with_a_reason():
    found = fit(LeastSquares().start(DECAY_BOX), lambda points: np.ones((len(points), 5)))
    assert "do not depend" in found.reason


def test_replay_asks_for_the_same_points_and_stays_in_the_box():
    residuals = rough(decay_residuals(5))
    first, journal = LeastSquares(starts=4).start(DECAY_BOX, seed=2), []
    while not first.done:
        journal.append((first.ask(), residuals(first.ask())))
        first.tell(journal[-1][1])
    second = LeastSquares(starts=4).start(DECAY_BOX, seed=2)
    for points, values in journal:
        assert np.array_equal(second.ask(), points)
        assert np.array_equal(second.ask(), points)
        second.tell(values)
        assert ((points >= DECAY_BOX.low) & (points <= DECAY_BOX.high)).all()
    assert second.done
    assert second.best.error == first.best.error
    assert second.evaluations == sum(len(points) for points, _ in journal)


def test_several_starts_find_the_deeper_of_two_minima():
    def two(points):
        return np.concatenate(((points - 0.2) * (points - 0.7) / 0.02, 2.0 * (points - 0.7)), 1)

    where = box([0], [1], [0.1])
    assert fit(LeastSquares().start(where), two).point[0] == pytest.approx(0.2, abs=0.05)
    search = LeastSquares(starts=4).start(where)
    assert fit(search, two).point[0] == pytest.approx(0.7, abs=1e-5)
    assert len(search.fits) == 4
    assert search.best.error == search.fits[0].deviance


def test_one_trial_and_each_kind_of_difference_work():
    residuals = decay_residuals(4)
    best = fit(LeastSquares().start(DECAY_BOX), residuals)
    for options in (
        LeastSquares(trials=1),
        LeastSquares(trials=4, differences="one-sided"),
        LeastSquares(differences="central"),
    ):
        found = fit(options.start(DECAY_BOX), residuals)
        np.testing.assert_allclose(found.point, best.point, atol=2e-3)


def test_no_point_is_requested_twice_where_no_step_helps():
    """A weak slope that a ripple hides: all differences have their largest step already."""

    def rippled(points):
        slope = 0.3 * (points - np.array([0.3, 0.4])) / 0.1
        return slope + 0.05 * np.sin(1e7 * points + np.arange(2))

    seen = []

    def noted(points):
        seen.extend(map(tuple, points))
        return rippled(points)

    assert fit(LeastSquares().start(box([0, 0], [1, 1])), noted).reason == STUCK
    assert len(seen) - len(set(seen)) <= 3


def test_an_edge_on_all_sides_does_not_shrink_steps_for_ever():
    def cornered(points):
        values = (points - np.array([0.3, 0.4])) / 0.01
        values[:, 0] += 1e150 * (points[:, 1] != 0.5)
        return values

    found = fit(LeastSquares().start(box([0, 0], [1, 1])), cornered)
    assert np.isfinite(found.hessian).all()
    assert found.reason


def test_overflow_is_a_failure():
    assert Cost().deviance(np.zeros((1, 1)), np.full((1, 3), 1e200))[0] == np.inf
    assert Cost().deviance(np.zeros((1, 1)), np.full((1, 3), np.nan))[0] == np.inf


def test_refusals():
    refused(LeastSquares, loss="cubes", match=r"LeastSquares\.loss")
    refused(LeastSquares, trials=0, match=r"LeastSquares\.trials")
    refused(LeastSquares, difference=0.0, match=r"LeastSquares\.difference")
    with pytest.raises(InvalidInput, match="prior"):
        LeastSquares().start(DECAY_BOX, prior=NormalPrior(mean=np.zeros(2), sd=np.ones(2)))
    refused(NormalPrior, mean=np.zeros(2), sd=np.zeros(2), match="prior")
    refused(LeastSquares().start(DECAY_BOX).tell, np.zeros((1, 5)), match="residuals")
